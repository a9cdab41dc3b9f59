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

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Annotated, Any

import numpy as np
import pandas as pd
import tyro

from inclined_landing.envs.flights import Flight, record_flights
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.shared import runs
from inclined_landing.envs.tasks import Start
from inclined_landing.envs.tasks.base import joined
from inclined_landing.eval.base.conditions import fly_all
from inclined_landing.eval.base.options import Flag, Flat, Flown, NewFolder, Seed
from inclined_landing.eval.base.policies import AnyPolicy
from inclined_landing.eval.policies import success_table
from inclined_landing.eval.policies.evaluators import evaluator_of, report_of
from inclined_landing.models.attitude import LAG
from inclined_landing.models.effects import LIBRARY, Effect
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import Vehicle
from inclined_landing.models.plants import make_plant

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
    return _evaluate(policy, plant, thrust_scales, disturbance, seed)[0]


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
        disturbance: with the disturbance of the air that the vehicle file has, as landing-eval gap writes it.
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
    report: dict[str, Any]
    flights: list[tuple[float, str, Flight]] | None = None
    if effects:
        report = evaluate_effects(loaded, plant=flown.plant, seed=seed)
    else:
        report, flights = _evaluate(loaded, flown.plant, scales, disturbance, seed)
    report["vehicle"] = str(flown.vehicle) if flown.vehicle is not None else "crazyflie.toml"
    files = None if flights is None else {"flights.csv": _flights_csv(flights)}
    runs.hand_over(report, success_table.show, json, out, files)


def _evaluate(
    policy: Policy, plant: str, thrust_scales: Sequence[float], disturbance: bool, seed: int
) -> tuple[dict[str, Any], list[tuple[float, str, Flight]]]:
    """Return the report, and every flight with its thrust scale and group of starts."""
    task, evaluator = policy.task, evaluator_of(policy.task)
    groups = evaluator.groups(task, seed)
    names = np.repeat(list(groups), [len(starts) for starts in groups.values()]).tolist()
    starts = joined(list(groups.values()))

    def fly_scaled(scale: float) -> list[Flight]:
        fleet = make_plant(plant, len(starts), task.vehicle, disturbance=0 if disturbance else None)
        if scale != 1.0:
            fleet.perturb(thrust_scale=scale)
        return record_flights(policy, fleet, starts, steps=task.judged_steps)

    conditions, rows = [], []
    found = fly_all({(f"thrust scale {scale}",): partial(fly_scaled, scale) for scale in thrust_scales})
    for scale in thrust_scales:
        flights = found[f"thrust scale {scale}",]
        flown = {name: [f for f, group in zip(flights, names) if group == name] for name in groups}
        conditions.append({"thrust_scale": float(scale), **evaluator.condition(task, flown, scale)})
        rows += [(scale, name, flight) for name, flight in zip(names, flights)]
    report = report_of("success", policy, plant, seed) | {"paper": evaluator.paper, "conditions": conditions}
    return report | ({"disturbance": True} if disturbance else {}), rows


def evaluate_effects(policy: Policy, *, plant: str = "mujoco", seed: int = 0) -> dict[str, Any]:
    """Return the report as plain numbers; one entry of `effects` per effect, the first without any.

    Only the vehicle in the plant has the effect, at its plausible size: the policy, its task and its goal
    know nothing of it. Landing policies fly from the frozen grid, and where they arrive their motors are cut;
    others fly from random starts. plant: "mujoco", "hybrid" or "analytic". seed: of the random starts.
    """
    task, evaluator = policy.task, evaluator_of(policy.task)
    starts = evaluator.groups(task, seed)[evaluator.frozen]

    def count(vehicle: Vehicle) -> dict[str, Any]:
        return evaluator.effect(task, fly(policy, plant, vehicle, starts), vehicle)

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


def fly(policy: Policy, plant: str, vehicle: Vehicle, starts: Start) -> list[Flight]:
    """Return flights of `vehicle`, of which the policy knows nothing, from `starts` of its own vehicle."""
    task, starts = policy.task, dataclasses.replace(starts, state=starts.state.copy())
    starts.state[:, LAG] *= task.vehicle.thrust_lag_rate / vehicle.thrust_lag_rate  # the same load
    tilt = vehicle.platform_inclination - task.vehicle.platform_inclination
    fleet = make_plant(plant, len(starts), vehicle)
    return record_flights(policy, _Tilted(fleet, tilt) if tilt else fleet, starts, steps=task.judged_steps)


class _Tilted:
    """A plant whose platforms are inclined by `tilt` [rad] more than the task sets them."""

    def __init__(self, plant: Any, tilt: float):
        self._plant, self._tilt = plant, tilt

    def __getattr__(self, name: str) -> Any:
        return getattr(self._plant, name)

    def set_platform(self, ids, inclination, present=True, azimuth=0.0) -> None:
        """Set the platforms as the plant does, inclined by more."""
        self._plant.set_platform(ids, np.asarray(inclination) + self._tilt, present, azimuth)


def _flights_csv(flights: Sequence[tuple[float, str, Flight]]) -> str:
    """Return one row per flight; times in s, positions in m."""
    columns = "thrust_scale starts x y z success touched time end_x end_y end_z".split()
    rows = [
        (scale, group, *f.state[0, :3], int(f.success), int(f.touched), f.duration, *f.state[-1, :3])
        for scale, group, f in flights
    ]
    return pd.DataFrame(rows, columns=columns).to_csv(index=False, float_format="%.6g")
