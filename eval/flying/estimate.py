"""State estimation of the pilot: position and velocity from motion capture, attitude from the vehicle's log.

`KalmanFilter` has three states of each axis: position, velocity, acceleration. The acceleration is a
first-order Gauss-Markov process (R. A. Singer, "Estimating Optimal Tracking Filter Performance for Manned
Maneuvering Targets", IEEE Transactions on Aerospace and Electronic Systems 6(4), 1970): its correlation time
is the time constant of the attitude loop, and its size that of the accelerations that the commands allow.
Measurements may arrive at any interval; during dropouts the state is predicted and its variance grows.

`Estimator` adds the attitude to it, and `ConsistencyMonitor` checks whether the measured motion is consistent
with the forces on the vehicle: a marker left behind, or a rigid body found in the wrong place, gives
positions that are new, noisy and wrong. The vehicle's accelerometer and attitude determine its acceleration,
whose integral must agree with the measured velocity.
"""

from __future__ import annotations

import collections
import dataclasses
import math

import numpy as np

from inclined_landing.envs.tasks.touchdown import HOLD_STEPS, REST_SPEED
from inclined_landing.eval.flying import frames
from inclined_landing.eval.flying.interfaces import MeasuredPose
from inclined_landing.models.attitude import PITCH, ROLL, STATE_SIZE, VX, VZ, YAW, X, Z
from inclined_landing.models.vehicle import Vehicle

# IMPACT [m/s]: largest change of the velocity by a touch, a flight's largest speed. IMPACT_TIME [s]: longest
# interval between the two poses. A larger jump than their product, 12 cm, is a measurement error.
IMPACT, IMPACT_TIME = 4.0, 0.03
POSITION_NOISE = 1e-3  # m, standard deviation per axis: calibrated motion capture is as accurate or better
SPEED = 1.0  # m/s, the standard deviation of the velocity before the first measurement, per axis
GATE = 30.7  # largest normalised innovation squared: one of a million, chi-square with 3 degrees
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)
RESTART = 5.0  # s: a larger difference of clocks is a restart, such as the vehicle's overflow after 4.7 h
HEADING_TIME = 0.5  # s, time constant of the heading's correction: gyroscopes drift over minutes
LONGEST_STEP = 0.06  # s, longest prediction step, three control periods; inputs are unknown beyond
TIME_CONSTANT = 2.5  # s: a false acceleration of 0.8 m/s2, a tilt error of 5 deg, then gives 2 m/s at most


class KalmanFilter:
    """Kalman filter of one flight; initialised by the first measurement.

    vehicle: its tilt limit allows accelerations that are taken to be uniform up to the largest. noise [m]:
    standard deviation of a measured position, per axis.
    """

    def __init__(self, vehicle: Vehicle, noise: float = POSITION_NOISE):
        largest = vehicle.environment_gravity * math.tan(vehicle.command_angle_limit)
        self.acceleration = largest / math.sqrt(3.0)  # standard deviation, per axis, m/s2
        self.correlation = vehicle.attitude_time_constant  # time after which it is forgotten, s
        self._noise = noise
        self.time: float | None = None  # of the last measurement that was believed, s
        self.mean = np.zeros((3, 3))  # position, velocity, acceleration of x, y, z
        self.variance = np.zeros((3, 3))  # of position, velocity, acceleration, the same for all axes
        self.contact_updates = 0  # measurements that only a touch explains
        self.normalised_innovation_squared = 0.0  # of the last measurement; chi-square with 3 degrees

    def update(self, time: float, position: np.ndarray, impact: bool = False) -> bool:
        """Update the state with a position (3,) [m] measured at `time` [s]; return False if it is rejected.

        impact: a surface is near, so the velocity may have changed instantly. Positions are rejected if they
        are not finite, not newer than the last one, or outside GATE.
        """
        position = np.asarray(position, float)
        if not (math.isfinite(time) and np.isfinite(position).all()):
            return False
        if self.time is None:
            self.mean[0] = position
            self.variance = np.diag([self._noise**2, SPEED**2, self.acceleration**2])
            self.time = time
            return True
        if time <= self.time:
            return False
        # Innovation y = z - H x, S = H P H' + R, NIS = y'y / S, K = P H' / S, H = (1, 0, 0) for each axis.
        mean, variance = self._ahead(time - self.time)
        innovation = position - mean[0]
        expected = variance[0, 0] + self._noise**2
        self.normalised_innovation_squared = float(innovation @ innovation / expected)
        if not self.normalised_innovation_squared <= GATE:
            reach = IMPACT * min(time - self.time, IMPACT_TIME) + 5.0 * self._noise
            if not (impact and math.sqrt(innovation @ innovation) <= reach):
                return False
            # Contact adds an unknown change w of velocity within dt: P + w^2 (dt, 1, 0)' (dt, 1, 0).
            hit = np.array([time - self.time, 1.0, 0.0]) * IMPACT
            variance = variance + np.outer(hit, hit)
            self.contact_updates += 1
            expected = variance[0, 0] + self._noise**2
        gain = variance[:, 0] / expected
        reduction = np.eye(3)
        reduction[:, 0] -= gain
        self.mean = mean + np.outer(gain, innovation)
        # Joseph's form, which stays symmetric and positive: P = (I - K H) P (I - K H)' + K R K'.
        self.variance = reduction @ variance @ reduction.T + self._noise**2 * np.outer(gain, gain)
        self.time = time
        return True

    def predict(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Return position (3,) [m] and velocity (3,) [m/s] at `time` [s]; NaN before any measurement."""
        if self.time is None:
            return np.full(3, np.nan), np.full(3, np.nan)
        mean = transition(max(0.0, time - self.time), self.correlation) @ self.mean
        return mean[0], mean[1]

    def _ahead(self, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and covariance (3, 3) propagated by dt [s]."""
        f = transition(dt, self.correlation)
        grown = process_noise(dt, self.acceleration, self.correlation)
        return f @ self.mean, f @ self.variance @ f.T + grown


def transition(dt: float, correlation: float) -> np.ndarray:
    """Return the transition matrix (3, 3) of position, velocity, acceleration over dt [s]."""
    # exp(A dt) of dx/dt = v, dv/dt = a, da/dt = -a / T, with s = dt / T (Singer 1970):
    #   [1  dt  T^2 (s - 1 + exp(-s))],  [0  1  T (1 - exp(-s))],  [0  0  exp(-s)]
    s = dt / correlation
    decay, rise = math.exp(-s), -math.expm1(-s)
    return np.array(
        [[1.0, dt, correlation**2 * (s - rise)], [0.0, 1.0, correlation * rise], [0.0, 0.0, decay]]
    )


def process_noise(dt: float, acceleration: float, correlation: float) -> np.ndarray:
    """Return the process noise covariance (3, 3) of the random acceleration over dt [s].

    It is the integral of the response to white jerk, by Gauss-Legendre quadrature: positive semidefinite for
    any dt, and exact to rounding for those between two measurements.
    """
    # Q = 2 sigma^2 / T  int_0^dt  r(s) r(s)' ds,  r the last column of the transition matrix.
    ages = 0.5 * dt * (_NODES + 1.0)
    s = ages / correlation
    rise = -np.expm1(-s)
    response = np.stack([correlation**2 * (s - rise), correlation * rise, np.exp(-s)])
    density = 2.0 * acceleration**2 / correlation
    return 0.5 * dt * density * (response * _WEIGHTS) @ response.T


@dataclasses.dataclass(frozen=True)
class Attitude:
    """One attitude from the vehicle's log."""

    time: float  # s of the pilot's clock at which the vehicle took it
    rotation: np.ndarray  # (3, 3) body to the vehicle's own world, whose heading is the gyroscopes'
    specific_force: float = math.nan  # g, along the body's z as the accelerometer shows it; NaN: not logged


class ClockOffset:
    """Offset between the clocks of vehicle and pilot, from the fastest packet so far.

    A packet arrives late, never early: the smallest difference between arrival and the vehicle's own time
    stamp is the offset of its clock plus the shortest delay of a packet, free of the radio's jitter.
    """

    def __init__(self):
        self._offset = math.inf

    def date(self, stamp: int, arrival: float) -> float:
        """Return the pilot's time [s] of a packet with vehicle time `stamp` [ms], from its `arrival` [s]."""
        # offset = min over packets of (arrival - stamp): the one with the shortest delay
        offset = arrival - 1e-3 * stamp
        if abs(offset - self._offset) > RESTART:
            self._offset = math.inf
        self._offset = min(self._offset, offset)
        return 1e-3 * stamp + self._offset


@dataclasses.dataclass(frozen=True)
class StateEstimate:
    """The estimated state of the vehicle at one time, and the age of its measurements."""

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

    noise [m]: that of the positions, see `KalmanFilter`.
    heading [rad]: direction of the nose when the first attitude arrives; used while no pose has an attitude.
    None: the vehicle's own heading is relative to the arena.
    """

    def __init__(self, vehicle: Vehicle, noise: float = POSITION_NOISE, heading: float | None = 0.0):
        self.filter = KalmanFilter(vehicle, noise)
        self.last_pose: MeasuredPose | None = None  # the last pose, believed or not
        self.attitude: Attitude | None = None
        self.heading_measured = False  # does motion capture show it
        self._heading = heading
        self._offset: float | None = None  # of the arena's heading over the vehicle's own, rad
        self._mocap_attitude: tuple[float, np.ndarray] | None = None  # time, rotation (3, 3)

    def add_pose(self, pose: MeasuredPose, impact: bool = False) -> bool:
        """Fuse a pose; return whether its position is new and accepted. impact: contact is possible.

        A position identical to the previous one is not a measurement: camera noise never repeats exactly.
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

    def _align(self, pose: MeasuredPose, dt: float) -> None:
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


class ConsistencyMonitor:
    """The velocity (3,) [m/s] by which forces and measured motion disagree, forgotten in `TIME_CONSTANT`.

    In flight it differs from 0 because of drag (0.5 m/s2 at 3 m/s), errors of the level calibration (0.17
    m/s2 per degree) and the accelerometer (0.2 m/s2), and a filter that is late by 20 ms.
    """

    def __init__(self, gravity: float):
        self._gravity = gravity
        self.reset()

    def reset(self) -> None:
        """Set the mismatch to zero, at the start and while something else than the rotors supports it."""
        self._parted = np.zeros(3)
        self._before: tuple[float, np.ndarray] | None = None

    @property
    def velocity_mismatch(self) -> float:
        """Norm of the velocity mismatch [m/s]."""
        return float(np.linalg.norm(self._parted))

    def update(self, time: float, velocity: np.ndarray, up: np.ndarray, lift: float) -> None:
        """Add the estimate at `time` [s] to the comparison; NaN and gaps beyond LONGEST_STEP are skipped.

        velocity (3,) [m/s]; up (3,): the body's z axis in the arena; lift: acceleration along it as measured
        by an accelerometer [g].
        """
        if not (np.isfinite(velocity).all() and np.isfinite(up).all() and math.isfinite(lift)):
            return
        if self._before is not None and 0.0 < time - self._before[0] <= LONGEST_STEP:
            # d <- d exp(-dt / T) + g (f b_z - e_z) dt - (v - v_before), f [g] the specific force along b_z
            dt = time - self._before[0]
            gained = self._gravity * (lift * up - np.array([0.0, 0.0, 1.0])) * dt
            self._parted = (
                self._parted * math.exp(-dt / TIME_CONSTANT) + gained - (velocity - self._before[1])
            )
        self._before = time, velocity.copy()


class RestMonitor:
    """The time [s] for which a vehicle has lain still, by its positions at control steps of `period` [s]."""

    def __init__(self, period: float):
        self._period, self.time = period, 0.0
        self._positions: collections.deque[np.ndarray] = collections.deque(maxlen=HOLD_STEPS)

    def update(self, position: np.ndarray, supported: bool) -> None:
        """Add the position (3,) [m] of a control step; supported: whether it can lie there."""
        self._positions.append(position.copy())
        moved = np.ptp(list(self._positions), axis=0).max()
        still = len(self._positions) == HOLD_STEPS and moved < REST_SPEED * HOLD_STEPS * self._period
        self.time = self.time + self._period if still and supported else 0.0
