"""Landing policies flown on named vehicles and on vehicles drawn from a file of ranges.

Every vehicle flies in its own plant, or as a member of a pool, with its own shapes, from those starts of the
frozen grid that keep 5 cm to the platform with them. Each drawn vehicle flies from a few of them, which all
policies share.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.progress import track

from inclined_landing.envs import starts as landing_starts
from inclined_landing.envs.flights import Flight, record_flights
from inclined_landing.envs.policy import Policy, load_policy
from inclined_landing.envs.randomise import read_ranges
from inclined_landing.envs.tasks.landing import START_CLEARANCE
from inclined_landing.envs.vehicle_parameters import NAMES, vehicle_parameters
from inclined_landing.eval.base import runs
from inclined_landing.eval.base.statistics import proportion, spread
from inclined_landing.models import geometry
from inclined_landing.models.attitude import LAG
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.parameters import Vehicle, load_vehicle
from inclined_landing.models.plants import make_plant

MOST_SEEDS, LONGEST_LABEL = 100, 40  # policies that count as one; characters of their name


@dataclasses.dataclass(frozen=True)
class Entry:
    """Policies that count as one, such as three seeds of a training."""

    label: str
    policies: tuple[str, ...]
    vehicle: str | None = None  # the only one that they are flown on; None: all, and the drawn ones


def parse_entry(text: str) -> Entry:
    """LABEL=POLICY+POLICY, LABEL@VEHICLE=POLICY+POLICY or POLICY; raises UserError for anything else."""
    head, equals, files = text.partition("=")
    if not equals:
        return Entry(text.rpartition("/")[2].removesuffix(".zip"), (text,))
    label, at, vehicle = head.partition("@")
    policies = tuple(files.split("+"))
    if not (label and all(policies) and (vehicle or not at)):
        raise UserError(
            f"policies are written LABEL=POLICY+POLICY or LABEL@VEHICLE=POLICY, not {shown(repr(text), 60)}"
        )
    if len(label) > LONGEST_LABEL or not label.isprintable():
        raise UserError(f"label {shown(label, 40)}: at most {LONGEST_LABEL} printable characters are read")
    if len(policies) > MOST_SEEDS:
        raise UserError(f"{label} has {len(policies)} policies; at most {MOST_SEEDS} count as one")
    if len(set(policies)) < len(policies):
        raise UserError(f"{label} has a policy twice; each counts once")
    return Entry(label, policies, vehicle or None)


def evaluate(
    entries: Sequence[Entry],
    vehicles: Sequence[str],
    ranges: str | None,
    *,
    draws: int,
    starts: int,
    plant: str,
    seed: int,
) -> dict:
    """The report as plain numbers: `vehicles` and `draws`, each with `outcomes` by label.

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
    rows = []
    for name in track(vehicles, "flying", console=Console(stderr=True), transient=True):
        outcomes: dict[str, list[dict]] = {}
        for entry in entries:
            if entry.vehicle in (None, name):
                flown = [_outcome(path, _named(path, known[name], plant)) for path in entry.policies]
                outcomes.setdefault(entry.label, []).extend(flown)
        pooled = {label: _pooled(runs_) for label, runs_ in outcomes.items()}
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
        report["draws"] = {"ranges": ranges} | _drawn(entries, pool, starts, plant, seed)
    return report | {"versions": runs.versions()}


def _named(path: str, vehicle: Vehicle, plant: str) -> list[Flight]:
    policy = load_policy(path, vehicle=vehicle)
    task = policy.task
    states = landing_starts.at_rest(task, landing_starts.clear(task, landing_starts.grid()))
    return _fly(policy, make_plant(plant, len(states), vehicle), states)


def _fly(policy: Policy, plant, states: np.ndarray) -> list[Flight]:
    try:
        return record_flights(policy, plant, states, steps=policy.task.judged_steps)
    except FloatingPointError as error:
        raise UserError(f"policy {policy.path}: {error}") from error


def _drawn(entries: Sequence[Entry], pool: Sequence[Vehicle], starts: int, plant: str, seed: int) -> dict:
    draws = len(pool)
    member = np.repeat(np.arange(draws), starts)
    fleet = make_plant(plant, len(member), load_vehicle(), pool=pool)
    fleet.assign(np.arange(fleet.n), 1 + member)
    outcomes: dict[str, list[dict]] = {}
    landed: dict[str, np.ndarray] = {}
    general = [entry for entry in entries if entry.vehicle is None]
    for entry in track(general, "flying draws", console=Console(stderr=True), transient=True):
        for path in entry.policies:
            policy = load_policy(path)
            points = _starts_of_draws(policy, fleet, draws, starts, seed)
            states = landing_starts.at_rest(policy.task, points)
            states[:, LAG] *= fleet.hover_share
            flights = _fly(policy, fleet, states)
            outcomes.setdefault(entry.label, []).append(_outcome(path, flights))
            strict = np.array([flight.strict for flight in flights]).reshape(draws, starts).sum(axis=1)
            landed[entry.label] = landed.get(entry.label, 0) + strict
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
    """Starts (draws * starts, 2) of the frozen grid, those of each drawn vehicle clear of the platform."""
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


def _description(vehicle: Vehicle) -> dict:
    numbers = zip(NAMES, vehicle_parameters(vehicle).tolist())
    return {"mass": vehicle.body_mass, **{name.replace(" ", "_"): value for name, value in numbers}}


def _outcome(path: str, flights: Sequence[Flight]) -> dict:
    return {
        "policy": path,
        "strict": proportion(sum(f.strict for f in flights), len(flights)),
        "success": proportion(sum(f.success for f in flights), len(flights)),
        "touched": proportion(sum(f.touched for f in flights), len(flights)),
        "time_to_goal": spread([f.duration for f in flights if f.success]),
    }


def _pooled(found: Sequence[dict]) -> dict:
    """All flights of the policies together, and each of them."""
    keys = ("strict", "success", "touched")
    sums = {k: proportion(sum(o[k]["count"] for o in found), sum(o[k]["of"] for o in found)) for k in keys}
    return sums | {"policies": list(found)}
