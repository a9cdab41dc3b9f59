"""Model (form) errors: what the formula of an effect may have wrong, as columns beside its own.

No formula is exact. What an effect contributes to the prediction is, in reality, some percent larger or
smaller at more load, at speed, in a climb, late in a flight, along one axis, or comes a little later. Each of
these is a column: the contribution times such a quantity of order one, with a normal weight as wide as the
effect's `form`, free while the effect is named. Without them an error of the formula that all flights share
would be evidence for a second effect, and the surer the more flights there are. What the base model
predicts - thrust, drag, the answers of the loops - has such columns always.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from inclined_landing.eval.gap.flights.windows import Measured

LAG = 0.03  # s, by which a contribution may come later
_LOAD, _SPEED, _CLIMB, _TIME = 0.2, 1.0, 0.5, 20.0  # of hover thrust, m/s, m/s, s: quantities of order one
_ANGLE, _TURN = 0.2, 1.0  # rad, rad/s
TRANSLATION, TILT, YAW = slice(0, 3), slice(3, 5), slice(5, 6)
FORMS = {
    "translation": ("load", "speed", "climb", "time", "vertical", "late"),
    "attitude": ("angle", "load", "time", "roll", "late"),
    "yaw": ("turn", "time", "late"),
}
# Of the base model, with the standard deviations of their weights.
BASE = {
    **{f"thrust {what}": 0.02 for what in ("load", "speed", "climb", "time")},
    **{f"drag {what}": 0.1 for what in ("load", "speed", "climb", "x")},
    **{f"attitude {what}": 0.05 for what in ("angle", "load", "time", "roll")},
    "attitude bend": 0.3,
    **{f"yaw {what}": 0.05 for what in ("turn", "time")},
}
GROUPS = {"translation": TRANSLATION, "attitude": TILT, "yaw": YAW}


def forms_of(channels: tuple[str, ...]) -> list[str]:
    """Names of the form errors of an effect that shows in some channels."""
    acts = [group for group in FORMS if group in channels]
    names = [f"{group} {name}" for group in acts for name in FORMS[group]]
    return names + [f"{group} all" for group in acts[1:]]


def column(name: str, contribution: np.ndarray, flight: Measured) -> np.ndarray:
    """(m, 6) what a prediction changes by when a contribution (m, 6) is off by one such error."""
    group, what = name.split()
    own = GROUPS[group]
    result, part = np.zeros_like(contribution), contribution[:, own]
    if what == "all":
        result[:, own] = part
    elif what == "late":
        result[:, own] = -LAG * np.gradient(part, flight.dt, axis=0)
    elif what == "bend":  # of the loop's answer: one order more
        result[:, own] = LAG**2 * np.gradient(np.gradient(part, flight.dt, axis=0), flight.dt, axis=0)
    elif what == "vertical":
        result[:, 2] = contribution[:, 2]
    elif what == "roll":
        result[:, 3] = contribution[:, 3]
    elif own == TRANSLATION:
        result[:, own] = _moved(np.diff(part, 2, axis=0), what, flight)
    else:
        result[:, own] = part * _quantity(what, flight)[:, None]
    return result


def base_column(name: str, predicted: np.ndarray, gravity: float, flight: Measured) -> np.ndarray:
    """(m, 6) what a prediction (m, 6) of the base model changes by when it is off by one such error."""
    group, what = name.split()
    if group not in ("thrust", "drag"):
        return column(name, predicted, flight)
    # Of the acceleration without gravity, thrust is what lies along the body's z axis, drag the rest.
    moved = np.diff(predicted[:, :3], 2, axis=0)
    moved[:, 2] += gravity * flight.dt**2
    rotation = flight.middle_rotation[1:]
    axial = np.einsum("ki,ki->k", rotation[:, :, 2], moved)[:, None] * rotation[:, :, 2]
    result, part = np.zeros_like(predicted), axial if group == "thrust" else moved - axial
    if what == "x":
        part = np.einsum("ki,ki->k", rotation[:, :, 0], part)[:, None] * rotation[:, :, 0]
    result[:, TRANSLATION] = _moved(part, what, flight)
    return result


def _moved(second: np.ndarray, what: str, flight: Measured) -> np.ndarray:
    """(m, 3) positions that come of second differences (m - 2, 3) times a quantity."""
    bent = second if what == "x" else second * _quantity(what, flight)[1:-1, None]
    return np.vstack([np.zeros((2, 3)), np.cumsum(np.cumsum(bent, axis=0), axis=0)])


def _quantity(what: str, flight: Measured) -> np.ndarray:
    """(m,) what goes with a form error, of order one."""
    if what == "load":
        pwm = flight.command[:, 0]
        share = np.exp(-flight.dt / 0.065)
        lagged = lfilter([1.0 - share], [1.0, -share], pwm - pwm[0]) + pwm[0]
        return (lagged / np.median(pwm[flight.usable]) - 1.0) / _LOAD
    if what == "speed":
        return np.hypot(flight.velocity[:, 0], flight.velocity[:, 1]) / _SPEED
    if what == "climb":
        return flight.velocity[:, 2] / _CLIMB
    if what == "time":
        return flight.t / _TIME
    if what == "angle":
        return np.hypot(flight.command[:, 1], flight.command[:, 2]) / _ANGLE
    return np.abs(flight.command[:, 3]) / _TURN
