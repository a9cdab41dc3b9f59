"""Checks that a vehicle is plausible: its values fit each other; the range of each is in `crazyflie.toml`.

`contradictions` yields a sentence for each pair that is inconsistent. All limits allow for every quadrotor of
5 g to 5 kg and for the values that fits of effects try; a refused value is a typing error or cannot be
integrated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from inclined_landing.models.base.errors import UserError
from inclined_landing.models.vehicle import Vehicle

ENGINE_STEP = 0.004  # s, of scenes and plants unless told otherwise
_STABLE = 2.5  # rate times step; RK4 follows decays up to 2.78
_SMOOTH = 1.0  # the same for rates that grow with the speed
_GYRATION = (0.05, 5.0)  # radius of gyration over the distance of a motor from the centre
_HOVER = 5.0  # times the largest command; fits of weak motors go beyond one
_BIAS = 10.0  # times the weight
_FACTOR = 100.0  # of the thrust by battery, voltage and wind together
_REFERENCE = 1e-6  # PWM, least distance from 0: the load is divided by it
_SOLREF = (1e-4, 0.01)  # s, 1: least time constant and damping ratio
_STIFFNESS = 1.0  # 1/s2, least


def contradictions(v: Vehicle) -> Iterator[str]:
    """Yield a sentence for every inconsistency between the values of a vehicle."""
    yield from _body(v)
    yield from _thrust(v)
    yield from _commands(v)
    yield from _arena(v)
    yield from _contact(v)
    yield from _disturbance(v)
    yield from _steps(v)


def misplaced(v: Vehicle) -> Iterator[str]:
    """Yield a sentence if the platform does not fit into the arena or exceeds the limits of the tasks.

    This applies to vehicle files only: fits of platform height and tilt may exceed these limits.
    """
    try:
        v.check_inclination(v.platform_inclination)
    except UserError as error:
        yield str(error)
    rise = 0.5 * v.platform_width * abs(math.tan(v.platform_inclination))
    extents = {
        "x": (-0.5 * v.platform_width, 0.5 * v.platform_width),
        "y": (-0.5 * v.platform_depth, 0.5 * v.platform_depth),
        "z": (v.platform_surface_height - rise, v.platform_surface_height + rise),
    }
    for axis, (low, high) in extents.items():
        least, most = getattr(v, f"arena_{axis}")
        if low < least or high > most:
            yield (
                f"the platform reaches from {low:.3g} to {high:.3g} m in {axis} and does not fit into "
                f"arena.{axis}, {least:g} to {most:g} m"
            )


def _body(v: Vehicle) -> Iterator[str]:
    a, b, c = sorted(v.body_inertia)
    if a + b < c * (1 - 1e-9):
        yield f"body.inertia is impossible: {c:g} kg m2 is more than the sum of the other two, {a + b:g}"
    distance = math.sqrt(2.0) * v.rotor_arm
    for moment in (a, c):
        radius = math.sqrt(moment / v.body_mass)
        low, high = (share * distance for share in _GYRATION)
        if not low <= radius <= high:
            yield (
                f"body.inertia of {moment:g} kg m2 with body.mass of {v.body_mass:g} kg gives a radius of "
                f"gyration of {radius:.3g} m; with this rotor.arm it must be from {low:.3g} to {high:.3g} m"
            )
    if v.rotor_radius > v.rotor_arm:
        yield (
            f"the rotors overlap: rotor.radius of {v.rotor_radius:g} m is more than rotor.arm of "
            f"{v.rotor_arm:g} m, half the distance between two"
        )
    if v.motor_count != round(v.motor_count):
        yield f"motor.count must be a whole number, not {v.motor_count:g}"
    if max(map(abs, v.effects_com_offset)) > v.rotor_arm:
        yield f"effects.com_offset lies outside the rotors, farther than rotor.arm of {v.rotor_arm:g} m"


def _thrust(v: Vehicle) -> Iterator[str]:
    weight, most = v.weight, v.command_pwm_range[1]
    if v.thrust_per_pwm * _HOVER * most < weight:
        full = v.thrust_per_pwm * most
        yield (
            f"the vehicle cannot hover: its thrust at the {most:g} PWM of command.pwm_range is {full:.3g} N, "
            f"its weight {weight:.3g} N"
        )
        return
    if v.hover_pwm < 1.0:
        yield f"the thrust carries the weight at {v.hover_pwm:.3g} PWM; it must be at least 1 PWM"
    if weight <= v.motor_count * v.motor_pwm_to_force[2]:
        yield "motor.pwm_to_force carries the weight at PWM 0; its last number is too large"
    if abs(v.effects_thrust_bias) > _BIAS * weight:
        yield (
            f"effects.thrust_bias of {v.effects_thrust_bias:g} N is more than {_BIAS:g} times the weight, "
            f"{weight:.3g} N"
        )
    if abs(v.effects_battery_reference) < _REFERENCE:
        yield f"effects.battery_reference must not be 0 PWM, nor within {_REFERENCE:g} PWM of it"
        return
    sag = 1.0 - v.effects_battery_sag * (v.hover_pwm / v.effects_battery_reference - 1.0)
    voltage = v.effects_voltage_open - v.effects_voltage_drop * v.hover_pwm
    charge = 1.0 + v.effects_voltage_sensitivity * (voltage - v.effects_voltage_reference)
    lift = 1.0 + v.effects_translational_lift * sum(x * x for x in v.effects_wind)
    for name, factor in {
        "effects.battery_sag": sag,
        "effects.voltage_sensitivity": charge,
        "effects.translational_lift with effects.wind": lift,
    }.items():
        if not abs(factor) <= _FACTOR:
            yield f"{name} makes the thrust in hover {factor:.3g} times as large"


def _commands(v: Vehicle) -> Iterator[str]:
    low, high = v.command_pwm_range
    if low >= high:
        yield f"command.pwm_range must be increasing, not {low:g} to {high:g} PWM"
    elif not low <= v.command_pwm_centre <= high:
        yield (
            f"command.pwm_centre of {v.command_pwm_centre:g} PWM is outside command.pwm_range, "
            f"{low:g} to {high:g} PWM"
        )


def _arena(v: Vehicle) -> Iterator[str]:
    for axis in "xyz":
        low, high = getattr(v, f"arena_{axis}")
        if low >= high:
            yield f"arena.{axis} must be increasing, not {low:g} to {high:g} m"


def check_solref(value) -> np.ndarray:
    """Return solref (..., 2) if it is in one of MuJoCo's two formats, else raise UserError."""
    value = np.asarray(value, float)
    if value.shape[-1:] != (2,):
        raise UserError(
            f"solref must be two numbers, (time constant, damping ratio), not of shape {value.shape}"
        )
    standard = (value > 0).all(axis=-1)
    direct = (value[..., 0] < 0) & (value[..., 1] <= 0)
    if not (np.isfinite(value).all() and (standard | direct).all()):
        raise UserError(
            "solref must be (time constant, damping ratio), both positive, or (-stiffness, -damping)"
        )
    return value


def _contact(v: Vehicle) -> Iterator[str]:
    first, second = v.contact_solref
    try:
        check_solref(v.contact_solref)
    except UserError as error:
        yield f"contact.{error}, not ({first:g}, {second:g})"
        return
    if first > 0 and (first < _SOLREF[0] or second < _SOLREF[1]):
        yield (
            f"contact.solref must be at least ({_SOLREF[0]:g} s, {_SOLREF[1]:g}), "
            f"not ({first:g} s, {second:g})"
        )
    if -_STIFFNESS < first < 0:
        yield f"contact.solref has a stiffness of {-first:g} 1/s2; it must be at least {_STIFFNESS:g} 1/s2"


def _disturbance(v: Vehicle) -> Iterator[str]:
    for name in ("acceleration", "angular"):
        sizes, times = getattr(v, f"disturbance_{name}"), getattr(v, f"disturbance_{name}_time")
        if any(size > 0.0 and time == 0.0 for size, time in zip(sizes, times)):
            yield f"disturbance.{name}_time must be above 0 s where disturbance.{name} is above 0"


def _steps(v: Vehicle) -> Iterator[str]:
    """Yield a sentence for dynamics that are too fast for the control period or the time steps."""
    period, mass = v.command_control_period, v.body_mass
    steps = period / ENGINE_STEP
    if round(steps) < 1 or abs(steps - round(steps)) > 1e-9:
        yield (
            f"command.control_period of {period:g} s is not a whole number of engine steps of "
            f"{ENGINE_STEP:g} s"
        )
    speeds = v.motor_pwm_to_speed[0] * v.hover_pwm + v.motor_pwm_to_speed[1]
    drag = max(map(abs, v.drag_coefficients)) * v.motor_count * speeds / mass
    air = math.hypot(*v.effects_wind) + 2.0  # m/s, with some of the vehicle's own
    # sqrt(|f|/(m L)) of the slung load's swing, under four times the thrust of hover
    stretched = 4.0 * v.weight / (mass * v.effects_load_length) if v.effects_load_mass > 0.0 else 0.0
    for name, rate, step, most in (
        ("thrust.lag_rate", v.thrust_lag_rate, period, _STABLE),
        ("1/attitude.time_constant", 1.0 / v.attitude_time_constant, period, _STABLE),
        ("drag.coefficients slow the vehicle; their rate", drag, period, _SMOOTH),
        ("effects.body_drag slows the vehicle; its rate", v.effects_body_drag * air / mass, period, _SMOOTH),
        ("the swing of a load on effects.load_length", math.sqrt(stretched), period, _STABLE),
        ("attitude.bandwidth", v.attitude_bandwidth, ENGINE_STEP, _STABLE),
        (
            "attitude.damping times the rates of both loops",
            v.attitude_damping * (v.attitude_bandwidth + 1.0 / v.attitude_time_constant),
            *(ENGINE_STEP, _STABLE),
        ),
        ("attitude.yaw_bandwidth", v.attitude_yaw_bandwidth, ENGINE_STEP, _STABLE),
    ):
        if rate * step > most:
            yield (
                f"{name} of {rate:.3g} 1/s is too fast for steps of {step:g} s, which resolve up to "
                f"{most / step:.3g} 1/s"
            )
