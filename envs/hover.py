"""What every set-point flight to a hand-over point needs besides its policy, simulated or real."""

from __future__ import annotations

import numpy as np

# A landing may begin within the set-point task's tolerance of the point, slower than this, for so long.
HAND_OVER_SPEED, HAND_OVER_TIME = 0.15, 0.4  # m/s, s
YAW_GAIN = 2.0  # 1/s, heading error to yaw rate command
CLEAR = 0.25  # m that a planned way keeps to the platform: twice the vehicle's half width, and some
# Of the trim:
GAIN = 0.5  # 1/s: how fast it is learnt
LIMIT = 0.3  # m
REACH = 0.3  # m from the target within which it is


class Trim:
    """By how much targets are moved for n vehicles, `offset` (n, 3) [m].

    A set-point policy flies with the thrust that it was trained for; a vehicle with less of it sinks below
    its target. By how much is learnt near the target, as an integral controller does.
    """

    def __init__(self, n: int):
        self.offset = np.zeros((n, 3))

    def learn(self, away: np.ndarray, dt: float, who: np.ndarray | None = None) -> None:
        """The targets were `away` (n, 3) [m] for another dt [s]; who: (n,) bool, those that learn."""
        near = np.linalg.norm(away, axis=1) < REACH
        near = near if who is None else near & who
        self.offset[near] = np.clip(self.offset[near] + GAIN * dt * away[near], -LIMIT, LIMIT)
