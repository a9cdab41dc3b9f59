"""Perturbations: constant deviations of each vehicle from the nominal model, with one meaning in all plants.

A perturbation is one row of an (n, 7) array. The neutral row changes nothing, bit for bit.
"""

import numpy as np

from inclined_landing.models.base.errors import UserError

NAMES = (
    "thrust_scale",  # total thrust times this
    "thrust_bias",  # N added to the total thrust
    "lag_scale",  # time constant of the thrust lag times this
    "drag_change",  # rotor drag times (1 + this)
    "gain_scale",  # attitude gain k times this
    "time_constant_scale",  # attitude time constant tau times this
    "mass_scale",  # mass times this, inertia unchanged
)
THRUST_SCALE, THRUST_BIAS, LAG_SCALE, DRAG_CHANGE = 0, 1, 2, 3
GAIN_SCALE, TIME_CONSTANT_SCALE, MASS_SCALE = 4, 5, 6
NEUTRAL = (1.0, 0.0, 1.0, 0.0, 1.0, 1.0, 1.0)
_POSITIVE = {"lag_scale", "time_constant_scale", "mass_scale"}


def neutral(n: int) -> np.ndarray:
    """Return the (n, 7) perturbation that changes nothing."""
    return np.tile(np.array(NEUTRAL), (n, 1))


def perturb(rows: np.ndarray, **changes) -> np.ndarray:
    """Return a copy of `rows` (n, 7) with named columns set to a number or an (n,) array.

    Raises UserError on an unknown name, a value that is not finite, or a non-positive scale.
    """
    rows = rows.copy()
    for name, value in changes.items():
        if name not in NAMES:
            raise UserError(f"unknown perturbation {name!r}; choose from {', '.join(NAMES)}")
        value = np.asarray(value, float)
        if not np.isfinite(value).all() or (name in _POSITIVE and (value <= 0).any()):
            raise UserError(f"perturbation {name} must be finite and scales must be positive")
        rows[:, NAMES.index(name)] = value
    return rows
