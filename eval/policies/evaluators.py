"""The success table of a task: what is counted of its flights (see `flying`).

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
from inclined_landing.envs.tasks import Task
from inclined_landing.envs.tasks.landing import PAPER_RESULTS
from inclined_landing.envs.tasks.setpoint import TOLERANCE
from inclined_landing.eval.policies.motors_cut import Aftermath, in_plane
from inclined_landing.models import surface
from inclined_landing.models.attitude import PITCH, VX, VZ, YAW
from inclined_landing.models.surface import split


class Flights:
    """Flights from random starts: success as the task judges it, the sum of rewards, the duration."""

    paper: tuple[dict, ...] | None = None  # the paper's results
    frozen = "random"  # the group of starts from which effects are tried
    report_scales: tuple[float, ...] = (1.0,)  # thrust scales of the report after a training

    def summary(self, task: Task, flights: Sequence[Flight]) -> dict:
        """Return what is counted of the flights from one group."""
        reward = [f.reward.sum() for f in flights]
        return {
            "success": proportion(sum(f.success for f in flights), len(flights)),
            "reward": mean(reward) | spread(reward),
            "duration": spread([f.duration for f in flights]),
        }

    def condition(self, task: Task, flown: Mapping[str, Sequence[Flight]], cut: Aftermath | None) -> dict:
        """Return the entry of one thrust scale in the report; cut: what followed a motor cut on arrival."""
        return self.summary(task, flown["random"])

    def effect(self, task: Task, flights: Sequence[Flight], cut: Aftermath | None) -> dict:
        """Return the entry of one effect; cut: what followed a motor cut on arrival."""
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
    """Flights from the paper's starts, scattered ones and the frozen grid, and a motor cut on arrival."""

    paper: tuple[dict, ...] | None = PAPER_RESULTS
    frozen = "grid"
    report_scales = (1.0, 1.05, 0.95)

    def summary(self, task, flights: Sequence[Flight]) -> dict:
        """Return success, strict success, platform touches and time to the goal box of landing flights."""
        return outcome(flights)

    def condition(self, task, flown: Mapping[str, Sequence[Flight]], cut: Aftermath | None) -> dict:
        """Return each group, the entry into the goal box, and what follows a motor cut there."""
        condition: dict[str, Any] = {name: self.summary(task, flights) for name, flights in flown.items()}
        if "grid" in flown:
            left_out = len(landing_starts.grid()) - len(flown["grid"])  # too close at this inclination
            condition["grid"]["left_out"] = left_out
        arrived = [f for f in flown[self.frozen] if f.success]
        condition["entry"] = _entry(arrived) if arrived else None
        condition["motors_cut"] = _motors_cut(cut) if cut else None
        return condition

    def effect(self, task, flights: Sequence[Flight], cut: Aftermath | None) -> dict:
        """Return the frozen starts, how many rest after a motor cut, and their touchdown speed [m/s]."""
        return self.summary(task, flights) | {
            "at_rest_on_feet": proportion(cut.at_rest.sum() if cut else 0, len(flights)),
            "normal_speed": spread(cut.normal_speed if cut else []),
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


EVALUATORS = {"flights": Flights(), "error": Errors(), "goal_box": Landings(), "slopes": Slopes()}


def evaluator_of(task: Task) -> Flights:
    """Return the evaluator of a task, one with a success table (see `flying.groups_of`)."""
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


def outcome(flights: Sequence[Flight]) -> dict[str, Any]:
    """Return the shares of landing flights with their intervals, and the time to the goal box [s].

    success: the goal box is reached in time; touched: a part met the platform before; strict: the first
    without the second.
    """
    n = len(flights)
    return {
        "strict": proportion(sum(f.strict for f in flights), n),
        "success": proportion(sum(f.success for f in flights), n),
        "touched": proportion(sum(f.touched for f in flights), n),
        "time_to_goal": spread([f.duration for f in flights if f.success]),
    }


def _entry(arrived: Sequence[Flight]) -> dict:
    """Return velocities [m/s] and pitch error [rad] of the flights at the entry into the goal box."""
    state, inclination = in_plane(arrived)
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


def _motors_cut(after: Aftermath) -> dict:
    """Return how flights ended whose motors were cut on arrival."""
    count = len(after.touched)
    return {
        "touchdown": proportion(after.touched.sum(), count),
        "normal_speed": spread(after.normal_speed),
        "tangential_speed": spread(after.tangential_speed),
        "at_rest_on_feet": proportion(after.at_rest.sum(), count),
    }
