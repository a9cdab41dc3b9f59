"""`landing-eval success`: how often, how fast and how hard policies reach their goals.

Each policy flies from the groups of starts of its task (`Task.evaluation_groups`): a landing from the paper's
three, scattered ones and the frozen grid, or from the frozen set over its slopes; others from random starts.
`Task.measures` says what is counted. The goal box of a landing is not yet a landing, so the velocity at its
entry is reported too, and what happens when the motors are cut there (`rest.py`).

With ``--effects`` the last group alone, once for every effect of the library (`changes`).
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import tyro
from msgspec import Meta

from inclined_landing.envs.policy import SHIPPED, Policy
from inclined_landing.envs.shared.measures import Measure, count_words
from inclined_landing.envs.tasks.landing import PAPER_RESULTS
from inclined_landing.envs.tasks.start import joined
from inclined_landing.eval.base.options import MOST_COMPARED, Flag, Flat, Flown, NewFolder, Seed, only_without
from inclined_landing.eval.study import changes
from inclined_landing.eval.study.engine import Case, Panel, Results, Study, View, fact, run
from inclined_landing.eval.study.flights import ARRIVAL, fly, named_policies, policy_facts, slope_words
from inclined_landing.eval.study.show import hand_over
from inclined_landing.models.errors import UserError

Policies = Annotated[
    tuple[str, ...],
    tyro.conf.Positional,
    tyro.conf.arg(
        metavar="POLICY [...]",
        help=f"policy files, run folders or shipped policies ({', '.join(SHIPPED)}), each flown on its task. "
        "LABEL=POLICY gives a name, LABEL@VEHICLE=POLICY a name and a vehicle.",
    ),
    Meta(max_length=MOST_COMPARED),
]
Scales = Annotated[
    tuple[tuple[changes.ThrustScale, ...], ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="X [X ...]")
]


def command(
    policies: Policies,
    /,
    *,
    flown: Flat[Flown] = Flown(),
    thrust_scale: Annotated[Scales, only_without("effects")] = (),
    effects: Flag = False,
    disturbance: Annotated[Flag, only_without("effects")] = False,
    seed: Seed = 0,
    json: Flag = False,
    out: NewFolder = None,
) -> None:
    """Compare policies: how often, how fast and how hard they reach their goals.

    Args:
        policies: policy files.
        thrust_scale: factors on the total thrust, one row for each (default: 1).
        effects: one row for each physical effect of the library at a plausible size, which the policies were
            not trained with; flown from the frozen grid only (four minutes).
        disturbance: fly in the air disturbance of the vehicle file, as landing-eval gap writes it.
        seed: seed for the random starts.
        json: print only JSON on standard output.
        out: new folder for index.html, the numbers as JSON, flights.csv, and the figures.
    """
    if not policies:
        raise UserError("name at least one policy")
    scales = tuple(dict.fromkeys(itertools.chain(*thrust_scale))) or (1.0,)
    loaded, facts = {}, [fact("flights", "plant", flown.plant), fact("flights", "seed", seed)]
    for name, path in named_policies(policies).items():
        vehicle = "" if name == Path(path).stem else name.partition("@")[2]
        its = dataclasses.replace(flown, vehicle=Path(vehicle)) if vehicle else flown
        loaded[name] = its.load(path)
        facts.append(fact(name, "vehicle", str(its.vehicle or "crazyflie.toml")))
    for policy in loaded.values():
        air = policy.task.vehicle
        if disturbance and not any((*air.disturbance_acceleration, *air.disturbance_angular)):
            raise UserError("--disturbance needs a --vehicle whose table [disturbance] is not all zero")
    if effects:
        of_effects = changes.changes(thrusts=(), of_sizes=("medium",))
        found = [changes.study(kind, of_effects, plant=flown.plant, seed=seed) for kind in kinds(loaded)]
    else:
        options: dict[str, Any] = {"thrust_scales": scales, "disturbance": disturbance}
        found = [study(kind, plant=flown.plant, seed=seed, **options) for kind in kinds(loaded)]
    found[0] = dataclasses.replace(found[0], facts=[*facts, *found[0].facts])
    hand_over("success", run(found), json=json, out=out)


def kinds(policies: Mapping[str, Policy]) -> list[dict[str, Policy]]:
    """Return the policies in groups with the same measures, which share a table."""
    found: dict[tuple[Measure, ...], dict[str, Policy]] = {}
    for name, policy in policies.items():
        if policy.task.evaluated_by != "success":
            other = policy.task.evaluated_by
            raise UserError(f"the task {policy.task.name} is evaluated by landing-eval {other}")
        found.setdefault(policy.task.measures, {})[name] = policy
    return list(found.values())


def study(
    policies: Mapping[str, Policy],
    *,
    plant: str = "mujoco",
    thrust_scales: Sequence[float] = (1.0,),
    disturbance: bool = False,
    seed: int = 0,
) -> Study:
    """Return the study of policies of one kind from all groups of starts.

    plant: "mujoco", "hybrid" or "analytic", always the plain one (no keep-out zone, RK4 at 4 ms).
    disturbance: fly in that of the task's vehicle, the same in every call. seed: for the random starts.
    """
    task = next(iter(policies.values())).task
    by = ("policy", "starts", *["slope"] * task.has_platform, "thrust_scale")
    views = [View(by, task.measures, "success")]
    if task.cut_at_success:
        at_entry = "At entry into the goal box, and after cutting the motors there (frozen starts)"
        views.append(View(("policy", "thrust_scale"), ARRIVAL, at_entry, across=True))
    return Study(
        name=f"success_{task.name}",
        title=f"{task.name}, {plant} plant, starts drawn with seed {seed}",
        cases=[
            Case(
                {"policy": name, "thrust_scale": float(scale)},
                partial(_fly, policy, plant, scale, disturbance, seed),
            )
            for name, policy in policies.items()
            for scale in thrust_scales
        ],
        views=views,
        panels=[Panel("Success", task.measures[0], "starts")],
        remarks=partial(_remarks, policies),
        facts=policy_facts(policies),
        heads={"thrust_scale": "thrust x"},
        hidden=frozenset(["thrust_scale"] if len(thrust_scales) == 1 else []),
    )


def _fly(policy: Policy, plant: str, scale: float, disturbance: bool, seed: int) -> pd.DataFrame:
    """Return the flights from all groups of starts; motors are cut on arrival in the last one."""
    groups = policy.task.evaluation_groups(seed)
    counts = [len(group) for group in groups.values()]
    starts, cut_from = joined(list(groups.values())), sum(counts[:-1])
    options: dict[str, Any] = {"thrust_scale": scale, "disturbance": disturbance}
    flights = fly(policy, starts, plant, cut_from=cut_from, **options)
    return flights.assign(starts=np.repeat(list(groups), counts), slope=slope_words(policy.task))


def _remarks(policies: Mapping[str, Policy], results: Results) -> list[str]:
    """Return the paper's result next to which landings stand, and a sentence on each policy."""
    remarks = []
    if any(policy.task.cut_at_success and not policy.task.observes_slope for policy in policies.values()):
        shares = " and ".join(f"{100 * result['share']:.1f} %" for result in PAPER_RESULTS)
        remarks.append(f"The paper reports {shares} from its three starts and within 0.1 m around them.")
    for name, policy in policies.items():
        measure = policy.task.measures[0]
        rows = results.all(measure, policy=name)
        rows = [row for row in rows if row["starts"] == rows[-1]["starts"]]
        parts = [
            f"{'' if row['thrust_scale'] == 1.0 else 'at thrust x {:g} it '.format(row['thrust_scale'])}"
            f"{measure.said} in {count_words(row)}"
            for row in rows
        ]
        hint = "" if any(row["count"] for row in rows) else _sign_hint(policy)
        remarks.append(f"{name} {'; '.join(parts)}.{hint}")
    return remarks


def _sign_hint(policy: Policy) -> str:
    """Return a sentence if a slope's sign is not that of the training, else ""."""
    trained = policy.metadata.get("task_options", {}).get("inclination")
    flown = policy.task.options.get("inclination")
    if not (trained and flown and trained * flown < 0):
        return ""
    trained, flown = math.degrees(trained), math.degrees(flown)
    return (
        f" It was trained at {trained:.1f} deg, and {flown:g} deg slopes the other way: "
        f"try --inclination {-flown:g}."
    )
