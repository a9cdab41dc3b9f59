"""Landing policies over all slopes of their training: success by angle, and on single slopes.

A policy that observes the slope flies from the frozen set (`over_slopes`), which training never uses. In
space it flies from this set a second time, with random headings. Every policy also flies from the frozen
planar grid over single slopes: the steepest of its training, the paper's, or the one that it was trained for.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from inclined_landing.envs.policy import Policy
from inclined_landing.envs.shared.measures import STRICT, count_words
from inclined_landing.envs.tasks import Start, Task, frozen, hover_states, make_task
from inclined_landing.envs.tasks.slopes import Slopes, over_slopes
from inclined_landing.eval.study.engine import Case, Panel, Results, Study, View
from inclined_landing.eval.study.flights import fly, policy_facts, slope_words
from inclined_landing.models.attitude import YAW
from inclined_landing.models.base.errors import UserError

SAME, SINGLE = "the same slopes, any heading", " deg only"
_HEADINGS_SEED = 25_700_551


def study(policies: Mapping[str, Policy], *, plant: str, every: int = 1) -> Study:
    """Return the study of policies, given by their labels, each over its slopes.

    every: use every k-th start. Raises UserError for policies that do not land.
    """
    for policy in policies.values():
        if not policy.task.cut_at_success:
            raise UserError(f"policy {policy.path} is for the task {policy.task.name}, not for landing")
    measures = next(iter(policies.values())).task.measures
    return Study(
        name="slopes",
        title=f"Other slopes, {plant} plant",
        cases=[case for name, policy in policies.items() for case in _cases(name, policy, plant, every)],
        views=[
            View(("policy", "slopes"), measures, "slopes"),
            View(("policy", "inclination"), (STRICT,)),
            View(("policy", "azimuth"), (STRICT,)),
        ],
        panels=[
            Panel("All slopes of the training", STRICT, "inclination", "inclination [deg]"),
            Panel("All directions of these slopes", STRICT, "azimuth", "azimuth [deg]"),
            Panel("Single slopes, frozen grid", STRICT, "slopes", kept=_singles),
        ],
        remarks=_remarks,
        facts=policy_facts(policies),
    )


def _cases(name: str, policy: Policy, plant: str, every: int) -> Iterator[Case]:
    """Yield the flights over each kind of slopes, beginning with all slopes of the training."""
    task = policy.task
    if task.observes_slope:
        slopes = over_slopes(task, every=every)
        yield Case({"policy": name, "slopes": slope_words(task)}, partial(_fly_all, policy, slopes, plant))
    for slope in single_slopes(task):
        one = _on_one_slope(task, slope)
        grid = frozen.clear(one, frozen.grid())[::every]
        start = one.start(hover_states(grid, one.vehicle))
        labels = {"policy": name, "slopes": f"{math.degrees(one.inclination):.1f}{SINGLE}"}
        yield Case(labels, partial(fly, policy, start, plant))
    if task.observes_slope and not task.is_planar:
        start = _any_heading(slopes.start)
        yield Case({"policy": name, "slopes": SAME}, partial(fly, policy, start, plant))


def _fly_all(policy: Policy, slopes: Slopes, plant: str) -> pd.DataFrame:
    """Return the flights over all slopes, with the centres of their cells of the angles [deg]."""
    angles: dict[str, Any] = {}
    edges_of = {"inclination": slopes.inclinations, "azimuth": slopes.azimuths}
    for (name, edges), cell in zip(edges_of.items(), slopes.cell):
        if len(edges) > 2:
            angles[name] = np.degrees(0.5 * (edges[:-1] + edges[1:]))[cell]
    return fly(policy, slopes.start, plant).assign(**angles)


def _any_heading(start: Start) -> Start:
    """Return starts with random headings."""
    turned = dataclasses.replace(start, state=start.state.copy())
    turned.state[:, YAW] = np.random.default_rng(_HEADINGS_SEED).uniform(-math.pi, math.pi, len(start))
    return turned


def single_slopes(task: Task) -> list[float]:
    """Return the single inclinations [rad] that a policy is evaluated on."""
    if task.steepest is None:
        return [task.inclination]
    paper = task.vehicle.platform_inclination
    known = [-task.steepest, task.steepest] if task.is_planar else []
    return [*known, *([paper] if abs(paper) < task.steepest - 1e-6 else [])]


def _on_one_slope(task: Task, inclination: float) -> Task:
    """Return the task with one slope towards +x."""
    options = task.options | {"inclination": inclination, "azimuth": 0.0}
    if task.is_planar:
        del options["azimuth"]
    return make_task(task.name, task.vehicle, **options)


def _singles(results: Results) -> list[str]:
    return [name for name in results.labels("slopes") if name.endswith(SINGLE)]


def _remarks(results: Results) -> list[str]:
    """Return a sentence on each policy and all slopes of its training."""
    first = {policy: results.one(STRICT, policy=policy) for policy in results.labels("policy")}
    return [
        f"{policy} {STRICT.said} in {count_words(row)} on slopes of {row['slopes']}."
        for policy, row in first.items()
    ]
