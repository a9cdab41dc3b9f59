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
from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from inclined_landing.eval.gap.measured.windows import REQUEST_SIGNS
from inclined_landing.eval.gap.model.swing import Starts, pulled
from inclined_landing.models import plugins
from inclined_landing.models.attitude import PWM, ROLL_COMMAND, YAW_RATE_COMMAND, entries, tilted
from inclined_landing.models.attitude_loops import angle_steps, integrated_steps, yaw_steps
from inclined_landing.models.compiled import inlined, unlocked
from inclined_landing.models.delays import averages
from inclined_landing.models.forces import (
    AZIMUTH,
    INCLINATION,
    PRESENT,
    ground_effect,
    lags,
    pack,
    wrench_near,
)
from inclined_landing.models.perturbation import NEUTRAL
from inclined_landing.models.vehicle import Vehicle

CHANNELS = ("x", "y", "z", "roll", "pitch", "yaw")  # of the pose
REQUEST_CHANNELS = ("roll request", "pitch request", "yaw request")
# The unit of a disturbance in each channel.
UNITS_OF = {
    **dict.fromkeys(CHANNELS[:3], "m/s2"),
    **dict.fromkeys(CHANNELS[3:], "rad/s2"),
    **dict.fromkeys(REQUEST_CHANNELS, "1"),
}
ROLL_CHANNEL, YAW_CHANNEL = 3, 5
# Channels of effects -> channels of a flight.
CHANNEL_GROUPS = {
    "translation": slice(0, 3),
    "attitude": slice(3, 5),
    "yaw": slice(5, 6),
    "requests": slice(6, 9),
}
_NEUTRAL = np.array(NEUTRAL)
# These constants act in the attitude loops alone, as do those of the table `attitude`: the constants of the
# loops' plugin, and the delay of their commands. Vehicles that differ in none of these share a prediction of
# the attitude.
_OF_THE_LOOPS = {*plugins.fields()["attitude"].values(), "effects_attitude_delay"}
_fields = [f.name for f in dataclasses.fields(Vehicle)]
_of_loops = [n for n in _fields if n in _OF_THE_LOOPS or n.startswith("attitude_")]
_translation = attrgetter(*(n for n in _fields if n not in _of_loops))  # of a vehicle: all that it depends on
_loops = attrgetter(*_of_loops, "effects_mocap_delay")  # with the attitude and the moments


def channels_of(flights) -> tuple[str, ...]:
    """Return the names of the channels (C,) of flights, or of a problem."""
    return CHANNELS if flights.channels == len(CHANNELS) else CHANNELS + REQUEST_CHANNELS


def predict(flight, vehicle: Vehicle) -> np.ndarray:
    """Return what is predicted (m, C) of `vehicle` along a `MeasuredFlight`: x, y, z, roll, pitch, yaw, and
    the differences of the motors' requests where they were logged.

    Positions start at zero with velocity zero: compare them up to a line in time. Measurements that are
    late (mocap_delay) meet commands that are early by as much; a tilt (mocap_tilt) and a further delay
    (estimator_delay) of the measured attitude are taken off the attitude that drives the translation, and
    put on that of the loops.
    """
    return predictor(flight, [vehicle])(flight)[0]


def predictor(like, vehicles: Sequence[Vehicle]) -> Callable[[Any], np.ndarray]:
    """Return the predictions (n, m, C) of vehicles as a function of a flight logged as the flight `like` is.

    In memory they lie one channel after another.
    """
    packed = _packed(like, vehicles)
    # For speed alone: vehicles with the same correction of the measured attitude are predicted together, and
    # what one has in common with the first of them (`same`) is taken from that.
    seen = [(v.effects_mocap_tilt, v.effects_estimator_delay) for v in vehicles]
    groups = []
    for alike in dict.fromkeys(seen):
        own = np.array([k for k, one in enumerate(seen) if one == alike])
        of_first = vehicles[own[0]]
        same = [[of(vehicles[k]) == of(of_first) for k in own] for of in (_translation, _loops)]
        groups.append((of_first, own, np.array(same)))

    def along(flight) -> np.ndarray:
        out = np.empty((len(vehicles), flight.channels, flight.samples))
        for of_first, own, same in groups:
            begun = Starts.none(flight.samples, flight.starts, flight.rows, flight.dt)
            _predict(_Measured.of(flight, of_first), packed, own, same, begun, out)
        if flight.requests is not None:
            for vehicle, one in zip(vehicles, out):
                one[YAW_CHANNEL + 1 :] = requested_differences(flight, vehicle).T
        return out.transpose(0, 2, 1)

    return along


def angle_integrals(flight, vehicle: Vehicle) -> np.ndarray:
    """Return the integrals (m, 2) [rad s] of the errors of roll and pitch along a flight's prediction."""
    if vehicle.effects_attitude_integral == vehicle.effects_attitude_hold == 0.0:
        return np.zeros((flight.samples, 2))
    return _integrals(_Measured.of(flight, vehicle), _packed(flight, [vehicle]))


def _packed(flight, vehicles: Sequence[Vehicle]) -> np.ndarray:
    """Return vehicles (n,) as the kernels take them, without what a flight's log shows otherwise."""
    packed = [pack(as_flown(flight, v)) for v in vehicles]
    return np.stack([one.view(float) for one in packed]).view(packed[0].dtype)[:, 0]


def as_flown(flight, vehicle: Vehicle) -> Vehicle:
    """Return the vehicle without what a flight's log shows otherwise.

    Measured rotor speeds lag behind nothing. Where the requests of the motors were logged, these show a
    thrust that acts off the centre of mass: a controller that asks for them leaves nothing of it in the
    attitude.
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
    return commands, lags(commands[:, PWM], dt, pack(vehicle))[0]


def without_delays(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle without delays, for commands that `delayed_commands` has delayed."""
    return dataclasses.replace(
        vehicle, effects_thrust_delay=0.0, effects_attitude_delay=0.0, effects_mocap_delay=0.0
    )


def requested_differences(flight, vehicle: Vehicle) -> np.ndarray:
    """Return the differences (m, 3) of the motors' requests in roll, pitch and yaw that the motion needs.

    They are relative to the sum of all four; see `REQUEST_SIGNS`.
    """
    # With the centre of mass at (x, y), the steady torques over arm and weight that the rotors must give:
    #   t_roll = y/arm,  t_pitch = -x/arm,  t_yaw = imbalance
    # the request of a motor that has lost the share l_i:  r_i ~ ((1 + sum_k s_ki t_k) / (1 - l_i))^(1/e),
    # e = d log F / d log PWM in hover, and the differences with the motion's torques J w'/(arm m g), to first
    # order in these:  d_k = J_k w_k'/(arm m g e) + sum_i s_ki r_i / sum_i r_i. Products of both depend on how
    # the thrust bends over its command, which no vehicle file says so exactly.
    x, y = np.array(vehicle.effects_com_offset) / vehicle.rotor_arm
    slope = flight.requests.slope or thrust_elasticity(vehicle)
    needed = 1.0 + np.array([y, -x, vehicle.effects_yaw_imbalance]) @ REQUEST_SIGNS
    requested = np.maximum(needed / (1.0 - np.array(vehicle.effects_rotor_loss)), 0.0) ** (1.0 / slope)
    return flight.requests.torques / slope + REQUEST_SIGNS @ requested / requested.sum()


def thrust_elasticity(vehicle: Vehicle) -> float:
    """Return by what power of its command a rotor's thrust goes in hover, at the same voltage.

    It is kept to what propellers and batteries do: flights at one height show the thrust, not its slope.
    """
    # F = (k u + bias) (1 - sag (u / reference - 1)):  e = k u / (k u + bias) - sag u / reference / (1 - ...)
    u = vehicle.hover_pwm
    for _ in range(3):  # the command at which this is the weight
        load = u / vehicle.effects_battery_reference
        sag = 1.0 - vehicle.effects_battery_sag * (load - 1.0)
        u = (vehicle.weight / max(sag, 0.1) - vehicle.effects_thrust_bias) / vehicle.thrust_per_pwm
    line = vehicle.thrust_per_pwm * u
    load = u / vehicle.effects_battery_reference
    slope = line / (line + vehicle.effects_thrust_bias)
    slope -= vehicle.effects_battery_sag * load / max(1.0 - vehicle.effects_battery_sag * (load - 1.0), 0.1)
    return min(max(slope, 0.7), 1.4)


class _Measured(NamedTuple):
    """Measurements in m rows, and at the middle of the m - 1 steps between them."""

    command: np.ndarray  # (m, 4)
    position: np.ndarray  # (m, 3) m
    middle_position: np.ndarray  # (m - 1, 3) m
    velocity: np.ndarray  # (m - 1, 3) m/s
    rotation: np.ndarray  # (m - 1, 3, 3), body to world
    turning: np.ndarray  # (m - 1, 3) Euler rates of a body rate of 1 rad/s about x
    first_attitude: np.ndarray  # (3,) in the first row
    ambient: np.ndarray  # (m - 1, AMBIENT_SIZE)
    starts: np.ndarray  # (w,) first row of every window
    rows: int  # of a window
    dt: float  # s

    @staticmethod
    def of(flight, vehicle: Vehicle) -> _Measured:
        """Return a flight as the kernels take it, attitudes as the rotors were (`attitude_of`)."""
        _, rotation, turning, first_attitude = flight.attitude_of(vehicle)
        return _Measured(
            command=flight.command,
            position=flight.position,
            middle_position=flight.middle_position,
            velocity=flight.middle_velocity,
            rotation=rotation,
            turning=turning,
            first_attitude=first_attitude,
            ambient=flight.ambient,
            starts=flight.starts,
            rows=flight.rows,
            dt=flight.dt,
        )


@unlocked
def _predict(measured, vehicles, own, same, begun, out):
    """Write the predicted pose (6, m) of every vehicle `own` (k,) into out (n, C, m).

    same (2, k): whether its translation, and its loops, are those of the first of these. begun: `Starts` of
    loads.
    """
    dt, steps, pose = measured.dt, measured.velocity.shape, slice(0, YAW_CHANNEL + 1)
    twist, first_twist, near = np.zeros(steps), np.zeros(steps), np.zeros(steps)
    pwm, lag, first_commands, first_yaw = np.empty(0), np.empty(0), np.empty((2, 0)), np.empty(0)
    met, driven = 0, 0  # the vehicles that `near`, and `pwm` and `lag`, are of
    for k in range(len(own)):
        vehicle, predicted, first = vehicles[own[k] : own[k] + 1], out[own[k], pose], out[own[0], pose]
        v = vehicle[0]
        if k == 0 or not same[0, k]:
            if k == 0 or not _same_ground(v, vehicles[own[met]]):
                _ground(measured, v, near)
                met = k
            if k == 0 or not _same_lag(v, vehicles[own[driven]]):
                pwm, lag = _thrust_commands(measured, vehicle)
                driven = k
            acceleration = _accelerations(measured, v, near, pwm, lag, twist)
            if v.effects.load_mass != 0.0:
                seen, starts, rows = measured.position, measured.starts, measured.rows
                acceleration = pulled(acceleration, seen, starts, rows, dt, vehicle, begun)
            _translate(acceleration, v.environment.gravity, dt, predicted)
        else:
            predicted[:ROLL_CHANNEL], twist[:] = first[:ROLL_CHANNEL], first_twist
        alike = k > 0 and same[1, k]
        if alike and np.array_equal(twist, first_twist):
            predicted[ROLL_CHANNEL:] = first[ROLL_CHANNEL:]
            continue
        if not alike:
            commands, yaw = _loop_commands(measured, v), _yaw(measured, vehicle)
        else:
            commands, yaw = first_commands, first_yaw
        angles = np.empty((len(yaw), 3))
        for axis in range(2):
            turned, start = twist[:, axis], measured.first_attitude[axis]
            angles[:, axis] = angle_steps(axis, commands[axis], turned, start, dt, vehicle)
        angles[:, 2] = yaw
        if k == 0:
            first_twist[:], first_commands, first_yaw = twist, commands, yaw
        tilt = v.effects.mocap_tilt
        if tilt[0] != 0.0 or tilt[1] != 0.0:
            tilted(angles.copy(), tilt[0], tilt[1], angles)
        predicted[ROLL_CHANNEL:] = angles.T


@inlined
def _same_ground(v, w):
    """Return whether two vehicles meet the same ground effect at the same thrust."""
    same = v.effects.ground_effect == w.effects.ground_effect
    same &= v.effects.ground_fading == w.effects.ground_fading
    same &= v.rotor.radius == w.rotor.radius and v.rotor.arm == w.rotor.arm
    same &= v.rotor.height == w.rotor.height and v.slab_half_length == w.slab_half_length
    return (
        same
        and v.platform.depth == w.platform.depth
        and v.platform.surface_height == w.platform.surface_height
    )


@inlined
def _same_lag(v, w):
    """Return whether the thrust of two vehicles lags behind the same commands by the same."""
    same = v.effects.thrust_delay == w.effects.thrust_delay and v.thrust.lag_rate == w.thrust.lag_rate
    return (
        same and v.effects.mocap_delay == w.effects.mocap_delay and v.effects.spin_down == w.effects.spin_down
    )


@unlocked
def _thrust_commands(measured, vehicle):
    """Return the delayed thrust commands (m - 1,) and the mean thrust lag (m - 1,) over every step."""
    effects, dt = vehicle[0].effects, measured.dt
    pwm = averages(measured.command[:, PWM], dt, effects.thrust_delay + effects.mocap_delay)
    return pwm, lags(pwm, dt, vehicle)[1]


@unlocked
def _ground(measured, v, near):
    """Write the ground effect of a thrust of 1 N along a flight into near (m - 1, 3), as `wrench_near`."""
    near[:] = 0.0
    if v.effects.ground_effect == 0.0:
        return
    position, ambient = measured.middle_position, measured.ambient
    for k in range(len(near)):
        inclination, present, azimuth = ambient[k, INCLINATION], ambient[k, PRESENT], ambient[k, AZIMUTH]
        near[k, 0], near[k, 1], near[k, 2] = ground_effect(
            position[k], entries(measured.rotation[k]), 1.0, inclination, present, azimuth, v
        )


@unlocked
def _accelerations(measured, v, near, pwm, lag, twist):
    """Return accelerations (m - 1, 3) without gravity's and a load's; write the angles' ones into twist.

    near, pwm, lag: as `_ground` and `_thrust_commands` have them.
    """
    out, velocity, ambient = np.empty_like(measured.velocity), measured.velocity, measured.ambient
    for k in range(len(pwm)):
        r = entries(measured.rotation[k])
        fx, fy, fz, tx, ty = wrench_near(near[k], velocity[k], r, lag[k], pwm[k], ambient[k], v, _NEUTRAL)
        out[k, 0] = (r[0] * fx + r[1] * fy + r[2] * fz) / v.body.mass
        out[k, 1] = (r[3] * fx + r[4] * fy + r[5] * fz) / v.body.mass
        out[k, 2] = (r[6] * fx + r[7] * fy + r[8] * fz) / v.body.mass
        about_x, about_y = tx / v.body.inertia[0], ty / v.body.inertia[1]
        twist[k, 0] = measured.turning[k, 0] * about_x
        twist[k, 1] = measured.turning[k, 1] * about_x + about_y
        twist[k, 2] = measured.turning[k, 2] * about_x
    return out


@unlocked
def _translate(acceleration, gravity, dt, out):
    """Write positions (3, m) from rest at zero under accelerations (m - 1, 3) without gravity's into out."""
    for i in range(3):
        moved, speed, down = 0.0, 0.0, gravity if i == 2 else 0.0
        out[i, 0] = 0.0
        for k in range(len(acceleration)):
            # x += dt (v + dt/2 a), v += dt a,  a = R f/m - (0, 0, g)
            a = acceleration[k, i] - down
            moved += dt * (speed + 0.5 * dt * a)
            speed += dt * a
            out[i, k + 1] = moved


@unlocked
def _integrals(measured, vehicle):
    """Return the integrals (m, 2) [rad s] of the errors of roll and pitch."""
    v, twist, out = vehicle[0], np.empty_like(measured.velocity), np.empty((len(measured.command), 2))
    near, commands = np.empty_like(twist), _loop_commands(measured, v)
    _ground(measured, v, near)
    pwm, lag = _thrust_commands(measured, vehicle)
    _accelerations(measured, v, near, pwm, lag, twist)
    for axis in range(2):
        start, turned = measured.first_attitude[axis], twist[:, axis]
        out[:, axis] = integrated_steps(axis, commands[axis], turned, start, measured.dt, vehicle)[:, 1]
    return out


@unlocked
def _yaw(measured, vehicle):
    """Return the yaw (m,) by its loop."""
    effects, dt = vehicle[0].effects, measured.dt
    delay = effects.attitude_delay + effects.mocap_delay
    return yaw_steps(averages(measured.command[:, YAW_RATE_COMMAND], dt, delay), dt, vehicle)


@unlocked
def _loop_commands(measured, v):
    """Return what the loops of roll and pitch follow (2, m - 1) [rad]."""
    lean, late = v.effects.estimator_lean, v.effects.mocap_delay + v.effects.estimator_delay
    delay = max(0.0, v.effects.attitude_delay + late)
    out = np.empty((2, len(measured.velocity)))
    for axis in range(2):
        out[axis] = averages(measured.command[:, ROLL_COMMAND + axis], measured.dt, delay)
        if lean == 0.0:
            continue
        # The angle at which the loops come to rest moves with the speed: as by a command.
        aside, share = 1 - axis, (2 * axis - 1) * lean / v.attitude.gain
        for k in range(out.shape[1]):
            r, velocity = measured.rotation[k], measured.velocity[k]
            speed = r[0, aside] * velocity[0] + r[1, aside] * velocity[1] + r[2, aside] * velocity[2]
            out[axis, k] += share * speed
    return out
