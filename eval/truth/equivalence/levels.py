"""Three levels of agreement: accelerations, one control step, flights of 6 s; both attitude modes."""

from __future__ import annotations

import dataclasses
from functools import partial

import mujoco
import numpy as np
from matplotlib.axes import Axes

from inclined_landing.eval.base.claims import Claim, Section, Table, number
from inclined_landing.eval.base.colours import BLUE, GREEN, INK, MUTED, ORANGE
from inclined_landing.eval.base.style import legend_below
from inclined_landing.eval.truth.equivalence import flying
from inclined_landing.eval.truth.equivalence.flying import (
    FAMILIES,
    HEIGHT,
    MODES,
    WORDS,
    Sequences,
    angle_gap,
    engine,
    equations,
    position_gap,
)
from inclined_landing.eval.truth.figures import panels
from inclined_landing.models.attitude import LAG, ROLL, VX, VZ, WX, WZ, YAW, X, Z, body_rates, quaternion
from inclined_landing.models.equations import derivative
from inclined_landing.models.parameters import constants
from inclined_landing.models.plants import Attitude
from inclined_landing.models.vehicle import Vehicle

PAPER_SUBSTEPS = 1  # RK4 at the control period, as the paper integrates
FLIGHT_LIMITS = {
    attitude: tuple(WORDS.tables["levels"][f"flight_{attitude}_{q}"]["high"] for q in ("position", "angle"))
    for attitude in MODES
}  # m, deg


@dataclasses.dataclass(frozen=True)
class Gaps:
    """Differences of flights, by sequence and over time."""

    labels: list[str]  # of the groups
    group: np.ndarray  # (n,) index into labels
    position: np.ndarray  # (steps, n) m
    angle: np.ndarray  # (steps, n) deg

    @classmethod
    def of(cls, sequences: list[Sequences], a: np.ndarray, b: np.ndarray) -> Gaps:
        """Return the differences of flights a and b (steps, n, 13) of all the sequences side by side."""
        group = np.repeat(np.arange(len(sequences)), [len(s.yaw) for s in sequences])
        return cls([s.label for s in sequences], group, position_gap(a, b), angle_gap(a, b))

    def by_group(self) -> list[tuple[str, float, float]]:
        """Return (label, m, deg) largest of each group."""
        parts = [(label, self.group == k) for k, label in enumerate(self.labels)]
        return [(s, float(self.position[:, k].max()), float(self.angle[:, k].max())) for s, k in parts]


def accelerations(vehicle: Vehicle, attitude: Attitude, count: int, seed: int) -> dict[str, float]:
    """Return the largest differences of accelerations at `count` random states, mj_forward against equations.

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


def one_step(plant, commands: np.ndarray, starts: np.ndarray, flown: np.ndarray) -> np.ndarray:
    """Return the states (steps, n, 13) one control step after every state of the flights `flown`."""
    everyone = np.arange(plant.n)
    plant.set_platform(everyone, plant.vehicle.platform_inclination, False)
    stepped = np.empty_like(flown)
    for k, command in enumerate(commands):
        plant.reset(everyone, starts if k == 0 else flown[k - 1])
        plant.step(command)
        stepped[k] = plant.state
    return stepped


def measure(
    vehicle: Vehicle, attitude: Attitude, sequences: list[Sequences], count: int, seed: int
) -> tuple[list[Claim], np.ndarray, np.ndarray, tuple[Gaps, Gaps]]:
    """Return the claims of the three levels, the flights, and the gaps of single steps and of flights.

    The flights (steps, n, 13) are those of the equations and of the engine; they are claimed by family.
    """
    commands, starts = flying.side_by_side(vehicle, sequences)
    n, mode = len(starts), MODES[attitude]
    found = accelerations(vehicle, attitude, count, seed)
    flown = flying.fly(equations(n, attitude, vehicle=vehicle), commands, starts)
    landed = flying.fly(engine(n, attitude, vehicle), commands, starts)
    stepped = one_step(equations(n, attitude, vehicle=vehicle), commands, starts, landed)
    step, flight = Gaps.of(sequences, landed, stepped), Gaps.of(sequences, landed, flown)
    where = f"{mode}, {count} random states"
    claims = [WORDS.claim("levels", key, value, where=where) for key, value in found.items()]
    largest = float(step.position.max()), float(step.angle.max())
    for level, label, *gaps in [("step", "", *largest), *(("flight", *g) for g in flight.by_group())]:
        for quantity, gap in zip(("position", "angle"), gaps):
            key = f"{level}_{attitude}_{quantity}"
            claims.append(WORDS.claim("levels", key, gap, mode=mode, label=label))
    return claims, flown, landed, (step, flight)


@panels(2, 4.6, 4.0)
def draw(vehicle: Vehicle, gaps: dict[Attitude, Gaps], *axes: Axes) -> None:
    """Draw the position difference of flights over 6 s in both modes."""
    colours = dict(zip(FAMILIES, (BLUE, GREEN, ORANGE)))
    for axis, (attitude, flight) in zip(axes, gaps.items()):
        t = vehicle.command_control_period * np.arange(1, len(flight.position) + 1)
        for k, label in enumerate(flight.labels):
            family, dimension = label.rsplit(", ", 1)
            largest = flight.position[:, flight.group == k].max(axis=1)
            style = {"ls": "-", "label": family} if dimension == "3-D" else {"ls": "--"}
            axis.semilogy(t, np.maximum(largest, 1e-13), color=colours[family], lw=1.4, **style)
        axis.axhline(FLIGHT_LIMITS[attitude][0], color=INK, lw=1, ls=":", label="tolerance")
        axis.plot([], [], color=MUTED, lw=1.4, ls="--", label="the same in 2-D")
        axis.set(title=MODES[attitude].capitalize(), xlabel="time [s]", xlim=(0, 6))
        axis.set(ylabel="largest position difference [m]", ylim=(1e-11, 1e-3))
        legend_below(axis)


def section(vehicle: Vehicle, sequences: list[Sequences], count: int, seed: int) -> Section:
    """Return the section."""
    commands, starts = flying.side_by_side(vehicle, sequences)
    n = len(starts)
    kinematic, _, landed, drawn = measure(vehicle, "kinematic", sequences, count, seed)
    coarse = flying.fly(equations(n, "kinematic", PAPER_SUBSTEPS, vehicle), commands, starts)
    kinematic.append(WORDS.claim("levels", "paper_step", float(position_gap(landed, coarse).max())))
    mass = next(c for c in constants() if (c.section, c.name) == ("body", "mass"))
    uncertain = float(np.asarray(mass.uncertainty))
    heavy = vehicle.changed(body_mass=vehicle.body_mass + uncertain)
    heavier = flying.fly(equations(n, "kinematic", PAPER_SUBSTEPS, heavy), commands, starts)
    metres = float(np.median(position_gap(heavier, coarse)[-1]))
    rate_loop, flown, _, looped = measure(vehicle, "rate_loop", sequences, count, seed)
    gaps: dict[Attitude, tuple[Gaps, Gaps]] = {"kinematic": drawn, "rate_loop": looped}
    rows = [
        (MODES[attitude], label, p, s, a)
        for attitude, (step, flight) in gaps.items()
        for (label, p, a), (_, s, _) in zip(flight.by_group(), step.by_group())
    ]
    worst = max(c.measured for c in rate_loop if c.unit == "m")
    speed = float(np.linalg.norm(flown[..., VX : VZ + 1], axis=-1).max())
    filling = {
        "count": n,
        "families": ", ".join(dict.fromkeys(s.family for s in sequences)),
        "height": HEIGHT,
        "speed": speed,
        "grams": number(1e3 * uncertain),
        "metres": metres,
        "times": number(metres / worst),
    }
    heads = ("mode", "commands", "6 s: position [m]", "one step: position [m]", "6 s: angle [deg]")
    tables = [Table("Largest differences by family", heads, rows)]
    data = {"mass_uncertainty_moves_m": metres, "largest_speed": speed}
    figure = partial(draw, vehicle, {attitude: flight for attitude, (_, flight) in gaps.items()})
    return WORDS.section("levels", kinematic + rate_loop, filling, tables=tables, data=data, draw=figure)
