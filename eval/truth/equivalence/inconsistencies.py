"""Numerical comparison of the paper with itself and with its authors' public code.

The public code is described here by its equations (see `paper.toml` for its address); the model follows
the paper's equations.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from inclined_landing.eval.base.claims import Section, Table, number
from inclined_landing.eval.truth.equivalence import flying
from inclined_landing.eval.truth.equivalence.flying import WORDS, Sequences
from inclined_landing.eval.truth.equivalence.motor import quoted
from inclined_landing.models.attitude import LAG, PITCH, PITCH_COMMAND, PWM, VX, VZ, X, Z, rotation
from inclined_landing.models.equations import derivative
from inclined_landing.models.forces import pack, rotor_speed_sum
from inclined_landing.models.vehicle import Vehicle


def code_rotor_speed(thrust: float, v: Vehicle) -> float:
    """Return w_sum [rad/s] of the public code: the force map inverted without its factor four at zero PWM."""
    a, b, c = v.motor_pwm_to_force
    n = v.motor_count
    pwm = (-n * b + np.sqrt((n * b) ** 2 - 4 * n * a * (c - thrust))) / (2 * n * a)
    slope, idle = v.motor_pwm_to_speed
    return n * (slope * pwm + idle)


def code_planar(y: np.ndarray, u: np.ndarray, v: Vehicle) -> np.ndarray:
    """Return the public code's d/dt of x, z, vx, vz, pitch, lag (6,) under PWM and pitch commands (2,).

    Drag is in world axes and multiplied, with the thrust, by sin(pitch) in x and cos(pitch) in z.
    """
    _, _, vx, vz, pitch, lag = y
    thrust = v.thrust_state_gain * lag + v.thrust_direct_gain * u[0]
    speed = code_rotor_speed(thrust, v)
    kx, _, kz = v.drag_coefficients
    return np.array(
        [
            vx,
            vz,
            np.sin(pitch) * (thrust + kx * speed * vx) / v.body_mass,
            np.cos(pitch) * (thrust + kz * speed * vz) / v.body_mass - v.environment_gravity,
            (v.attitude_gain * u[1] - pitch) / v.attitude_time_constant,
            u[0] - v.thrust_lag_rate * lag,
        ]
    )


def drag(v: Vehicle, sequences: Sequences) -> tuple[float, float]:
    """Return the rms of the paper's drag, and of the public code's difference from it [m/s2].

    The states are those of the paper's equations under planar `sequences`.
    """
    commands = sequences.commands
    flown = flying.fly(flying.equations(commands.shape[1], "kinematic", vehicle=v), commands)
    without = dataclasses.replace(v, drag_coefficients=(0.0, 0.0, 0.0))
    papers, codes = [], []
    for state, command in zip(flown[4::5].reshape(-1, 13), commands[4::5].reshape(-1, 4)):
        free = np.asarray(derivative(state, command, without)["acceleration"])[[0, 2]]
        papers.append(np.asarray(derivative(state, command, v)["acceleration"])[[0, 2]] - free)
        y = state[[X, Z, VX, VZ, PITCH, LAG]]
        codes.append(code_planar(y, command[[PWM, PITCH_COMMAND]], v)[2:4] - free)
    paper, code = np.array(papers), np.array(codes)
    paper_rms, error = (float(np.sqrt((gap**2).sum(axis=1).mean())) for gap in (paper, code - paper))
    return paper_rms, error


def rotation_defects(v: Vehicle, printed: bool) -> tuple[float, float]:
    """Return the largest entry of |R'R - 1| and relative change of thrust over the commanded attitudes.

    printed: with the last term of (2,3) positive, as printed, the other misprint corrected.
    """
    defect = stretch = 0.0
    angles = np.linspace(-v.command_angle_limit, v.command_angle_limit, 9)
    for roll, pitch, yaw in itertools.product(angles, angles, np.linspace(-np.pi, np.pi, 17)):
        matrix = rotation(roll, pitch, yaw)
        if printed:
            matrix[1, 2] += 2 * np.cos(yaw) * np.sin(roll) * np.cos(pitch)
        defect = max(defect, np.abs(matrix.T @ matrix - np.eye(3)).max())
        stretch = max(stretch, abs(np.linalg.norm(matrix[:, 2]) - 1))
    return float(defect), float(stretch)


def section(v: Vehicle, sequences: Sequences) -> Section:
    """Return the section over planar flights `sequences`."""
    flight, static = quoted("hover", "flight_pwm"), quoted("hover", "static_pwm")
    factor, g = quoted("hover", "force_factor"), v.environment_gravity
    needed = v.hover_pwm / flight
    paper_drag, drag_error = drag(v, sequences)
    share = drag_error / paper_drag
    weight = v.body_mass * g
    speed = rotor_speed_sum(weight, pack(v)[0])
    excess = code_rotor_speed(weight, v) / speed - 1
    low = v.thrust_per_pwm * v.command_pwm_range[0]
    excess_low = code_rotor_speed(low, v) / rotor_speed_sum(low, pack(v)[0]) - 1
    defect, stretch = rotation_defects(v, printed=True)
    sound, _ = rotation_defects(v, printed=False)
    roll = v.command_angle_limit
    filling = {
        "static": number(static),
        "static_hover": number(v.static_hover_pwm),
        "hover": number(v.hover_pwm),
        "climb": (static / v.hover_pwm - 1) * g,
        "maps": 100 * (v.static_hover_pwm / v.hover_pwm - 1),
        "flight": number(flight),
        "factor": factor,
        "factored": number(v.hover_pwm / factor),
        "needed": needed,
        "explained": 100 * (1 - factor) / (1 - needed),
        "paper_drag": paper_drag,
        "drag_error": drag_error,
        "family": sequences.family,
        "share": 100 * share,
        "speed": number(speed),
        "excess": 100 * excess,
        "excess_low": 100 * excess_low,
        "low": number(v.command_pwm_range[0]),
        "sound": number(sound),
        "defect": defect,
        "stretch": 100 * stretch,
        "roll": np.degrees(roll),
        "sideways": 2 * g * np.tan(roll),
    }
    measured = {
        "hover": v.hover_pwm,
        "static_hover": v.static_hover_pwm / static,
        "corrected": sound,
        "printed": defect,
        "drag": share,
        "factor_four": excess,
    }
    rows = [tuple(cell.format(**filling) for cell in row) for row in WORDS.tables["inconsistencies"]["rows"]]
    data = {"drag_rms": paper_drag, "drag_error_rms": drag_error, "hover_pwm": v.hover_pwm}
    data |= {"static_hover_pwm": v.static_hover_pwm, "thrust_stretch": stretch}
    tables = [Table("Inconsistencies", ("what", "paper or code", "here", "consequence"), rows)]
    return WORDS.section("inconsistencies", measured, tables=tables, data=data)
