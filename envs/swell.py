"""Moving platforms, drawn for training: steady travel any way, and a swell of heave, roll and pitch.

Ships and cars are not included: the motions of the benchmark have their own spectra
(`eval/policies/moving/scenarios`).
"""

from __future__ import annotations

import math

import numpy as np

from inclined_landing.models.motion import MODES, Motion

WAVES = 2  # per mode
PERIODS = (1.2, 6.0)  # s, evenly in their logarithm
_LOGARITHMS = np.log(PERIODS)
# Of a swell of 1, each wave evenly from 0 to these.
HEAVE_SPEED = 0.35  # m/s
HEAVE = 0.12  # m, at most
TILT = math.radians(8.0)  # rad, of roll and of pitch
TILT_RATE = 0.4  # rad/s, at most
STEEPEST = WAVES * TILT * math.sqrt(2.0)  # rad: by which a swell of 1 may incline a platform


def draw(rng: np.random.Generator, fastest: float, swell: float, room: np.ndarray) -> Motion:
    """Return motions of k platforms: travel at 0 to fastest [m/s], and waves of `swell` times the sizes
    above, but roll and pitch together by at most room (k,) [rad].
    """
    k = len(room)
    # Each wave is A sin(w t + phi): A = min(v_max / w, A_max), so that speed and amplitude stay bounded.
    shape = (k, len(MODES), WAVES)
    speed, heading = fastest * rng.random(k), rng.uniform(-math.pi, math.pi, k)
    frequency = 2.0 * math.pi / np.exp(rng.uniform(*_LOGARITHMS, shape))
    share, amplitude, velocity = swell * rng.random(shape), np.zeros(shape), np.zeros((k, 3))
    amplitude[:, 2] = share[:, 2] * np.minimum(HEAVE_SPEED / frequency[:, 2], HEAVE)
    largest = np.minimum(TILT_RATE / frequency[:, 3:5], TILT)
    amplitude[:, 3:5] = share[:, 3:5] * largest
    reduced = np.minimum(1.0, room / np.maximum(largest_tilt(amplitude), 1e-9))
    amplitude[:, 3:5] = share[:, 3:5] * reduced[:, None, None] * largest
    velocity[:, 0], velocity[:, 1] = speed * np.cos(heading), speed * np.sin(heading)
    return Motion.unchecked(velocity, amplitude, frequency, rng.uniform(-math.pi, math.pi, shape))


def largest_tilt(amplitude: np.ndarray) -> np.ndarray:
    """Return the angle (k,) [rad] that waves (k, 6, W) incline a level platform by at most."""
    return np.hypot(*amplitude[:, 3:5].sum(axis=2).T)
