"""The link between the vehicle and its pilot: radio and cameras with latency, noise and dropouts."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np

from inclined_landing.eval.flying.interfaces import MeasuredPose, MotionCapture


@dataclasses.dataclass(frozen=True)
class LinkQuality:
    """Latency and losses of the radio, the same in both directions.

    The Crazyradio resends a packet until it is acknowledged, so transmission errors mostly cause delays. The
    figures are estimates: bitcraze's own measurements give round trips of 4 to 10 ms at 2 Mbit/s.
    """

    latency: float = 0.003  # s, from call to arrival, when the first attempt succeeds
    jitter: float = 0.001  # s, mean of an exponential on top
    failing: float = 0.05  # share of the attempts that fail
    again: float = 0.002  # s per further attempt
    attempts: int = 100  # cflib's radio driver then gives up the link (`_nr_of_retries`)
    lost: float = 0.005  # share of the packets lost for good, in full queues


class LinkDirection:
    """One direction of the link. down: nothing gets through; storm: additional share of lost packets."""

    def __init__(self, link: LinkQuality, random: np.random.Generator):
        self.link = link
        self.down = False
        self.storm = 0.0
        self._random = random
        self._last = 0.0

    def arrival(self, time: float) -> float | None:
        """Return the arrival time of a packet sent at `time` [s]; None when it is lost."""
        link, random = self.link, self._random
        lost = random.random() < link.lost + self.storm
        failed = random.geometric(1.0 - link.failing) - 1
        delay = link.latency + random.exponential(link.jitter) + failed * link.again
        if self.down or lost or failed >= link.attempts:
            return None
        self._last = max(self._last, time + delay)
        return self._last


@dataclasses.dataclass(frozen=True)
class CameraQuality:
    """Rate, latency, noise and dropouts of the motion capture, as estimated for halls with eight or more
    cameras.
    """

    rate: float = 120.0  # Hz
    latency: float = 0.008  # s from exposure to arrival
    jitter: float = 0.001  # s, mean of an exponential on top
    noise: float = 0.0005  # m, standard deviation per axis
    angle_noise: float = 0.004  # rad, standard deviation per axis
    dropouts: float = 0.5  # 1/s, how often the markers are lost from sight
    dropout_length: float = 0.03  # s, mean of an exponential


class SimulatedMotionCapture(MotionCapture):
    """The simulated motion capture, with its faults.

    blind: no pose; frozen: the last pose repeatedly, with new times; stuck: a constant position with new
    noise; shift (3,) [m]: another marker is mistaken for the vehicle's; turned: the attitude is reversed.
    """

    def __init__(self, cameras: CameraQuality, random: np.random.Generator):
        self.cameras = cameras
        self.blind = self.frozen = self.stuck = self.turned = False
        self.shift = np.zeros(3)
        self._random = random
        self._hidden_until = 0.0
        self._stuck_at: np.ndarray | None = None
        self._frame: tuple[np.ndarray, np.ndarray] | None = None
        self._pose: MeasuredPose | None = None

    def latest(self) -> MeasuredPose | None:
        return self._pose

    def expose(
        self, time: float, position: np.ndarray, attitude: np.ndarray
    ) -> tuple[float, MeasuredPose] | None:
        """Return arrival time and pose of a frame at `time` [s]; None where nothing is seen."""
        c, random = self.cameras, self._random
        delay = c.latency + random.exponential(c.jitter)
        noise, angles = random.normal(0.0, c.noise, 3), random.normal(0.0, c.angle_noise, 3)
        if random.random() < c.dropouts / c.rate:
            self._hidden_until = time + random.exponential(c.dropout_length)
        if self.blind or time < self._hidden_until:
            return None
        if self.stuck:
            self._stuck_at = position = position if self._stuck_at is None else self._stuck_at
        if not self.frozen or self._frame is None:
            seen = _multiplied(attitude, np.array([1.0, *(angles / 2)]))
            if self.turned:  # half a turn about z
                seen = _multiplied(seen, np.array([0.0, 0.0, 0.0, 1.0]))
            self._frame = position + noise + self.shift, seen
        # A system knows its latency, and not how late a single packet is.
        return time + delay, MeasuredPose(time + delay - c.latency, *self._frame)

    def arrive(self, pose: MeasuredPose) -> None:
        """Store a pose as the newest one, unless there is a newer one."""
        if self._pose is None or pose.time >= self._pose.time:
            self._pose = pose


def _multiplied(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the product of two quaternions (4,), normalised."""
    product = np.empty(4)
    mujoco.mju_mulQuat(product, a, b)
    return product / np.linalg.norm(product)
