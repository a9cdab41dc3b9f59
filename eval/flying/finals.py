"""What a flight is for, after the approach: the landing of a policy, or a planned flight."""

from __future__ import annotations

import math

import numpy as np

from inclined_landing.envs.policy import Policy
from inclined_landing.envs.tasks.touchdown import HOLD_STEPS, IDLE_ACTION
from inclined_landing.eval.base.tracking import Tracker
from inclined_landing.eval.flying.planned import PlannedFlight
from inclined_landing.eval.flying.policies import PolicyRunner, SetpointFollower
from inclined_landing.eval.flying.safety import Phase
from inclined_landing.models.attitude import PWM, ROLL_COMMAND, X, Z


class Landing:
    """A landing by its policy. The pilot holds the heading, and y for policies that ask for no roll."""

    phase = Phase.LANDING
    turns = False  # are heading and yaw rate the pilot's, and commands of heading 0
    astray = 0.0

    def __init__(self, policy: Policy, follower: SetpointFollower):
        self.policy, self._task = policy, policy.task
        self._runner, self._follower = PolicyRunner(policy), follower
        self._idle_steps = 0  # control steps in a row
        self.limit = self._task.max_steps * self._task.vehicle.command_control_period  # s that it may take

    def reset(self) -> None:
        """Forget what was observed."""
        self._runner.reset()
        self._idle_steps = 0

    def step(self, since: float, state: np.ndarray, resting: bool) -> np.ndarray | str:
        """Return the command (4,) at a state (13,), or the outcome where the goal is reached.

        since [s]: the landing began; resting: the vehicle lies still on something. Raises InvalidAction.
        """
        size = self._task.goal_size
        if size is not None and self._task.in_goal(state[None], size, self._runner.platform)[0]:
            return "goal box"
        action, command = self._runner.act(state)
        if self._task.is_planar:
            command[ROLL_COMMAND] = self._follower.roll_command_to_hold(state, 0.0)
        self._idle_steps = self._idle_steps + 1 if command[PWM] == 0.0 and action[0] <= IDLE_ACTION else 0
        if size is None and self._idle_steps >= HOLD_STEPS and resting:
            return "at rest"
        return command

    def heading_error(self, since: float, yaw: float) -> float:
        """Return by how much the heading [rad] is off."""
        return yaw


class Planned:
    """A planned flight, tracked by the controller that the plan was simulated with."""

    phase = Phase.PLAN
    turns = True
    limit = math.inf  # it ends by itself
    policy = None

    def __init__(self, flight: PlannedFlight):
        self._flight = flight
        self.astray = 0.0  # m off the reference now
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self._tracker, self._before = Tracker(self._flight.reference, self._flight.vehicle), 0.0

    def step(self, since: float, state: np.ndarray, resting: bool) -> np.ndarray | str:
        """Return the command (4,), in the vehicle's heading, at a state (13,); the outcome at the end."""
        reference = self._flight.reference
        if since > reference.seconds:
            return "plan flown"
        self.astray = float(np.linalg.norm(state[X : Z + 1] - reference.position[reference.row(since)]))
        command = self._tracker.command(since, state[None], since - self._before)[0]
        self._before = since
        return command

    def heading_error(self, since: float, yaw: float) -> float:
        """Return by how much a heading [rad] is behind the plan's."""
        return float(self._tracker.heading_error(since, np.array([yaw]))[0])
