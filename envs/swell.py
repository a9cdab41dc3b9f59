"""Random platform motions for training: steady travel in any direction, and swell in heave, roll and pitch.

Ships and cars are not included: the motions of the benchmark have their own spectra
(`eval/study/scenarios.toml`).
"""

from __future__ import annotations

import math

import numpy as np

from inclined_landing.models.compiled import kernel
from inclined_landing.models.motion import MODES, Motion

WAVES = 2  # per mode
PERIODS = (1.2, 6.0)  # s, evenly in their logarithm
_LOGARITHMS = np.log(PERIODS)
# For a swell of 1, each wave is drawn uniformly from 0 to these limits.
HEAVE_SPEED = 0.35  # m/s
HEAVE = 0.12  # m, at most
TILT = math.radians(8.0)  # rad, of roll and of pitch
TILT_RATE = 0.4  # rad/s, at most
STEEPEST = WAVES * TILT * math.sqrt(2.0)  # rad: by which a swell of 1 may incline a platform


def draw(rng: np.random.Generator, fastest: float, swell: float, room: np.ndarray) -> Motion:
    """Return motions of k platforms: travel at 0 to fastest [m/s], and waves of `swell` times the sizes
    above, with roll and pitch together limited to room (k,) [rad].
    """
    k, shape = len(room), (len(room), len(MODES), WAVES)
    travel, (log_period, share, phase) = rng.random((2, k)), rng.random((3, *shape))
    period = np.exp(_LOGARITHMS[0] + (_LOGARITHMS[1] - _LOGARITHMS[0]) * log_period)
    motion = Motion.unchecked(np.zeros((k, 3)), np.zeros(shape), 2.0 * math.pi / period, phase)
    _draw(travel, share, float(fastest), float(swell), room, motion.arrays)
    return motion


@kernel
def _draw(travel, share, fastest, swell, room, waves):
    """Write the motions of `draw` from numbers in [0, 1): travel (2, k), share and phase (k, 6, W)."""
    for i in range(len(room)):
        speed, heading = fastest * travel[0, i], -math.pi + 2.0 * math.pi * travel[1, i]
        waves.velocity[i, 0], waves.velocity[i, 1] = speed * math.cos(heading), speed * math.sin(heading)
        # Each wave is A sin(w t + phi): A = min(v_max / w, A_max), so that speed and amplitude stay bounded.
        tilt = np.zeros(2)
        for mode in range(6):
            for w in range(share.shape[2]):
                omega, size = waves.frequency[i, mode, w], swell * share[i, mode, w]
                waves.phase[i, mode, w] = -math.pi + 2.0 * math.pi * waves.phase[i, mode, w]
                if mode == 2:
                    waves.amplitude[i, mode, w] = size * min(HEAVE_SPEED / omega, HEAVE)
                elif mode == 3 or mode == 4:
                    tilt[mode - 3] += size * min(TILT_RATE / omega, TILT)
        reduced = min(1.0, room[i] / max(math.hypot(tilt[0], tilt[1]), 1e-9))
        for mode in range(3, 5):
            for w in range(share.shape[2]):
                largest = min(TILT_RATE / waves.frequency[i, mode, w], TILT)
                waves.amplitude[i, mode, w] = swell * share[i, mode, w] * reduced * largest


def largest_tilt(amplitude: np.ndarray) -> np.ndarray:
    """Return the largest inclination (k,) [rad] that waves (k, 6, W) give a level platform."""
    return np.hypot(*amplitude[:, 3:5].sum(axis=2).T)
