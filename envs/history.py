"""What a policy is given: the present observation and, with the task option `history`, what came before it.

A task with `history=K` has its policy see, behind the present observation (o,), the last K steps, the latest
one first, each as its observation (o,) and the action (a,) that answered it. Of steps before the start the
observation is the first one and the action 0. From such pairs a policy can tell what one observation does
not show: a weaker thrust, a later answer.
"""

from __future__ import annotations

import numpy as np

from inclined_landing.envs.tasks import Task


def input_names(task: Task) -> tuple[str, ...]:
    """What a policy is given, o + K (o + a) numbers: x ... pitch, x[-1] ... pitch command[-1], x[-2] ..."""
    step = (*task.observation_names, *(f"{name} command" for name in task.action_names))
    past = (f"{name}[-{k}]" for k in range(1, task.history + 1) for name in step)
    return (*task.observation_names, *past)


def input_centre(task: Task) -> np.ndarray:
    """What a policy network subtracts from what it is given; shape as `input_names`."""
    return _repeated(task, task.observation_centre, 0.0)


def input_scale(task: Task) -> np.ndarray:
    """Typical size of what a policy is given; shape as `input_names`."""
    return _repeated(task, task.observation_scale, 1.0)


def _repeated(task: Task, of_observation: np.ndarray, of_action: float) -> np.ndarray:
    step = np.append(of_observation, [of_action] * len(task.action_names))
    return np.concatenate([of_observation, np.tile(step, task.history)])


class History:
    """The last `task.history` steps of n vehicles: `steps` (n, K, o + a) float32, the latest one first."""

    def __init__(self, task: Task, n: int):
        self._seen = len(task.observation_names)
        self.steps = np.zeros((n, task.history, self._seen + len(task.action_names)), np.float32)

    def begin(self, ids, observation: np.ndarray) -> None:
        """New episodes of the vehicles `ids` with their first observation (k, o)."""
        self.steps[ids, :, : self._seen] = observation[:, None]
        self.steps[ids, :, self._seen :] = 0.0

    def note(self, observation: np.ndarray, actions: np.ndarray) -> None:
        """A step of all vehicles: the observation (n, o) and the actions (n, a) in [-1, 1] given to it."""
        if self.steps.shape[1]:
            self.steps[:, 1:] = self.steps[:, :-1]
            self.steps[:, 0, : self._seen], self.steps[:, 0, self._seen :] = observation, actions

    def behind(self, observation: np.ndarray, ids=slice(None)) -> np.ndarray:
        """The present observation (k, o) of the vehicles `ids`, their past behind it: (k, o + K (o + a))."""
        if not self.steps.shape[1]:
            return observation
        past = self.steps[ids]
        return np.concatenate([observation, past.reshape(len(past), -1)], axis=1)
