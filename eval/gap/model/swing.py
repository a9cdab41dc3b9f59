"""The swing of a slung load along a measured flight, from a start that the flight itself shows.

Nothing damps the swing, so that the load's unknown state at a flight's beginning moves the vehicle to its
end, by as much as what the flight excites later. It is estimated for every stretch of a flight by least
squares of the measured positions in the windows, each up to a line, with a normal prior about hanging at
rest. In the limit of no mass nothing is estimated.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from inclined_landing.models.load import LOAD_SIZE, advance
from inclined_landing.models.vehicle import Vehicle

STRETCH = 10.0  # s, the longest with one start: air and string damp what is older
ANGLE = (
    0.3  # rad, standard deviation of the start's angle; of its rate as much times the frequency of the swing
)
_NUMBERS = 2.0  # independent errors in one channel of a window: they are smooth
_ROUNDS = 3  # of Gauss and Newton
_STEP = 1e-3  # of differences, in standard deviations


def pulled(flight, vehicle: Vehicle, acceleration: np.ndarray) -> np.ndarray:
    """Return the mean accelerations (m - 1, 3) [m/s2] of a vehicle whose load swings, over a flight's steps.

    flight: a `MeasuredFlight` of m rows. acceleration (m - 1, 3): without the load. Both without gravity's.
    """
    mass, length = vehicle.effects_load_mass, vehicle.effects_load_length
    share = mass / (vehicle.body_mass + mass)
    frequency = math.sqrt(vehicle.weight / (vehicle.body_mass * length))
    spread = np.array([ANGLE, ANGLE, ANGLE * frequency, ANGLE * frequency])
    out = (1.0 - share) * acceleration  # as one body, beside the windows
    position = np.ascontiguousarray(flight.measured[:, :2])
    for starts in stretches(flight):
        steps = slice(int(starts[0]), int(starts[-1]) + flight.rows - 1)
        own, seen = acceleration[steps], position[steps.start : steps.stop + 1]
        string = share, length, flight.dt
        start = _start(seen, own, starts - steps.start, flight.rows, spread, string)
        _swing(own, start, string, out[steps])
    return out


def stretches(flight) -> list[np.ndarray]:
    """Return the first rows of the windows, one array for each stretch of at most `STRETCH`."""
    found: list[list[int]] = []
    for start in flight.starts:
        if not found or (start + flight.rows - 1 - found[-1][0]) * flight.dt > STRETCH:
            found.append([])
        found[-1].append(int(start))
    return [np.array(starts) for starts in found]


@numba.njit(cache=True, nogil=True)
def _state(z, spread):
    """Return the state (6,) of a load at the standardised angles and rates z (4,) along x and y."""
    load = np.zeros(LOAD_SIZE)
    load[0], load[1], load[2] = spread[0] * z[0], spread[1] * z[1], -1.0
    load[:3] /= math.sqrt((load[:3] ** 2).sum())
    load[3], load[4] = spread[2] * z[2], spread[3] * z[3]
    load[3:] -= (load[:3] * load[3:]).sum() * load[:3]
    return load


@numba.njit(cache=True, nogil=True)
def _swing(acceleration, start, string, out):
    """Write the vehicle's accelerations (k, 3) with a load from `start` (6,) into out."""
    share, length, dt = string
    load = start.copy()
    for k in range(len(acceleration)):
        a = acceleration[k]
        out[k, 0], out[k, 1], out[k, 2] = advance(load, a[0], a[1], a[2], share, length, dt)


@numba.njit(cache=True, nogil=True)
def _errors(position, acceleration, start, starts, rows, string):
    """Return the errors (2 w rows,) [m] of x and y in the windows, each without its line."""
    dt = string[2]
    pull, moved = np.empty_like(acceleration), np.zeros((len(acceleration) + 1, 2))
    _swing(acceleration, start, string, pull)
    for i in range(2):
        speed = 0.0
        for k in range(len(pull)):
            moved[k + 1, i] = moved[k, i] + dt * (speed + 0.5 * dt * pull[k, i])
            speed += dt * pull[k, i]
    out = np.empty(2 * len(starts) * rows)
    middle, squares, at = 0.5 * (rows - 1), rows * (rows * rows - 1.0) / 12.0, 0
    for first in starts:
        for i in range(2):
            mean, slope = 0.0, 0.0
            for k in range(rows):
                out[at + k] = position[first + k, i] - moved[first + k, i]
                mean += out[at + k] / rows
                slope += (k - middle) * out[at + k] / squares
            for k in range(rows):
                out[at + k] -= mean + slope * (k - middle)
            at += rows
    return out


@numba.njit(cache=True, nogil=True)
def _start(position, acceleration, starts, rows, spread, string):
    """Return the load's most probable state (6,) at the beginning of a stretch of k steps.

    position (k + 1, 2) [m] measured, acceleration (k, 3) [m/s2] without the load, starts (w,) of the windows.
    """
    z, eye = np.zeros(4), np.eye(4)
    errors = _errors(position, acceleration, _state(z, spread), starts, rows, string)
    slopes = np.empty((4, len(errors)))
    for _ in range(_ROUNDS):
        for i in range(4):
            state = _state(z + _STEP * eye[i], spread)
            slopes[i] = (_errors(position, acceleration, state, starts, rows, string) - errors) / _STEP
        # Minimise w |e + S dz|^2 + |z + dz|^2,  w = numbers/(rows mean e^2)
        weight = _NUMBERS / (rows * (errors**2).mean() + 1e-12)
        z -= np.linalg.solve(weight * (slopes @ slopes.T) + eye, weight * (slopes @ errors) + z)
        errors = _errors(position, acceleration, _state(z, spread), starts, rows, string)
    return _state(z, spread)
