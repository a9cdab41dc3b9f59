"""Landing policies over all slopes they know: shares of the flights by angle, and on single slopes.

A policy that observes the slope flies from the frozen set (`envs.starts.over_slopes`), which training never
sees; in space once more with random headings. Every policy also flies from the frozen grid of the plane over
single slopes: the steepest that it knows, the paper's, or the one that it was trained for.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from inclined_landing.envs import starts as landing_starts
from inclined_landing.envs.flights import Flight, record_flights
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.statistics import proportion
from inclined_landing.envs.shared.tables import count_words, share_cell, spread_cell
from inclined_landing.envs.tasks import Start, Task, make_task
from inclined_landing.eval.base.claims import Section, Table
from inclined_landing.eval.base.conditions import fly_all
from inclined_landing.eval.policies.evaluators import outcome
from inclined_landing.eval.policies.success_table import slope_words
from inclined_landing.models.attitude import YAW
from inclined_landing.models.errors import UserError
from inclined_landing.models.plants import make_plant

HEADS = ("policy", "slopes", "flights", "strict [%]", "success [%]", "touched", "time [s]")
CAPTION = "strict: the goal box within 300 steps and no touch before; 95 % Wilson intervals"
_HEADINGS_SEED = 25_700_551


def evaluate(policies: Mapping[str, Policy], *, plant: str = "mujoco", every: int = 1) -> dict[str, Any]:
    """Return the report as plain numbers: `policies`, one entry for each of those given by their labels.

    every: fly from each k-th start only. Raises UserError for policies that do not land.
    """
    for policy in policies.values():
        if not policy.task.cut_at_success:
            raise UserError(f"policy {policy.path} is for the task {policy.task.name}, not for landing")
    entries = fly_all({(name,): partial(_entry, name, p, plant, every) for name, p in policies.items()})
    return {
        "command": "slopes",
        "plant": plant,
        "policies": list(entries.values()),
        "versions": runs.versions(),
    }


def _entry(name: str, policy: Policy, plant: str, every: int) -> dict[str, Any]:
    task = policy.task
    entry = {
        "name": name,
        "policy": str(policy.path),
        "trained": policy.metadata,
        "task_options": task.options,
        "single": [_single(policy, angle, plant, every) for angle in single_slopes(task)],
    }
    if not task.observes_slope:
        return entry
    frozen = landing_starts.over_slopes(task, every=every)
    flights = _fly(policy, plant, frozen.start)
    entry |= {
        "all": outcome(flights),
        "inclinations": frozen.inclinations.tolist(),
        "azimuths": frozen.azimuths.tolist(),
        "cells": _cells(flights, frozen),
        "curve": _curve(flights, frozen),
    }
    if not task.is_planar:
        turned = dataclasses.replace(frozen.start, state=frozen.start.state.copy())
        draw = np.random.default_rng(_HEADINGS_SEED)
        turned.state[:, YAW] = draw.uniform(-math.pi, math.pi, len(turned))
        entry["any_heading"] = outcome(_fly(policy, plant, turned))
    return entry


def single_slopes(task: Task) -> list[float]:
    """Return the single inclinations [rad] that a policy is evaluated on."""
    if task.steepest is None:
        return [task.inclination]
    paper = task.vehicle.platform_inclination
    known = [-task.steepest, task.steepest] if task.is_planar else []
    return [*known, *([paper] if abs(paper) < task.steepest - 1e-6 else [])]


def _single(policy: Policy, inclination: float, plant: str, every: int) -> dict:
    """Return the outcome on one slope towards +x, from the starts of the frozen grid clear of it."""
    options = policy.task.options | {"inclination": inclination, "azimuth": 0.0}
    if policy.task.is_planar:
        del options["azimuth"]
    task = make_task(policy.task.name, policy.task.vehicle, **options)
    grid = landing_starts.clear(task, landing_starts.grid())[::every]
    start = task.start(landing_starts.at_rest(task, grid))
    return {"inclination": task.inclination} | outcome(_fly(policy, plant, start))


def _fly(policy: Policy, plant: str, start: Start) -> list[Flight]:
    return record_flights(policy, make_plant(plant, len(start), policy.task.vehicle), start)


def _strict(flights: Sequence[Flight], frozen: landing_starts.Slopes) -> list[list[list[bool]]]:
    """Return whether each flight is a strict success, by cell of the inclination and of the azimuth."""
    a, b = len(frozen.inclinations) - 1, len(frozen.azimuths) - 1
    found: list[list[list[bool]]] = [[[] for _ in range(b)] for _ in range(a)]
    for flight, i, j in zip(flights, *frozen.cell):
        found[i][j].append(flight.strict)
    return found


def _cells(flights: Sequence[Flight], frozen: landing_starts.Slopes) -> list[list[dict]]:
    """Return the strict success of every cell; rows are inclinations, columns azimuths."""
    return [[proportion(sum(c), len(c)) for c in row] for row in _strict(flights, frozen)]


def _curve(flights: Sequence[Flight], frozen: landing_starts.Slopes) -> list[dict]:
    """Return the strict success over the inclination: `from` and `to` [rad] of the cells."""
    rows = [[x for cell in row for x in cell] for row in _strict(flights, frozen)]
    edges = frozen.inclinations
    return [
        {"from": float(low), "to": float(high), "strict": proportion(sum(row), len(row))}
        for low, high, row in zip(edges, edges[1:], rows)
    ]


def cells(report: dict[str, Any]) -> list[tuple[str, ...]]:
    """Return one row, under HEADS, for each policy and kind of slopes."""
    found: list[tuple[str, ...]] = []
    for entry in report["policies"]:
        rows = {f"{math.degrees(row['inclination']):.1f} deg alone": row for row in entry["single"]}
        if "all" in entry:
            rows = {slope_words(entry["task_options"]): entry["all"]} | rows
        if "any_heading" in entry:
            rows["the same, any heading"] = entry["any_heading"]
        for k, (kind, row) in enumerate(rows.items()):
            shares = share_cell(row["strict"]), share_cell(row["success"]), str(row["touched"]["count"])
            name = entry["name"] if k == 0 else ""
            found.append((name, kind, str(row["strict"]["of"]), *shares, spread_cell(row["time_to_goal"])))
    return found


def answers(report: dict[str, Any]) -> list[str]:
    """Return a sentence on the landings of each policy, over all its slopes or on the one that it knows."""
    found = []
    for entry in report["policies"]:
        landed, slope = entry.get("all", entry["single"][0]), slope_words(entry["task_options"])
        where = f"on slopes {slope}" if "all" in entry else f"on the slope of {slope}"
        found.append(f"{entry['name']} landed in {count_words(landed['strict'])} {where}.")
    return found


def sections(report: dict[str, Any]) -> list[Section]:
    """Return the section of the page."""
    figure = {
        "slopes": "Strict success over the inclination with 95 % intervals; in space over all directions."
    }
    table = Table("", HEADS, cells(report))
    title, said = f"Over slopes, {report['plant']} plant", [CAPTION, *answers(report)]
    return [Section("slopes", title, [], [], [table], figure, said)]
