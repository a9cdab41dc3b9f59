"""One flight: measurements, pilot, flight controller and physics in lockstep, and the log that comes out."""

from __future__ import annotations

import dataclasses

import numba
import numpy as np

from . import control, dynamics
from .vehicle import CONTROL_RATE, LOG_RATE, PHYSICS_RATE, PILOT_RATE, Constants, World, constants

WARM_UP = 4.0  # s flown before the log begins: filters and pilot settle
_GUST_TIME = 0.8  # s, correlation time


@dataclasses.dataclass(frozen=True)
class Recording:
    """The log of one flight at 100 Hz, as a motion capture and a radio would give it.

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
        """The rows from `start` to `end` [s], with time from 0; an even first row keeps the pilot's beat."""
        first = round(start * LOG_RATE) // 2 * 2
        rows = slice(max(0, first), round(end * LOG_RATE))
        cut = {f.name: getattr(self, f.name)[rows] for f in dataclasses.fields(self)}
        return Recording(**cut | {"t": cut["t"] - cut["t"][0]})


@numba.njit(cache=True)
def _fly(s, reference, gust, gyro_noise, mocap_noise, warm_up, substeps, c, w, log, truth):
    ticks = gyro_noise.shape[0]
    dt = 1.0 / CONTROL_RATE
    h = dt / substeps
    per_log, per_pilot = CONTROL_RATE // LOG_RATE, CONTROL_RATE // PILOT_RATE
    thrust_delay = round(w.thrust_delay * CONTROL_RATE)
    attitude_delay = round(w.attitude_delay * CONTROL_RATE)
    mocap_delay = round(w.mocap_delay * CONTROL_RATE)
    poses, commands = np.zeros((ticks, 6)), np.zeros((ticks, 4))
    work, r, contact = np.zeros((4, dynamics.SIZE)), np.zeros((3, 3)), np.zeros(4)
    anchor = np.full((4, 3), np.nan)
    target, memory = s[dynamics.ROTORS : dynamics.ROTORS + 4].copy(), np.zeros(7)
    command, setpoint, gyro = np.zeros(4), np.zeros(3), np.zeros(3)
    position, velocity, integral = s[:3].copy(), np.zeros(3), np.zeros(3)
    measured = np.zeros(6)
    dynamics.rotation(s[dynamics.QUATERNION : dynamics.QUATERNION + 4], r)
    roll, pitch, _ = dynamics.angles(r)
    turns = 0.0
    for k in range(ticks):
        time = k * dt - warm_up
        # Measure.
        turns = _pose(s, r, poses, k, turns)
        for j in range(3):
            gyro[j] = s[dynamics.RATES + j] + gyro_noise[k, j]
        if k > 0:
            a, b, _ = control.angle_rates(roll, pitch, gyro[0], gyro[1], gyro[2])
            roll += dt * a
            pitch += dt * b
        if k % per_log == 0:
            for j in range(6):
                measured[j] = poses[max(0, k - mocap_delay), j] + mocap_noise[k // per_log, j]
            # The estimate of roll and pitch leans on the vehicle's own sense of level.
            roll += c.attitude_trust * (measured[3] - roll)
            pitch += c.attitude_trust * (measured[4] - pitch)
            if w.mocap_roll != 0.0 or w.mocap_pitch != 0.0:
                measured[3], measured[4], measured[5] = dynamics.tilted(
                    measured[3], measured[4], measured[5], w.mocap_roll, w.mocap_pitch
                )
            _track(measured, dt, per_log, c, position, velocity)
        # Command.
        if k % per_pilot == 0:
            row = min(k // per_pilot, reference.shape[0] - 1)
            control.pilot(reference[row], position, velocity, measured[5], integral, c, command)
        for j in range(4):
            commands[k, j] = command[j]
        pwm = commands[max(0, k - thrust_delay), 0]
        _received(commands[max(0, k - attitude_delay)], w, setpoint)
        # A trim is an attitude sensor that sits crooked.
        gain = c.attitude_gain * w.attitude_gain_scale
        level_roll, level_pitch = roll - gain * w.trim_roll, pitch - gain * w.trim_pitch
        # The estimator knows its gyro's bias in roll and pitch, not about the vertical.
        gyro[2] -= w.yaw_drift
        control.flight_controller(pwm, setpoint, level_roll, level_pitch, gyro, memory, dt, c, w, target)
        volts = dynamics.voltage(s, time, c, w)
        if w.battery_reference > 0.0:
            for j in range(4):
                target[j] *= volts / w.battery_reference
        # Log.
        if k % per_log == 0:
            i = k // per_log
            _write(measured, command, volts, contact, log[i])
            _write_truth(s, poses[k], c, truth[i])
        for j in range(substeps):
            dynamics.advance(s, target, gust[k], anchor, time + j * h, h, c, w, work, r, contact)


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
def _track(measured, dt, per_log, c, position, velocity):
    """The pilot's estimates (3,) of position and velocity follow the measured pose, every `per_log` steps."""
    for j in range(3):
        position[j] += velocity[j] * dt * per_log
        error = measured[j] - position[j]
        position[j] += c.position_filter[0] * error
        velocity[j] += c.position_filter[1] * error / (dt * per_log)


@numba.njit(cache=True)
def _received(command, w, setpoint):
    """Roll, pitch and yaw rate (3,) that the vehicle makes of a command (4,)."""
    for j in range(3):
        setpoint[j] = command[1 + j]
    if w.dead_zone > 0.0:
        for j in range(2):
            if abs(setpoint[j]) < w.dead_zone:
                setpoint[j] = 0.0
    setpoint[1] += w.cross_coupling * setpoint[0]


@numba.njit(cache=True)
def _write(measured, command, volts, contact, row):
    """A row (12,) of the log."""
    row[:6], row[6:10], row[10] = measured, command, volts
    for j in range(4):
        if contact[j] > 0.0:
            row[11] = 1.0


@numba.njit(cache=True)
def _write_truth(s, pose, c, row):
    """A row (16,) of `Recording.truth`."""
    row[:6], row[6:9], row[9:12] = s[:6], pose[3:6], s[dynamics.RATES : dynamics.RATES + 3]
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
    reference: np.ndarray,
    world: World,
    rng: np.random.Generator,
    *,
    noise: float = 1.0,
    vehicle: Constants | None = None,
    warm_up: float = WARM_UP,
    physics_rate: int = PHYSICS_RATE,
) -> Recording:
    """Fly one reference and return its log.

    reference (k, REF_SIZE) at 50 Hz (see `control.py`), flown from its first row, after `warm_up` seconds
    on that row; noise scales the motion capture's; rng gives all noise and gusts.
    Raises ValueError for a delay that is not a whole number of control periods.
    """
    c = constants() if vehicle is None else vehicle
    for delay in (world.thrust_delay, world.attitude_delay, world.mocap_delay):
        if abs(delay * CONTROL_RATE - round(delay * CONTROL_RATE)) > 1e-6 or delay < 0:
            raise ValueError(f"a delay of {delay} s is not a whole number of {1000 / CONTROL_RATE:g} ms")
    waiting = np.repeat(reference[:1], round(warm_up * PILOT_RATE), axis=0)
    rows = np.ascontiguousarray(np.vstack([waiting, reference]))
    ticks = len(rows) * (CONTROL_RATE // PILOT_RATE)
    samples = ticks * LOG_RATE // CONTROL_RATE
    gyro = c.gyro_noise * rng.standard_normal((ticks, 3))
    scale = np.array([c.position_noise] * 3 + [c.attitude_noise] * 3)
    mocap = noise * scale * rng.standard_normal((samples, 6))
    volts = c.voltage_noise * rng.standard_normal(samples)
    gust = _gusts(rng.standard_normal((ticks, 2)), world.gust)
    log, truth = np.zeros((samples, 12)), np.zeros((samples, 16))
    s = initial_state(rows[0, :3], rows[0, control.REF_YAW], c, world)
    substeps = physics_rate // CONTROL_RATE
    _fly(s, rows, gust, gyro, mocap, warm_up, substeps, c, world, log, truth)
    first = round(warm_up * LOG_RATE)
    log, truth = log[first:], truth[first:]
    return Recording(
        t=np.arange(len(log)) / LOG_RATE,
        position=log[:, :3],
        attitude=log[:, 3:6],
        command=log[:, 6:10],
        voltage=log[:, 10] + volts[first:],
        contact=log[:, 11] > 0,
        truth=truth,
    )


def _gusts(white: np.ndarray, deviation: float) -> np.ndarray:
    """Ornstein-Uhlenbeck wind (ticks, 2) [m/s] from white noise (ticks, 2)."""
    from scipy.signal import lfilter

    keep = np.exp(-1.0 / (_GUST_TIME * CONTROL_RATE))
    return deviation * lfilter([np.sqrt(1 - keep**2)], [1, -keep], white, axis=0)
