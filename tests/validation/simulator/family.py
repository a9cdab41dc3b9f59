"""Families of realities: vehicles, airs and logs drawn at random, without any hidden cause.

Members of a family share the structure of their parts - flight controller, estimator, motors, drag, ground
effect, battery - and differ in every number. The development families and those left out share no structure
but the rigid body: what is tuned on the former has not seen the latter.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from .flight import Reality
from .vehicle import (
    CASCADE,
    CHEESEMAN,
    CONTROL_RATE,
    EXPONENTIAL,
    FADING,
    FIRST_ORDER_SPEED,
    FIRST_ORDER_THRUST,
    FULL_STATE,
    INCREMENTAL,
    Build,
    Constants,
    constants,
)

BASE_ERROR = 0.1  # by which the constants may be off the paper's


def draw(family: str, rng: np.random.Generator) -> Reality:
    """A reality of a family of FAMILIES."""
    c, common = _constants(rng), _common(rng)
    c, own = _FAMILIES[family](c, rng)
    return Reality(c, Build(**(common | own)), family)


def _about(rng, size: float) -> float:
    return rng.uniform(1 - size, 1 + size)


def between(rng, low: float, high: float) -> float:
    """Uniform on a logarithmic scale."""
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def _ticks(seconds: float) -> float:
    """The nearest whole number of control periods [s]."""
    return round(seconds * CONTROL_RATE) / CONTROL_RATE


def _constants(rng) -> Constants:
    """Constants up to BASE_ERROR off the paper's, and noise of motion capture."""
    c = constants()
    mass = _about(rng, BASE_ERROR)
    level = _about(rng, BASE_ERROR)  # thrust over mass
    drag = _about(rng, BASE_ERROR)
    return c._replace(
        mass=c.mass * mass,
        thrust_per_pwm=c.thrust_per_pwm * mass * level,
        motor_time=c.motor_time * _about(rng, BASE_ERROR),
        drag_per_speed=tuple(x * drag for x in c.drag_per_speed),
        attitude_gain=c.attitude_gain * _about(rng, BASE_ERROR),
        attitude_time=c.attitude_time * _about(rng, BASE_ERROR),
        arm=c.arm * _about(rng, 0.02),
        inertia=tuple(x * _about(rng, BASE_ERROR) for x in c.inertia),
        battery_voltage=rng.uniform(3.85, 4.15),
        position_noise=between(rng, 0.0002, 0.003),
        attitude_noise=math.radians(between(rng, 0.05, 0.5)),
        yaw_bandwidth=rng.uniform(12.0, 20.0),
        gyro_noise=between(rng, 0.0005, 0.002),
    )


def _common(rng) -> dict:
    """What members of every family differ in: geometry, disturbance of the air, log."""
    size = between(rng, 0.02, 0.15)
    turn = between(rng, 0.1, 1.0)
    ticks = float(rng.choice([1, 2, 4, 5, 10], p=[0.1, 0.15, 0.2, 0.35, 0.2]))
    return {
        # Differences of thrust would be causes to be named: a centre of mass that is off, a turning vehicle.
        "rotor": tuple(_about(rng, 0.05) for _ in range(4)),
        "disturbance": tuple(size * between(rng, 0.6, 1.6) for _ in range(3)),
        "disturbance_time": between(rng, 0.1, 1.0),
        "disturbance_torque": (turn * _about(rng, 0.3), turn * _about(rng, 0.3), 0.3 * turn),
        "log_ticks": ticks,
        "stamp_jitter": 0.1 * ticks / CONTROL_RATE if rng.uniform() < 0.3 else 0.0,
        "log_estimate": 1.0 if rng.uniform() < 0.3 else 0.0,
    }


def _cascade(c: Constants, rng) -> tuple[Constants, dict]:
    """As the reference is built: the paper's loop, attitude fused from gyro and motion capture."""
    c = c._replace(
        rate_bandwidth=c.rate_bandwidth * _about(rng, 0.2), attitude_trust=between(rng, 0.003, 0.03)
    )
    return c, {
        "controller": CASCADE,
        "capture_age": _ticks(rng.uniform(0.0, 0.01)),
        "motors": FIRST_ORDER_THRUST,
        "thrust_exponent": _about(rng, 0.03),
        "ground": CHEESEMAN,
        "uncompensated": rng.uniform(0.0, 0.03),
    }


def _firmware(c: Constants, rng) -> tuple[Constants, dict]:
    """Rates with integral and a low-passed derivative, as in the Crazyflie's firmware; late motion capture;
    no axial drag to speak of; an exponential ground effect."""
    derivative, damping = rng.uniform(1.6, 2.6), rng.uniform(0.75, 0.95)
    bandwidth = (1.0 + derivative) ** 2 / (4.0 * damping**2 * c.motor_time)
    drag = (*c.drag_per_speed[:2], c.drag_per_speed[2] * rng.uniform(0.0, 0.3))
    c = c._replace(rate_bandwidth=bandwidth, drag_per_speed=drag, attitude_trust=between(rng, 0.003, 0.02))
    return c, {
        "controller": CASCADE,
        "lead": 0.0,
        "pole_shift": rng.uniform(0.6, 1.0),
        "derivative": derivative,
        "derivative_filter": between(rng, 0.003, 0.008),
        "integral": bandwidth * rng.uniform(0.1, 0.4),
        "integral_leak": rng.uniform(0.5, 1.5),
        "capture_age": _ticks(rng.uniform(0.01, 0.03)),
        "motors": FIRST_ORDER_SPEED,
        "dead_time": _ticks(rng.uniform(0.0, 0.004)),
        "thrust_exponent": _about(rng, 0.05),
        "ground": EXPONENTIAL,
        "ground_range": rng.uniform(0.05, 0.08),
        "uncompensated": rng.uniform(0.0, 0.03),
    }


def _feed_forward(c: Constants, rng) -> tuple[Constants, dict]:
    """An attitude gain with feed-forward over rates with a derivative; drag of its own ratio."""
    derivative, damping = rng.uniform(1.2, 2.0), rng.uniform(0.75, 0.95)
    lead = rng.uniform(0.3, 0.6)
    bandwidth = (1.0 + derivative) ** 2 / (4.0 * damping**2 * c.motor_time * (1.0 - lead))
    drag = (
        *(x * rng.uniform(0.9, 1.1) for x in c.drag_per_speed[:2]),
        c.drag_per_speed[2] * rng.uniform(0.4, 1.6),
    )
    c = c._replace(rate_bandwidth=bandwidth, drag_per_speed=drag, attitude_trust=between(rng, 0.002, 0.02))
    return c, {
        "controller": CASCADE,
        "lead": lead,
        "pole_shift": rng.uniform(0.7, 1.0),
        "feed_forward": rng.uniform(0.03, 0.1),
        "derivative": derivative,
        "integral": bandwidth * rng.uniform(0.0, 0.2),
        "integral_leak": rng.uniform(0.5, 1.5),
        "capture_age": _ticks(rng.uniform(0.0, 0.02)),
        "motors": FIRST_ORDER_SPEED,
        "thrust_exponent": _about(rng, 0.04),
        "ground": CHEESEMAN,
        "uncompensated": rng.uniform(0.0, 0.03),
    }


def _geometric(c: Constants, rng) -> tuple[Constants, dict]:
    """Increments of torque on a geometric attitude error, levelled by its accelerometer; motors that slow
    down later than they speed up; blades that flap; a battery with a slow part."""
    c = c._replace(
        rate_bandwidth=rng.uniform(18.0, 26.0),
        drag_per_speed=(*(x * rng.uniform(1.05, 1.2) for x in c.drag_per_speed[:2]), c.drag_per_speed[2]),
        attitude_trust=0.01 / rng.uniform(15.0, 40.0),
    )
    return c, {
        "controller": INCREMENTAL,
        "lead": rng.uniform(0.5, 0.75),
        "derivative_filter": between(rng, 0.004, 0.008),
        "kept_torque": rng.uniform(0.3, 0.6),
        "accelerometer": 1.0,
        "wander": between(rng, 0.0005, 0.003),
        "motors": FIRST_ORDER_THRUST,
        "spin_down": rng.uniform(0.05, 0.25),
        "dead_time": _ticks(rng.uniform(0.0, 0.006)),
        "thrust_curve": rng.uniform(-0.04, 0.04),
        "battery_power": rng.uniform(1.4, 1.8),
        "uncompensated": rng.uniform(0.0, 0.03),
        "polarisation": rng.uniform(0.01, 0.03),
        "flapping": rng.uniform(0.05, 0.15),
        "ground": FADING,
    }


def _full_state(c: Constants, rng) -> tuple[Constants, dict]:
    """A gain on angle, rate and motor torque; drag with a quadratic part in every axis; a quadratic thrust
    curve."""
    linear = rng.uniform(0.75, 0.9)
    c = c._replace(
        drag_per_speed=tuple(x * linear for x in c.drag_per_speed), attitude_trust=between(rng, 0.001, 0.01)
    )
    return c, {
        "controller": FULL_STATE,
        "lead": 0.0,
        "pole_rate": rng.uniform(25.0, 45.0),
        "pole_damping": rng.uniform(0.7, 1.0),
        "capture_age": _ticks(rng.uniform(0.005, 0.03)),
        "motors": FIRST_ORDER_SPEED,
        "spin_down": rng.uniform(0.0, 0.15),
        "thrust_curve": rng.uniform(-0.05, 0.05),
        "battery_power": rng.uniform(1.4, 2.2),
        "polarisation": rng.uniform(0.01, 0.03),
        "polarisation_time": rng.uniform(2.0, 10.0),
        "quadratic_drag": tuple(rng.uniform(0.1, 0.25) for _ in range(3)),
        "ground": FADING,
    }


def _reference(c: Constants, rng) -> tuple[Constants, dict]:
    """The reference itself: nothing is drawn."""
    return constants(), Build()._asdict()


_FAMILIES: dict[str, Callable] = {
    "reference": _reference,
    "cascade": _cascade,
    "firmware": _firmware,
    "feed_forward": _feed_forward,
    "geometric": _geometric,
    "full_state": _full_state,
}
FAMILIES = tuple(_FAMILIES)
