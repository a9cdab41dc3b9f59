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
(`success_effects.py`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np
import pandas as pd
import tyro
from rich.console import Console
from rich.progress import track

from inclined_landing.envs.flights import record_flights
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.tasks.base import joined
from inclined_landing.eval.base import runs
from inclined_landing.eval.base.options import Flag, Flat, Flown, NewFolder, Seed
from inclined_landing.eval.base.policies import AnyPolicy
from inclined_landing.eval.policies import success_table
from inclined_landing.eval.policies.judges import judge_of, report_of
from inclined_landing.models.errors import UserError
from inclined_landing.models.plants import make_plant

Scales = Annotated[
    tuple[tuple[float, ...], ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="X [X ...]")
]


def evaluate(
    policy: Policy,
    *,
    plant: str = "mujoco",
    thrust_scales: Sequence[float] = (1.0,),
    unrest: bool = False,
    seed: int = 0,
) -> dict:
    """The success report of a policy, as plain numbers; one entry of `conditions` per thrust scale.

    plant: "mujoco", "hybrid" or "analytic", always the plain one (no keep-out zone, RK4 at 4 ms).
    unrest: fly in that of the task's vehicle, always the same. seed: of the random starts.
    """
    return _evaluate(policy, plant, thrust_scales, unrest, seed)[0]


def command(
    policy: AnyPolicy,
    /,
    flown: Flat[Flown] = Flown(),
    thrust_scale: Scales = (),
    effects: Flag = False,
    unrest: Flag = False,
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
        unrest: with the unrest of the air that the vehicle file has, as landing-eval gap writes it.
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
    if effects and unrest:
        raise UserError("give either --effects or --unrest: effects are flown in still air")
    if out is not None:
        runs.check_new_run(out)
    loaded = flown.load(policy)
    vehicle = loaded.task.vehicle
    if unrest and not any((*vehicle.unrest_acceleration, *vehicle.unrest_angular)):
        raise UserError(
            "--unrest needs a --vehicle whose table [unrest] is not all 0; this one's air is still"
        )
    if effects:
        from inclined_landing.eval.policies import success_effects

        report, flights = success_effects.evaluate(loaded, plant=flown.plant, seed=seed), None
    else:
        report, flights = _evaluate(loaded, flown.plant, scales, unrest, seed)
    report["vehicle"] = str(flown.vehicle) if flown.vehicle is not None else "crazyflie.toml"
    files = None if flights is None else {"flights.csv": _flights_csv(flights)}
    runs.hand_over(report, success_table.show, json, out, files)


def _evaluate(policy: Policy, plant: str, thrust_scales: Sequence[float], unrest: bool, seed: int):
    task, judge = policy.task, judge_of(policy.task)
    groups = judge.groups(task, seed)
    names = np.repeat(list(groups), [len(starts) for starts in groups.values()])
    starts = joined(list(groups.values()))
    conditions, rows = [], []
    for scale in track(thrust_scales, "flying", console=Console(stderr=True), transient=True):
        fleet = make_plant(plant, len(starts), task.vehicle, unrest=0 if unrest else None)
        if scale != 1.0:
            fleet.perturb(thrust_scale=scale)
        try:
            flights = record_flights(policy, fleet, starts, steps=task.judged_steps)
        except FloatingPointError as error:
            raise UserError(f"thrust scale {scale:g}: {error}") from error
        flown = {name: [f for f, group in zip(flights, names) if group == name] for name in groups}
        conditions.append({"thrust_scale": float(scale), **judge.condition(task, flown, scale)})
        rows += [(scale, name, flight) for name, flight in zip(names, flights)]
    report = report_of("success", policy, plant, seed) | {"paper": judge.paper, "conditions": conditions}
    return report | ({"unrest": True} if unrest else {}), rows


def _flights_csv(flights) -> str:
    """One row per flight; times in s, positions in m."""
    columns = "thrust_scale starts x y z success touched time end_x end_y end_z".split()
    rows = [
        (scale, group, *f.state[0, :3], int(f.success), int(f.touched), f.duration, *f.state[-1, :3])
        for scale, group, f in flights
    ]
    return pd.DataFrame(rows, columns=columns).to_csv(index=False, float_format="%.6g")
