"""Share, time and speed with which policies reach their goals, for each group of starts.

Each policy flies from the groups of starts of its task (`Task.evaluation_groups`): landings from the paper's
three starts, scattered ones and the frozen grid, or from the frozen set over slopes; other tasks from random
starts. `Task.measures` defines the measures. The goal box of a landing is not yet a landing, so the velocity
at its entry is reported too, and what happens when the motors are cut there (`rest.py`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import numpy as np
import pandas as pd

from inclined_landing.envs.policy import Policy
from inclined_landing.envs.shared.measures import Measure, count_words
from inclined_landing.envs.tasks.landing import PAPER_SHARES
from inclined_landing.envs.tasks.start import joined
from inclined_landing.eval.study.engine import Case, Panel, Results, Study, View
from inclined_landing.eval.study.flights import ARRIVAL, SharedFlights, fly_each, policy_facts, slope_words
from inclined_landing.models.base.errors import UserError


def by_measures(policies: Mapping[str, Policy]) -> list[dict[str, Policy]]:
    """Return the policies with the same measures together, because they share a table."""
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
    seed: int = 0,
) -> Study:
    """Return the study of policies with the same measures from all groups of starts.

    plant: "mujoco", "hybrid" or "analytic", always the plain one (no keep-out zone, RK4 at 4 ms). seed: for
    the random starts.
    """
    task = next(iter(policies.values())).task
    by = ("policy", "starts", *["slope"] * task.has_platform, "thrust_scale")
    views = [View(by, task.measures, "success")]
    if task.cut_at_success:
        at_entry = "At entry into the goal box, and after cutting the motors there (frozen starts)"
        views.append(View(("policy", "thrust_scale"), ARRIVAL, at_entry, across=True))
    # All scales of a policy are simulated together.
    flights = {name: SharedFlights(_fly(p, plant, thrust_scales, seed)) for name, p in policies.items()}
    return Study(
        name=f"success_{task.name}",
        title=f"{task.name}, {plant} plant, starts drawn with seed {seed}",
        cases=[
            Case({"policy": name, "thrust_scale": float(scale)}, partial(shared.table, k))
            for name, shared in flights.items()
            for k, scale in enumerate(thrust_scales)
        ],
        views=views,
        panels=[Panel("Success", task.measures[0], "starts")],
        remarks=partial(_remarks, policies),
        facts=policy_facts(policies),
        heads={"thrust_scale": "thrust x"},
        hidden=frozenset(["thrust_scale"] if len(thrust_scales) == 1 else []),
    )


def _fly(policy: Policy, plant: str, scales: Sequence[float], seed: int) -> Iterator[pd.DataFrame]:
    """Yield the flights from all groups of starts for each scale; motors are cut in the frozen set."""
    groups = policy.task.evaluation_groups(seed)
    counts = [len(group) for group in groups.values()]
    starts, cut_from = joined(list(groups.values())), sum(counts[:-1])  # the last group is the frozen set
    variants = [(policy.task.vehicle, scale) for scale in scales]
    for flights in fly_each(policy, starts, plant, variants, cut_from=cut_from):
        yield flights.assign(starts=np.repeat(list(groups), counts), slope=slope_words(policy.task))


def _remarks(policies: Mapping[str, Policy], results: Results) -> list[str]:
    """Return a sentence on each policy, and the paper's result for comparison with landings."""
    remarks = []
    for name, policy in policies.items():
        measure = policy.task.measures[0]
        rows = results.all(measure, policy=name)
        # Of the last group of starts: for landings, the frozen ones.
        rows = [row for row in rows if row["starts"] == rows[-1]["starts"]]
        parts = [
            f"{'' if row['thrust_scale'] == 1.0 else 'at thrust x {:g} it '.format(row['thrust_scale'])}"
            f"{measure.said} in {count_words(row)}"
            for row in rows
        ]
        hint = "" if any(row["count"] for row in rows) else _sign_hint(policy)
        remarks.append(f"{name} {'; '.join(parts)}.{hint}")
    if any(policy.task.cut_at_success and not policy.task.observes_slope for policy in policies.values()):
        shares = " and ".join(f"{100 * share:.1f} %" for share in PAPER_SHARES)
        remarks.append(f"The paper reports {shares} from its three starts and within 0.1 m around them.")
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
