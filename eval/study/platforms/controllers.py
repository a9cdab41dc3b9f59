"""What the benchmark scores: policies, and the planner."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np

from inclined_landing.envs.policy import Policy, load_policy
from inclined_landing.envs.tasks import StepContext
from inclined_landing.eval.study.flights import named_policies
from inclined_landing.eval.study.options import BASELINES, PLANNER
from inclined_landing.eval.study.platforms.planner import Planner
from inclined_landing.eval.study.rest import Pilot, PolicyPilot
from inclined_landing.models.attitude import PWM
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.vehicle import Vehicle

ANGLE_LIMIT = math.radians(55.0)  # of attitude commands: 50 deg of slope and some to steer with


def vehicle_flown() -> Vehicle:
    """Return the vehicle of the benchmark: the shipped one, with attitude commands up to 55 deg."""
    return load_vehicle().changed(command_angle_limit=ANGLE_LIMIT)


@dataclasses.dataclass(frozen=True)
class Controller:
    """Something to score; `pilot(n)` begins a scenario of n flights."""

    name: str
    vehicle: Vehicle
    pilot: Callable[[int], Pilot]


def find(name: str, label: str | None = None) -> Controller:
    """Return the controller `name`: the planner, or a policy."""
    if name == PLANNER:
        vehicle = vehicle_flown()
        return Controller(PLANNER, vehicle, lambda n: PlannerPilot(vehicle))
    return of_policy(load_policy(name), label)


def find_all(names: Sequence[str]) -> list[Controller]:
    """Return the controllers by their names, the baselines if none are given.

    Raises UserError if two of them have the same name.
    """
    named = named_policies(tuple(dict.fromkeys(names)) or BASELINES)
    found = [find(policy, label) for label, policy in named.items()]
    called = [controller.name for controller in found]
    if twice := [name for name in called if called.count(name) > 1]:
        raise UserError(f"two controllers are named {twice[0]}; rename one")
    return found


def of_policy(policy: Policy, label: str | None = None) -> Controller:
    """Return a policy as a controller; raises UserError for one that flies in a plane or does not land."""
    if not policy.task.has_platform:
        raise UserError(f"policy {policy.path} is for {policy.task.name}, which has no platform to land on")
    if "roll" not in policy.task.action_names:
        raise UserError(
            f"policy {policy.path} flies in a plane; the scenarios need one in three dimensions, such as "
            "those of landing-train touchdown --dimensions 3"
        )
    return Controller(label or policy.name, vehicle_flown(), lambda n: PolicyPilot(policy, n))


class PlannerPilot:
    """The planner, whose commands are cut to what the vehicle takes."""

    def __init__(self, vehicle: Vehicle):
        self._planner = Planner(vehicle)
        angle, yaw = vehicle.command_angle_limit, vehicle.command_yaw_rate_limit
        self._low = np.array([vehicle.command_pwm_range[0], -angle, -angle, -yaw])
        self._high = np.array([vehicle.command_pwm_range[1], angle, angle, yaw])

    def __call__(self, t: float, context: StepContext) -> np.ndarray:
        """Return commands (n, 4)."""
        planned = self._planner(t, context.state, context.platform)
        commands = np.clip(planned, self._low, self._high)
        commands[planned[:, PWM] <= 0.0, PWM] = 0.0
        return commands
