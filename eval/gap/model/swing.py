"""The swing of a slung load along a measured flight, from a start that the flight itself shows.

Nothing damps the swing. The load's unknown state at the beginning of a flight therefore moves the vehicle
until its end, by as much as what the flight excites later. This state is estimated for every stretch of a
flight by least squares of the measured positions in the windows, each up to a line, with a normal prior about
hanging at rest. In the limit of no mass nothing is estimated.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from inclined_landing.models.compiled import unlocked
from inclined_landing.models.load import LOAD_SIZE, advance

NEARLY = 0.05  # m/s2, accelerations so near lead to a load's start by a single linear step
STRETCH = 10.0  # s, the longest with one start: air and string damp what is older
ANGLE = 0.3  # rad, standard deviation of the start's angle; of its rate, times the swing's frequency
_NUMBERS = 2.0  # independent errors in one channel of a window: they are smooth
_ROUNDS = 3  # of Gauss and Newton
_STEP = 1e-3  # of differences, in standard deviations


class Starts(NamedTuple):
    """The load's standardised states at the beginning of s stretches, and how they follow from errors."""

    z: np.ndarray  # (s, 4) angles and rates along x and y
    gain: np.ndarray  # (4, 2 w rows) of the errors in all windows
    inverse: np.ndarray  # (s, 4, 4) of the prior
    of: np.ndarray  # (3,) masses of load and vehicle, length of the string; NaN: not fitted yet
    acceleration: np.ndarray  # (m - 1, 3) m/s2, of the vehicle without the load

    @staticmethod
    def none(samples: int, starts: np.ndarray, rows: int, dt: float) -> Starts:
        """Return those before the first fit to a flight of m samples. Other arguments: see `pulled`."""
        s, numbers = len(stretches(starts, rows, dt)) - 1, 2 * len(starts) * rows
        fitted = np.zeros((s, 4)), np.zeros((4, numbers)), np.zeros((s, 4, 4))
        return Starts(*fitted, np.full(3, np.nan), np.zeros((samples - 1, 3)))


@unlocked
def pulled(acceleration, position, starts, rows, dt, vehicle, begun):
    """Return the mean accelerations (m - 1, 3) [m/s2] of a vehicle whose load swings, over a flight's steps.

    acceleration (m - 1, 3): without the load. Both without gravity's. position (m, 3) [m] measured; starts
    (w,): first rows of the windows, of `rows` rows `dt` [s] apart. vehicle: see `forces.pack`. begun:
    `Starts`, filled at the first call. From those of nearly the same accelerations with the same
    load a single linear step leads to these.
    """
    v = vehicle[0]
    mass, length = v.effects.load_mass, v.effects.load_length
    total = v.body.mass + mass
    share = mass / total
    frequency = math.sqrt(total * v.environment.gravity / (v.body.mass * length))
    spread = np.array([ANGLE, ANGLE, ANGLE * frequency, ANGLE * frequency])
    string = share, length, dt
    out = (1.0 - share) * acceleration  # as one body, outside the windows
    of = np.array([mass, v.body.mass, length])
    same = np.array_equal(begun.of, of)
    again = same and ((acceleration - begun.acceleration) ** 2).mean() < NEARLY**2
    if np.isnan(begun.of[0]):
        begun.of[:], begun.acceleration[:] = of, acceleration
        z_of, gain_of, inverse_of = begun.z, begun.gain, begun.inverse
    elif again:
        z_of, gain_of, inverse_of = begun.z, begun.gain, begun.inverse
    else:
        z_of = np.empty_like(begun.z)
        gain_of, inverse_of = np.empty_like(begun.gain), np.empty_like(begun.inverse)
    ends = stretches(starts, rows, dt)
    for i in range(len(ends) - 1):
        own = starts[ends[i] : ends[i + 1]]
        first, last = own[0], own[-1] + rows - 1
        free, seen = acceleration[first:last], position[first : last + 1]
        z, inverse = z_of[i], inverse_of[i]
        gain = gain_of[:, 2 * rows * ends[i] : 2 * rows * ends[i + 1]]
        if not again:
            _start(seen, free, own - first, rows, spread, string, z, gain, inverse)
        loads = _state(z, spread).reshape(1, LOAD_SIZE)
        errors = _errors(seen, free, loads, own - first, rows, string)[0]
        _swing(free, _state(z - _step(errors, z, gain, inverse), spread), string, out[first:last])
    return out


@unlocked
def stretches(starts, rows, dt):
    """Return where stretches of at most `STRETCH` begin among the windows, and the number of these."""
    found = [0]
    for k in range(1, len(starts)):
        if (starts[k] + rows - 1 - starts[found[-1]]) * dt > STRETCH:
            found.append(k)
    found.append(len(starts))
    return np.array(found)


@unlocked
def _state(z, spread):
    """Return the state (6,) of a load at the standardised angles and rates z (4,) along x and y."""
    load = np.zeros(LOAD_SIZE)
    load[0], load[1], load[2] = spread[0] * z[0], spread[1] * z[1], -1.0
    load[:3] /= math.sqrt((load[:3] ** 2).sum())
    load[3], load[4] = spread[2] * z[2], spread[3] * z[3]
    load[3:] -= (load[:3] * load[3:]).sum() * load[:3]
    return load


@unlocked
def _swing(acceleration, start, string, out):
    """Write the vehicle's accelerations (k, 3) with a load from `start` (6,) into out."""
    share, length, dt = string
    load = start.copy()
    for k in range(len(acceleration)):
        a = acceleration[k]
        out[k, 0], out[k, 1], out[k, 2] = advance(load, a[0], a[1], a[2], share, length, dt)


@unlocked
def _errors(position, acceleration, loads, starts, rows, string):
    """Return the errors (s, 2 w rows) [m] of x and y in the windows, each without its line.

    loads (s, 6): states at the beginning.
    """
    dt, pulled_by = string[2], np.empty_like(acceleration)
    moved = np.zeros((len(loads), 2, len(acceleration) + 1))
    for s in range(len(loads)):
        _swing(acceleration, loads[s], string, pulled_by)
        for i in range(2):
            way, speed = 0.0, 0.0
            for k in range(len(pulled_by)):
                way += dt * (speed + 0.5 * dt * pulled_by[k, i])
                speed += dt * pulled_by[k, i]
                moved[s, i, k + 1] = way
    out = np.empty((len(loads), 2 * len(starts) * rows))
    middle, squares = 0.5 * (rows - 1), rows * (rows * rows - 1.0) / 12.0
    for s in range(len(loads)):
        at = 0
        for first in starts:
            for i in range(2):
                mean, slope = 0.0, 0.0
                for k in range(rows):
                    error = position[first + k, i] - moved[s, i, first + k]
                    out[s, at + k] = error
                    mean += error
                    slope += (k - middle) * error
                mean, slope = mean / rows, slope / squares
                for k in range(rows):
                    out[s, at + k] -= mean + slope * (k - middle)
                at += rows
    return out


@unlocked
def _step(errors, z, gain, inverse):
    """Return the step (4,) of Gauss and Newton, to be taken off, at errors (n,)."""
    step = np.zeros(4)
    for i in range(4):
        for k in range(len(errors)):
            step[i] += gain[i, k] * errors[k]
        for j in range(4):
            step[i] += inverse[i, j] * z[j]
    return step


@unlocked
def _start(position, acceleration, starts, rows, spread, string, z, gain, inverse):
    """Write the load's most probable state at the beginning of a stretch of k steps, as of `Starts`.

    position (k + 1, 3) [m] measured, acceleration (k, 3) [m/s2] without the load, starts (w,) of the windows.
    """
    eye = np.eye(4)
    loads = np.empty((5, LOAD_SIZE))
    z[:] = 0.0
    for _ in range(_ROUNDS):
        loads[0] = _state(z, spread)
        for i in range(4):
            loads[1 + i] = _state(z + _STEP * eye[i], spread)
        errors = _errors(position, acceleration, loads, starts, rows, string)
        here, slopes = errors[0], (errors[1:] - errors[0]) / _STEP
        # Minimise w |e + S dz|^2 + |z + dz|^2,  w = numbers/(rows mean e^2):
        #   dz = -(w S S' + 1)^-1 (w S e + z)
        weight = _NUMBERS / (rows * (here**2).mean() + 1e-12)
        inverse[:] = np.linalg.inv(weight * (slopes @ slopes.T) + eye)
        gain[:] = inverse @ (weight * slopes)
        z -= _step(here, z, gain, inverse)
