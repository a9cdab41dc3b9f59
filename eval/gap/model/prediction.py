"""The simulator's prediction along a measured flight, channel by channel.

Translation is driven by the measured attitude and the commanded PWM, the attitude loops run open loop
from the attitude commands, yaw from the yaw rate command. A start state enters the first linearly and
has died away in the others, so that one pass over a flight serves every short window of it: whitening
projects the start state out.

Effects are those of the vehicle: its packed constants (`forces.pack`) and its delays. Commands are
held between rows and averaged exactly over each step, which makes delays differentiable.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numba
import numpy as np

from inclined_landing.eval.gap.flights.windows import REQUEST_SIGNS
from inclined_landing.eval.gap.model.swing import pulled
from inclined_landing.models.attitude import (
    PITCH_COMMAND,
    PWM,
    ROLL_COMMAND,
    YAW_RATE_COMMAND,
    euler_rates,
    tilted,
)
from inclined_landing.models.attitude_loops import angle_steps, integrated_angle_steps, yaw_steps
from inclined_landing.models.delays import averages
from inclined_landing.models.forces import lag_step, lags, pack, wrench
from inclined_landing.models.perturbation import NEUTRAL
from inclined_landing.models.vehicle import Vehicle

CHANNELS = ("x", "y", "z", "roll", "pitch", "yaw")  # of the pose
REQUEST_CHANNELS = ("roll request", "pitch request", "yaw request")
# Of a disturbance in a channel.
UNITS_OF = {
    **dict.fromkeys(CHANNELS[:3], "m/s2"),
    **dict.fromkeys(CHANNELS[3:], "rad/s2"),
    **dict.fromkeys(REQUEST_CHANNELS, "1"),
}
ROLL_CHANNEL, YAW_CHANNEL = 3, 5
_NEUTRAL = np.array(NEUTRAL)


def channels_of(flights) -> tuple[str, ...]:
    """Return the names of the channels (C,) of flights, or of a problem."""
    return CHANNELS if flights.channels == len(CHANNELS) else CHANNELS + REQUEST_CHANNELS


def predict(flight, vehicle: Vehicle, like: tuple[np.ndarray, np.ndarray] | None = None) -> np.ndarray:
    """Return what is predicted (m, C) of `vehicle` along a `MeasuredFlight`: x, y, z, roll, pitch, yaw, and
    the differences of the motors' requests where they were logged.

    like: the result of `translated` for a vehicle with the same translation.

    Positions start at zero with velocity zero: compare them up to a line in time. Measurements that are
    late (mocap_delay) meet commands that are early by as much; a tilt (mocap_tilt) and a further delay
    (estimator_delay) of the measured attitude are taken off the attitude that drives the translation, and
    put on that of the loops.
    """
    late = vehicle.effects_mocap_delay
    vehicle, given = as_flown(flight, vehicle), vehicle
    dt, packed = flight.dt, pack(vehicle)
    tilt = vehicle.effects_mocap_tilt
    out = np.empty((flight.samples, flight.channels))
    out[:, :3], twist = translated(flight, vehicle) if like is None else like
    commands, start = _loop_commands(flight, vehicle)
    for k in (0, 1):
        out[:, ROLL_CHANNEL + k] = angle_steps(k, commands[k], twist[:, k], start[k], dt, packed)
    turns = averages(flight.command[:, YAW_RATE_COMMAND], dt, vehicle.effects_attitude_delay + late)
    out[:, YAW_CHANNEL] = yaw_steps(turns, dt, packed)
    if any(tilt):
        angles_of = slice(ROLL_CHANNEL, YAW_CHANNEL + 1)
        tilted(out[:, angles_of].copy(), *tilt, out[:, angles_of])
    if flight.requests is not None:
        out[:, YAW_CHANNEL + 1 :] = requested_differences(flight, given)
    return out


def _loop_commands(flight, vehicle: Vehicle) -> tuple[list[np.ndarray], np.ndarray]:
    """Return what the loops of roll and pitch follow (m - 1,) each, and the attitude at which they start."""
    late = vehicle.effects_mocap_delay + vehicle.effects_estimator_delay
    delay = max(0.0, vehicle.effects_attitude_delay + late)
    roll, pitch = (averages(flight.command[:, k], flight.dt, delay) for k in (ROLL_COMMAND, PITCH_COMMAND))
    _, rotation, start = flight.attitude_of(vehicle)
    if (
        lean := vehicle.effects_estimator_lean
    ):  # the angle at which the loops come to rest moves with the speed: as by a command
        moved = lean / vehicle.attitude_gain * np.einsum("kji,kj->ki", rotation, flight.middle_velocity)
        roll, pitch = roll - moved[:, 1], pitch + moved[:, 0]
    return [roll, pitch], start


def angle_integrals(flight, vehicle: Vehicle) -> np.ndarray:
    """Return the integrals (m, 2) [rad s] of the errors of roll and pitch along a flight's prediction."""
    if vehicle.effects_attitude_integral == 0.0:
        return np.zeros((flight.samples, 2))
    vehicle, (_, twist) = as_flown(flight, vehicle), translated(flight, vehicle)
    commands, start = _loop_commands(flight, vehicle)
    packed, loops = pack(vehicle), zip((0, 1), commands, twist.T, start)
    steps = [integrated_angle_steps(k, u, t, x, flight.dt, packed) for k, u, t, x in loops]
    return np.stack([loop[:, 1] for loop in steps], axis=1)


def as_flown(flight, vehicle: Vehicle) -> Vehicle:
    """Return the vehicle without what a flight's log shows otherwise.

    Measured rotor speeds lag behind nothing. Where the requests of the motors were logged, these show a
    thrust beside the centre of mass: a controller that asks for them leaves nothing of it in the attitude.
    """
    if flight.thrust_is_measured:
        vehicle = vehicle.without_thrust_lag()
    if flight.requests is not None:
        vehicle = vehicle.changed(effects_com_offset=vehicle.thrust_centre)
    return vehicle


def delayed_commands(command: np.ndarray, dt: float, vehicle: Vehicle) -> tuple[np.ndarray, np.ndarray]:
    """Return commands (m, 4) as delayed means (m - 1, 4) over each step, and the thrust lag state (m,)."""
    late = vehicle.effects_mocap_delay
    delays = [vehicle.effects_thrust_delay + late] + [vehicle.effects_attitude_delay + late] * 3
    commands = np.stack([averages(command[:, k], dt, d) for k, d in enumerate(delays)], axis=1)
    return commands, lags(commands[:, PWM], dt, pack(vehicle))


def without_delays(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle without delays, for commands that `delayed_commands` has delayed."""
    return dataclasses.replace(
        vehicle, effects_thrust_delay=0.0, effects_attitude_delay=0.0, effects_mocap_delay=0.0
    )


def requested_differences(flight, vehicle: Vehicle) -> np.ndarray:
    """Return the differences (m, 3) of the motors' requests in roll, pitch and yaw that the motion needs.

    They are relative to the sum of all four; see `REQUEST_SIGNS`.
    """
    # With the centre of mass at (x, y), the torques over arm and weight that the rotors must give:
    #   t_roll = J_x p'/(arm m g) + y/arm,  t_pitch = J_y q'/(arm m g) - x/arm,  t_yaw = imbalance
    # and the request of a motor that has lost the share l_i:  r_i ~ (1 + sum_k s_ki t_k) / (1 - l_i)
    x, y = np.array(vehicle.effects_com_offset) / vehicle.rotor_arm
    wanted = flight.requests.torques + [y, -x, vehicle.effects_yaw_imbalance]
    requested = (1.0 + wanted @ REQUEST_SIGNS) / (1.0 - np.array(vehicle.effects_rotor_loss))
    return requested @ REQUEST_SIGNS.T / requested.sum(axis=1, keepdims=True)


def translated(flight, vehicle: Vehicle) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (m, 3) from rest at zero, and angular accelerations (m - 1, 3) of roll, pitch, yaw."""
    late, dt = vehicle.effects_mocap_delay, flight.dt
    vehicle = as_flown(flight, vehicle)
    pwm = averages(flight.command[:, PWM], dt, vehicle.effects_thrust_delay + late)
    attitude, rotation, _ = flight.attitude_of(vehicle)
    out, twist = np.empty((flight.samples, 3)), np.zeros((flight.samples - 1, 3))
    measured = _Measured(flight.middle_position, flight.middle_velocity, rotation, attitude)
    acceleration = np.empty_like(twist)
    _accelerate(measured, pwm, flight.ambient, pack(vehicle), dt, acceleration, twist)
    if vehicle.effects_load_mass != 0.0:
        acceleration = pulled(flight, vehicle, acceleration)
    _translate(acceleration, vehicle.environment_gravity, dt, out)
    return out, twist


class _Measured(NamedTuple):
    """The measured motion in the middle of each of m steps."""

    position: np.ndarray  # (m, 3) m
    velocity: np.ndarray  # (m, 3) m/s
    rotation: np.ndarray  # (m, 3, 3), body to world
    attitude: np.ndarray  # (m, 3) roll, pitch, yaw, rad


@numba.njit(cache=True, nogil=True)
def _accelerate(measured, pwm, ambient, vehicle, dt, out, twist):
    """Write accelerations without gravity's and a load's into out, of roll, pitch and yaw into twist."""
    position, velocity, rotation, attitude = measured
    v, f = vehicle[0], np.zeros(5)
    lag = pwm[0] / v.thrust.lag_rate
    for k in range(pwm.shape[0]):
        u = pwm[k]
        lag, mean = lag_step(lag, u, dt, v)
        r = rotation[k]
        wrench(position[k], velocity[k], r, mean, u, ambient[k], v, _NEUTRAL, f)
        for i in range(3):
            out[k, i] = (r[i, 0] * f[0] + r[i, 1] * f[1] + r[i, 2] * f[2]) / v.body.mass
        if f[3] != 0.0 or f[4] != 0.0:
            twist[k, 0], twist[k, 1], twist[k, 2] = euler_rates(
                attitude[k, 0], attitude[k, 1], f[3] / v.body.inertia[0], f[4] / v.body.inertia[1], 0.0
            )


@numba.njit(cache=True, nogil=True)
def _translate(acceleration, gravity, dt, out):
    """Write positions (m, 3) from rest at zero under accelerations (m - 1, 3) without gravity's into out."""
    moved, speed = np.zeros(3), np.zeros(3)
    out[0, 0] = out[0, 1] = out[0, 2] = 0.0
    for k in range(len(acceleration)):
        # x += dt (v + dt/2 a), v += dt a,  a = R f/m - (0, 0, g)
        for i in range(3):
            a = acceleration[k, i]
            if i == 2:
                a -= gravity
            moved[i] += dt * (speed[i] + 0.5 * dt * a)
            speed[i] += dt * a
            out[k + 1, i] = moved[i]
