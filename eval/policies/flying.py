"""Flights of policies as tables, one row per flight, and their statistics.

Every table has `x y z` of the start and `end_x end_y end_z` [m], `success`, `touched` (did a part meet the
platform), `strict` (the first without the second), `time` [s], `time_to_goal` [s] and `reward`. Of landings
whose motors are cut on arrival it also says how they entered the goal box and what followed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from inclined_landing.envs import starts as landing_starts
from inclined_landing.envs.flights import Flight, record_flights
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.shared.statistics import mean, proportion, spread
from inclined_landing.envs.tasks import Start, Task
from inclined_landing.envs.tasks.setpoint import TOLERANCE
from inclined_landing.envs.tasks.start import joined
from inclined_landing.eval.policies.rest import cut_motors
from inclined_landing.models import surface
from inclined_landing.models.attitude import LAG, PITCH, VX, VZ, YAW
from inclined_landing.models.errors import UserError
from inclined_landing.models.plants import make_plant
from inclined_landing.models.vehicle import Vehicle

RANDOM_STARTS = 200
LANDINGS = ("goal_box", "slopes")  # tables of the tasks that end where the motors are cut
_ARRIVAL_NUMBERS = (
    *("entry_speed", "entry_normal_speed", "entry_tangential_speed", "pitch_error"),
    *("normal_speed", "tangential_speed"),
)
_ARRIVAL_FLAGS = ("moving_away", "touchdown", "at_rest_on_feet")


def groups_of(task: Task, seed: int) -> dict[str, Start]:
    """Return the groups of starts of a task by name; the last one is frozen, or random where none is.

    Landing: the paper's starts, scattered ones and the frozen grid; the frozen set over the slopes of a
    policy that observes them (`envs.starts`). Raises UserError for a task that another command evaluates.
    """
    if task.table in ("flights", "error"):
        return {"random": task.sample(np.random.default_rng(seed), RANDOM_STARTS)}
    if task.table == "slopes":
        return {"slopes": landing_starts.over_slopes(task).start}
    if task.table != "goal_box":
        other = {"moving": "robustness --over moving"}.get(task.table, task.table)
        raise UserError(f"the task {task.name} is evaluated by landing-eval {other}")
    starts = {
        "paper_starts": landing_starts.paper(),
        "scattered_starts": landing_starts.scattered(seed),
        "grid": landing_starts.clear(task, landing_starts.grid()),
    }
    return {name: task.start(landing_starts.at_rest(task, group)) for name, group in starts.items()}


def frozen_starts(task: Task, seed: int = 0) -> Start:
    """Return the last group of `groups_of`, on which policies are compared."""
    return list(groups_of(task, seed).values())[-1]


def fly(
    policy: Policy,
    starts: Start,
    plant: str,
    *,
    vehicle: Vehicle | None = None,
    thrust_scale: float = 1.0,
    disturbance: bool = False,
    cut_from: int | None = 0,
) -> pd.DataFrame:
    """Return a row for each flight of a policy from `starts`.

    vehicle: the one that flies, where it is not the policy's, which knows nothing of it; it begins with the
    same load. disturbance: fly in that of the vehicle, always the same. cut_from: of landings, the first
    flight whose motors are cut on arrival; None: of no flight.
    """
    task = policy.task
    vehicle = task.vehicle if vehicle is None else vehicle
    starts = dataclasses.replace(starts, state=starts.state.copy())
    starts.state[:, LAG] *= task.vehicle.thrust_lag_rate / vehicle.thrust_lag_rate
    fleet = make_plant(plant, len(starts), vehicle, disturbance=0 if disturbance else None)
    if thrust_scale != 1.0:
        fleet.perturb(thrust_scale=thrust_scale)
    tilt = vehicle.platform_inclination - task.vehicle.platform_inclination
    fleet = _Tilted(fleet, tilt) if tilt else fleet
    flights = record_flights(policy, fleet, starts, steps=task.judged_steps)
    table = table_of(task, flights)
    if cut_from is None or task.table not in LANDINGS:
        return table
    return table.join(_arrivals(flights, cut_from, vehicle, thrust_scale))


def fly_groups(
    policy: Policy, plant: str, thrust_scale: float, disturbance: bool = False, seed: int = 0
) -> pd.DataFrame:
    """Return a row for each flight from all groups of starts, with its `group`; arrivals of the last one."""
    groups = groups_of(policy.task, seed)
    counts = [len(group) for group in groups.values()]
    options: dict[str, Any] = {"thrust_scale": thrust_scale, "disturbance": disturbance}
    starts = joined(list(groups.values()))
    flights = fly(policy, starts, plant, cut_from=sum(counts[:-1]), **options)
    return flights.assign(group=np.repeat(list(groups), counts))


class _Tilted:
    """A plant whose platforms are inclined by `tilt` [rad] more than the task sets them."""

    def __init__(self, plant: Any, tilt: float):
        self._plant, self._tilt = plant, tilt

    def __getattr__(self, name: str) -> Any:
        return getattr(self._plant, name)

    def set_platform(self, ids, inclination, present=True, azimuth=0.0) -> None:
        """Set the platforms as the plant does, inclined by more."""
        self._plant.set_platform(ids, np.asarray(inclination) + self._tilt, present, azimuth)


def table_of(task: Task, flights: Sequence[Flight]) -> pd.DataFrame:
    """Return a row for each flight, with the columns that every table has."""
    first, last = (np.array([f.state[row] for f in flights]) for row in (0, -1))
    table = pd.DataFrame(
        {
            **dict(zip("xyz", first[:, :3].T)),
            "success": [f.success for f in flights],
            "touched": [f.touched for f in flights],
            "strict": [f.strict for f in flights],
            "time": [f.duration for f in flights],
            **dict(zip(("end_x", "end_y", "end_z"), last[:, :3].T)),
            "reward": [f.reward.sum() for f in flights],
        }
    )
    table["time_to_goal"] = table["time"].where(table["success"])
    if task.table == "error":
        table["error"] = task.position_error(last)  # type: ignore[attr-defined]
        table["within"] = table["error"] < TOLERANCE
    return table


def _arrivals(
    flights: Sequence[Flight], cut_from: int, vehicle: Vehicle, thrust_scale: float
) -> pd.DataFrame:
    """Return how flights entered the goal box, and what followed when their motors were cut there.

    Velocities in m/s, towards and along the slope; `pitch_error` in rad; False and NaN where none arrived.
    """
    rows = [k for k, f in enumerate(flights) if k >= cut_from and f.success]
    if not rows:
        none = pd.DataFrame(np.nan, range(len(flights)), list(_ARRIVAL_NUMBERS))
        return none.assign(**dict.fromkeys(_ARRIVAL_FLAGS, False))
    platform = np.array([flights[k].platform[-1] for k in rows])  # type: ignore[index]
    inclination = platform[:, PITCH]
    state = surface.turned(np.array([flights[k].state[-1] for k in rows]), -platform[:, YAW])
    velocity = state[:, VX : VZ + 1]
    away, along = surface.split(velocity, inclination)
    _, standing = surface.attitude_at_rest(inclination, -state[:, YAW])
    pitch_error = np.abs(state[:, PITCH] - standing)
    after = cut_motors(state, inclination, vehicle, thrust_scale)
    numbers = (np.linalg.norm(velocity, axis=1), -away, along, pitch_error)
    flags = (away > 0, after.touched, after.at_rest)
    columns = zip(
        (*_ARRIVAL_NUMBERS, *_ARRIVAL_FLAGS), (*numbers, after.normal_speed, after.tangential_speed, *flags)
    )
    table = pd.DataFrame(dict(columns), index=rows).reindex(range(len(flights)))
    table[list(_ARRIVAL_FLAGS)] = table[list(_ARRIVAL_FLAGS)].eq(True)  # False where none arrived
    return table


def summary(flights: pd.DataFrame, *columns: str, **renamed: str) -> dict[str, Any]:
    """Return the share of flights where a column is true, and median and quantiles of one of numbers.

    renamed: columns by the name that they get.
    """
    names = dict(zip(columns, columns)) | renamed
    return {
        name: proportion(flights[column].sum(), len(flights))
        if flights[column].dtype == bool
        else spread(flights[column])
        for name, column in names.items()
    }


def outcome(task: Task, flights: pd.DataFrame) -> dict[str, Any]:
    """Return what the table of a task counts of flights from one group of starts."""
    if task.table == "error":
        error = flights["error"]
        return {"error": mean(error) | spread(error)} | summary(flights, "within")
    if task.table in LANDINGS:
        return summary(flights, "strict", "success", "touched", "time_to_goal")
    reward = flights["reward"]
    return summary(flights, "success", duration="time") | {"reward": mean(reward) | spread(reward)}


def effect_outcome(task: Task, flights: pd.DataFrame) -> dict[str, Any]:
    """Return `outcome`, and of landings how many rest after a motor cut, and their touchdown speed [m/s]."""
    counted = outcome(task, flights)
    return counted | (summary(flights, "at_rest_on_feet", "normal_speed") if task.table in LANDINGS else {})


def condition_outcome(task: Task, flights: pd.DataFrame) -> dict[str, Any]:
    """Return `outcome` of flights of `fly_groups`, for landings of each group.

    And of the frozen group the entry into the goal box, and what follows a motor cut there.
    """
    if task.table not in LANDINGS:
        return outcome(task, flights)
    counted: dict[str, Any] = {}
    for name, group in flights.groupby("group", sort=False):
        counted[str(name)] = outcome(task, group)
    if "grid" in counted:
        too_close = len(landing_starts.grid()) - counted["grid"]["strict"]["of"]  # at this inclination
        counted["grid"]["left_out"] = too_close
    arrived = group[group["success"]]
    entry = {f"{name}speed": f"entry_{name}speed" for name in ("", "normal_", "tangential_")}
    cut = ("touchdown", "normal_speed", "tangential_speed", "at_rest_on_feet")
    counted["entry"] = summary(arrived, "moving_away", "pitch_error", **entry) if len(arrived) else None
    counted["motors_cut"] = summary(arrived, *cut) if len(arrived) else None
    return counted


def headline(task: Task, condition: dict[str, Any]) -> dict[str, Any]:
    """Return the part of a condition's outcome that the record of a training keeps."""
    if task.table == "error":
        return {"mean_error": condition["error"], "within": condition["within"]}
    if task.table not in LANDINGS:
        return {"success": condition["success"], "reward": condition["reward"]["mean"]}
    frozen = condition["grid" if task.table == "goal_box" else "slopes"]
    kept = {name: frozen[name] for name in ("strict", "success")}
    return {"thrust_scale": condition["thrust_scale"], **kept, "entry": condition["entry"]}
