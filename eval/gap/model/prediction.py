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

from inclined_landing.eval.gap.measured.windows import REQUEST_SIGNS, RotorAttitude
from inclined_landing.eval.gap.model.swing import Starts, pulled
from inclined_landing.models import plugins
from inclined_landing.models.attitude import PWM, ROLL_COMMAND, YAW_RATE_COMMAND, entries, tilted, to_world
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
from inclined_landing.models.vehicle import Vehicle

POSE_CHANNELS = ("x", "y", "z", "roll", "pitch", "yaw")  # of the pose
REQUEST_CHANNELS = ("roll request", "pitch request", "yaw request")
# The unit of a disturbance in each channel.
UNITS_OF = {
    **dict.fromkeys(POSE_CHANNELS[:3], "m/s2"),
    **dict.fromkeys(POSE_CHANNELS[3:], "rad/s2"),
    **dict.fromkeys(REQUEST_CHANNELS, "1"),
}
ROLL_CHANNEL, YAW_CHANNEL, YAW_REQUEST_CHANNEL = 3, 5, 8
# Powers of its command that a rotor's thrust may go with, chosen by hand about the shipped vehicle's, 1.
LEAST_ELASTICITY, MOST_ELASTICITY = 0.7, 1.4
# Channels of effects -> channels of a flight.
CHANNEL_GROUPS = {
    "translation": slice(0, 3),
    "attitude": slice(3, 5),
    "yaw": slice(5, 6),
    "requests": slice(6, 9),
}

# Vehicles share a prediction of the translation, or of the attitude, if all constants that it depends on are
# equal. Those of the attitude loops alone are those of the table `attitude`, of the loops' plugin, and the
# delay of their commands; the translation depends on all others.
_LOOPS_OF_PLUGIN = set(plugins.fields()["attitude"].values())
_OF_THE_LOOPS = [
    name
    for name in (f.name for f in dataclasses.fields(Vehicle))
    if name in _LOOPS_OF_PLUGIN or name.startswith("attitude_") or name == "effects_attitude_delay"
]
_OTHERS = [f.name for f in dataclasses.fields(Vehicle) if f.name not in _OF_THE_LOOPS]
_constants_of_translation = attrgetter(*_OTHERS)
# Next to these the attitude depends on its start and on torques, which are compared when they are known.
_constants_of_attitude = attrgetter(*_OF_THE_LOOPS, "effects_mocap_delay")


def channels_of(flights) -> tuple[str, ...]:
    """Return the names of the channels (C,) of flights, or of a problem."""
    return POSE_CHANNELS if flights.channels == len(POSE_CHANNELS) else POSE_CHANNELS + REQUEST_CHANNELS


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
    # For speed alone: vehicles with the same correction of the measured attitude are predicted together.
    corrections = [(v.effects_mocap_tilt, v.effects_estimator_delay) for v in vehicles]
    groups = [
        _Group.of(vehicles, [k for k, one in enumerate(corrections) if one == correction])
        for correction in dict.fromkeys(corrections)
    ]

    def along(flight) -> np.ndarray:
        out = np.empty((len(vehicles), flight.channels, flight.samples))
        for group in groups:
            measured = _Measured.of(flight, vehicles[group.own[0]])
            begun = Starts.none(flight.samples, flight.starts, flight.rows, flight.dt)
            _predict(measured, packed, group.own, group.same, begun, out)
        if flight.requests is not None:
            for vehicle, one in zip(vehicles, out):
                one[YAW_CHANNEL + 1 :] = requested_differences(flight, vehicle).T
        return out.transpose(0, 2, 1)

    return along


class _Group(NamedTuple):
    """Vehicles with one correction of the measured attitude, and what they share with the first of them."""

    own: np.ndarray  # (k,) their indices
    # (2, k) bool: whether the constants of translation, and of attitude, are those of the first
    same: np.ndarray

    @staticmethod
    def of(vehicles: Sequence[Vehicle], own: Sequence[int]) -> _Group:
        """Return the vehicles `own`, compared with the first of these."""
        first = vehicles[own[0]]
        translation = [
            _constants_of_translation(vehicles[k]) == _constants_of_translation(first) for k in own
        ]
        attitude = [_constants_of_attitude(vehicles[k]) == _constants_of_attitude(first) for k in own]
        return _Group(np.array(own), np.array([translation, attitude]))


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
    # order in these:  d_k = J_k w_k'/(arm m g e) + sum_i s_ki r_i / sum_i r_i. Products of both are
    # neglected: no vehicle file gives the thrust's curvature accurately enough.
    x, y = np.array(vehicle.effects_com_offset) / vehicle.rotor_arm
    slope = flight.requests.slope or thrust_elasticity(vehicle)
    needed = 1.0 + np.array([y, -x, vehicle.effects_yaw_imbalance]) @ REQUEST_SIGNS
    requested = np.maximum(needed / (1.0 - np.array(vehicle.effects_rotor_loss)), 0.0) ** (1.0 / slope)
    return flight.requests.torques / slope + REQUEST_SIGNS @ requested / requested.sum()


def thrust_elasticity(vehicle: Vehicle) -> float:
    """Return by what power of its command a rotor's thrust goes in hover, at the same voltage.

    It is kept to what propellers and batteries do: flights at one height show the thrust, not its slope.
    """
    # F = (k u + bias) s,  s = 1 - sag (u / reference - 1):
    #   e = d log F / d log u = k u / (k u + bias) - sag (u / reference) / s
    k, bias = vehicle.thrust_per_pwm, vehicle.effects_thrust_bias
    sag, reference = vehicle.effects_battery_sag, vehicle.effects_battery_reference
    u = vehicle.hover_pwm
    for _ in range(3):  # the command u at which F is the weight, where sag is a small correction
        supply = 1.0 - sag * (u / reference - 1.0)
        u = (vehicle.weight / max(supply, 0.1) - bias) / k
    supply = 1.0 - sag * (u / reference - 1.0)
    slope = k * u / (k * u + bias) - sag * (u / reference) / max(supply, 0.1)
    return min(max(slope, LEAST_ELASTICITY), MOST_ELASTICITY)


class _Measured(NamedTuple):
    """Measurements in m rows, and at the middle of the m - 1 steps between them."""

    command: np.ndarray  # (m, 4)
    position: np.ndarray  # (m, 3) m
    middle_position: np.ndarray  # (m - 1, 3) m
    velocity: np.ndarray  # (m - 1, 3) m/s
    attitude: RotorAttitude
    ambient: np.ndarray  # (m - 1, AMBIENT_SIZE)
    starts: np.ndarray  # (w,) first row of every window
    rows: int  # of a window
    dt: float  # s

    @staticmethod
    def of(flight, vehicle: Vehicle) -> _Measured:
        """Return a flight as the kernels take it, with the attitude of the rotors of `vehicle`."""
        return _Measured(
            command=flight.command,
            position=flight.position,
            middle_position=flight.middle_position,
            velocity=flight.middle_velocity,
            attitude=flight.attitude_of(vehicle),
            ambient=flight.ambient,
            starts=flight.starts,
            rows=flight.rows,
            dt=flight.dt,
        )


@unlocked
def _predict(measured, vehicles, own, same, begun, out):
    """Write the predicted pose (6, m) of every vehicle `own` (k,) into out (n, C, m).

    same (2, k): see `_Group`. begun: `Starts` of loads. Results that the first vehicle, or the one before,
    has in common with the next are kept in the variables of this function.
    """
    dt, steps, pose = measured.dt, measured.velocity.shape, slice(0, YAW_CHANNEL + 1)
    twist, first_twist, near = np.zeros(steps), np.zeros(steps), np.zeros(steps)
    pwm, lag, first_commands, first_yaw = np.empty(0), np.empty(0), np.empty((2, 0)), np.empty(0)
    of_near, of_lag = 0, 0  # vehicles for which `near`, and `pwm` and `lag`, were computed
    for k in range(len(own)):
        vehicle, predicted, first = vehicles[own[k] : own[k] + 1], out[own[k], pose], out[own[0], pose]
        v = vehicle[0]
        # The translation, and the angular accelerations `twist` by the same wrench
        if k == 0 or not same[0, k]:
            if k == 0 or not _same_ground(v, vehicles[own[of_near]]):
                _ground(measured, v, near)
                of_near = k
            if k == 0 or not _same_lag(v, vehicles[own[of_lag]]):
                pwm, lag = _thrust_commands(measured, vehicle)
                of_lag = k
            acceleration = _accelerations(measured, v, near, pwm, lag, twist)
            if v.effects.load_mass != 0.0:
                seen, starts, rows = measured.position, measured.starts, measured.rows
                acceleration = pulled(acceleration, seen, starts, rows, dt, vehicle, begun)
            _translate(acceleration, v.environment.gravity, dt, predicted)
        else:
            predicted[:ROLL_CHANNEL], twist[:] = first[:ROLL_CHANNEL], first_twist
        # The attitude, which these accelerations disturb
        same_loops = k > 0 and same[1, k]
        if same_loops and np.array_equal(twist, first_twist):
            predicted[ROLL_CHANNEL:] = first[ROLL_CHANNEL:]
            continue
        if not same_loops:
            commands, yaw = _loop_commands(measured, v), _yaw(measured, vehicle)
        else:
            commands, yaw = first_commands, first_yaw
        angles = np.empty((len(yaw), 3))
        for axis in range(2):
            turned, start = twist[:, axis], measured.attitude.first[axis]
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
            position[k], entries(measured.attitude.rotation[k]), 1.0, inclination, present, azimuth, v
        )


@unlocked
def _accelerations(measured, v, near, pwm, lag, twist):
    """Return accelerations (m - 1, 3) without gravity's and a load's; write the angles' ones into twist.

    near, pwm, lag: as `_ground` and `_thrust_commands` have them.
    """
    out, velocity, ambient = np.empty_like(measured.velocity), measured.velocity, measured.ambient
    for k in range(len(pwm)):
        r = entries(measured.attitude.rotation[k])
        fx, fy, fz, tx, ty = wrench_near(near[k], velocity[k], r, lag[k], pwm[k], ambient[k], 1.0, v)
        fx, fy, fz = to_world(r, fx, fy, fz)
        out[k, 0], out[k, 1], out[k, 2] = fx / v.body.mass, fy / v.body.mass, fz / v.body.mass
        about_x, about_y = tx / v.body.inertia[0], ty / v.body.inertia[1]
        twist[k, 0] = measured.attitude.rates_about_x[k, 0] * about_x
        twist[k, 1] = measured.attitude.rates_about_x[k, 1] * about_x + about_y
        twist[k, 2] = measured.attitude.rates_about_x[k, 2] * about_x
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
        start, turned = measured.attitude.first[axis], twist[:, axis]
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
            r, velocity = measured.attitude.rotation[k], measured.velocity[k]
            speed = r[0, aside] * velocity[0] + r[1, aside] * velocity[1] + r[2, aside] * velocity[2]
            out[axis, k] += share * speed
    return out
