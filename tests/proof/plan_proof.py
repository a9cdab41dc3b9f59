"""`plan-proof`: flights until the right name stands alone, planned against ordinary ones.

Every case is a reality of the simulator's families with one hidden cause, identified first without it. After
a few ordinary flights the right name is one of several in doubt. From there two ways part: flights that
`landing-eval plan` designs from the diagnosis, each from all flights before it, and further ordinary flights.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
import tyro
from msgspec import Meta

from inclined_landing.envs.shared import runs
from inclined_landing.eval.base.options import Folder, Seed
from inclined_landing.eval.base.tracking import thrust_and_angles
from inclined_landing.eval.gap.answer.named import scored_sets, unidentifiable_sets
from inclined_landing.eval.gap.flights.windows import prepare_all
from inclined_landing.eval.gap.infer.sets import search
from inclined_landing.eval.gap.model.problem import Problem, identifiable_effects
from inclined_landing.eval.gap.model.reference import VehiclePosterior
from inclined_landing.eval.gap.plan import NoiseLevels, ScoredSet, design
from inclined_landing.eval.gap.plan.setpoints import Setpoints
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models import storage
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.vehicle import Vehicle
from tests.proof import simulator
from tests.proof.gap_blind import cases as blind
from tests.proof.gap_blind import causes, generate
from tests.proof.gap_blind.accepted import accepted, entailed
from tests.proof.shared import check_known, in_processes, table
from tests.proof.simulator import control

ALONE = 0.95  # probability from which the right name stands alone ...
RIVAL = 0.5  # ... while no wrong one has this
DOUBT = (0.01, 0.7)  # between which the right name is in doubt
BEFORE = 1  # ordinary flights that the doubt comes from
MOST = 4  # flights after these
SECONDS = 20.0
# Told by the scale and not by flights.
WEIGHED = ("thrust_scale", "thrust_bias", "mass")
WAYS = ("planned", "ordinary")


def command(
    out: Folder,
    family: Annotated[str, tyro.conf.arg(metavar="{dev,fresh}")] = "dev",
    cases: Annotated[int, Meta(ge=1, le=1000)] = 16,
    seed: Seed = 0,
    processes: Annotated[int, Meta(ge=1, le=256)] = 2,
) -> None:
    """Flights until the right name stands alone, planned or not (minutes).

    Args:
        out: new folder for results.json and table.md.
        family: realities to develop on, or those held out.
        cases: drawn; those in which the right name is not in doubt after the first flights are counted only.
        seed: of the cases.
        processes: cases at a time.
    """
    check_known("family", [family], blind.SETS)
    runs.check_new_run(out)
    calls = [(family, (seed, k)) for k in range(cases)]
    rows = [row for _, row in in_processes(race, calls, processes)]
    rows.sort(key=lambda row: row["seed"])
    text = markdown(rows)
    with runs.staged_run(out) as folder:
        storage.write_json(folder / "results.json", {"cases": rows, "versions": runs.versions()})
        storage.write_text(folder / "table.md", text)
    print(text)


def race(family: str, seed: tuple[int, ...]) -> dict:
    """One case: probability of the right name after the first flights, and after each further one."""
    from inclined_landing.eval.gap.answer.identify import identify

    rng = np.random.default_rng((*seed, 7))
    names = [name for name in causes.FREE_FLIGHT if name not in WEIGHED]
    cause, size = str(rng.choice(names)), str(rng.choice(causes.SIZES[:2]))
    case = blind.draw(family, "single", cause, size, (*seed, 8))
    world = case.drawn[cause]
    plain = generate.fly_all(causes.Drawn({}, {}), rng, case.reality, count=blind.IDENTIFY)
    known = identify(generate.logs(plain, voltage=case.voltage), load_vehicle())
    vehicle = known.vehicle
    first = generate.fly_all(world, rng, case.reality, count=BEFORE)
    first = generate.logs(first, voltage=case.voltage)
    start = _searched(first, vehicle, known.reference)
    row = {"seed": list(seed), "family": case.family, "cause": cause, "size": size}
    row["before"] = _named(cause, [*start[0], *start[1]])
    row["sets"] = [(h.text, h.probability) for h in start[0][:4]]
    if not DOUBT[0] <= row["before"][0] <= DOUBT[1]:
        return row
    for way in WAYS:
        flights, now, told = list(first), start, []
        while len(told) < MOST and not (told and alone(*told[-1])):
            if way == "planned":
                recording = _planned(now, vehicle, world, case, rng, seed=len(told))
            else:
                recording = generate.fly_all(world, rng, case.reality, count=1)[0]
            flights += generate.logs([recording], voltage=case.voltage)
            now = _searched(flights, vehicle, known.reference)
            told.append(_named(cause, now[0]))
        row[way] = told
    return row


def _searched(
    flights: Sequence[FlightLog], vehicle: Vehicle, known: VehiclePosterior
) -> tuple[list[ScoredSet], list[ScoredSet], NoiseLevels]:
    """What the flights leave in doubt, as `landing-eval gap` finds it, and what they could not have shown."""
    measured = prepare_all(flights, vehicle, False, [])
    library, _ = identifiable_effects({n: e for n, e in LIBRARY.items() if not e.contact}, measured)
    problem = Problem(measured, vehicle, library, known)
    found = search(problem)
    sets = scored_sets(problem, found)
    return sets, unidentifiable_sets(problem, found), NoiseLevels.of(problem, found)


def _named(cause: str, hypotheses: Sequence[ScoredSet]) -> tuple[float, float]:
    """Probability of the right name, and the largest of a wrong one: that it belongs to what is missing."""
    options = accepted(cause)
    welcome = set().union(*options) | entailed(cause)
    wrong: dict[str, float] = {}
    right = 0.0
    for h in hypotheses:
        right += h.probability * any(option <= set(h.effects) for option in options)
        for name in set(h.effects) - welcome:
            wrong[name] = wrong.get(name, 0.0) + h.probability
    return right, max(wrong.values(), default=0.0)


def alone(right: float, wrong: float) -> bool:
    """Does the right name stand alone?"""
    return right >= ALONE and wrong < RIVAL


def _planned(now, vehicle: Vehicle, world: causes.Drawn, case: blind.Case, rng, seed: int):
    """The recording of a flight planned for what is in doubt now, flown in the case's reality."""
    hypotheses, hidden, noise_levels = now
    plan = design([*hypotheses, *hidden], vehicle, noise_levels=noise_levels, seconds=SECONDS, seed=seed)
    fields = world.world | {field: rng.uniform(*ends) for field, ends in world.spread.items()}
    return simulator.fly(reference(plan.points, vehicle), simulator.World(**fields), rng, case.reality)


def reference(points: Setpoints, vehicle: Vehicle) -> np.ndarray:
    """Set-points as the reference (k, REF_SIZE) of the simulator's pilot, 50 rows a second."""
    every = slice(None, None, 2)
    path, g = points.path, vehicle.environment_gravity
    size, angles = thrust_and_angles(points.acceleration, path.yaw, g)
    # What the commands have beside those of a vehicle without lags: its own pilot adds the rest.
    lead = points.command[:, :3] - np.column_stack(
        [vehicle.hover_pwm * size / g, angles / vehicle.attitude_gain]
    )
    rows = np.zeros((len(path.yaw[every]), control.REF_SIZE))
    rows[:, control.REF_POSITION : control.REF_POSITION + 3] = path.position[every]
    rows[:, control.REF_VELOCITY : control.REF_VELOCITY + 3] = points.velocity[every]
    rows[:, control.REF_ACCELERATION : control.REF_ACCELERATION + 3] = points.acceleration[every]
    rows[:, control.REF_YAW], rows[:, control.REF_YAW_RATE] = path.yaw[every], points.command[every, 3]
    rows[:, control.REF_PWM] = lead[every, 0]
    rows[:, control.REF_ROLL] = lead[every, 1] * vehicle.attitude_gain
    rows[:, control.REF_PITCH] = lead[every, 2] * vehicle.attitude_gain
    return rows


def flown(told: Sequence[tuple[float, float]]) -> int:
    """Flights until the right name stood alone; one more than MOST where it never did."""
    return len(told) if alone(*told[-1]) else MOST + 1


def markdown(rows: Sequence[dict], seed: int = 0) -> str:
    """The table: flights of both ways with 95 % intervals over cases drawn with replacement."""
    doubtful = [row for row in rows if "planned" in row]
    text = (
        f"{len(rows)} cases; in {len(doubtful)} the right name is in doubt after {BEFORE} ordinary flight "
        f"(probability {DOUBT[0]:g} to {DOUBT[1]:g}).\n"
    )
    if not doubtful:
        return text
    counts = {way: np.array([flown(row[way]) for row in doubtful]) for way in WAYS}
    draws = np.random.default_rng(seed).integers(0, len(doubtful), (2000, len(doubtful)))
    means = []
    for way, n in counts.items():
        low, high = np.quantile(n[draws].mean(axis=1), [0.025, 0.975])
        resolved, mean = f"{(n <= MOST).sum()} of {len(n)}", f"{n.mean():.1f} ({low:.1f} to {high:.1f})"
        means.append([way, resolved, mean, f"{np.median(n):.0f}", str((n == 1).sum())])
    ratio = counts["planned"][draws].sum(axis=1) / counts["ordinary"][draws].sum(axis=1)
    low, high = np.quantile(ratio, [0.025, 0.975])
    share = counts["planned"].sum() / counts["ordinary"].sum()
    header = ("further flights", "resolved", "mean until the right name stands alone (95 %)", "median")
    every = [
        [row["cause"], row["size"], row["family"], f"{row['before'][0]:.2f}"]
        + [" ".join(f"{p:.2f}" for p, _ in row[way]) for way in WAYS]
        for row in doubtful
    ]
    return "\n".join(
        (
            text,
            table([*header, "after one"], means),
            f"Planned flights needed: {share:.2f} times the ordinary ones (95 %: {low:.2f} to {high:.2f}). "
            f"What was not resolved after {MOST} flights counts as {MOST + 1}.\n",
            table(["cause", "size", "family", "P before", *WAYS], every),
        )
    )
