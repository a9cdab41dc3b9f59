"""Model (form) errors as additional columns of the regression: structural error of the formulas.

No formula is exact. True thrust, drag and loop responses are some percent larger or smaller with the load,
at speed, in a climb, late in a flight or along one axis. Each of these is a column, the base model's
contribution times a quantity of order one, with a normal prior on its weight. Without them a structural error
of the base model would be evidence for an effect, more so with more flights. An effect may have such errors
of its own (`Effect.forms`), free while it is in the set.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from inclined_landing.eval.gap.flights.windows import MeasuredFlight
from inclined_landing.models.parameters import load_vehicle

LAG = 0.03  # s, by which a contribution may come later
_LOAD, _SPEED, _CLIMB, _TIME = 0.2, 1.0, 0.5, 20.0  # of hover thrust, m/s, m/s, s: quantities of order one
_ANGLE, _TURN = 0.2, 1.0  # rad, rad/s
_MOTOR = 0.065  # s, lag of the load
_HOVER = load_vehicle().hover_pwm  # the same for all vehicles and flights, so that weights mean the same
# Errors of the base model, with the standard deviations of their weights: from development families.
DEVIATIONS = {
    **{f"thrust {what}": 0.02 for what in ("load", "speed", "climb", "time")},
    **{f"drag {what}": 0.1 for what in ("load", "speed", "climb", "x")},
    **{f"attitude {what}": 0.05 for what in ("angle", "load", "time", "roll")},
    "attitude bend": 0.3,
    **{f"yaw {what}": 0.05 for what in ("turn", "time")},
}
ALONE = 0.05  # share of these that is free where no flights of a reference have shown them
_CHANNELS = {"translation": slice(0, 3), "attitude": slice(3, 5), "yaw": slice(5, 6)}


def column(name: str, contribution: np.ndarray, flight: MeasuredFlight) -> np.ndarray:
    """Return the Jacobian column (m, 6) of a model error of an effect that contributes (m, 6)."""
    group, what = name.split()
    own = _CHANNELS[group]
    result, part = np.zeros_like(contribution), contribution[:, own]
    if what == "late":
        result[:, own] = -LAG * np.gradient(part, flight.dt, axis=0)
    elif what == "bend":  # one order more of a loop's answer
        result[:, own] = LAG**2 * np.gradient(np.gradient(part, flight.dt, axis=0), flight.dt, axis=0)
    elif what == "roll":
        result[:, 3] = contribution[:, 3]
    elif group == "translation":
        result[:, own] = _moved(np.diff(part, 2, axis=0), what, flight)
    else:
        result[:, own] = part * _quantity(what, flight)[:, None]
    return result


def base_column(name: str, predicted: np.ndarray, gravity: float, flight: MeasuredFlight) -> np.ndarray:
    """Return the Jacobian column (m, 6) of a model error of the base model that predicts (m, 6)."""
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
    result[:, :3] = _moved(part, what, flight)
    return result


def _moved(second: np.ndarray, what: str, flight: MeasuredFlight) -> np.ndarray:
    """Return the positions (m, 3): double sum of second differences (m - 2, 3) times a quantity."""
    bent = second if what == "x" else second * _quantity(what, flight)[1:-1, None]
    return np.vstack([np.zeros((2, 3)), np.cumsum(np.cumsum(bent, axis=0), axis=0)])


def _quantity(what: str, flight: MeasuredFlight) -> np.ndarray:
    """Return the quantity (m,) of order one that a model error is proportional to."""
    if what == "load":
        pwm = flight.command[:, 0]
        share = np.exp(-flight.dt / _MOTOR)
        lagged = lfilter([1.0 - share], [1.0, -share], pwm - pwm[0]) + pwm[0]
        return (lagged / _HOVER - 1.0) / _LOAD
    if what == "speed":
        return np.hypot(flight.velocity[:, 0], flight.velocity[:, 1]) / _SPEED
    if what == "climb":
        return flight.velocity[:, 2] / _CLIMB
    if what == "time":
        return flight.t / _TIME
    if what == "angle":
        return np.hypot(flight.command[:, 1], flight.command[:, 2]) / _ANGLE
    return np.abs(flight.command[:, 3]) / _TURN
