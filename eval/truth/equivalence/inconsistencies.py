"""The paper against itself and against its authors' public code, in numbers.

The public code is described here by its equations (see `paper.toml` for where it is); the model follows
the paper's equations.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from inclined_landing.eval.base.claims import Claim, Section, Table, number
from inclined_landing.eval.truth.equivalence import flying
from inclined_landing.eval.truth.equivalence.flying import HEIGHT
from inclined_landing.eval.truth.equivalence.motor import quoted
from inclined_landing.eval.truth.equivalence.sequences import Sequences
from inclined_landing.models.attitude import LAG, PITCH, PITCH_COMMAND, PWM, VX, VZ, X, Z, rotation
from inclined_landing.models.equations import derivative, pack, rotor_speed_sum
from inclined_landing.models.parameters import Vehicle

_SUBSTEPS = 5


def code_rotor_speed(thrust: float, v: Vehicle) -> float:
    """w_sum [rad/s] as the public code has it: the force map inverted without its factor four at zero PWM."""
    a, b, c = v.motor_pwm_to_force
    n = v.motor_count
    pwm = (-n * b + np.sqrt((n * b) ** 2 - 4 * n * a * (c - thrust))) / (2 * n * a)
    slope, idle = v.motor_pwm_to_speed
    return n * (slope * pwm + idle)


def code_planar(y: np.ndarray, u: np.ndarray, v: Vehicle) -> np.ndarray:
    """The public code's planar motion: d/dt of x, z, vx, vz, pitch, lag (6,) under a PWM and a pitch (2,).

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


def fly_code(v: Vehicle, commands: np.ndarray) -> np.ndarray:
    """(steps, n, 2) x, z [m] of the public code's motion under planar commands (steps, n, 4), from hover."""
    steps, n, _ = commands.shape
    h = v.command_control_period / _SUBSTEPS
    history = np.empty((steps, n, 2))
    for i in range(n):
        y = np.array([0, HEIGHT, 0, 0, 0, v.hover_lag])
        for k in range(steps):
            u = commands[k, i, [PWM, PITCH_COMMAND]]
            for _ in range(_SUBSTEPS):
                k1 = code_planar(y, u, v)
                k2 = code_planar(y + h / 2 * k1, u, v)
                k3 = code_planar(y + h / 2 * k2, u, v)
                k4 = code_planar(y + h * k3, u, v)
                y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            history[k, i] = y[:2]
    return history


@dataclasses.dataclass(frozen=True)
class Drag:
    """The public code's drag against the paper's, over states of planar flight."""

    paper: float  # m/s2, rms of the paper's drag
    error: float  # m/s2, rms of the difference
    apart: np.ndarray  # (steps,) m, median distance over time under the same commands

    @property
    def share(self) -> float:
        """The error as a share of the drag."""
        return self.error / self.paper


def drag(v: Vehicle, sequences: Sequences) -> Drag:
    """Along flights of the paper's equations under planar `sequences`."""
    commands = sequences.commands
    flown = flying.fly(flying.equations(commands.shape[1], "kinematic", vehicle=v), commands)
    without = dataclasses.replace(v, drag_coefficients=(0.0, 0.0, 0.0))
    paper, code = [], []
    for state, command in zip(flown[4::5].reshape(-1, 13), commands[4::5].reshape(-1, 4)):
        free = derivative(state, command, without)["acceleration"][[0, 2]]
        paper.append(derivative(state, command, v)["acceleration"][[0, 2]] - free)
        y = state[[X, Z, VX, VZ, PITCH, LAG]]
        code.append(code_planar(y, command[[PWM, PITCH_COMMAND]], v)[2:4] - free)
    paper, code = np.array(paper), np.array(code)
    return Drag(
        float(np.sqrt((paper**2).sum(axis=1).mean())),
        float(np.sqrt(((code - paper) ** 2).sum(axis=1).mean())),
        np.median(np.linalg.norm(fly_code(v, commands) - flown[..., [X, Z]], axis=-1), axis=1),
    )


def printed_rotation(roll, pitch, yaw) -> np.ndarray:
    """(3, 3) rotation with the last term of (2,3) positive, as printed; the other misprint is corrected."""
    matrix = rotation(roll, pitch, yaw)
    matrix[1, 2] += 2 * np.cos(yaw) * np.sin(roll) * np.cos(pitch)
    return matrix


def rotation_defects(v: Vehicle, printed: bool) -> tuple[float, float]:
    """Largest entry of |R'R - 1| and largest relative change of the thrust, over the commanded attitudes."""
    defect = stretch = 0.0
    angles = np.linspace(-v.command_angle_limit, v.command_angle_limit, 9)
    for roll in angles:
        for pitch in angles:
            for yaw in np.linspace(-np.pi, np.pi, 17):
                matrix = (printed_rotation if printed else rotation)(roll, pitch, yaw)
                defect = max(defect, np.abs(matrix.T @ matrix - np.eye(3)).max())
                stretch = max(stretch, abs(np.linalg.norm(matrix[:, 2]) - 1))
    return float(defect), float(stretch)


def section(v: Vehicle, sequences: Sequences) -> tuple[Section, dict]:
    """The section over planar flights `sequences`, and what its figure draws."""
    flight, static = quoted("hover", "flight_pwm"), quoted("hover", "static_pwm")
    factor, g = quoted("hover", "force_factor"), v.environment_gravity
    climb, needed = (static / v.hover_pwm - 1) * g, v.hover_pwm / flight
    found = drag(v, sequences)
    weight = v.body_mass * g
    speed = rotor_speed_sum(weight, pack(v)[0])
    excess = code_rotor_speed(weight, v) / speed - 1
    low = v.thrust_per_pwm * v.command_pwm_range[0]
    excess_low = code_rotor_speed(low, v) / rotor_speed_sum(low, pack(v)[0]) - 1
    defect, stretch = rotation_defects(v, printed=True)
    sound, _ = rotation_defects(v, printed=False)
    roll = v.command_angle_limit
    at = [round(t / v.command_control_period) - 1 for t in (2.0, 6.0)]
    n = number
    rows = [
        ("Hover PWM",
         f"{n(static)} in the paper; its static force map gives {n(v.static_hover_pwm)} for the same mass",
         f"{n(v.hover_pwm)} from its motor function, which the equations use",
         f"action 0 climbs at {climb:.2f} m/s²; the two maps differ by "
         f"{100 * (v.static_hover_pwm / v.hover_pwm - 1):.0f} % of PWM in hover"),
        ("Hover in the real flights",
         f"{n(flight)} PWM; a factor {factor:g} on the force in the code, commented out",
         f"the factor makes it {n(v.hover_pwm / factor)}",
         f"the motor function would have to be scaled by {needed:.2f}; {factor:g} explains "
         f"{100 * (1 - factor) / (1 - needed):.0f} % of the missing force"),
        ("Drag in the public code",
         "multiplied by sin(pitch) in x, cos(pitch) in z, no rotation into the body",
         f"R K R' v, {found.paper:.2f} m/s² (rms) over {sequences.family} commands",
         f"{found.error:.2f} m/s² (rms) off, {100 * found.share:.0f} % of the drag; under the same commands "
         f"{n(found.apart[at[0]])} m apart after 2 s and {n(found.apart[at[1]])} m after 6 s (median)"),
        ("A factor four in the public code",
         "the inverse force map takes the constant of one motor for all four",
         f"rotor speeds in hover {n(speed)} rad/s",
         f"{100 * excess:+.1f} % in hover, {100 * excess_low:+.0f} % at {n(v.command_pwm_range[0])} PWM, "
         "and the drag with it"),
        ("Printed rotation matrix", "last term of (2,3) positive, and a misprint in (2,2)",
         f"corrected: |R'R − 1| ≤ {n(sound)}",
         f"|R'R − 1| up to {defect:.2f} from (2,3) alone; the thrust is up to {100 * stretch:.0f} % wrong "
         "with yaw"),
        ("Sign of the roll", "public code: positive roll accelerates +y, the printed (2,3) taken as it is",
         "positive roll accelerates −y, as the rotation has it",
         f"at {np.degrees(roll):.0f} deg the sideways acceleration is {2 * g * np.tan(roll):.1f} m/s² apart: "
         "a policy of one sign flies away with the other"),
    ]  # fmt: skip
    claims = [
        Claim("hover PWM of the motor function", v.hover_pwm, 34_150, "PWM",
              "the design quotes 34 100: three digits", low=34_050),
        Claim("hover PWM of the static map over the quoted one", v.static_hover_pwm / static, 1.01, "ratio",
              "42 000 is quoted with two digits: within 1 %", low=0.99),
        Claim("corrected rotation matrix, |R'R − 1|", sound, 1e-14, "1",
              "rounding of three products, times ten"),
        Claim("printed rotation matrix, |R'R − 1|", defect, np.inf, "1",
              "orthonormality would be 1e-15; columns 2 and 3 have the product sin(2 roll) cos(pitch) at "
              "yaw 0, 0.87",
              low=0.5),
        Claim("drag of the public code, error", found.share, np.inf, "of the drag",
              "in level flight sin(pitch) is small and the horizontal drag is missing: the error is of its "
              "size",
              low=0.5),
        Claim("factor four: rotor speed in hover", excess, 0.05, "relative",
              "the wrong constant adds three times its 5.5e-4 N to 0.32 N of thrust, 0.5 %, at about half "
              "of the speed's sensitivity", low=1e-3),
    ]  # fmt: skip
    part = Section(
        "inconsistencies",
        "Where the paper and its code disagree",
        [
            "The model follows the paper's equations. These are the places where the paper's numbers, its "
            "printed formulas and its authors' public code differ, and by how much."
        ],
        claims,
        [Table("Inconsistencies", ("what", "paper or code", "here", "consequence"), rows)],
        data={"drag_rms": found.paper, "drag_error_rms": found.error, "hover_pwm": v.hover_pwm,
              "static_hover_pwm": v.static_hover_pwm, "thrust_stretch": stretch},
    )  # fmt: skip
    return part, {"drag": found}
