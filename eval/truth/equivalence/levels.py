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
    WORDS,
    angle_gap,
    engine,
    equations,
    position_gap,
)
from inclined_landing.eval.truth.equivalence.sequences import Sequences
from inclined_landing.models.attitude import LAG, ROLL, VX, VZ, WX, WZ, YAW, X, Z, body_rates, quaternion
from inclined_landing.models.equations import derivative
from inclined_landing.models.parameters import constants
from inclined_landing.models.plants import Attitude
from inclined_landing.models.vehicle import Vehicle

PAPER_SUBSTEPS = 1  # RK4 at the control period, as the paper integrates
FLIGHT_LIMITS = {
    attitude: tuple(WORDS.tables["levels"][f"flight_{attitude}_{q}"]["high"] for q in ("position", "angle"))
    for attitude in ATTITUDES
}  # m, deg
_PLAIN = {"kinematic": "kinematic", "rate_loop": "rate loop"}


@dataclasses.dataclass(frozen=True)
class Gaps:
    """Differences of flights, by sequence: largest over time, at the end, and over time."""

    labels: list[str]  # of the groups
    group: np.ndarray  # (n,) index into labels
    position: np.ndarray  # (steps, n) m
    angle: np.ndarray  # (steps, n) deg

    def largest(self) -> tuple[float, float]:
        """Return the largest differences (m, deg)."""
        return float(self.position.max()), float(self.angle.max())

    def by_group(self) -> list[tuple[str, float, float]]:
        """Return (label, m, deg) largest of each group."""
        parts = [(label, self.group == k) for k, label in enumerate(self.labels)]
        return [(s, float(self.position[:, k].max()), float(self.angle[:, k].max())) for s, k in parts]


def accelerations(vehicle: Vehicle, attitude: Attitude, count: int, seed: int) -> dict[str, float]:
    """Return the largest differences of accelerations at `count` random states, mj_forward against the
    equations.

    Largest differences: linear [m/s2], angular [rad/s2, body axes], lag [PWM, relative to the largest rate].
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
        expected = derivative(state, command, vehicle, rate_loop)
        if rate_loop:
            second = expected["euler_accelerations"]
        else:
            second = -rates / vehicle.attitude_time_constant * [1, 1, 0]
        turning = body_accelerations(roll, pitch, rates, second)
        linear = max(linear, np.abs(data.qacc[:3] - expected["acceleration"]).max())
        angular = max(angular, np.abs(data.qacc[3:] - turning).max())
        lag = max(lag, abs(data.act_dot[0] - expected["lag_rate"]) / vehicle.command_pwm_range[1])
    return {"linear": float(linear), "angular": float(angular), "lag": float(lag)}


def _random_state(rng) -> np.ndarray:
    """Return a random state (13,) far above every surface; rates 0."""
    state = np.zeros(13)
    state[X : Z + 1] = rng.uniform(-1, 1, 3) + [0, 0, 50]
    state[VX : VZ + 1] = rng.uniform(-8, 8, 3)
    state[ROLL : YAW + 1] = rng.uniform([-1.2, -3, -3], [1.2, 3, 3])
    state[LAG] = rng.uniform(500, 4000)
    return state


def body_accelerations(roll, pitch, rates, second) -> np.ndarray:
    """Return d(body rates)/dt (3,) [rad/s2] from Euler rates and accelerations."""
    # w = E(roll, pitch) d(angles)/dt,  so  dw/dt = E d2(angles)/dt2 + dE/dt d(angles)/dt
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


def reference(vehicle: Vehicle, attitude: Attitude, sequences: list[Sequences], substeps: int = flying.FINE):
    """Return the states (steps, n, 13) of the equations over all the sequences side by side."""
    commands, starts, _ = stack(vehicle, sequences)
    return flying.fly(equations(commands.shape[1], attitude, substeps, vehicle), commands, starts)


def stack(vehicle: Vehicle, sequences: list[Sequences]):
    """Return (commands (steps, n, 4), start states (n, 13), group (n,)) of all the sequences together."""
    commands = np.concatenate([s.commands for s in sequences], axis=1)
    yaw = np.concatenate([s.yaw for s in sequences])
    group = np.repeat(np.arange(len(sequences)), [s.commands.shape[1] for s in sequences])
    return commands, flying.start_states(len(yaw), yaw, vehicle), group


def one_step(vehicle: Vehicle, attitude: Attitude, sequences: list[Sequences], flown: np.ndarray) -> Gaps:
    """Return one control step of the engine from every state of the flights `flown` (steps, n, 13)."""
    commands, starts, group = stack(vehicle, sequences)
    plant = engine(len(group), attitude, vehicle)
    everyone = np.arange(plant.n)
    plant.set_platform(everyone, vehicle.platform_inclination, False)
    landed = np.empty_like(flown)
    for k, command in enumerate(commands):
        plant.reset(everyone, starts if k == 0 else flown[k - 1])
        plant.step(command)
        landed[k] = plant.state
    return _gaps(sequences, group, landed, flown)


def rollouts(vehicle: Vehicle, attitude: Attitude, sequences: list[Sequences], flown: np.ndarray) -> Gaps:
    """Return the flights of 6 s in the engine against `flown` (steps, n, 13), commands only."""
    commands, starts, group = stack(vehicle, sequences)
    landed = flying.fly(engine(len(group), attitude, vehicle), commands, starts)
    return _gaps(sequences, group, landed, flown)


def _gaps(sequences, group, a, b) -> Gaps:
    return Gaps([s.label for s in sequences], group, position_gap(a, b), angle_gap(a, b))


def acceleration_claims(attitude: Attitude, found: dict[str, float], count: int) -> list[Claim]:
    """Return the claims of level 1, accelerations."""
    where = f"{_PLAIN[attitude]}, {count} random states"
    return [WORDS.claim("levels", key, value, where=where) for key, value in found.items()]


def gap_claims(attitude: Attitude, step: Gaps, flight: Gaps) -> list[Claim]:
    """Return the claims of levels 2 and 3, one step and flights, by family."""
    claims = []
    for level, label, *gaps in [("step", "", *step.largest()), *(("flight", *g) for g in flight.by_group())]:
        for quantity, gap in zip(("position", "angle"), gaps):
            key = f"{level}_{attitude}_{quantity}"
            claims.append(WORDS.claim("levels", key, gap, mode=_PLAIN[attitude], label=label))
    return claims


def section(
    vehicle: Vehicle, sequences: list[Sequences], count: int, seed: int, tick
) -> tuple[Section, dict]:
    """Return the section and what its figure draws: {attitude: (step gaps, flight gaps)}."""
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
            largest, _ = rollouts(vehicle, attitude, sequences, coarse).largest()
            claims.append(WORDS.claim("levels", "paper_step", largest))
            commands, starts, _ = stack(vehicle, sequences)
            mass = next(c for c in constants() if (c.section, c.name) == ("body", "mass"))
            uncertain = float(np.asarray(mass.uncertainty))
            heavier = flying.fly(
                equations(commands.shape[1], attitude, flying.FINE, vehicle), commands, starts,
                mass_scale=1 + uncertain / vehicle.body_mass,
            )  # fmt: skip
            scale = float(np.median(position_gap(heavier, flown)[-1]))
            tick()
    worst = max(c.measured for c in claims if c.unit == "m" and "rate loop" in c.name)
    speed = float(np.linalg.norm(flown[..., VX : VZ + 1], axis=-1).max())
    heads = ("mode", "commands", "6 s: position [m]", "one step: position [m]", "6 s: angle [deg]")
    filling = {
        "count": sum(len(s.yaw) for s in sequences),
        "families": ", ".join(dict.fromkeys(s.family for s in sequences)),
        "height": HEIGHT,
        "speed": speed,
        "grams": number(1e3 * uncertain),
        "metres": scale,
        "times": number(scale / worst),
    }
    tables = [Table("Largest differences by family", heads, table)]
    data = {"mass_uncertainty_moves_m": scale, "largest_speed": speed}
    return WORDS.section("levels", claims, filling, tables=tables, data=data), drawn
