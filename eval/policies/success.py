"""`landing-eval success`: how often, how fast and how hard a policy reaches its goal.

Landing: the deterministic policy flies from the paper's three starts, from ten scattered starts
around each, and from the frozen grid (`envs/starts.py`); one that observes the slope from the frozen set over
its slopes. *Success* is reaching the goal box
(0.10, 0.10, 1.5, 1.5, 0.025) within 300 control steps; *strict* success also means that no part
touched the platform before. The goal box is not yet a landing, so the velocity at its entry is
reported too, and what happens when the motors are cut there (`motors_cut.py`).

Set-point: the position error after 3 s from 200 random starts. Other tasks: success as they judge it,
reward and duration, from as many (`judges.py`).

With ``--effects`` the frozen grid (or the random starts) alone, once for every effect of the library
(`evaluate_effects`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Annotated, Any

import pandas as pd
import tyro

from inclined_landing.envs.policy import Policy
from inclined_landing.envs.shared import runs
from inclined_landing.eval.base.conditions import fly_all
from inclined_landing.eval.base.options import Flag, Flat, Flown, NewFolder, Seed
from inclined_landing.eval.base.policies import AnyPolicy
from inclined_landing.eval.policies import success_table
from inclined_landing.eval.policies.evaluators import evaluator_of, report_of
from inclined_landing.eval.policies.flying import FlownAt, fly, fly_scaled, groups_of
from inclined_landing.models.effects import LIBRARY, Effect
from inclined_landing.models.errors import UserError
from inclined_landing.models.vehicle import Vehicle

Scales = Annotated[
    tuple[tuple[float, ...], ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="X [X ...]")
]


def evaluate(
    policy: Policy,
    *,
    plant: str = "mujoco",
    thrust_scales: Sequence[float] = (1.0,),
    disturbance: bool = False,
    seed: int = 0,
) -> dict[str, Any]:
    """Return the success report of a policy as plain numbers; one entry of `conditions` per thrust scale.

    plant: "mujoco", "hybrid" or "analytic", always the plain one (no keep-out zone, RK4 at 4 ms).
    disturbance: fly in that of the task's vehicle, always the same. seed: of the random starts.
    """
    flown = fly_scaled(policy, plant, thrust_scales, disturbance=disturbance, seed=seed)
    return _report(policy, plant, seed, disturbance, flown)


def command(
    policy: AnyPolicy,
    /,
    *,
    flown: Flat[Flown] = Flown(),
    thrust_scale: Scales = (),
    effects: Flag = False,
    disturbance: Annotated[Flag, tyro.conf.arg(aliases=["--unrest"])] = False,
    seed: Seed = 0,
    json: Flag = False,
    out: NewFolder = None,
) -> None:
    """Success table of a policy: how often, how fast, how hard it reaches its goal.

    Args:
        policy: file, or the name of a shipped one.
        thrust_scale: total thrust times this, one row for each value (default: 1).
        effects: one row for every physical effect of the library at a plausible size, which the policy
            knows nothing of; from the frozen grid only (four minutes).
        disturbance: fly in the air disturbance of the vehicle file, as landing-eval gap writes it.
        seed: of the random starts.
        json: print JSON, and nothing else, on standard output.
        out: new folder for success.json and (without effects) flights.csv.
    """
    scales = tuple(itertools.chain(*thrust_scale)) or (1.0,)
    for scale in scales:
        if not (math.isfinite(scale) and 0 < scale <= 3):
            raise UserError(f"--thrust-scale must be above 0 and at most 3, not {scale:g}")
    if effects and scales != (1.0,):
        raise UserError("give either --effects or --thrust-scale: an effect of the library scales the thrust")
    if effects and disturbance:
        raise UserError("give either --effects or --disturbance: effects are flown in still air")
    if out is not None:
        runs.check_new_run(out)
    loaded = flown.load(policy)
    vehicle = loaded.task.vehicle
    if disturbance and not any((*vehicle.disturbance_acceleration, *vehicle.disturbance_angular)):
        raise UserError(
            "--disturbance needs a --vehicle whose table [disturbance] is not all 0; this one's air is still"
        )
    files = {}
    if effects:
        report = evaluate_effects(loaded, plant=flown.plant, seed=seed)
    else:
        found = fly_scaled(loaded, flown.plant, scales, disturbance=disturbance, seed=seed)
        files["flights.csv"] = _flights_csv(found)
        report = _report(loaded, flown.plant, seed, disturbance, found)
    report["vehicle"] = str(flown.vehicle) if flown.vehicle is not None else "crazyflie.toml"
    runs.hand_over(report, success_table.show, json, out, files)


def _report(
    policy: Policy, plant: str, seed: int, disturbance: bool, flown: Sequence[FlownAt]
) -> dict[str, Any]:
    """Return the report on flights."""
    task, evaluator = policy.task, evaluator_of(policy.task)
    conditions = [
        {"thrust_scale": one.thrust_scale, **evaluator.condition(task, one.flights, one.cut)} for one in flown
    ]
    report = report_of("success", policy, plant, seed) | {"paper": evaluator.paper, "conditions": conditions}
    return report | ({"disturbance": True} if disturbance else {})


def evaluate_effects(policy: Policy, *, plant: str = "mujoco", seed: int = 0) -> dict[str, Any]:
    """Return the report as plain numbers; one entry of `effects` per effect, the first without any.

    Only the vehicle in the plant has the effect, at its plausible size: the policy, its task and its goal
    know nothing of it. Landing policies fly from the frozen grid, and where they arrive their motors are cut;
    others fly from random starts. plant: "mujoco", "hybrid" or "analytic". seed: of the random starts.
    """
    task, evaluator = policy.task, evaluator_of(policy.task)
    starts = groups_of(task, seed)[evaluator.frozen]

    def count(vehicle: Vehicle) -> dict[str, Any]:
        return evaluator.effect(task, *fly(policy, plant, vehicle, starts))

    vehicles = {"none": task.vehicle}
    vehicles |= {name: effect.apply(task.vehicle, effect.plausible) for name, effect in LIBRARY.items()}
    found = fly_all({(f"effect {name}",): partial(count, vehicle) for name, vehicle in vehicles.items()})
    rows = [
        {
            "effect": name,
            "parameters": sizes(LIBRARY[name], LIBRARY[name].plausible) if name in LIBRARY else {},
            **found[f"effect {name}",],
        }
        for name in vehicles
    ]
    return report_of("success --effects", policy, plant, seed) | {"effects": rows}


def sizes(effect: Effect, values: Mapping[str, float]) -> dict[str, dict[str, Any]]:
    """Return values of an effect's parameters with their units, for a report."""
    units = {p.name: p.unit for p in effect.parameters}
    return {name: {"value": value, "unit": units[name]} for name, value in values.items()}


def _flights_csv(flown: Sequence[FlownAt]) -> str:
    """Return one row per flight; times in s, positions in m."""
    columns = "thrust_scale starts x y z success touched time end_x end_y end_z".split()
    rows = [
        (
            at.thrust_scale,
            group,
            *f.state[0, :3],
            int(f.success),
            int(f.touched),
            f.duration,
            *f.state[-1, :3],
        )
        for at in flown
        for group, flights in at.flights.items()
        for f in flights
    ]
    return pd.DataFrame(rows, columns=columns).to_csv(index=False, float_format="%.6g")
