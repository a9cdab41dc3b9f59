"""The interfaces of a pilot other than cflib: a clock and a motion capture.

Each has two sides: the real clock sleeps and real cameras stream; the simulated clock advances the simulated
vehicle, and its motion capture shows that one.
"""

from __future__ import annotations

import dataclasses
import time
from typing import Protocol

import numpy as np


class FlightClock(Protocol):
    """A monotonic time [s] with an origin of its own."""

    def now(self) -> float:
        """Return the present time [s]."""
        ...

    def wait_until(self, moment: float) -> None:
        """Return at `moment` [s], at once where it has passed.

        The simulated clock calls cflib's callbacks meanwhile, in the caller's thread; with the real one
        they come from cflib's own thread.
        """
        ...


class RealClock:
    """The machine's monotonic clock [s]."""

    def now(self) -> float:
        """Return the present time [s]."""
        return time.monotonic()

    def wait_until(self, moment: float) -> None:
        """Sleep until `moment` [s]."""
        time.sleep(max(0.0, moment - time.monotonic()))


@dataclasses.dataclass(frozen=True)
class MeasuredPose:
    """A pose of the vehicle measured by motion capture, in the frame of the arena: x, y, z up."""

    time: float  # s of the clock at which it was taken: arrival less the system's known latency
    position: np.ndarray  # (3,) m
    attitude: np.ndarray | None = None  # (4,) unit quaternion w, x, y, z; None where only a point is seen


class MotionCapture(Protocol):
    """A source of poses; when it sees nothing, it keeps returning its last pose with its old time."""

    def latest(self) -> MeasuredPose | None:
        """Return the newest pose; None before the first one."""
        ...
