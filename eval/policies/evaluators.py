"""The success table of a task: its starts, and what is counted of the flights from there.

An evaluator is found by the task's `table`. The one of this name, `flights`, fits any task.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from inclined_landing.envs import starts as landing_starts
from inclined_landing.envs.flights import Flight
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.statistics import mean, proportion, spread
from inclined_landing.envs.tasks import Start, Task
from inclined_landing.envs.tasks.landing import PAPER_RESULTS
from inclined_landing.envs.tasks.setpoint import TOLERANCE
from inclined_landing.eval.base.conditions import outcome
from inclined_landing.eval.policies.motors_cut import cut_motors
from inclined_landing.models import surface
from inclined_landing.models.attitude import PITCH, VX, VZ, YAW
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import Vehicle
from inclined_landing.models.surface import split, turned

RANDOM_STARTS = 200


class Flights:
    """Random starts of the task: success as the task judges it, the sum of rewards, the duration."""

    paper: tuple[dict, ...] | None = None  # the paper's results
    frozen = "random"  # the group of starts from which effects are tried
    report_scales: tuple[float, ...] = (1.0,)  # thrust scales of the report after a training

    def groups(self, task: Task, seed: int) -> dict[str, Start]:
        """Return the groups of starts by name."""
        return {"random": task.sample(np.random.default_rng(seed), RANDOM_STARTS)}

    def summary(self, task: Task, flights: Sequence[Flight]) -> dict:
        """Return what is counted of the flights from one group."""
        reward = [f.reward.sum() for f in flights]
        return {
            "success": proportion(sum(f.success for f in flights), len(flights)),
            "reward": mean(reward) | spread(reward),
            "duration": spread([f.duration for f in flights]),
        }

    def condition(self, task: Task, flown: Mapping[str, Sequence[Flight]], scale: float) -> dict:
        """Return the entry of one thrust scale in the report."""
        return self.summary(task, flown["random"])

    def effect(self, task: Task, flights: Sequence[Flight], vehicle: Vehicle) -> dict:
        """Return the entry of one effect; vehicle: what was flown."""
        return self.summary(task, flights)

    def headline(self, condition: dict) -> dict:
        """Return the part of an entry that the record of a training keeps."""
        return {"success": condition["success"], "reward": condition["reward"]["mean"]}


class Errors(Flights):
    """Distance to the goal at the end, in place of success."""

    def summary(self, task, flights: Sequence[Flight]) -> dict:
        """Return the position error [m] at the end of the flights, and the share within 5 cm."""
        error = task.position_error(np.array([f.state[-1] for f in flights]))
        return {
            "error": mean(error) | spread(error),
            "within": proportion((error < TOLERANCE).sum(), len(error)),
        }

    def headline(self, condition: dict) -> dict:
        """Return error and share within 5 cm."""
        return {"mean_error": condition["error"], "within": condition["within"]}


class Landings(Flights):
    """The paper's starts, scattered ones and the frozen grid; from its flights the motors are cut."""

    paper: tuple[dict, ...] | None = PAPER_RESULTS
    frozen = "grid"
    report_scales = (1.0, 1.05, 0.95)

    def groups(self, task, seed: int) -> dict[str, Start]:
        """Return the starts of `envs.starts`."""
        starts = {
            "paper_starts": landing_starts.paper(),
            "scattered_starts": landing_starts.scattered(seed),
            "grid": landing_starts.clear(task, landing_starts.grid()),
        }
        return {name: task.start(landing_starts.at_rest(task, group)) for name, group in starts.items()}

    def summary(self, task, flights: Sequence[Flight]) -> dict:
        """Return success, strict success, platform touches and time to the goal box of landing flights."""
        return outcome(flights)

    def condition(self, task, flown: Mapping[str, Sequence[Flight]], scale: float) -> dict:
        """Return each group, the entry into the goal box, and what follows a motor cut there."""
        condition: dict[str, Any] = {name: self.summary(task, flights) for name, flights in flown.items()}
        if "grid" in flown:
            left_out = len(landing_starts.grid()) - len(flown["grid"])  # too close at this inclination
            condition["grid"]["left_out"] = left_out
        arrived = [f for f in flown[self.frozen] if f.success]
        condition["entry"] = _entry(arrived) if arrived else None
        condition["motors_cut"] = _motors_cut(arrived, task, scale) if arrived else None
        return condition

    def effect(self, task, flights: Sequence[Flight], vehicle: Vehicle) -> dict:
        """Return the frozen starts, how many rest after a motor cut, and their touchdown speed [m/s]."""
        arrived = [f for f in flights if f.success]
        after = cut_motors(*_in_plane(arrived), vehicle) if arrived else None
        return self.summary(task, flights) | {
            "at_rest_on_feet": proportion(after.at_rest.sum() if after else 0, len(flights)),
            "normal_speed": spread(after.normal_speed if after else []),
        }

    def headline(self, condition: dict) -> dict:
        """Return the frozen starts and the entry into the goal box."""
        frozen = condition[self.frozen]
        scale, entry = condition["thrust_scale"], condition["entry"]
        return {
            "thrust_scale": scale,
            "strict": frozen["strict"],
            "success": frozen["success"],
            "entry": entry,
        }


class Slopes(Landings):
    """The frozen set over the angles, for policies that observe the slope."""

    paper = None
    frozen = "slopes"

    def groups(self, task, seed: int) -> dict[str, Start]:
        """Return the starts of `envs.starts.over_slopes`."""
        return {"slopes": landing_starts.over_slopes(task).start}


EVALUATORS = {"flights": Flights(), "error": Errors(), "goal_box": Landings(), "slopes": Slopes()}


def evaluator_of(task: Task) -> Flights:
    """Return the evaluator of a task; raises UserError for a task that another command evaluates."""
    if task.table not in EVALUATORS:
        other = {"moving": "robustness --over moving"}.get(task.table, task.table)
        raise UserError(f"the task {task.name} has a table of its own: landing-eval {other} evaluates it")
    return EVALUATORS[task.table]


def report_of(command: str, policy: Policy, plant: str, seed: int) -> dict:
    """Return what every report says of the policy and how it was flown."""
    return {
        "command": command,
        "policy": str(policy.path),
        "trained": policy.metadata,
        "task": policy.task.name,
        "table": policy.task.table,
        "task_options": policy.task.options,
        "plant": plant,
        "seed": int(seed),
        "versions": runs.versions(),
    }


def _in_plane(arrived: Sequence[Flight]) -> tuple[np.ndarray, np.ndarray]:
    """Return the last states (n, 13) of flights, turned to slopes of azimuth 0, and the inclinations."""
    platform = np.array([f.platform[-1] for f in arrived if f.platform is not None])
    return turned(np.array([f.state[-1] for f in arrived]), -platform[:, YAW]), platform[:, PITCH]


def _entry(arrived: Sequence[Flight]) -> dict:
    """Return velocities [m/s] and pitch error [rad] of the flights at the entry into the goal box."""
    state, inclination = _in_plane(arrived)
    velocity = state[:, VX : VZ + 1]
    away, along = split(velocity, inclination)
    _, standing = surface.attitude_at_rest(inclination, -state[:, YAW])
    return {
        "speed": spread(np.linalg.norm(velocity, axis=1)),
        "normal_speed": spread(-away),  # towards the surface
        "tangential_speed": spread(along),
        "moving_away": proportion((away > 0).sum(), len(arrived)),
        "pitch_error": spread(np.abs(state[:, PITCH] - standing)),
    }


def _motors_cut(arrived: Sequence[Flight], task, scale: float) -> dict:
    after = cut_motors(*_in_plane(arrived), task.vehicle, scale)
    return {
        "touchdown": proportion(after.touched.sum(), len(arrived)),
        "normal_speed": spread(after.normal_speed),
        "tangential_speed": spread(after.tangential_speed),
        "at_rest_on_feet": proportion(after.at_rest.sum(), len(arrived)),
    }
