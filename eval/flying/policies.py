"""Policies as the pilot uses them: a believed state in, a command out, by the task's own maps."""

from __future__ import annotations

import numpy as np

from inclined_landing.envs.history import History
from inclined_landing.envs.hover import Trim
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.tasks import Setpoint, StepContext
from inclined_landing.envs.tasks.base import hover_states
from inclined_landing.models.attitude import ROLL_COMMAND, YAW, X, Y, Z


class InvalidAction(Exception):
    """Raised for an action that is NaN or infinite."""

    def __init__(self, policy: Policy):
        super().__init__(f"the policy {policy.name} gives NaN or infinity")
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

        Raises BadAction when the action is NaN or infinite.
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
    """The set-point policy flying to any target: it observes its state relative to the task's goal."""

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
