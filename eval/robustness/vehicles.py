"""Landing policies on named vehicles, and on vehicles drawn from a file of ranges.

Each vehicle flies with its own shapes, from those starts of the frozen grid that keep them 5 cm clear of the
platform; a drawn one from a few of these, which are the same for all policies. A policy that observes the
vehicle's parameters (`landing-train --observe-vehicle`) is given those of the vehicle it flies.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from inclined_landing.envs import starts as landing_starts
from inclined_landing.envs.flights import record_flights
from inclined_landing.envs.policy import Policy, load_policy
from inclined_landing.envs.randomise import read_ranges
from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.statistics import proportion
from inclined_landing.envs.shared.tables import share_cell
from inclined_landing.envs.tasks.landing import START_CLEARANCE
from inclined_landing.envs.vehicle_parameters import NAMES, vehicle_parameters
from inclined_landing.eval.base.claims import Section, Table
from inclined_landing.eval.base.conditions import fly_all
from inclined_landing.eval.policies.evaluators import outcome
from inclined_landing.eval.robustness.entries import Entry
from inclined_landing.models import geometry
from inclined_landing.models.attitude import LAG
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import make_plant
from inclined_landing.models.vehicle import Vehicle


def evaluate(
    entries: Sequence[Entry],
    vehicles: Sequence[str],
    ranges: str | Path | None,
    *,
    draws: int,
    starts: int,
    plant: str,
    seed: int,
) -> dict[str, Any]:
    """Return the report as plain numbers: `vehicles` and `draws`, each with `outcomes` by label.

    draws: vehicles drawn from `ranges`, each flown from `starts` of the grid; seed: of both.
    """
    for entry in entries:
        if entry.vehicle is not None and entry.vehicle not in vehicles:
            raise UserError(
                f"{entry.label} is for the vehicle {shown(entry.vehicle, 40)}, which is not flown"
            )
    known = {name: load_vehicle(name) for name in vehicles}
    drawn_from = None if ranges is None else read_ranges(ranges)
    pool = drawn_from.draw(load_vehicle(), seed, draws) if drawn_from is not None and draws else []
    for entry in entries:
        for policy in entry.policies:
            if not (task := load_policy(policy).task).cut_at_success:
                raise UserError(f"policy {policy} is for the task {task.name}, not for landing")
    work = {
        (entry.label, path, name): partial(_on_named, path, known[name], plant)
        for name in vehicles
        for entry in entries
        if entry.vehicle in (None, name)
        for path in entry.policies
    }
    flown = fly_all(work)
    rows = []
    for name in vehicles:
        outcomes: dict[str, list[dict]] = {}
        for label, path, vehicle in work:
            if vehicle == name:
                outcomes.setdefault(label, []).append(flown[label, path, name])
        pooled = {label: _pooled(found) for label, found in outcomes.items()}
        rows.append({"vehicle": name, **_description(known[name]), "outcomes": pooled})
    report = {
        "command": "vehicles",
        "plant": plant,
        "seed": int(seed),
        "labels": list(dict.fromkeys(entry.label for entry in entries)),
        "vehicles": rows,
        "draws": None,
    }
    if pool:
        report["draws"] = {"ranges": str(ranges)} | _drawn(entries, pool, starts, plant, seed)
    return report | {"versions": runs.versions()}


def _on_named(path: str, vehicle: Vehicle, plant: str) -> dict[str, Any]:
    """Return the outcome of a policy on one vehicle, from the whole grid."""
    policy = load_policy(path, vehicle=vehicle)
    task = policy.task
    states = landing_starts.at_rest(task, landing_starts.clear(task, landing_starts.grid()))
    flights = record_flights(policy, make_plant(plant, len(states), vehicle), states, steps=task.judged_steps)
    return {"policy": path} | outcome(flights)


def _drawn(
    entries: Sequence[Entry], pool: Sequence[Vehicle], starts: int, plant: str, seed: int
) -> dict[str, Any]:
    """Return the outcomes on the vehicles of `pool`, each from `starts` of the grid."""
    draws = len(pool)
    member = np.repeat(np.arange(draws), starts)
    fleet = make_plant(plant, len(member), load_vehicle(), pool=pool)
    fleet.assign(np.arange(fleet.n), 1 + member)
    outcomes: dict[str, list[dict]] = {}
    landed: dict[str, np.ndarray] = {}

    def count(path: str) -> tuple[dict[str, Any], np.ndarray]:
        policy = load_policy(path)
        states = landing_starts.at_rest(policy.task, _starts_of_draws(policy, fleet, draws, starts, seed))
        states[:, LAG] *= fleet.hover_share
        flights = record_flights(policy, fleet, states, steps=policy.task.judged_steps)
        strict = np.array([flight.strict for flight in flights]).reshape(draws, starts).sum(axis=1)
        return {"policy": path} | outcome(flights), strict

    general = [entry for entry in entries if entry.vehicle is None]
    work = {(entry.label, path): partial(count, path) for entry in general for path in entry.policies}
    for (label, _), (found, strict) in fly_all(work).items():
        outcomes.setdefault(label, []).append(found)
        landed[label] = landed.get(label, 0) + strict
    flown = {label: starts * len(found) for label, found in outcomes.items()}
    return {
        "count": draws,
        "starts_each": starts,
        "outcomes": {label: _pooled(found) for label, found in outcomes.items()},
        "flown_each": flown,
        "members": [
            {**_description(v), "strict": {label: int(counts[k]) for label, counts in landed.items()}}
            for k, v in enumerate(pool)
        ],
    }


def _starts_of_draws(policy: Policy, fleet, draws: int, starts: int, seed: int) -> np.ndarray:
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


def _pooled(found: Sequence[dict]) -> dict[str, Any]:
    """Return the shares over the flights of all policies together, and the outcome of each policy."""
    keys = ("strict", "success", "touched")
    sums = {k: proportion(sum(o[k]["count"] for o in found), sum(o[k]["of"] for o in found)) for k in keys}
    return sums | {"policies": list(found)}


def cells(report: dict[str, Any]) -> list[tuple[str, ...]]:
    """Return a row for each named vehicle, and one for all drawn ones: strict success [%] of each policy."""

    def shares(outcomes: dict[str, dict]) -> list[str]:
        return [share_cell(outcomes[x]["strict"]) if x in outcomes else "-" for x in report["labels"]]

    rows: list[tuple[str, ...]] = [
        (
            row["vehicle"],
            f"{1e3 * row['mass']:.1f}",
            f"{row['thrust_to_weight']:.2f}",
            *shares(row["outcomes"]),
        )
        for row in report["vehicles"]
    ]
    if draws := report["draws"]:
        mass, power = ([m[key] for m in draws["members"]] for key in ("mass", "thrust_to_weight"))
        name = f"{draws['count']} drawn, {draws['starts_each']} starts each"
        masses = f"{1e3 * min(mass):.1f} to {1e3 * max(mass):.0f}"
        rows.append((name, masses, f"{min(power):.2f} to {max(power):.2f}", *shares(draws["outcomes"])))
    return rows


def answers(report: dict[str, Any]) -> list[str]:
    """Return a sentence on the landings of each label: with every named vehicle, and with the drawn ones."""
    flown = [(row["vehicle"], row["outcomes"]) for row in report["vehicles"]]
    if draws := report["draws"]:
        flown.append((f"{draws['count']} drawn vehicles", draws["outcomes"]))
    found = []
    for label in report["labels"]:
        shares = {name: outcomes[label]["strict"] for name, outcomes in flown if label in outcomes}
        counts = [f"{share['count']} of {share['of']} flights with {name}" for name, share in shares.items()]
        found.append(f"{label} landed in {', '.join(counts)}.")
    return found


def sections(report: dict[str, Any]) -> list[Section]:
    """Return the section of the page."""
    figure = {
        "vehicles": "Strict success over mass and thrust to weight; lines: drawn vehicles, 95 % intervals."
    }
    heads = ("vehicle", "mass [g]", "thrust/weight", *report["labels"])
    table = Table("", heads, cells(report))
    return [
        Section(
            "vehicles",
            f"Over vehicles, {report['plant']} plant",
            [],
            [],
            [table],
            figure,
            ["Strict success [%], 95 % intervals.", *answers(report)],
        )
    ]
