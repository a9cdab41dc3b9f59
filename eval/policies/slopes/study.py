"""Landing policies over slopes: shares of the flights by angle, and on single slopes beside them.

A policy that observes the slope flies from the frozen set (`envs.starts.over_slopes`); in space once more
with headings that are drawn. Every policy flies from the frozen grid of the plane too, over single slopes:
the steepest that it knows, the paper's, or the one that it was trained for.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from rich.console import Console
from rich.progress import track

from inclined_landing.envs import starts as landing_starts
from inclined_landing.envs.flights import Flight, record_flights
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.tasks import Start, Task, make_task
from inclined_landing.eval.base import runs
from inclined_landing.eval.base.statistics import proportion, spread
from inclined_landing.models.attitude import YAW
from inclined_landing.models.errors import UserError
from inclined_landing.models.plants import make_plant

_HEADINGS_SEED = 25_700_551


def evaluate(policies: Mapping[str, Policy], *, plant: str = "mujoco", every: int = 1) -> dict:
    """The report as plain numbers, an entry of `policies` for each of those that are given by their names.

    every: flies from each k-th start only. Raises UserError for policies that do not land.
    """
    for policy in policies.values():
        if not policy.task.cut_at_success:
            raise UserError(f"policy {policy.path} is for the task {policy.task.name}, not for landing")
    entries = [
        _entry(name, policy, plant, every)
        for name, policy in track(
            policies.items(), "flying", console=Console(stderr=True), transient=True, total=len(policies)
        )
    ]
    return {"command": "slopes", "plant": plant, "policies": entries, "versions": runs.versions()}


def _entry(name: str, policy: Policy, plant: str, every: int) -> dict:
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
        "all": summary(flights),
        "inclinations": frozen.inclinations.tolist(),
        "azimuths": frozen.azimuths.tolist(),
        "cells": _cells(flights, frozen),
        "curve": _curve(flights, frozen),
    }
    if not task.is_planar:
        turned = dataclasses.replace(frozen.start, state=frozen.start.state.copy())
        draw = np.random.default_rng(_HEADINGS_SEED)
        turned.state[:, YAW] = draw.uniform(-math.pi, math.pi, len(turned))
        entry["any_heading"] = summary(_fly(policy, plant, turned))
    return entry


def single_slopes(task: Task) -> list[float]:
    """Inclinations [rad] that a policy is judged on alone."""
    if task.steepest is None:
        return [task.inclination]
    paper = task.vehicle.platform_inclination
    known = [-task.steepest, task.steepest] if task.is_planar else []
    return [*known, *([paper] if abs(paper) < task.steepest - 1e-6 else [])]


def _single(policy: Policy, inclination: float, plant: str, every: int) -> dict:
    """One slope towards +x, from those of the frozen grid that are clear of it."""
    options = policy.task.options | {"inclination": inclination, "azimuth": 0.0}
    if policy.task.is_planar:
        del options["azimuth"]
    task = make_task(policy.task.name, policy.task.vehicle, **options)
    grid = landing_starts.clear(task, landing_starts.grid())[::every]
    start = task.start(landing_starts.at_rest(task, grid))
    return {"inclination": task.inclination} | summary(_fly(policy, plant, start))


def _fly(policy: Policy, plant: str, start: Start) -> list[Flight]:
    return record_flights(policy, make_plant(plant, len(start), policy.task.vehicle), start)


def summary(flights: Sequence[Flight]) -> dict:
    """Shares of flights: strict success, success, a touch before; time to the goal [s]."""
    n = len(flights)
    return {
        "strict": proportion(sum(f.strict for f in flights), n),
        "success": proportion(sum(f.success for f in flights), n),
        "touched": proportion(sum(f.touched for f in flights), n),
        "time_to_goal": spread([f.duration for f in flights if f.success]),
    }


def _strict(flights: Sequence[Flight], frozen: landing_starts.Slopes) -> list[list[list[bool]]]:
    """By cell of the inclination and of the azimuth, whether each flight is a strict success."""
    a, b = len(frozen.inclinations) - 1, len(frozen.azimuths) - 1
    found: list[list[list[bool]]] = [[[] for _ in range(b)] for _ in range(a)]
    for flight, i, j in zip(flights, *frozen.cell):
        found[i][j].append(flight.strict)
    return found


def _cells(flights: Sequence[Flight], frozen: landing_starts.Slopes) -> list[list[dict]]:
    """Strict success of every cell; rows are inclinations, columns azimuths."""
    return [[proportion(sum(c), len(c)) for c in row] for row in _strict(flights, frozen)]


def _curve(flights: Sequence[Flight], frozen: landing_starts.Slopes) -> list[dict]:
    """Strict success over the inclination: `from` and `to` [rad] of the cells."""
    rows = [[x for cell in row for x in cell] for row in _strict(flights, frozen)]
    edges = frozen.inclinations
    return [
        {"from": float(low), "to": float(high), "strict": proportion(sum(row), len(row))}
        for low, high, row in zip(edges, edges[1:], rows)
    ]
