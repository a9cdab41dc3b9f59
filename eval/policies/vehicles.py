"""Landing policies on named vehicles, and on vehicles drawn from a file of ranges.

Each vehicle flies with its own shapes, from those starts of the frozen grid that keep them 5 cm clear of the
platform; a drawn one from a few of these, which are the same for all policies. A policy that observes the
vehicle's parameters (`landing-train --observe-vehicle`) is given those of the vehicle it flies.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from inclined_landing.envs import starts as landing_starts
from inclined_landing.envs.flights import record_flights
from inclined_landing.envs.policy import Policy, load_policy
from inclined_landing.envs.randomise import read_ranges
from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.statistics import proportion
from inclined_landing.envs.tasks.landing import START_CLEARANCE
from inclined_landing.envs.vehicle_parameters import NAMES, vehicle_parameters
from inclined_landing.eval.policies.flying import fly, summary, table_of
from inclined_landing.eval.policies.study import Key, Study, fly_all, joined
from inclined_landing.eval.policies.tables import STRICT, Panel, Row
from inclined_landing.models import geometry
from inclined_landing.models.attitude import LAG
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import make_plant
from inclined_landing.models.vehicle import Vehicle

NAMED = ("crazyflie-2.0", "crazyflie-2.1", "crazyflie-2.1-brushless", "hummingbird")
_DRAWN = "drawn vehicles"
_COUNTED = ("strict", "success", "touched", "time_to_goal")
_BINS = 8  # groups of drawn vehicles


def run(
    policies: Mapping[str, str],
    vehicles: Sequence[str],
    ranges: str | Path | None,
    *,
    draws: int,
    starts: int,
    plant: str,
    seed: int,
    every: int = 1,
) -> Study:
    """Return the study of policies, by their labels, on named vehicles and on `draws` drawn from `ranges`.

    starts: number of starts of the grid for each drawn vehicle; seed: for both. every: fly named vehicles
    from each k-th start only. Raises UserError for policies that do not land.
    """
    for path in policies.values():
        if not (task := load_policy(path).task).cut_at_success:
            raise UserError(f"policy {path} is for the task {task.name}, not for landing")
    known = {name: load_vehicle(name) for name in vehicles}
    drawn_from = None if ranges is None else read_ranges(ranges)
    pool = drawn_from.draw(load_vehicle(), seed, draws) if drawn_from is not None and draws else []
    work: dict[Key, Callable[[], pd.DataFrame]] = {}
    for name, vehicle in known.items():
        for label, path in policies.items():
            work[label, name] = partial(_on_named, path, vehicle, plant, every)
    for label, path in policies.items() if pool else ():
        work[label, _DRAWN] = partial(_on_drawn, path, pool, starts, plant, seed)
    flown = fly_all(work)

    def outcomes(where: str) -> dict[str, Any]:
        return {x: {"policy": policies[x]} | summary(flown[x, where], *_COUNTED) for x in policies}

    report: dict[str, Any] = {
        "command": "vehicles",
        "plant": plant,
        "seed": int(seed),
        "labels": list(policies),
        "vehicles": [
            {"vehicle": name, **_description(vehicle), "outcomes": outcomes(name)}
            for name, vehicle in known.items()
        ],
        "draws": None,
        "versions": runs.versions(),
    }
    if pool:
        landed = {x: flown[x, _DRAWN]["strict"].to_numpy().reshape(-1, starts).sum(axis=1) for x in policies}
        report["draws"] = {
            "ranges": str(ranges),
            "count": len(pool),
            "starts_each": starts,
            "outcomes": outcomes(_DRAWN),
            "members": [
                {**_description(v), "strict": {x: int(counts[k]) for x, counts in landed.items()}}
                for k, v in enumerate(pool)
            ],
        }
    rows, remarks = _rows(report)
    return Study(
        name="vehicles",
        title=f"Over vehicles, {plant} plant",
        report=report,
        flights=joined(flown),
        heads=("vehicle", "policy", "mass [g]", "thrust/weight"),
        rows=rows,
        panels=_panels(report),
        remarks=remarks,
    )


def _on_named(path: str, vehicle: Vehicle, plant: str, every: int) -> pd.DataFrame:
    """Return the flights of a policy on one vehicle, from the grid."""
    policy = load_policy(path, vehicle=vehicle)
    grid = landing_starts.clear(policy.task, landing_starts.grid())[::every]
    start = policy.task.start(landing_starts.at_rest(policy.task, grid))
    return fly(policy, start, plant, cut_from=None)


def _on_drawn(path: str, pool: Sequence[Vehicle], starts: int, plant: str, seed: int) -> pd.DataFrame:
    """Return the flights on the vehicles of `pool`, each from `starts` of the grid, one after the other."""
    policy = load_policy(path)
    member = np.repeat(np.arange(len(pool)), starts)
    fleet = make_plant(plant, len(member), load_vehicle(), pool=pool)
    fleet.assign(np.arange(fleet.n), 1 + member)
    points = _starts_of_draws(policy, fleet, len(pool), starts, seed)
    states = landing_starts.at_rest(policy.task, points)
    states[:, LAG] *= fleet.hover_share
    flights = record_flights(policy, fleet, states, steps=policy.task.judged_steps)
    return table_of(policy.task, flights)


def _starts_of_draws(policy: Policy, fleet: Any, draws: int, starts: int, seed: int) -> np.ndarray:
    """Return starts (draws * starts, 2) of the frozen grid, each vehicle's clear of the platform."""
    task, grid = policy.task, landing_starts.grid()
    states = landing_starts.at_rest(task, grid)
    start = task.start(states)
    position, _ = geometry.platform_poses(start.inclination, start.present, task.vehicle)
    rng = np.random.default_rng(seed)
    points = np.empty((draws, starts, 2))
    for k in range(draws):
        which = np.full(len(grid), 1 + k if len(fleet.fleet.reach) > 1 else 0)
        distance = geometry.clearances(states, start.inclination, position, fleet.fleet, which=which)
        clear = np.flatnonzero(distance[:, :2].min(axis=(1, 2)) >= START_CLEARANCE)
        if len(clear) < starts:
            raise UserError(
                f"only {len(clear)} starts of the grid are clear of the platform for a drawn vehicle"
            )
        points[k] = grid[rng.choice(clear, starts, replace=False)]
    return points.reshape(-1, 2)


def _description(vehicle: Vehicle) -> dict[str, float]:
    """Return the mass [kg] and the numbers that policies may observe of a vehicle."""
    numbers = zip(NAMES, vehicle_parameters(vehicle).tolist())
    return {"mass": vehicle.body_mass, **{name.replace(" ", "_"): value for name, value in numbers}}


def _rows(report: dict[str, Any]) -> tuple[list[Row], list[str]]:
    """Return a row for each vehicle and policy, and a sentence of each policy."""
    flown = {}
    for row in report["vehicles"]:
        flown[row["vehicle"]] = f"{1e3 * row['mass']:.1f}", f"{row['thrust_to_weight']:.2f}", row["outcomes"]
    if draws := report["draws"]:
        mass, power = ([m[key] for m in draws["members"]] for key in ("mass", "thrust_to_weight"))
        masses = f"{1e3 * min(mass):.1f} to {1e3 * max(mass):.0f}"
        powers = f"{min(power):.2f} to {max(power):.2f}"
        flown[f"{draws['count']} drawn vehicles"] = masses, powers, draws["outcomes"]
    rows: list[Row] = [
        ((name, label, *size), of[label]) for name, (*size, of) in flown.items() for label in of
    ]
    remarks = [STRICT]
    for label in report["labels"]:
        shares = {name: of[label]["strict"] for name, (_, _, of) in flown.items()}
        counts = [f"{share['count']} of {share['of']} flights with {name}" for name, share in shares.items()]
        remarks.append(f"{label} landed in {', '.join(counts)}.")
    return rows, remarks


def _panels(report: dict[str, Any]) -> list[Panel]:
    """Return strict success over mass and thrust to weight of groups of drawn vehicles, and of named ones."""
    found = report["vehicles"]
    named = {x: {r["vehicle"]: r["outcomes"][x]["strict"] for r in found} for x in report["labels"]}
    panels = [Panel("Named vehicles", named)]
    if draws := report["draws"]:
        panels += [
            Panel("Drawn vehicles", _groups(draws, "mass", 1e3), "mass [g]", logarithmic=True),
            Panel("", _groups(draws, "thrust_to_weight", 1.0), "thrust / weight"),
        ]
    return panels


def _groups(draws: dict[str, Any], key: str, factor: float) -> dict[str, dict[float, dict]]:
    """Return by label the strict success of groups of drawn vehicles, over the median of a quantity."""
    where = factor * np.array([member[key] for member in draws["members"]])
    found: dict[str, dict[float, dict]] = {}
    for label in draws["outcomes"]:
        landed = np.array([member["strict"][label] for member in draws["members"]])
        found[label] = {
            float(np.median(where[rows])): proportion(landed[rows].sum(), draws["starts_each"] * len(rows))
            for rows in np.array_split(np.argsort(where), min(_BINS, len(where)))
        }
    return found
