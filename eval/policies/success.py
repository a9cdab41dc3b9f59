"""`landing-eval success`: how often, how fast and how hard a policy reaches its goal.

Landing: the deterministic policy flies from the paper's three starts, from ten scattered starts
around each, and from the frozen grid (`landing_starts.py`). *Success* is reaching the goal box
(0.10, 0.10, 1.5, 1.5, 0.025) within 300 control steps; *strict* success also means that no part
touched the platform before. The goal box is not yet a landing, so the velocity at its entry is
reported too, and what happens when the motors are cut there (`motors_cut.py`).

Set-point: the position error after 3 s from 200 random starts. Other tasks: success as they judge it,
reward and duration, from as many (`judges.py`).

With ``--effects`` the frozen grid (or the random starts) alone, once for every effect of the library
(`success_effects.py`).
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from inclined_landing.envs.flights import record_flights
from inclined_landing.envs.policy import Policy, load_policy
from inclined_landing.eval.base import runs
from inclined_landing.eval.policies.judges import judge_of
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import PLANTS, make_plant


def evaluate(
    policy: Policy, *, plant: str = "mujoco", thrust_scales: Sequence[float] = (1.0,), seed: int = 0
) -> dict:
    """The success report of a policy, as plain numbers; one entry of `conditions` per thrust scale.

    plant: "mujoco" or "analytic", always the plain one (no keep-out zone, RK4 at 4 ms).
    seed: of the random starts.
    """
    report, _ = _evaluate(policy, plant, thrust_scales, seed)
    return report


def run(
    policy: str,
    *,
    task: str | None = None,
    plant: str = "mujoco",
    thrust_scale: Sequence[float] = (1.0,),
    inclination: float | None = None,
    vehicle: Path | None = None,
    effects: bool = False,
    seed: int = 0,
    json: bool = False,
    out: Path | None = None,
) -> None:
    """The command; inclination in degrees. Prints a table, or JSON alone."""
    if plant not in PLANTS:
        raise UserError(f"unknown plant {plant!r}; known are {' and '.join(PLANTS)}")
    for scale in thrust_scale:
        if not (math.isfinite(scale) and 0 < scale <= 3):
            raise UserError(f"--thrust-scale must be above 0 and at most 3, not {scale:g}")
    if effects and tuple(thrust_scale) != (1.0,):
        raise UserError("give either --effects or --thrust-scale: an effect of the library scales the thrust")
    if seed < 0:
        raise UserError(f"--seed must not be negative, it is {seed}")
    if out is not None:
        runs.check_new_run(out)
    flown = load_vehicle(vehicle) if vehicle is not None else None
    angle = None if inclination is None else math.radians(inclination)
    if angle is not None:
        (flown or load_vehicle()).check_inclination(angle)
    loaded = load_policy(policy, task, vehicle=flown, inclination=angle)
    if effects:
        from inclined_landing.eval.policies import success_effects

        report, flights = success_effects.evaluate(loaded, plant=plant, seed=seed, progress=True), None
    else:
        report, flights = _evaluate(loaded, plant, thrust_scale, seed, progress=True)
    report["vehicle"] = str(vehicle) if vehicle is not None else "crazyflie.toml"
    if out is not None:
        folder = runs.new_run(out)
        if flights is not None:
            storage.write_text(folder / "flights.csv", _flights_csv(flights))
        storage.write_json(folder / "success.json", report)
    if json:
        print(storage.to_json(report))
    else:
        from inclined_landing.eval.policies import success_table

        (success_table.show_effects if effects else success_table.show)(report)


def _evaluate(policy: Policy, plant: str, thrust_scales: Iterable[float], seed: int, progress=False):
    task, judge = policy.task, judge_of(policy.task)
    if progress:
        from rich.console import Console
        from rich.progress import track

        thrust_scales = track(list(thrust_scales), "flying", console=Console(stderr=True), transient=True)
    groups = judge.groups(task, seed)
    names = np.repeat(list(groups), [len(states) for states in groups.values()])
    starts = np.concatenate(list(groups.values()))
    conditions, rows = [], []
    for scale in thrust_scales:
        fleet = make_plant(plant, len(starts), task.vehicle)
        if scale != 1.0:
            fleet.perturb(thrust_scale=scale)
        try:
            flights = record_flights(policy, fleet, starts, steps=task.judged_steps)
        except FloatingPointError as error:
            raise UserError(f"thrust scale {scale:g}: {error}") from error
        flown = {name: [f for f, group in zip(flights, names) if group == name] for name in groups}
        conditions.append({"thrust_scale": float(scale), **judge.condition(task, flown, scale)})
        rows += [(scale, name, flight) for name, flight in zip(names, flights)]
    report = {
        "command": "success",
        "policy": str(policy.path),
        "trained": policy.metadata,
        "task": task.name,
        "task_options": task.options,
        "plant": plant,
        "seed": int(seed),
        "paper": judge.paper,
        "conditions": conditions,
        "versions": runs.versions(),
    }
    return report, rows


def _flights_csv(flights) -> str:
    """One row per flight; times in s, positions in m."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow("thrust_scale starts x y z success touched time end_x end_y end_z".split())
    for scale, group, f in flights:
        row = [*f.state[0, :3], int(f.success), int(f.touched), f.duration, *f.state[-1, :3]]
        table.writerow([f"{scale:g}", group, *(f"{value:.6g}" for value in row)])
    return text.getvalue()
