"""The interfaces between a pilot and its vehicle: a clock and a motion capture.

Each has two implementations, whose methods have the meaning stated here: the real clock sleeps and real
cameras stream; the simulated clock advances the simulated vehicle, which its cameras see. The radio link is
`CflibLink`, or the simulated `World` with the same methods.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np


class FlightClock(Protocol):
    """A monotonic time [s] with an arbitrary origin."""

    def now(self) -> float:
        """Return the present time [s]."""
        ...

    def wait_until(self, moment: float) -> None:
        """Return at `moment` [s], or immediately if it has passed.

        The simulated clock delivers packets that arrive meanwhile in the caller's thread; with the real one
        they arrive in cflib's own thread.
        """
        ...


class RealClock(FlightClock):
    """The machine's monotonic clock [s]."""

    def now(self) -> float:
        return time.monotonic()

    def wait_until(self, moment: float) -> None:
        time.sleep(max(0.0, moment - time.monotonic()))


@dataclasses.dataclass(frozen=True)
class MeasuredPose:
    """A pose of the vehicle measured by motion capture, in the frame of the arena: x, y, z up."""

    time: float  # s of the clock at which it was taken: arrival less the system's known latency
    position: np.ndarray  # (3,) m
    attitude: np.ndarray | None = None  # (4,) unit quaternion w, x, y, z; None where only a point is seen


class MotionCapture(Protocol):
    """A source of poses; if the vehicle is not visible, the last pose is returned with its old time."""

    def latest(self) -> MeasuredPose | None:
        """Return the newest pose; None before the first one."""
        ...


Arrived = Callable[[int, Mapping[str, float]], None]  # called with the vehicle's time [ms] and values by name
