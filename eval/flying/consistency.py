"""Does the motion that is measured fit the forces on the vehicle?

A marker left behind, or a rigid body found in the wrong place, gives positions that are fresh, noisy and
wrong. The vehicle's accelerometer and attitude say how it accelerates; what that adds up to must be found in
the measured velocity.
"""

from __future__ import annotations

import math

import numpy as np

TIME_CONSTANT = 2.5  # s: an acceleration of 0.8 m/s2 that leads nowhere, a lean of 5 deg, is then 2 m/s


class ConsistencyMonitor:
    """The velocity (3,) [m/s] by which forces and measured motion have parted, forgotten in `TIME_CONSTANT`.

    In flight it is not 0 by drag (0.5 m/s2 at 3 m/s), a level that is off (0.17 m/s2 per degree), an
    accelerometer that is (0.2 m/s2), and a filter that is late by 20 ms.
    """

    def __init__(self, gravity: float):
        self._gravity = gravity
        self.reset()

    def reset(self) -> None:
        """Set the mismatch to zero: at the start, and while anything but the rotors supports the vehicle."""
        self._parted = np.zeros(3)
        self._before: tuple[float, np.ndarray] | None = None

    @property
    def velocity_mismatch(self) -> float:
        """Norm of the velocity mismatch [m/s]."""
        return float(np.linalg.norm(self._parted))

    def update(self, time: float, velocity: np.ndarray, up: np.ndarray, lift: float) -> None:
        """Add the estimate at `time` [s] to the comparison; NaN is skipped.

        velocity (3,) [m/s]; up (3,): the body's z axis in the arena; lift: acceleration along it as an
        accelerometer shows it [g].
        """
        if not (np.isfinite(velocity).all() and np.isfinite(up).all() and math.isfinite(lift)):
            return
        if self._before is not None and time > self._before[0]:
            # d <- d exp(-dt / T) + g (f b_z - e_z) dt - (v - v_before), f [g] the specific force along b_z
            dt = time - self._before[0]
            gained = self._gravity * (lift * up - np.array([0.0, 0.0, 1.0])) * dt
            self._parted = (
                self._parted * math.exp(-dt / TIME_CONSTANT) + gained - (velocity - self._before[1])
            )
        self._before = time, velocity.copy()
