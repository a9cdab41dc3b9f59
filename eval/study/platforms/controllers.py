"""Controllers that can be evaluated: policies, the planner, and custom controllers.

A controller is called once per control period with t [s], the states of n vehicles (n, 12) and of their
platforms (n, 12), both with the columns x y z, vx vy vz, roll pitch yaw, wx wy wz (m, m/s, rad, rad/s of the
body; attitude Rz(yaw) Rx(roll) Ry(pitch)), as they are now. It answers with commands (n, 4): PWM, roll, pitch
[rad], yaw rate [rad/s]. PWM 0 or less stops the motors, other commands are cut to what the vehicle takes.

Custom controllers are named `module:function`, `file.py:function`, or a class, which is called with the
vehicle and must make such a function; one is made for every scenario, so that it may remember.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from inclined_landing.envs.batch import as_floats
from inclined_landing.envs.policy import Policy, load_policy
from inclined_landing.envs.shared.user_code import import_named
from inclined_landing.envs.tasks import StepContext, is_path
from inclined_landing.eval.study.flights import named_policies
from inclined_landing.eval.study.platforms.planner import Planner
from inclined_landing.eval.study.rest import Pilot, PolicyPilot
from inclined_landing.models.attitude import COMMAND_SIZE, PWM, WZ
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.vehicle import Vehicle

PLANNER = "planner"
BASELINES = ("touchdown-moving", "landing-moving", PLANNER)
ANGLE_LIMIT = math.radians(55.0)  # of attitude commands: 50 deg of slope and some to steer with
_SEEN = WZ + 1  # columns of a state that a controller is given: all but the rotors' lag


def vehicle_flown() -> Vehicle:
    """Return the vehicle of the benchmark: the shipped one, with attitude commands up to 55 deg."""
    return load_vehicle().changed(command_angle_limit=ANGLE_LIMIT)


@dataclasses.dataclass(frozen=True)
class Controller:
    """Something to score; `pilot(n)` begins a scenario of n flights."""

    name: str
    kind: str  # "policy", "motor cut", "planner" or "controller"
    vehicle: Vehicle
    pilot: Callable[[int], Pilot]


def find(name: str, vehicle: Vehicle, label: str | None = None) -> Controller:
    """Return the controller `name`: the planner, a policy, or a custom one, `module:NAME`."""
    if name == PLANNER:
        return Controller(PLANNER, "planner", vehicle, lambda n: _Checked(Planner(vehicle), PLANNER, vehicle))
    if is_path(name):
        return _imported(name, vehicle)
    return of_policy(load_policy(name), vehicle, label)


def find_all(names: Sequence[str]) -> list[Controller]:
    """Return the controllers by their names, the baselines if none are given.

    Raises UserError if two of them have the same name.
    """
    vehicle, named = vehicle_flown(), named_policies(tuple(dict.fromkeys(names)) or BASELINES)
    found = [find(policy, vehicle, label) for label, policy in named.items()]
    called = [controller.name for controller in found]
    if twice := [name for name in called if called.count(name) > 1]:
        raise UserError(f"two controllers are named {twice[0]}; rename one")
    return found


def of_policy(policy: Policy, vehicle: Vehicle, label: str | None = None) -> Controller:
    """Return a policy as a controller; raises UserError for one that flies in a plane."""
    if "roll" not in policy.task.action_names:
        raise UserError(
            f"policy {policy.path} flies in a plane; the scenarios need one in three dimensions, such as "
            "those of landing-train touchdown --dimensions 3"
        )
    kind = "motor cut" if policy.task.cut_at_success else "policy"
    return Controller(label or policy.name, kind, vehicle, lambda n: PolicyPilot(policy, n))


class _Checked:
    """A controller as the module's docstring says, whose answers are checked."""

    def __init__(self, answer: Callable[[float, np.ndarray, np.ndarray], Any], name: str, vehicle: Vehicle):
        self._answer, self._name = answer, shown(name, 60)
        angle, yaw = vehicle.command_angle_limit, vehicle.command_yaw_rate_limit
        self._low = np.array([vehicle.command_pwm_range[0], -angle, -angle, -yaw])
        self._high = np.array([vehicle.command_pwm_range[1], angle, angle, yaw])

    def __call__(self, t: float, context: StepContext) -> np.ndarray:
        where = f"controller {self._name} at {t:.2f} s"
        with _blamed(where):
            answer = self._answer(t, context.state[:, :_SEEN].copy(), context.platform.copy())
        commands, shape = as_floats(answer, f"the answer of {where}"), (len(context.state), COMMAND_SIZE)
        if commands.shape != shape or not np.isfinite(commands).all():
            raise UserError(f"{where} must answer with finite numbers of shape {shape}, not {commands.shape}")
        stopped = commands[:, PWM] <= 0.0
        commands = np.clip(commands, self._low, self._high)
        commands[stopped, PWM] = 0.0
        return commands


@contextlib.contextmanager
def _blamed(who: str) -> Iterator[None]:
    """Turn any exception of a custom controller into a UserError that names it."""
    try:
        yield
    except UserError:
        raise
    except (Exception, SystemExit) as error:
        raise UserError(f"{who} raised {type(error).__name__}: {shown(error, 120)}") from error


def _imported(name: str, vehicle: Vehicle) -> Controller:
    found = import_named(name, "controller", "NAME")
    what = f"controller {shown(name, 60)}"
    if not callable(found):
        raise UserError(f"{what}: {name.rpartition(':')[0]} has no function or class of this name")

    def pilot(n: int) -> Pilot:
        with _blamed(what):
            made = found(vehicle) if isinstance(found, type) else found
        return _Checked(made, name, vehicle)

    return Controller(name.rpartition(":")[2], "controller", vehicle, pilot)
