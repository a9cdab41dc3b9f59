"""Landing policies over all slopes they know: shares of the flights by angle, and on single slopes.

A policy that observes the slope flies from the frozen set (`envs.starts.over_slopes`), which training never
sees; in space once more with random headings. Every policy also flies from the frozen grid of the plane over
single slopes: the steepest that it knows, the paper's, or the one that it was trained for.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from inclined_landing.envs import starts as landing_starts
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.statistics import proportion
from inclined_landing.envs.shared.tables import count_words
from inclined_landing.envs.tasks import Start, Task, make_task
from inclined_landing.eval.policies.flying import fly, outcome
from inclined_landing.eval.policies.study import Study, fly_all, joined
from inclined_landing.eval.policies.tables import STRICT, Panel, Row, slope_words
from inclined_landing.models.attitude import YAW
from inclined_landing.models.errors import UserError

ALL, ANY_HEADING = "all slopes", "all slopes, any heading"
_HEADINGS_SEED = 25_700_551


def run(policies: Mapping[str, Policy], *, plant: str, every: int = 1) -> Study:
    """Return the study of policies, given by their labels, over the slopes of each.

    every: fly from each k-th start only. Raises UserError for policies that do not land.
    """
    work: dict[tuple[str, str], Callable[[], pd.DataFrame]] = {}
    for name, policy in policies.items():
        if not policy.task.cut_at_success:
            raise UserError(f"policy {policy.path} is for the task {policy.task.name}, not for landing")
        for where, start in _starts(policy.task, every).items():
            work[name, where] = partial(fly, policy, start, plant, cut_from=None)
    flown = fly_all(work)
    report = {
        "command": "slopes",
        "plant": plant,
        "policies": [_entry(name, policy, flown, every) for name, policy in policies.items()],
        "versions": runs.versions(),
    }
    rows, remarks = _rows(report)
    return Study(
        name="slopes",
        title=f"Over slopes, {plant} plant",
        report=report,
        flights=joined(flown),
        heads=("policy", "slopes"),
        rows=rows,
        panels=_panels(report),
        remarks=remarks,
    )


def _starts(task: Task, every: int) -> dict[str, Start]:
    """Return the starts over each kind of slopes."""
    starts = {}
    for slope in single_slopes(task):
        one = _on_one_slope(task, slope)
        grid = landing_starts.clear(one, landing_starts.grid())[::every]
        starts[_alone(slope)] = one.start(landing_starts.at_rest(one, grid))
    if task.observes_slope:
        frozen = landing_starts.over_slopes(task, every=every).start
        starts[ALL] = frozen
        if not task.is_planar:
            starts[ANY_HEADING] = dataclasses.replace(frozen, state=frozen.state.copy())
            draw = np.random.default_rng(_HEADINGS_SEED)
            starts[ANY_HEADING].state[:, YAW] = draw.uniform(-math.pi, math.pi, len(frozen))
    return starts


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


def _entry(
    name: str, policy: Policy, flown: Mapping[tuple[str, str], pd.DataFrame], every: int
) -> dict[str, Any]:
    """Return what is counted of one policy's flights."""
    task = policy.task
    found = {where: outcome(task, flights) for (of, where), flights in flown.items() if of == name}
    entry = {
        "name": name,
        "policy": str(policy.path),
        "trained": policy.metadata,
        "task_options": task.options,
        "single": [
            {"inclination": _on_one_slope(task, slope).inclination} | found[_alone(slope)]
            for slope in single_slopes(task)
        ],
    }
    if ALL in found:
        frozen = landing_starts.over_slopes(task, every=every)
        strict, (row, column) = flown[name, ALL]["strict"].to_numpy(), frozen.cell
        entry |= {
            "all": found[ALL],
            "curve": _curve(frozen.inclinations, row, strict),
            "azimuth_curve": _curve(frozen.azimuths, column, strict),
        }
    return entry | ({"any_heading": found[ANY_HEADING]} if ANY_HEADING in found else {})


def _curve(edges: np.ndarray, part: np.ndarray, strict: np.ndarray) -> list[dict[str, Any]]:
    """Return the shares of the flights in each part between `edges` [rad]."""
    return [
        {"from": float(low), "to": float(high), "strict": proportion(of.sum(), len(of))}
        for low, high, of in zip(edges, edges[1:], (strict[part == k] for k in range(len(edges) - 1)))
    ]


def _rows(report: dict[str, Any]) -> tuple[list[Row], list[str]]:
    """Return a row for each policy and kind of slopes, and a sentence of each policy."""
    rows: list[Row] = []
    remarks = [STRICT]
    for entry in report["policies"]:
        name, slopes = entry["name"], slope_words(entry["task_options"])
        if "all" in entry:
            rows.append(((name, slopes), entry["all"]))
        rows += [((name, _alone(row["inclination"])), row) for row in entry["single"]]
        if "any_heading" in entry:
            rows.append(((name, "the same slopes, any heading"), entry["any_heading"]))
        landed = entry.get("all", entry["single"][0])["strict"]
        where = f"on slopes {slopes}" if "all" in entry else f"on a slope of {slopes}"
        remarks.append(f"{name} landed in {count_words(landed)} {where}.")
    return rows, remarks


def _panels(report: dict[str, Any]) -> list[Panel]:
    """Return strict success over the inclination, of policies in space over the azimuth, on single slopes."""
    entries = report["policies"]
    single = {e["name"]: {_alone(row["inclination"]): row["strict"] for row in e["single"]} for e in entries}
    over = {
        key: {
            e["name"]: {
                math.degrees(0.5 * (part["from"] + part["to"])): part["strict"] for part in e.get(key, ())
            }
            for e in entries
            if key == "curve" or len(e.get(key, ())) > 1
        }
        for key in ("curve", "azimuth_curve")
    }
    panels = [
        Panel("All slopes of the training", over["curve"], "inclination [deg]"),
        Panel("All directions of these slopes", over["azimuth_curve"], "azimuth [deg]"),
        Panel("Single slopes, frozen grid", single),
    ]
    return [panel for panel in panels if any(panel.shares.values())]


def _alone(inclination: float) -> str:
    return f"{math.degrees(inclination):.1f} deg only"
