"""What is flown for a success table: groups of starts, at other thrusts and by other vehicles.

The motors of landing policies are cut where they arrive.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from inclined_landing.envs import starts as landing_starts
from inclined_landing.envs.flights import Flight, record_flights
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.tasks import Start, Task
from inclined_landing.envs.tasks.base import joined
from inclined_landing.eval.base.conditions import fly_all
from inclined_landing.eval.policies.motors_cut import Aftermath, cut_on_arrival
from inclined_landing.models.attitude import LAG
from inclined_landing.models.errors import UserError
from inclined_landing.models.plants import make_plant
from inclined_landing.models.vehicle import Vehicle

RANDOM_STARTS = 200
LANDINGS = ("goal_box", "slopes")  # tables of the tasks that end where the motors are cut


@dataclasses.dataclass
class FlownAt:
    """The flights at one thrust scale."""

    thrust_scale: float
    flights: dict[str, list[Flight]]  # by group of starts
    cut: Aftermath | None  # of landings: from the last group, the frozen one, after a motor cut on arrival


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
        raise UserError(f"the task {task.name} has a table of its own: landing-eval {other} evaluates it")
    starts = {
        "paper_starts": landing_starts.paper(),
        "scattered_starts": landing_starts.scattered(seed),
        "grid": landing_starts.clear(task, landing_starts.grid()),
    }
    return {name: task.start(landing_starts.at_rest(task, group)) for name, group in starts.items()}


def fly_scaled(
    policy: Policy, plant: str, thrust_scales: Sequence[float], *, disturbance: bool, seed: int
) -> list[FlownAt]:
    """Return the flights from all groups of starts, at every thrust scale."""
    task, groups = policy.task, groups_of(policy.task, seed)
    counts = [len(group) for group in groups.values()]
    starts = joined(list(groups.values()))

    def fly_at(scale: float) -> FlownAt:
        fleet = make_plant(plant, len(starts), task.vehicle, disturbance=0 if disturbance else None)
        if scale != 1.0:
            fleet.perturb(thrust_scale=scale)
        flights = record_flights(policy, fleet, starts, steps=task.judged_steps)
        flown = {name: flights[end - n : end] for name, n, end in zip(groups, counts, np.cumsum(counts))}
        landed = flown[list(groups)[-1]] if task.table in LANDINGS else []
        return FlownAt(float(scale), flown, cut_on_arrival(landed, task.vehicle, scale))

    work = {(f"thrust scale {scale}",): partial(fly_at, scale) for scale in thrust_scales}
    return list(fly_all(work).values())


def fly(policy: Policy, plant: str, vehicle: Vehicle, starts: Start) -> tuple[list[Flight], Aftermath | None]:
    """Return flights of `vehicle`, of which the policy knows nothing, from `starts` of its own vehicle.

    And what follows a motor cut on arrival, of landing policies.
    """
    task, starts = policy.task, dataclasses.replace(starts, state=starts.state.copy())
    starts.state[:, LAG] *= task.vehicle.thrust_lag_rate / vehicle.thrust_lag_rate  # the same load
    tilt = vehicle.platform_inclination - task.vehicle.platform_inclination
    fleet = make_plant(plant, len(starts), vehicle)
    fleet = _Tilted(fleet, tilt) if tilt else fleet
    flights = record_flights(policy, fleet, starts, steps=task.judged_steps)
    return flights, cut_on_arrival(flights, vehicle) if task.table in LANDINGS else None


class _Tilted:
    """A plant whose platforms are inclined by `tilt` [rad] more than the task sets them."""

    def __init__(self, plant: Any, tilt: float):
        self._plant, self._tilt = plant, tilt

    def __getattr__(self, name: str) -> Any:
        return getattr(self._plant, name)

    def set_platform(self, ids, inclination, present=True, azimuth=0.0) -> None:
        """Set the platforms as the plant does, inclined by more."""
        self._plant.set_platform(ids, np.asarray(inclination) + self._tilt, present, azimuth)
