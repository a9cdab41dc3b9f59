"""Set-point flight to a hand-over point, simulated or real: arrival criterion and integral offset."""

from __future__ import annotations

import numpy as np

HAND_OVER = (-1.0, 1.8)  # m, x and z: before the platform's lower edge, higher than the upper one
TOLERANCE = 0.05  # m from the goal, of the set-point task
# A landing may begin after this time within the tolerance of the point, slower than this speed.
HAND_OVER_SPEED, HAND_OVER_TIME = 0.15, 0.4  # m/s, s
YAW_GAIN = 2.0  # 1/s, heading error to yaw rate command
CLEAR = 0.25  # m that a planned way keeps to the platform: twice the vehicle's half width, and some
TRIM_GAIN, TRIM_LIMIT = 0.5, 0.3  # 1/s, m: of the integral offset
TRIM_REACH = 0.3  # m from the target, within which the offset is integrated


class Trim:
    """Integral offset of the targets of n vehicles, `offset` (n, 3) [m].

    A set-point policy commands the thrust of the vehicle that it was trained for, so a vehicle with less
    thrust hovers below its target. The offset is learned near the target, as by an integral controller.
    """

    def __init__(self, n: int):
        self.offset = np.zeros((n, 3))

    def integrate(self, error: np.ndarray, dt: float, mask: np.ndarray | None = None) -> None:
        """Integrate position errors `error` (n, 3) [m] over dt [s]; mask: (n,) bool, vehicles that learn."""
        # offset <- clip(offset + K error dt, -limit, limit) near the target: integral action with anti-windup
        near = np.linalg.norm(error, axis=1) < TRIM_REACH
        near = near if mask is None else near & mask
        self.offset[near] = np.clip(self.offset[near] + TRIM_GAIN * dt * error[near], -TRIM_LIMIT, TRIM_LIMIT)
