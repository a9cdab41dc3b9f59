"""Parameters of MuJoCo's contact spring for a given restitution and contact time.

MuJoCo's contact is a damped spring on accelerations that pushes and never pulls. While the vehicle
overlaps a surface, its height over the first touch follows

    r'' = -2 beta r' - omega^2 r,   r(0) = 0, r'(0) = -speed,

until r = 0 or until the surface would have to pull it down, r'' < -g. `solref` finds the spring that throws a
drop at REFERENCE_SPEED back with the wanted share of its speed after the wanted time, and writes it in
the engine's direct format, (-stiffness, -damping).

Measured by drop tests of this vehicle on four feet, RK4 at 4 ms, eight phases of the touch within a step
(`landing-eval contact` repeats them). At the reference speed:

- restitutions from 0.1 are met within 0.02 on average (0.04 at the shortest contact time), with a scatter
  of 0.02 to 0.05 by the phase of the touch, half of it at 2 ms;
- the contact time is met within 1 ms;
- below 0.1 the vehicle stays down or leaves at a few cm/s, because of its weight.

Slower drops rebound less and faster ones more (set 0.3: 0.25 at 0.5 m/s, 0.33 at 2 m/s; set 0.6: 0.58 and
0.61), because the weight acts on them for the same time. The feet sink in by up to speed times contact
time / pi. Up to half of `Vehicle.slab_depth` the engine pushes them out at the upper side: none of 1 000
drops at 1 to 6 m/s passes, at any restitution, contact time and slope of the ranges, nor of as many onto
slabs that move and into the walls of the base.

A damper pushes with all its force at once where it is touched. Seen at steps of 4 ms only, that jump would
keep a springy vehicle trembling at rest by up to 2 cm/s, and creeping. So the first millimetre of every
contact is softened (`solimp` of the scene, 0.5 at the touch): four feet at rest stand 0.2 to 0.4 mm deep.
Friction acts within 1 / damping (5 ms for the default, 16 ms at 0.5), so that short touches slide more; a
vehicle at rest creeps by less than 0.2 mm/s (`impratio`). Beyond 0.6 tilted touches often end with more
energy than they began with, at any step: this is why the range ends there (at 0.6 it is one in a hundred).
"""

from __future__ import annotations

import math

import numpy as np

from inclined_landing.models.base.errors import UserError
from inclined_landing.models.compiled import inner, unlocked

REFERENCE_SPEED = 1.0  # m/s, normal speed of the drop that the setting is about
FRICTION = (0.0, 10.0)  # the vehicle file's range
# Reach of the feet over the nominal one: with less they would not stay below the body's collision box.
FOOT_HEIGHT = (0.6, 3.0)
RESTITUTION = (0.0, 0.6)  # supported range; above, tilted touches with friction gain energy
FASTEST = 6.0  # m/s, normal speed at which a touch is still pushed out at the upper side
# s; from three steps of 4 ms to six: at pi/2 0.1 m/FASTEST = 26 ms feet sink in by half of the slab's depth.
CONTACT_TIME = (0.012, 0.024)
# The impedance d of a contact deeper than 1 mm, from the scene's solimp. With four feet down the effective
# one is 4 d/(1 + 3 d), because the engine softens each contact as if it carried the vehicle alone.
_IMPEDANCE = 0.95
_EFFECTIVE = 4 * _IMPEDANCE / (1 + 3 * _IMPEDANCE)
# Drop tests: the engine's softer first millimetre, which the formula leaves out, takes some restitution.
_MEASURED = (0.0, 0.10, 0.172, 0.237, 0.357, 0.472, 0.581, 0.688, 0.795, 0.897, 0.948)
_OF_SPRING = (0.0, 0.20, 0.25, 0.30, 0.40, 0.50, 0.60, 0.70, 0.80, 0.90, 0.95)


def within(value, low: float, high: float, what: str, unit: str = "") -> np.ndarray:
    """Return `value` as an array if all of it is from `low` to `high`, else raise UserError."""
    value = np.asarray(value, float)
    outside = ~((value >= low - 1e-12) & (value <= high + 1e-12))
    if outside.any():
        wrong = float(value[outside].flat[0])
        raise UserError(f"{what} must be from {low:g} to {high:g}{unit}, not {wrong:g}{unit}")
    return value


def solref(restitution, contact_time, gravity: float) -> np.ndarray:
    """Return MuJoCo's solref (..., 2) for restitution and contact time [s], broadcast against each other.

    restitution: speed after a drop at REFERENCE_SPEED on four feet over the speed before it.
    contact_time: time for which the surface pushes in that drop; without rebound, the time until the vehicle
    hardly moves.
    gravity: m/s2, positive.

    Raises UserError outside the supported ranges.
    """
    restitution = within(restitution, *RESTITUTION, "restitution")
    return spring(restitution, within(contact_time, *CONTACT_TIME, "contact time", " s"), gravity)


def spring(restitution, contact_time, gravity: float) -> np.ndarray:
    """Return `solref` without its limits, for fits: restitution up to 0.95 and any contact time [s]."""
    e, time = np.broadcast_arrays(np.asarray(restitution, float), np.asarray(contact_time, float))
    # Each pair is solved once: studies repeat theirs.
    pairs, of_each = np.unique(np.stack([e.ravel(), time.ravel()], axis=1), axis=0, return_inverse=True)
    out = np.empty_like(pairs)
    _solve(np.interp(pairs[:, 0], _MEASURED, _OF_SPRING), pairs[:, 1].copy(), gravity, out)
    # Effective: damping * EFFECTIVE / d_w and stiffness * d EFFECTIVE / d_w^2, with d = d_w.
    return (-out * _IMPEDANCE / _EFFECTIVE)[of_each.ravel()].reshape(*e.shape, 2)


@inner
def _bounce(damping, weight):
    """Return restitution and end of contact of the spring r'' = -2 damping r' - r with speed 1 at r = 0.

    damping: ratio, 0 <= damping < 1; weight: gravity over (speed times natural frequency).
    Time in units of 1 / natural frequency. Each derivative of r turns the phase by arccos(damping).
    """
    w = math.sqrt(1.0 - damping * damping)
    turn = math.acos(damping)
    low, high = 2.0 * turn / w, min(3.0 * turn, math.pi) / w
    if -math.exp(-damping * high) * math.sin(w * high - 2.0 * turn) / w > -weight:
        return math.exp(-damping * math.pi / w), math.pi / w  # the spring is fully relaxed at the end
    for _ in range(40):
        middle = 0.5 * (low + high)
        if -math.exp(-damping * middle) * math.sin(w * middle - 2.0 * turn) / w > -weight:
            low = middle
        else:
            high = middle
    return math.exp(-damping * high) * math.sin(w * high - turn) / w, high


@inner
def _last_bouncing(weight):
    """Return the damping ratio, from 0.5 to 1, above which the weight keeps the vehicle down."""
    low, high = 0.5, 1.0 - 1e-6
    for _ in range(40):
        middle = 0.5 * (low + high)
        w = math.sqrt(1.0 - middle * middle)
        if math.exp(-3.0 * middle * math.acos(middle) / w) > weight:
            low = middle
        else:
            high = middle
    return low


@inner
def _spring(e, time, gravity):
    """Return damping ratio and natural frequency [rad/s] for restitution e and contact time [s]."""
    frequency, damping = math.pi / time, 0.5
    for _ in range(30):
        weight = gravity / (REFERENCE_SPEED * frequency)
        limit = _last_bouncing(weight)
        least = _bounce(limit, weight)[0] if limit > 0.5 else math.exp(-math.pi / math.sqrt(3.0))
        if e >= least:
            low, high = 0.0, limit
            for _ in range(40):
                damping = 0.5 * (low + high)
                if _bounce(damping, weight)[0] > e:
                    low = damping
                else:
                    high = damping
            end = _bounce(damping, weight)[1]
        else:
            damping = limit + (1.0 - 1e-6 - limit) * (1.0 - e / least)
            end = 3.0 * math.acos(damping) / math.sqrt(1.0 - damping * damping)
        before, frequency = frequency, end / time
        if abs(frequency - before) < 1e-6 * frequency:
            break
    return damping, frequency


@unlocked
def _solve(e, time, gravity, out):
    """Fill out (k, 2) with the stiffness [1/s2] and damping [1/s] of every pair."""
    for k in range(len(e)):
        damping, frequency = _spring(e[k], time[k], gravity)
        out[k, 0] = frequency * frequency
        out[k, 1] = 2.0 * damping * frequency
