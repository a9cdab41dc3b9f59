"""What the pilot believes: position and velocity from motion capture, attitude from the vehicle's own log."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from inclined_landing.eval.flying import frames
from inclined_landing.eval.flying.interfaces import Pose
from inclined_landing.eval.flying.kalman import KalmanFilter, NoiseModel
from inclined_landing.models.attitude import PITCH, ROLL, STATE_SIZE, VX, VZ, YAW, X, Z

RESTART = 5.0  # s: clocks this far apart mean that the vehicle's began anew, as its 24 bits do after 4.7 h
HEADING_TIME = 0.5  # s in which the heading follows motion capture: gyroscopes drift over minutes


@dataclasses.dataclass(frozen=True)
class Attitude:
    """One attitude from the vehicle's log."""

    time: float  # s of the pilot's clock at which the vehicle took it
    rotation: np.ndarray  # (3, 3) body to the vehicle's own world, whose heading is the gyroscopes'
    specific_force: float = (
        math.nan
    )  # g, along the body's z as the accelerometer shows it; NaN where not logged


class ClockOffset:
    """Offset between the clocks of vehicle and pilot, from the fastest packet so far.

    A packet arrives late, never early: the least difference between arrival and the vehicle's own time stamp
    is the offset of its clock, but for the shortest way that a packet took, and the jitter of the radio is
    gone.
    """

    def __init__(self):
        self._offset = math.inf

    def date(self, stamp: int, arrival: float) -> float:
        """Return the pilot's time [s] of a packet stamped `stamp` [ms] by the vehicle that came at `arrival`
        [s].
        """
        # offset = min over packets of (arrival - stamp): the one with the shortest delay
        offset = arrival - 1e-3 * stamp
        if abs(offset - self._offset) > RESTART:
            self._offset = math.inf
        self._offset = min(self._offset, offset)
        return 1e-3 * stamp + self._offset


@dataclasses.dataclass(frozen=True)
class StateEstimate:
    """The estimated state of the vehicle at one moment, and the age of its measurements."""

    time: float  # s
    state: np.ndarray  # (13,) as tasks observe it; NaN where nothing is known, rates and lag 0
    pose_age: float  # s since the last believed position
    attitude_age: float  # s since the last attitude
    attitude_mismatch: float  # rad between the attitudes of log and motion capture; 0 where one is not known
    acceleration: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(3))  # (3,) m/s2

    @property
    def tilt(self) -> float:
        """Angle [rad] between the body's z axis and the vertical."""
        return math.acos(math.cos(self.state[ROLL]) * math.cos(self.state[PITCH]))

    @property
    def speed(self) -> float:
        """Norm of the velocity [m/s]."""
        return float(np.linalg.norm(self.state[VX : VZ + 1]))


class Estimator:
    """State estimator that fuses motion capture poses and the vehicle's attitude log.

    heading [rad]: where the nose points when the first attitude comes; used while no pose has an attitude.
    None: the vehicle's own heading is the arena's.
    """

    def __init__(self, noise: NoiseModel, heading: float | None = 0.0):
        self.filter = KalmanFilter(noise)
        self.last_pose: Pose | None = None  # the last pose, believed or not
        self.attitude: Attitude | None = None
        self.heading_measured = False  # does motion capture show it
        self._heading = heading
        self._offset: float | None = None  # of the arena's heading over the vehicle's own, rad
        self._mocap_attitude: tuple[float, np.ndarray] | None = None  # time, rotation (3, 3)

    def add_pose(self, pose: Pose, impact: bool = False) -> bool:
        """Fuse a pose; return whether its position is new and accepted. impact: contact is possible.

        A position that equals the one before to the last bit is no measurement: cameras are never that still.
        """
        before, self.last_pose = self.last_pose, pose
        if before is not None and (
            pose.time == before.time or np.array_equal(pose.position, before.position)
        ):
            return False
        if pose.attitude is not None and np.isfinite(pose.attitude).all() and np.any(pose.attitude):
            self._align(pose, 0.0 if before is None else pose.time - before.time)
        return self.filter.update(pose.time, pose.position, impact)

    def add_attitude(self, attitude: Attitude) -> None:
        """Store an attitude of the vehicle's log, unless it is older than the last one or not finite."""
        if not np.isfinite(attitude.rotation).all() or (
            self.attitude and attitude.time <= self.attitude.time
        ):
            return
        self.attitude = attitude
        if self._offset is None and not self.heading_measured:
            seen = frames.heading_of(attitude.rotation)
            self._offset = 0.0 if self._heading is None else self._heading - seen

    def predict(self, time: float) -> StateEstimate:
        """Return the state estimate for `time` [s]."""
        state = np.zeros(STATE_SIZE)
        state[X : Z + 1], state[VX : VZ + 1] = self.filter.predict(time)
        attitude_mismatch = 0.0
        if self.attitude is None or self._offset is None:
            state[[ROLL, PITCH, YAW]] = np.nan
        else:
            rotation = frames.about_z(self._offset) @ self.attitude.rotation
            state[[ROLL, PITCH]] = frames.tilt(rotation[:, 2])
            state[YAW] = frames.heading_of(rotation)
            if (
                self._mocap_attitude is not None
                and abs(self._mocap_attitude[0] - self.attitude.time) < HEADING_TIME
            ):
                attitude_mismatch = frames.angle_between(rotation, self._mocap_attitude[1])
        last = self.filter.time
        return StateEstimate(
            time,
            state,
            math.inf if last is None else time - last,
            math.inf if self.attitude is None else time - self.attitude.time,
            attitude_mismatch,
            self.filter.mean[2].copy(),
        )

    def to_arena(self, attitude: Attitude) -> np.ndarray | None:
        """Return the rotation (3, 3), body to arena, of a logged attitude; None without a heading."""
        if self._offset is None:
            return None
        return frames.about_z(self._offset) @ attitude.rotation

    def _align(self, pose: Pose, dt: float) -> None:
        """Update the heading offset of the vehicle's log against motion capture, a first-order low-pass."""
        rotation = frames.quaternion_rotation(pose.attitude)
        self._mocap_attitude = pose.time, rotation
        if self.attitude is None:
            self.heading_measured = True
            return
        offset = frames.heading_of(rotation) - frames.heading_of(self.attitude.rotation)
        if self._offset is None or not self.heading_measured:
            self._offset = offset
        else:
            # First-order low-pass: o <- o + (1 - exp(-dt / T)) (o_measured - o)
            share = -math.expm1(-max(0.0, dt) / HEADING_TIME)
            self._offset += share * frames.wrapped(offset - self._offset)
        self.heading_measured = True
