"""The simulator's prediction along a measured flight, channel by channel.

Translation is driven by the measured attitude and the commanded PWM, the attitude loops run open loop
from the attitude commands, yaw from the yaw rate command. A start state enters the first linearly and
has died away in the others, so that one pass over a flight serves every short window of it: whitening
projects the start state out.

Effects are those of the vehicle: its packed constants (`equations.pack`) and its delays. Commands are
held between rows and averaged exactly over each step, which makes delays differentiable.
"""

from __future__ import annotations

import functools

import numba
import numpy as np
from scipy.linalg import expm

from inclined_landing.models.attitude import PWM, euler_rates, rotations, tilted
from inclined_landing.models.equations import pack, wrench
from inclined_landing.models.parameters import Vehicle
from inclined_landing.models.perturbation import NEUTRAL

CHANNELS = ("x", "y", "z", "roll", "pitch", "yaw")
X_CHANNEL, Z_CHANNEL, ROLL_CHANNEL, YAW_CHANNEL = 0, 2, 3, 5
_NEUTRAL = np.array(NEUTRAL)


def predict(flight, vehicle: Vehicle) -> np.ndarray:
    """Predicted pose (m, 6) of `vehicle` along a `windows.Measured`: x, y, z, roll, pitch, yaw.

    Positions start at zero with velocity zero: compare them up to a line in time. Measurements that are
    late (mocap_delay) meet commands that are early by as much; a tilt of the measured attitude
    (mocap_tilt) is taken off the attitude that drives the translation, and put on that of the loops.
    """
    late = vehicle.effects_mocap_delay
    dt = flight.dt
    pwm = averages(flight.command[:, PWM], dt, vehicle.effects_thrust_delay + late)
    angles = [averages(flight.command[:, k], dt, vehicle.effects_attitude_delay + late) for k in (1, 2, 3)]
    middle_attitude, middle_rotation, start = (
        flight.middle_attitude,
        flight.middle_rotation,
        flight.attitude[0],
    )
    tilt = vehicle.effects_mocap_tilt
    if any(tilt):
        middle_attitude, start = level(middle_attitude, tilt), level(flight.attitude[:1], tilt)[0]
        middle_rotation = rotations(middle_attitude)
    out = np.empty((flight.samples, 6))
    twist = np.zeros((flight.samples - 1, 3))
    _translate(
        flight.middle_position,
        flight.middle_velocity,
        middle_rotation,
        middle_attitude,
        pwm,
        flight.ambient,
        pack(vehicle),
        dt,
        out,
        twist,
    )
    bandwidth, tau = vehicle.attitude_bandwidth, vehicle.attitude_time_constant
    loop, drive = _discrete(bandwidth, tau, dt)
    for k in (0, 1):
        wanted = vehicle.attitude_gain * (angles[k] + vehicle.effects_attitude_trim[k])
        _second_order(wanted, twist[:, k], loop, drive, start[k], out[:, ROLL_CHANNEL + k])
    if any(tilt):  # with the measured heading: that of the loops is only compared up to its start
        loops = np.column_stack([out[:, ROLL_CHANNEL : ROLL_CHANNEL + 2], flight.attitude[:, 2]])
        tilted(loops.copy(), *tilt, loops)
        out[:, ROLL_CHANNEL : ROLL_CHANNEL + 2] = loops[:, :2]
    _first_order(
        angles[2] + vehicle.effects_yaw_drift, vehicle.attitude_yaw_bandwidth, dt, out[:, YAW_CHANNEL]
    )
    return out


def level(attitude: np.ndarray, tilt: tuple[float, float]) -> np.ndarray:
    """Attitudes (m, 3) of the vehicle whose measured ones are `attitude`, by a tilt (roll, pitch) [rad]."""
    # Ry(-pitch) Rx(-roll) undoes Rx(roll) Ry(pitch).
    out = np.empty_like(attitude)
    tilted(attitude, 0.0, -tilt[1], out)
    tilted(out.copy(), -tilt[0], 0.0, out)
    return out


@numba.njit(cache=True, nogil=True)
def averages(command, dt, delay):
    """Mean of a held command (m,) over each of the m - 1 steps, `delay` seconds late; (m - 1,)."""
    m = command.shape[0]
    mean = np.empty(m - 1)
    shift = delay / dt
    whole = int(np.floor(shift))
    part = shift - whole
    for k in range(m - 1):
        newer, older = max(0, k - whole), max(0, k - whole - 1)
        mean[k] = (1.0 - part) * command[newer] + part * command[older]
    return mean


@numba.njit(cache=True, nogil=True)
def _translate(position, velocity, attitude_matrix, attitude, pwm, ambient, vehicle, dt, out, twist):
    """Positions from rest at zero into out[:, :3], angular accelerations (roll, pitch, yaw) into twist."""
    v, f = vehicle[0], np.zeros(5)
    lag = pwm[0] / v.thrust.lag_rate
    moved, speed = np.zeros(3), np.zeros(3)
    out[0, 0] = out[0, 1] = out[0, 2] = 0.0
    for k in range(pwm.shape[0]):
        u = pwm[k]
        rate = v.thrust.lag_rate
        if v.effects.spin_down != 0.0 and u < v.thrust.lag_rate * lag:  # spins down slower, with that effect
            rate /= 1.0 + v.effects.spin_down
        steady = u / v.thrust.lag_rate
        decay = np.exp(-rate * dt)
        mean = steady + (lag - steady) * (1.0 - decay) / (rate * dt)
        lag = steady + (lag - steady) * decay
        r = attitude_matrix[k]
        wrench(position[k], velocity[k], r, mean, u, ambient[k], v, _NEUTRAL, f)
        for i in range(3):
            a = (r[i, 0] * f[0] + r[i, 1] * f[1] + r[i, 2] * f[2]) / v.body.mass
            if i == 2:
                a -= v.environment.gravity
            moved[i] += dt * (speed[i] + 0.5 * dt * a)
            speed[i] += dt * a
            out[k + 1, i] = moved[i]
        if f[3] != 0.0 or f[4] != 0.0:
            twist[k, 0], twist[k, 1], twist[k, 2] = euler_rates(
                attitude[k, 0], attitude[k, 1], f[3] / v.body.inertia[0], f[4] / v.body.inertia[1], 0.0
            )


@functools.lru_cache(maxsize=512)
def _discrete(bandwidth: float, tau: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Exact step of angle'' = B ((wanted - angle)/tau - rate) - rate/tau + twist.

    Returns the matrix (2, 2) on (angle, rate) and the input matrix (2, 2) on (wanted, twist).
    """
    a = np.zeros((4, 4))
    a[0, 1] = 1.0
    a[1] = [-bandwidth / tau, -bandwidth - 1.0 / tau, bandwidth / tau, 1.0]
    e = expm(a * dt)
    return np.ascontiguousarray(e[:2, :2]), np.ascontiguousarray(e[:2, 2:])


@numba.njit(cache=True, nogil=True)
def _second_order(wanted, twist, loop, drive, start, out):
    angle, rate = start, 0.0
    out[0] = angle
    for k in range(wanted.shape[0]):
        new = loop[0, 0] * angle + loop[0, 1] * rate + drive[0, 0] * wanted[k] + drive[0, 1] * twist[k]
        rate = loop[1, 0] * angle + loop[1, 1] * rate + drive[1, 0] * wanted[k] + drive[1, 1] * twist[k]
        angle = new
        out[k + 1] = angle


@numba.njit(cache=True, nogil=True)
def _first_order(rate_wanted, bandwidth, dt, out):
    """Yaw from zero, its rate following the wanted one with a bandwidth."""
    rate, angle = rate_wanted[0], 0.0
    decay = np.exp(-bandwidth * dt)
    out[0] = 0.0
    for k in range(rate_wanted.shape[0]):
        u = rate_wanted[k]
        angle += u * dt + (rate - u) * (1.0 - decay) / bandwidth
        rate = u + (rate - u) * decay
        out[k + 1] = angle
