"""Inputs of a policy: the present observation and, with the task option `history`, stacked past steps.

With `history=K` the present observation (o,) is followed by the last K steps, the latest one first, each as
its observation (o,) and the action (a,) that answered it. For steps before the start the observation is the
first one and the action 0. From such pairs a policy can infer a weaker thrust or a longer delay.

With `observe_vehicle` they are followed by the vehicle's parameters (`envs.vehicle_parameters`), a privileged
observation.
"""

from __future__ import annotations

import numpy as np

from inclined_landing.envs import vehicle_parameters
from inclined_landing.envs.tasks import Task


def input_names(task: Task) -> tuple[str, ...]:
    """Return the names of a policy's inputs, o + K (o + a): x ... pitch, x[-1] ... pitch command[-1], x[-2]
    ...

    With `observe_vehicle`, the names of the vehicle's parameters follow.
    """
    step = (*task.observation_names, *(f"{name} command" for name in task.action_names))
    past = (f"{name}[-{k}]" for k in range(1, task.history + 1) for name in step)
    return (*task.observation_names, *past, *(vehicle_parameters.NAMES if task.observe_vehicle else ()))


def input_centre(task: Task) -> np.ndarray:
    """Return the offset that a policy network subtracts from its inputs; shape as `input_names`."""
    return _repeated(task, task.observation_centre, 0.0, vehicle_parameters.CENTRE)


def input_scale(task: Task) -> np.ndarray:
    """Return the typical size of a policy's inputs; shape as `input_names`."""
    return _repeated(task, task.observation_scale, 1.0, vehicle_parameters.SCALE)


def _repeated(task: Task, of_observation: np.ndarray, of_action: float, of_vehicle: np.ndarray) -> np.ndarray:
    step = np.append(of_observation, [of_action] * len(task.action_names))
    parameters = of_vehicle if task.observe_vehicle else []
    return np.concatenate([of_observation, np.tile(step, task.history), parameters])


class History:
    """The last `task.history` steps of n vehicles: `steps` (n, K, o + a) float32, the latest one first."""

    def __init__(self, task: Task, n: int):
        self._seen = len(task.observation_names)
        self._privileged = (
            vehicle_parameters.vehicle_parameters(task.vehicle) if task.observe_vehicle else None
        )
        self.steps = np.zeros((n, task.history, self._seen + len(task.action_names)), np.float32)

    def reset(self, ids, observation: np.ndarray) -> None:
        """Begin new episodes of the vehicles `ids` with their first observation (k, o)."""
        self.steps[ids, :, : self._seen] = observation[:, None]
        self.steps[ids, :, self._seen :] = 0.0

    def record(self, observation: np.ndarray, actions: np.ndarray) -> None:
        """Append a step of all vehicles: observation (n, o) and the actions (n, a) in [-1, 1] that answered
        it.
        """
        if self.steps.shape[1]:
            self.steps[:, 1:] = self.steps[:, :-1]
            self.steps[:, 0, : self._seen], self.steps[:, 0, self._seen :] = observation, actions

    def stack(
        self, observation: np.ndarray, ids=slice(None), vehicle: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the observation (k, o) of the vehicles `ids` with their history appended: (k, o + K (o +
        a)).

        With `observe_vehicle` their vehicles' parameters follow: vehicle (k, 6), by default the task's own.
        """
        parts = [observation]
        if self.steps.shape[1]:
            past = self.steps[ids]
            parts.append(past.reshape(len(past), -1))
        if self._privileged is not None:
            usual = np.broadcast_to(self._privileged, (len(observation), len(self._privileged)))
            parts.append(usual if vehicle is None else vehicle)
        return np.concatenate(parts, axis=1) if len(parts) > 1 else observation
