"""Comparison of single terms with closed solutions: drag, lag, the Euler axes.

The closed solutions are derived here from the paper's formulas without `equations.py`, so that an error
common to both plants would be detected.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from inclined_landing.eval.base.claims import Section, Table
from inclined_landing.eval.truth.equivalence import flying
from inclined_landing.eval.truth.equivalence.flying import WORDS, engine
from inclined_landing.models.attitude import (
    LAG,
    PITCH,
    PITCH_COMMAND,
    PWM,
    ROLL,
    ROLL_COMMAND,
    VX,
    VZ,
    YAW,
    YAW_RATE_COMMAND,
    Z,
)
from inclined_landing.models.plants import Attitude
from inclined_landing.models.vehicle import Vehicle

STEPS = 100  # control steps, 2 s
SPEED = 3.0  # m/s at the start of the drag tests
NO_DRAG = (0.0, 0.0, 0.0)
_COLUMNS = {"roll": ROLL, "pitch": PITCH, "yaw": YAW}


def _hover(v: Vehicle) -> np.ndarray:
    """Return (STEPS, 1, 4) commands of hover."""
    commands = np.zeros((STEPS, 1, 4))
    commands[..., PWM] = v.hover_pwm
    return commands


def _times(v: Vehicle) -> np.ndarray:
    """Return the times (STEPS,) [s] at the ends of the control steps."""
    return v.command_control_period * np.arange(1, STEPS + 1)


def drag_errors(v: Vehicle) -> dict[str, float]:
    """Return the largest speed error [m/s] of level flight with a single drag term.

    At constant thrust the rotor speeds are constant and v(t) = v0 exp(K_i w_sum t / m). Body axes x and
    y are flown along the world's x and y, and turned by 90 degrees along y and -x.
    """
    slope, idle = v.motor_pwm_to_speed
    rotors = v.motor_count * (slope * v.static_hover_pwm + idle)  # rad/s
    cases = {"x": (0, 0.0, (1, 0, 0)), "y": (1, 0.0, (0, 1, 0)), "z": (2, 0.0, (0, 0, 1)),
             "x, turned": (0, math.pi / 2, (0, 1, 0)), "y, turned": (1, math.pi / 2, (-1, 0, 0))}  # fmt: skip
    errors = {}
    for name, (axis, yaw, direction) in cases.items():
        only: Any = tuple(c if k == axis else 0.0 for k, c in enumerate(v.drag_coefficients))
        plant = engine(1, "kinematic", dataclasses.replace(v, drag_coefficients=only))
        start = flying.start_states(1, yaw, v)
        start[:, VX : VZ + 1] = SPEED * np.array(direction)
        flown = flying.fly(plant, _hover(v), start)[:, 0, VX : VZ + 1]
        # m dv/dt = K_i w_sum v:  v(t) = v0 exp(K_i w_sum t / m)
        decay = np.exp(v.drag_coefficients[axis] * rotors / v.body_mass * _times(v))
        errors[name] = float(np.abs(flown - np.outer(decay, start[0, VX : VZ + 1])).max())
    return errors


def lag_errors(v: Vehicle, integrator: str) -> tuple[float, float]:
    """Return the errors of the lag state (relative) and height [m] after a PWM step from hover, no drag.

    Omega(t) = u/a + (Omega_0 - u/a) exp(-a t); the height is its double integral.
    """
    plant = engine(1, "kinematic", dataclasses.replace(v, drag_coefficients=NO_DRAG), integrator=integrator)
    commands = _hover(v)
    commands[..., PWM] = pwm = 50_000.0
    flown = flying.fly(plant, commands)[:, 0]
    a, t = v.thrust_lag_rate, _times(v)
    # Omega(t) = u/a + (Omega_0 - u/a) exp(-a t);  m z'' = c_s Omega + c_d u - m g, integrated twice
    final, jump = pwm / a, v.hover_lag - pwm / a
    lag = final + jump * np.exp(-a * t)
    steady = (v.thrust_state_gain * final + v.thrust_direct_gain * pwm) / v.body_mass - v.environment_gravity
    fading = v.thrust_state_gain * jump / v.body_mass * (t / a + np.expm1(-a * t) / a**2)
    height = flying.HEIGHT + 0.5 * steady * t**2 + fading
    return float(np.abs(flown[:, LAG] / lag - 1).max()), float(np.abs(flown[:, Z] - height).max())


def angle_errors(v: Vehicle, attitude: Attitude, commanded: tuple[str, ...]) -> dict[str, float]:
    """Return the largest error [deg] of each Euler angle after a full step of the named commands ("yaw"
    included).

    Kinematic: k c (1 - exp(-t/tau)); rate loop: with two exponentials, poles -1/tau and -B; yaw: the
    ramp, lagging by 1/B_yaw under the rate loop.
    """
    commands = _hover(v)
    t, a, b = _times(v), 1 / v.attitude_time_constant, v.attitude_bandwidth
    # First order: 1 - exp(-a t);  with the rate loop: 1 - (b exp(-a t) - a exp(-b t)) / (b - a),  a = 1/tau
    rise = 1 - np.exp(-a * t)
    if attitude == "rate_loop":
        rise = 1 - (b * np.exp(-a * t) - a * np.exp(-b * t)) / (b - a)
    expected = dict.fromkeys(_COLUMNS, np.zeros(STEPS))
    for name, column, size in (("roll", ROLL_COMMAND, -0.8), ("pitch", PITCH_COMMAND, 1.0)):
        if name in commanded:
            commands[..., column] = size * v.command_angle_limit
            expected[name] = v.attitude_gain * size * v.command_angle_limit * rise
    if "yaw" in commanded:
        rate, b = 0.5 * v.command_yaw_rate_limit, v.attitude_yaw_bandwidth
        commands[..., YAW_RATE_COMMAND] = rate
        expected["yaw"] = rate * (t + (np.expm1(-b * t) / b if attitude == "rate_loop" else 0.0))
    flown = flying.fly(engine(1, attitude, v), commands)[:, 0]
    gaps = {name: flown[:, column] - expected[name] for name, column in _COLUMNS.items()}
    turns = {name: np.arctan2(np.sin(gap), np.cos(gap)) for name, gap in gaps.items()}
    return {name: float(np.degrees(np.abs(turn).max())) for name, turn in turns.items()}


def section(v: Vehicle) -> Section:
    """Return the section of the report."""

    def claim(key, measured, **filling):
        return WORDS.claim("isolated", key, measured, **filling)

    claims = [claim("drag", error, name=name) for name, error in drag_errors(v).items()]
    for integrator in ("RK4", "implicitfast", "Euler"):
        lag, height = lag_errors(v, integrator)
        if integrator == "RK4":
            claims += [claim("lag_rk4", lag), claim("lag_height", height)]
        else:
            claims.append(claim("lag", lag, integrator=integrator))
    rows = []
    for attitude, mode in flying.MODES.items():
        alone = {name: angle_errors(v, attitude, (name,)) for name in _COLUMNS}
        together = angle_errors(v, attitude, tuple(_COLUMNS))
        for name in alone:
            claims.append(claim(f"alone_{attitude}", alone[name][name], name=name, mode=mode))
        others = max(alone[name][other] for name in alone for other in alone if other != name)
        claims.append(claim("others", others, mode=mode))
        claims.append(claim(f"together_{attitude}", max(together.values()), mode=mode))
        rows += [(mode, name, alone[name][name], together[name]) for name in alone]
    heads = ("mode", "angle", "alone", "all three at once")
    tables = [Table("Attitude steps: largest error [deg]", heads, rows)]
    return WORDS.section("isolated", claims, tables=tables)
