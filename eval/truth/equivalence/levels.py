"""Three levels of agreement: accelerations, one control step, flights of 6 s; both attitude modes."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np

from inclined_landing.eval.base.claims import Claim, Section, Table, number
from inclined_landing.eval.truth.equivalence import flying
from inclined_landing.eval.truth.equivalence.flying import (
    ATTITUDES,
    HEIGHT,
    angle_gap,
    engine,
    equations,
    position_gap,
)
from inclined_landing.eval.truth.equivalence.sequences import Sequences
from inclined_landing.models.attitude import LAG, ROLL, VX, VZ, WX, WZ, YAW, X, Z, body_rates, quaternion
from inclined_landing.models.equations import derivative
from inclined_landing.models.parameters import Vehicle, constants

PAPER_SUBSTEPS = 1  # RK4 at the control period, as the paper integrates
_PLAIN = {"kinematic": "kinematic", "rate_loop": "rate loop"}


@dataclasses.dataclass(frozen=True)
class Accelerations:
    """Largest differences of one forward pass."""

    linear: float  # m/s2
    angular: float  # rad/s2, body axes
    lag: float  # PWM, relative to the largest rate


@dataclasses.dataclass(frozen=True)
class Gaps:
    """Differences of flights, by sequence: largest over time, at the end, and over time."""

    labels: list[str]  # of the groups
    group: np.ndarray  # (n,) index into labels
    position: np.ndarray  # (steps, n) m
    angle: np.ndarray  # (steps, n) deg

    def largest(self) -> tuple[float, float]:
        """(m, deg) over everything."""
        return float(self.position.max()), float(self.angle.max())

    def by_group(self) -> list[tuple[str, float, float]]:
        """(label, m, deg) largest of each group."""
        return [
            (
                label,
                float(self.position[:, self.group == k].max()),
                float(self.angle[:, self.group == k].max()),
            )
            for k, label in enumerate(self.labels)
        ]


def accelerations(vehicle: Vehicle, attitude: str, count: int, seed: int) -> Accelerations:
    """`count` random states: one mj_forward, plugins included, against one evaluation of the equations.

    Kinematic: the body rates are those of the first-order loops, and the body accelerations must be
    those of the loops' own motion, d2(angle)/dt2 = -d(angle)/dt / tau.
    """
    rng = np.random.default_rng([seed, 10])
    model = engine(1, attitude, vehicle).model
    data = mujoco.MjData(model)
    data.mocap_pos[:, 2] = -100.0  # the platform, out of the way
    rate_loop = attitude == "rate_loop"
    linear = angular = lag = 0.0
    for _ in range(count):
        state, command = _random_state(rng), rng.uniform([0, -0.5, -0.5, -3], [60_000, 0.5, 0.5, 3])
        roll, pitch, yaw = state[ROLL : YAW + 1]
        if rate_loop:
            rates = rng.uniform(-3, 3, 3)
        else:
            rates = derivative(state, command, vehicle)["euler_rates"]
        state[WX : WZ + 1] = body_rates(roll, pitch, *rates)
        data.qpos[:] = [*state[:3], *quaternion(roll, pitch, yaw)]
        data.qvel[:3], data.qvel[3:], data.act[0] = state[VX : VZ + 1], state[WX : WZ + 1], state[LAG]
        data.ctrl[:] = command
        mujoco.mj_forward(model, data)
        wanted = derivative(state, command, vehicle, rate_loop)
        if rate_loop:
            second = wanted["euler_accelerations"]
        else:
            second = -rates / vehicle.attitude_time_constant * [1, 1, 0]
        turning = body_accelerations(roll, pitch, rates, second)
        linear = max(linear, np.abs(data.qacc[:3] - wanted["acceleration"]).max())
        angular = max(angular, np.abs(data.qacc[3:] - turning).max())
        lag = max(lag, abs(data.act_dot[0] - wanted["lag_rate"]) / vehicle.command_pwm_range[1])
    return Accelerations(float(linear), float(angular), float(lag))


def _random_state(rng) -> np.ndarray:
    """(13,) far above everything, rolled within 70 deg, pitched and turned at will; rates left 0."""
    state = np.zeros(13)
    state[X : Z + 1] = rng.uniform(-1, 1, 3) + [0, 0, 50]
    state[VX : VZ + 1] = rng.uniform(-8, 8, 3)
    state[ROLL : YAW + 1] = rng.uniform([-1.2, -3, -3], [1.2, 3, 3])
    state[LAG] = rng.uniform(500, 4000)
    return state


def body_accelerations(roll, pitch, rates, second) -> np.ndarray:
    """d(body rates)/dt (3,) [rad/s2] from Euler rates and accelerations: body_rates, differentiated."""
    sr, cr, sp, cp = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
    a, b, c = rates
    da, db, dc = second
    return np.array(
        [
            da * cp - a * b * sp - dc * cr * sp + c * (a * sr * sp - b * cr * cp),
            db + dc * sr + c * a * cr,
            da * sp + a * b * cp + dc * cr * cp - c * (a * sr * cp + b * cr * sp),
        ]
    )


def reference(vehicle: Vehicle, attitude: str, sequences: list[Sequences], substeps: int = flying.FINE):
    """States (steps, n, 13) of the equations over all the sequences side by side."""
    commands, starts, _ = stack(vehicle, sequences)
    return flying.fly(equations(commands.shape[1], attitude, substeps, vehicle), commands, starts)


def stack(vehicle: Vehicle, sequences: list[Sequences]):
    """(commands (steps, n, 4), start states (n, 13), group (n,)) of all the sequences together."""
    commands = np.concatenate([s.commands for s in sequences], axis=1)
    yaw = np.concatenate([s.yaw for s in sequences])
    group = np.repeat(np.arange(len(sequences)), [s.commands.shape[1] for s in sequences])
    return commands, flying.start_states(len(yaw), yaw, vehicle), group


def one_step(
    vehicle: Vehicle, attitude: str, sequences: list[Sequences], flown: np.ndarray, **options
) -> Gaps:
    """One control step of the engine from every state of the flights `flown` (steps, n, 13)."""
    commands, starts, group = stack(vehicle, sequences)
    plant = engine(len(group), attitude, vehicle, **options)
    everyone = np.arange(plant.n)
    plant.set_platform(everyone, vehicle.platform_inclination, False)
    landed = np.empty_like(flown)
    for k, command in enumerate(commands):
        plant.reset(everyone, starts if k == 0 else flown[k - 1])
        plant.step(command)
        landed[k] = plant.state
    return _gaps(sequences, group, landed, flown)


def rollouts(
    vehicle: Vehicle, attitude: str, sequences: list[Sequences], flown: np.ndarray, **options
) -> Gaps:
    """Flights of 6 s in the engine against `flown` (steps, n, 13), commands only."""
    commands, starts, group = stack(vehicle, sequences)
    return _gaps(
        sequences,
        group,
        flying.fly(engine(len(group), attitude, vehicle, **options), commands, starts),
        flown,
    )


def _gaps(sequences, group, a, b) -> Gaps:
    return Gaps([s.label for s in sequences], group, position_gap(a, b), angle_gap(a, b))


def acceleration_claims(attitude: str, found: Accelerations, count: int) -> list[Claim]:
    """Level 1."""
    where = f"{_PLAIN[attitude]}, {count} random states"
    return [
        Claim(f"linear acceleration, {where}", found.linear, 1e-11, "m/s²",
              "rounding: up to 100 m/s², some hundred operations of 1.1e-16 each, times 10"),
        Claim(f"angular acceleration, {where}", found.angular, 1e-9, "rad/s²",
              "rounding: up to 2000 rad/s², divided by cos(roll) ≥ 0.36 and by the inertia, times 10"),
        Claim(f"rate of the thrust lag, {where}", found.lag, 1e-14, "of full PWM",
              "rounding: one product and one difference"),
    ]  # fmt: skip


STEP_LIMITS = {"kinematic": (2e-8, 1e-5), "rate_loop": (2e-8, 1e-4)}  # m, deg
FLIGHT_LIMITS = {"kinematic": (2e-5, 2e-4), "rate_loop": (1e-4, 2e-3)}  # m, deg
PAPER_STEP_LIMIT = 5e-4  # m
_STEP_WHY = {
    "kinematic": (
        "lag at h = 4 ms: (a h)⁵/120 = 8e-9 of a speed change of 1 m/s, kept for the rest of 20 ms, five "
        "times: 1e-9 m; a margin of twenty for the turning thrust",
        "turning at ω ≤ 8.5 rad/s: (ω h)⁵ = 4.5e-8 rad, five times: 1.3e-5 deg before the constant of RK4, "
        "which is below one",
    ),
    "rate_loop": (
        "1.7e-6 rad (the angle's tolerance) of a thrust of 20 m/s² for 20 ms: 20 × 1.7e-6 × 0.02²/2 = 7e-9 "
        "m, times 3",
        "RK4 at h = 4 ms: (B h)⁵/120 = 2.7e-6 of the angle that a rate change of 6.3 rad/s makes in 1/B, "
        "7.2 deg, is 2e-5 deg; five decaying substeps 7e-5 deg",
    ),
}
_FLIGHT_WHY = {
    "kinematic": (
        "30 command changes with a speed error of 1e-8 m/s each, kept for up to 6 s: 2e-6 m; times ten for "
        "the tilt errors, which grow with t²",
        "the step's 1e-5 deg after each of 30 command changes, fading with τ; without fading for yaw",
    ),
    "rate_loop": (
        "1e-4 deg = 1.7e-6 rad after each command change, fading with τ = 0.18 s: 20 m/s² × 1.7e-6 × 0.18 "
        "s = 6e-6 m/s; √30 of them for 3 s on average: 1e-4 m",
        "the step's 1e-4 deg after a command change, of which at most a few have not faded; yaw keeps √30 "
        "of them and its axis error",
    ),
}


def gap_claims(attitude: str, step: Gaps, flight: Gaps) -> list[Claim]:
    """Levels 2 and 3, every family."""
    metres, degrees = STEP_LIMITS[attitude]
    p, a = step.largest()
    name = f"one control step, {_PLAIN[attitude]}"
    claims = [
        Claim(f"{name}: position", p, metres, "m", _STEP_WHY[attitude][0]),
        Claim(f"{name}: angle", a, degrees, "deg", _STEP_WHY[attitude][1]),
    ]
    metres, degrees = FLIGHT_LIMITS[attitude]
    for label, p, a in flight.by_group():
        name = f"6 s {_PLAIN[attitude]}, {label}"
        claims += [
            Claim(f"{name}: position", p, metres, "m", _FLIGHT_WHY[attitude][0]),
            Claim(f"{name}: angle", a, degrees, "deg", _FLIGHT_WHY[attitude][1]),
        ]
    return claims


def section(
    vehicle: Vehicle, sequences: list[Sequences], count: int, seed: int, tick
) -> tuple[Section, dict]:
    """The section and what its figure draws: {attitude: (step gaps, flight gaps)}."""
    claims, table, drawn = [], [], {}
    for attitude in ATTITUDES:
        claims += acceleration_claims(attitude, accelerations(vehicle, attitude, count, seed), count)
        tick()
        flown = reference(vehicle, attitude, sequences)
        step = one_step(vehicle, attitude, sequences, flown)
        tick()
        flight = rollouts(vehicle, attitude, sequences, flown)
        tick()
        claims += gap_claims(attitude, step, flight)
        drawn[attitude] = step, flight
        table += [
            (_PLAIN[attitude], label, p, s, a)
            for (label, p, a), (_, s, _) in zip(flight.by_group(), step.by_group())
        ]
        if attitude == "kinematic":
            coarse = reference(vehicle, attitude, sequences, PAPER_SUBSTEPS)
            claims.append(
                Claim("6 s kinematic, against RK4 at the paper's 0.02 s: position",
                      rollouts(vehicle, attitude, sequences, coarse).largest()[0], PAPER_STEP_LIMIT, "m",
                      "the error of RK4 at 0.02 s itself: (a h)⁵/120 = 2.4e-5 of the lag at each step of "
                      "the PWM")
            )  # fmt: skip
            commands, starts, _ = stack(vehicle, sequences)
            uncertain = next(c.uncertainty for c in constants() if (c.section, c.name) == ("body", "mass"))
            heavier = flying.fly(
                equations(commands.shape[1], attitude, flying.FINE, vehicle), commands, starts,
                mass_scale=1 + uncertain / vehicle.body_mass,
            )  # fmt: skip
            scale = float(np.median(position_gap(heavier, flown)[-1]))
            tick()
    worst = max(c.measured for c in claims if c.unit == "m" and "rate loop" in c.name)
    speed = float(np.linalg.norm(flown[..., VX : VZ + 1], axis=-1).max())
    n = len(stack(vehicle, sequences)[2])
    text = [
        f"{n} command sequences of 6 s ({', '.join(dict.fromkeys(s.family for s in sequences))}; half in "
        f"the plane, half in three dimensions with yaw), flown {HEIGHT:.0f} m above everything, up to "
        f"{speed:.0f} m/s. Kinematic mode is compared with the paper's equations, the rate loop with the "
        "equations extended by the same bandwidth; both solved with RK4 at 1 ms, the engine runs its "
        "default, RK4 at 4 ms. Torque limits are off, as the equations have none.",
    ]
    remarks = [
        f"For scale: the uncertainty of the mass alone ({number(1e3 * uncertain)} g) moves these flights "
        f"by {scale:.2g} m at their end, {number(scale / worst)} times the largest difference between "
        "engine and equations."
    ]
    return (
        Section(
            "levels", "Three levels", text, claims,
            [Table("Largest differences by family",
                   ("mode", "commands", "6 s: position [m]", "one step: position [m]", "6 s: angle [deg]"),
                   table)],
            remarks=remarks, data={"mass_uncertainty_moves_m": scale, "largest_speed": speed},
        ),
        drawn,
    )  # fmt: skip
