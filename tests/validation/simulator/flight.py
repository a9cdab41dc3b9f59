"""One flight: measurements, pilot, flight controller and physics in lockstep, and the log that comes out."""

from __future__ import annotations

import dataclasses

import numba
import numpy as np

from . import control, dynamics
from .vehicle import (
    CONTROL_RATE,
    PHYSICS_RATE,
    PILOT_RATE,
    TRACK_RATE,
    Build,
    Constants,
    World,
    constants,
    record,
)

WARM_UP = 4.0  # s flown before the log begins: filters and pilot settle
_LEVEL_TIME = 60.0  # s, in which an accelerometer's level wanders


@dataclasses.dataclass(frozen=True)
class Reality:
    """A vehicle, its air and its log: all that is the same in the flights of one set, hidden causes aside."""

    constants: Constants
    build: Build = dataclasses.field(default_factory=Build)
    family: str = "reference"

    @property
    def log_rate(self) -> float:
        """Rows of the log per second."""
        return CONTROL_RATE / self.build.log_ticks


def reference() -> Reality:
    """The vehicle that flies as the paper's equations say, in still air."""
    return Reality(constants())


@dataclasses.dataclass(frozen=True)
class Recording:
    """The log of one flight, as a motion capture and a radio would give it.

    `truth` is for tests and never written: position, velocity, roll, pitch, yaw, body rates, thrust of the
    four rotors in still air.
    """

    t: np.ndarray  # (m,) s
    position: np.ndarray  # (m, 3) m, measured
    attitude: np.ndarray  # (m, 3) rad, roll, pitch, yaw of Rz Rx Ry, measured
    command: np.ndarray  # (m, 4) PWM, roll, pitch [rad], yaw rate [rad/s], held until the next row
    voltage: np.ndarray  # (m,) V, measured
    contact: np.ndarray  # (m,) bool, any foot touches
    truth: np.ndarray  # (m, 16)

    def between(self, start: float, end: float) -> Recording:
        """The rows from `start` to `end` [s], with time from 0."""
        rows = slice(*np.searchsorted(self.t, [start - 1e-9, end - 1e-9]))
        cut = {f.name: getattr(self, f.name)[rows] for f in dataclasses.fields(self)}
        return Recording(**cut | {"t": cut["t"] - cut["t"][0]})


@numba.njit(cache=True)
def _fly(s, reference, air, gyro_noise, mocap_noise, level, heard, warm_up, substeps, c, b, w, log, truth):
    ticks = gyro_noise.shape[0]
    dt = 1.0 / CONTROL_RATE
    h = dt / substeps
    per_log, per_pilot = int(b.log_ticks), CONTROL_RATE // PILOT_RATE
    per_track = CONTROL_RATE // TRACK_RATE
    thrust_delay = round(w.thrust_delay * CONTROL_RATE)
    attitude_delay = round(w.attitude_delay * CONTROL_RATE)
    mocap_delay = round(w.mocap_delay * CONTROL_RATE)
    capture_age = mocap_delay + round(b.capture_age * CONTROL_RATE)
    log_delay = mocap_delay + round(w.log_delay * CONTROL_RATE)
    dead_time = round(b.dead_time * CONTROL_RATE)
    poses, commands, asked = np.zeros((ticks, 6)), np.zeros((ticks, 4)), np.zeros((ticks, 4))
    work, r, contact = np.zeros((4, dynamics.SIZE)), np.zeros((3, 3)), np.zeros(4)
    anchor = np.full((4, 3), np.nan)
    target, memory = s[dynamics.ROTORS : dynamics.ROTORS + 4].copy(), np.zeros(control.MEMORY)
    for j in range(4):
        asked[0, j] = target[j]
    command, setpoint, gyro, force = np.zeros(4), np.zeros(3), np.zeros(3), np.array([0.0, 0.0, c.gravity])
    position, velocity, integral = s[:3].copy(), np.zeros(3), np.zeros(3)
    measured = np.zeros(6)
    dynamics.rotation(s[dynamics.QUATERNION : dynamics.QUATERNION + 4], r)
    roll, pitch, _ = dynamics.angles(r)
    turns = polarised = 0.0
    for k in range(ticks):
        time = k * dt - warm_up
        # Measure.
        turns = _pose(s, r, poses, k, turns)
        for j in range(3):
            gyro[j] = s[dynamics.RATES + j] + gyro_noise[k, j]
        if k > 0:
            down, right, _ = control.angle_rates(roll, pitch, gyro[0], gyro[1], gyro[2])
            roll += dt * down
            pitch += dt * right
        if k % per_track == 0:
            # The estimate of roll and pitch leans on motion capture, or on the vehicle's own sense of level.
            if b.accelerometer != 0.0:
                lean_roll = np.arctan2(force[1], np.sqrt(force[0] ** 2 + force[2] ** 2)) + level[k, 0]
                lean_pitch = np.arctan2(-force[0], force[2]) + level[k, 1]
            else:
                lean_roll = poses[max(0, k - capture_age), 3] + mocap_noise[k, 3]
                lean_pitch = poses[max(0, k - capture_age), 4] + mocap_noise[k, 4]
            roll += c.attitude_trust * (lean_roll - roll)
            pitch += c.attitude_trust * (lean_pitch - pitch)
            _capture(poses[max(0, k - mocap_delay)], mocap_noise[k], roll, pitch, b, w, measured)
            _track(measured, dt * per_track, c, position, velocity)
        # Command.
        if k % per_pilot == 0:
            row = min(k // per_pilot, reference.shape[0] - 1)
            control.pilot(reference[row], position, velocity, measured[5], integral, c, command)
        for j in range(4):
            commands[k, j] = command[j]
        pwm = commands[heard[max(0, k - thrust_delay)], 0]
        _received(commands[heard[max(0, k - attitude_delay)]], w, setpoint)
        # A trim is an attitude sensor that sits crooked; a level that is off tilts the log too.
        level_roll, level_pitch = roll, pitch
        if w.level_roll != 0.0 or w.level_pitch != 0.0:
            level_roll, level_pitch, _ = dynamics.tilted(roll, pitch, 0.0, w.level_roll, w.level_pitch)
        gain = c.attitude_gain * w.attitude_gain_scale
        level_roll, level_pitch = level_roll - gain * w.trim_roll, level_pitch - gain * w.trim_pitch
        # The estimator knows its gyro's bias in roll and pitch, not about the vertical.
        gyro[2] -= w.yaw_drift
        control.flight_controller(pwm, setpoint, level_roll, level_pitch, gyro, memory, dt, c, b, w, target)
        volts = dynamics.voltage(s, time, c, w) - polarised
        polarised += dt / b.polarisation_time * (b.polarisation * dynamics.current(s, c) - polarised)
        supply = _supply(volts, c, b, w)
        for j in range(4):
            asked[k, j] = target[j] * supply
            target[j] = asked[max(0, k - dead_time), j]
        # Log.
        if k % per_log == 0:
            i = k // per_log
            _capture(poses[max(0, k - log_delay)], mocap_noise[k], roll, pitch, b, w, measured)
            _write(measured, command, volts, contact, log[i])
            _write_truth(s, poses[k], c, truth[i])
        for j in range(3):
            force[j] = s[dynamics.VELOCITY + j]
        for j in range(substeps):
            dynamics.advance(s, target, air[k], anchor, time + j * h, h, c, b, w, work, r, contact)
        _specific_force(s, r, dt, c, force)


@numba.njit(cache=True)
def _specific_force(s, r, dt, c, force):
    """What an accelerometer shows (3,) [m/s2], into `force`, which holds the velocity one period ago."""
    x = (s[dynamics.VELOCITY] - force[0]) / dt
    y = (s[dynamics.VELOCITY + 1] - force[1]) / dt
    z = (s[dynamics.VELOCITY + 2] - force[2]) / dt + c.gravity
    dynamics.rotation(s[dynamics.QUATERNION : dynamics.QUATERNION + 4], r)
    for j in range(3):
        force[j] = r[0, j] * x + r[1, j] * y + r[2, j] * z


@numba.njit(cache=True)
def _supply(volts, c, b, w):
    """Rotor speed per speed asked for, under the battery's voltage."""
    if w.battery_reference > 0.0:
        return (volts / w.battery_reference) ** (0.5 * b.battery_power)
    if b.uncompensated > 0.0:
        return (volts / c.battery_voltage) ** (0.5 * b.battery_power * b.uncompensated)
    return 1.0


@numba.njit(cache=True)
def _capture(pose, noise, roll, pitch, b, w, measured):
    """The pose (6,) as motion capture or, for roll and pitch, the vehicle's own estimate shows it."""
    for j in range(6):
        measured[j] = pose[j] + noise[j]
    if w.capture_scale != 0.0:
        measured[0] *= 1.0 + w.capture_scale * pose[0]
    if b.log_estimate != 0.0:
        measured[3], measured[4] = roll, pitch
    # The vehicle does not use the attitude of a tracked body that sits crooked.
    if w.mocap_roll != 0.0 or w.mocap_pitch != 0.0:
        measured[3], measured[4], measured[5] = dynamics.tilted(
            measured[3], measured[4], measured[5], w.mocap_roll, w.mocap_pitch
        )
    if w.level_roll != 0.0 or w.level_pitch != 0.0:
        measured[3], measured[4], measured[5] = dynamics.tilted(
            measured[3], measured[4], measured[5], w.level_roll, w.level_pitch
        )


@numba.njit(cache=True)
def _pose(s, r, poses, k, turns):
    """Pose of state s into row k of poses (m, 6), yaw continuous; returns the turns of yaw [rad] so far."""
    dynamics.rotation(s[dynamics.QUATERNION : dynamics.QUATERNION + 4], r)
    poses[k, 0], poses[k, 1], poses[k, 2] = s[0], s[1], s[2]
    poses[k, 3], poses[k, 4], poses[k, 5] = dynamics.angles(r)
    if k > 0:
        jump = poses[k, 5] + turns - poses[k - 1, 5]
        turns -= 2.0 * np.pi * np.round(jump / (2.0 * np.pi))
        poses[k, 5] += turns
    return turns


@numba.njit(cache=True)
def _track(measured, period, c, position, velocity):
    """The pilot's estimates (3,) of position and velocity follow the measured pose, every `period` [s]."""
    for j in range(3):
        position[j] += velocity[j] * period
        error = measured[j] - position[j]
        position[j] += c.position_filter[0] * error
        velocity[j] += c.position_filter[1] * error / period


@numba.njit(cache=True)
def _received(command, w, setpoint):
    """Roll, pitch and yaw rate (3,) that the vehicle makes of a command (4,)."""
    for j in range(3):
        setpoint[j] = command[1 + j]
    if w.dead_zone > 0.0:
        for j in range(2):
            if abs(setpoint[j]) < w.dead_zone:
                setpoint[j] = 0.0
    if w.quantum > 0.0:
        for j in range(2):
            setpoint[j] = w.quantum * np.round(setpoint[j] / w.quantum)
    setpoint[1] += w.cross_coupling * setpoint[0]


@numba.njit(cache=True)
def _write(measured, command, volts, contact, row):
    """A row (12,) of the log."""
    for j in range(6):
        row[j] = measured[j]
    row[10] = volts
    for j in range(4):
        row[6 + j] = command[j]
        if contact[j] > 0.0:
            row[11] = 1.0


@numba.njit(cache=True)
def _write_truth(s, pose, c, row):
    """A row (16,) of `Recording.truth`."""
    for j in range(3):
        row[j], row[3 + j], row[6 + j] = s[j], s[3 + j], pose[3 + j]
        row[9 + j] = s[dynamics.RATES + j]
    for j in range(4):
        row[12 + j] = c.thrust_per_speed * s[dynamics.ROTORS + j] ** 2


def initial_state(position, yaw: float, c: Constants, w: World) -> np.ndarray:
    """State (23,) of a vehicle at rest in the air with motors at hover speed, any load hanging still."""
    s = np.zeros(dynamics.SIZE)
    s[:3] = position
    s[dynamics.QUATERNION], s[dynamics.QUATERNION + 3] = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
    s[dynamics.ROTORS : dynamics.ROTORS + 4] = np.sqrt(c.mass * c.gravity / (4 * c.thrust_per_speed))
    s[dynamics.LOAD : dynamics.LOAD + 3] = position - np.array([0.0, 0.0, w.load_length])
    return s


def fly(
    path: np.ndarray,
    world: World,
    rng: np.random.Generator,
    reality: Reality | None = None,
    *,
    warm_up: float = WARM_UP,
) -> Recording:
    """Fly one path and return its log.

    path (k, REF_SIZE) at 50 Hz (see `control.py`), flown from its first row, after `warm_up` seconds
    on that row; reality: None is the reference; rng gives all noise and gusts.
    Raises ValueError for a delay that is not a whole number of control periods.
    """
    reality = reference() if reality is None else reality
    c, b = reality.constants, reality.build
    delays = (world.thrust_delay, world.attitude_delay, world.mocap_delay, world.log_delay)
    for delay in (*delays, b.capture_age, b.dead_time):
        if abs(delay * CONTROL_RATE - round(delay * CONTROL_RATE)) > 1e-6 or delay < 0:
            raise ValueError(f"a delay of {delay} s is not a whole number of {1000 / CONTROL_RATE:g} ms")
    waiting = np.repeat(path[:1], round(warm_up * PILOT_RATE), axis=0)
    rows = np.ascontiguousarray(np.vstack([waiting, path]))
    ticks = len(rows) * (CONTROL_RATE // PILOT_RATE)
    per_log = round(b.log_ticks)
    # The log begins with the first row at which the pilot commands after the warm-up.
    first = -(-round(warm_up * CONTROL_RATE) // per_log)
    samples = -(-ticks // per_log)
    gyro = c.gyro_noise * rng.standard_normal((ticks, 3))
    scale = np.array([c.position_noise] * 3 + [c.attitude_noise] * 3)
    mocap = scale * rng.standard_normal((ticks, 6))
    volts = c.voltage_noise * rng.standard_normal(samples)
    level = b.wander * correlated(rng, (ticks, 2), _LEVEL_TIME)
    log, truth = np.zeros((samples, 12)), np.zeros((samples, 16))
    s = initial_state(rows[0, :3], rows[0, control.REF_YAW], c, world)
    substeps = PHYSICS_RATE // CONTROL_RATE
    air, sent = _air(rng, ticks, b, world), heard(rng, ticks, np.array([world.command_jitter])).ravel()
    _fly(s, rows, air, gyro, mocap, level, sent, warm_up, substeps, *map(record, (c, b, world)), log, truth)
    log, truth = log[first:], truth[first:]
    t = np.arange(len(log)) * per_log / CONTROL_RATE
    if b.stamp_jitter > 0.0:
        late = np.clip(
            b.stamp_jitter * rng.standard_normal(len(t)), *(x * per_log / CONTROL_RATE for x in (-0.4, 0.4))
        )
        t = t + late - late[0]
    return Recording(
        t=t,
        position=log[:, :3],
        attitude=log[:, 3:6],
        command=log[:, 6:10],
        voltage=log[:, 10] + volts[first:],
        contact=log[:, 11] > 0,
        truth=truth,
    )


def correlated(rng, shape: tuple[int, ...], time, rate: int = CONTROL_RATE) -> np.ndarray:
    """Return Ornstein-Uhlenbeck paths (ticks, n, ...) of standard deviation 1; time: one, or (n,) [s]."""
    from scipy.signal import lfilter

    start, white = rng.standard_normal((1, *shape[1:])), rng.standard_normal(shape)
    paths = np.empty(shape)
    for j, keep in enumerate(np.exp(-1.0 / (np.broadcast_to(time, shape[1]) * rate))):
        each, gain = slice(j, j + 1), np.sqrt(1 - keep**2)
        paths[:, each] = lfilter([gain], [1, -keep], white[:, each], axis=0, zi=keep * start[:, each])[0]
    return paths


def _air(rng: np.random.Generator, ticks: int, b: Build, w: World) -> np.ndarray:
    """Wind, disturbance of acceleration, of angular acceleration (ticks, 8) (see `dynamics.derivative`)."""
    gust = w.gust * correlated(rng, (ticks, 2), w.gust_time)
    if w.gust_calm > 0.0:
        strength = correlated(rng, (ticks, 1), 1.5)
        gust *= strength > np.quantile(strength, w.gust_calm)
    size = np.array([*b.disturbance, *b.disturbance_torque])
    return np.hstack([gust, size * correlated(rng, (ticks, 6), b.disturbance_time)])


def heard(rng, ticks: int, latest: np.ndarray, rate: int = CONTROL_RATE) -> np.ndarray:
    """Return the period (ticks, n) whose command is in effect.

    Each command arrives up to `latest` (n,) [s] late.
    """
    held = rate // PILOT_RATE
    sent, periods = np.arange(0, ticks, held), np.arange(ticks)
    late_by = rng.uniform(0.0, 1.0, (len(sent), len(latest))) * latest * rate
    arrives = np.maximum.accumulate(sent[:, None] + np.round(late_by), axis=0)
    last = np.column_stack([np.searchsorted(one, periods, side="right") for one in arrives.T])
    # As many commands behind as have not arrived yet.
    behind = periods[:, None] // held - np.maximum(last - 1, 0)
    return np.maximum(periods[:, None] - behind * held, 0)
