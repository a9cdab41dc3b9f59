"""Fly for the pilot, from an estimated state to a command, by a policy or by the controller of a plan."""

from __future__ import annotations

import math

import numpy as np

from inclined_landing.envs.history import History
from inclined_landing.envs.hover import Trim
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.tasks import Setpoint, StepContext
from inclined_landing.envs.tasks.base import hover_states
from inclined_landing.envs.tasks.touchdown import HOLD_STEPS, IDLE_ACTION
from inclined_landing.eval.flying.safety import Phase
from inclined_landing.eval.flying.tracking import Tracker, Trajectory
from inclined_landing.models.attitude import PWM, ROLL_COMMAND, YAW, X, Y, Z
from inclined_landing.models.vehicle import Vehicle


class InvalidAction(Exception):
    """Raised for an action that is NaN or infinite."""

    def __init__(self, policy: Policy):
        super().__init__(f"the policy {policy.name} returned NaN or infinity")
        self.policy = policy


class PolicyRunner:
    """One policy with its observation history, over the one platform of its task."""

    def __init__(self, policy: Policy):
        self.policy, self.task = policy, policy.task
        start = self.task.start(hover_states(np.zeros((1, 3)), self.task.vehicle))
        self.platform = start.platforms(self.task.vehicle) if self.task.has_platform else None
        self._past = History(self.task, 1)
        self._begun = False

    def reset(self) -> None:
        """Clear the history: a new flight begins."""
        self._begun = False

    def act(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the action (a,) in [-1, 1] and the command (4,) PWM, rad, rad, rad/s for a state (13,).

        Raises InvalidAction when the action is NaN or infinite.
        """
        observation = self.task.observe(StepContext(state[None], platform=self.platform))
        if not self._begun:
            self._past.reset([0], observation)
            self._begun = True
        action = np.asarray(self.policy.predict(self._past.stack(observation)))
        if not np.isfinite(action).all():
            raise InvalidAction(self.policy)
        action = np.clip(action, -1.0, 1.0)
        self._past.record(observation, action)
        level = state[None].copy()
        level[:, YAW] = 0.0  # commands are along the arena's axes, and the pilot's to turn
        return action[0], self.task.body_commands(self.task.commands(action), level, self.platform)[0]


class SetpointFollower:
    """The set-point policy for any target: it observes the state shifted to the task's goal."""

    def __init__(self, policy: Policy):
        self.actor = PolicyRunner(policy)
        self.trim = Trim(1)
        self._task: Setpoint = policy.task  # type: ignore[assignment]

    def command_towards(self, state: np.ndarray, target: np.ndarray, dt: float) -> np.ndarray:
        """Return the command (4,) at a state (13,) towards a target (3,) [m], dt [s] after the last one."""
        self.trim.integrate((target - state[X : Z + 1])[None], dt)
        return self.actor.act(self._task.shifted(state[None], target + self.trim.offset)[0])[1]

    def roll_command_to_hold(self, state: np.ndarray, y: float) -> float:
        """Return the policy's roll command [rad] that holds y [m] in a planar flight."""
        shown = self._task.across(state[None], y + self.trim.offset[0, Y])[0]
        return float(self.actor.act(shown)[1][ROLL_COMMAND])


class PolicyLanding:
    """A landing by a policy. The pilot holds the heading, and y for policies that do not command roll."""

    phase = Phase.LANDING
    turns = False  # are heading and yaw rate the pilot's, and commands of heading 0
    astray = 0.0

    def __init__(self, policy: Policy):
        self.policy, self._task = policy, policy.task
        self.is_planar = self._task.is_planar  # does the pilot hold y
        self._runner = PolicyRunner(policy)
        self._idle_steps = 0  # control steps in a row
        self.limit = self._task.max_steps * self._task.vehicle.command_control_period  # s that it may take

    def reset(self) -> None:
        """Clear the observation history."""
        self._runner.reset()
        self._idle_steps = 0

    def step(self, since: float, state: np.ndarray, resting: bool) -> np.ndarray | str:
        """Return the command (4,) at a state (13,), or the outcome if the goal is reached.

        since [s]: start of the landing; resting: whether the vehicle is at rest on something. Raises
        InvalidAction.
        """
        size = self._task.goal_size
        if size is not None and self._task.in_goal(state[None], size, self._runner.platform)[0]:
            return "goal box"
        action, command = self._runner.act(state)
        self._idle_steps = self._idle_steps + 1 if command[PWM] == 0.0 and action[0] <= IDLE_ACTION else 0
        if size is None and self._idle_steps >= HOLD_STEPS and resting:
            return "at rest"
        return command

    def heading_error(self, since: float, yaw: float) -> float:
        """Return the heading error [rad]."""
        return yaw


class PlanTracking:
    """A planned flight, tracked by the controller that the plan was simulated with; see `PolicyLanding`."""

    phase = Phase.PLAN
    turns = True
    is_planar = False
    limit = math.inf  # it ends by itself
    policy = None

    def __init__(self, reference: Trajectory, vehicle: Vehicle):
        self.reference, self._vehicle = reference, vehicle
        self.reset()

    def reset(self) -> None:
        """Reset the tracker."""
        self._tracker, self._before = Tracker(self.reference, self._vehicle), 0.0
        self.astray = 0.0  # m off the reference now

    def step(self, since: float, state: np.ndarray, resting: bool) -> np.ndarray | str:
        """Return the command (4,), in the vehicle's heading, at a state (13,); the outcome at the end."""
        reference = self.reference
        if since > reference.seconds:
            return "plan flown"
        self.astray = float(np.linalg.norm(state[X : Z + 1] - reference.position[reference.row(since)]))
        command = self._tracker.command(since, state[None], since - self._before)[0]
        self._before = since
        return command

    def heading_error(self, since: float, yaw: float) -> float:
        """Return the angle by which a heading [rad] lags behind the plan's."""
        return float(self._tracker.heading_error(since, np.array([yaw]))[0])
