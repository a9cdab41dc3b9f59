"""A task of one's own tried before its training: a few steps show most of what is wrong with its code."""

from __future__ import annotations

import dataclasses

import numpy as np

from inclined_landing.envs.flights import record_flights
from inclined_landing.envs.tasks import Task
from inclined_landing.envs.tasks.guard import TaskError
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.plants import make_plant
from inclined_landing.train import ppo
from inclined_landing.train.config import TrainConfig
from inclined_landing.train.curriculum import make_curriculum

_STEPS, _FLIGHTS = 20, 2


class _Random:
    """In place of a policy: actions that are drawn."""

    def __init__(self, task: Task, rng: np.random.Generator):
        self.task, self._rng = task, rng

    def predict(self, observation: np.ndarray) -> np.ndarray:
        """Return actions (n, a) in [-1, 1]."""
        return self._rng.uniform(-1.0, 1.0, (len(observation), len(self.task.action_names)))


def rehearse(config: TrainConfig) -> None:
    """Ask the task of a resolved configuration for all that training and evaluation ask, for 20 steps.

    The task is guarded (`envs.tasks.guard`): TaskError says which of its methods raised, or returned what has
    the wrong shape or type, or is not finite; also where what they return does not fit together.
    """
    try:
        _rehearse(config)
    except (UserError, MemoryError, FloatingPointError):
        raise
    except Exception as error:
        said = f"{type(error).__name__}: {shown(error, 120)}"
        raise TaskError(
            f"task {shown(config.task, 60)}: what it says of itself does not fit: {said}"
        ) from error


def _rehearse(config: TrainConfig) -> None:
    task, rng = ppo.build_task(config), np.random.default_rng(config.seed)
    ppo.scaled_observation(task)
    plant = make_plant("hybrid", _FLIGHTS, task.vehicle, threads=1, **task.plant_options)
    starts = task.evaluation_starts(rng, _FLIGHTS)
    steps = min(_STEPS, task.max_steps, task.judged_steps or _STEPS)
    flights = record_flights(_Random(task, rng), plant, starts, steps=steps)
    task.score_words(task.score(flights))
    task.flight_words(flights[0])
    task.start_words(task.states_at(task.film_starts[:1])[0])
    curriculum = make_curriculum(config.curriculum, config.task, config.gamma, config.without or "")
    small = dataclasses.replace(config, threads=1)
    small.environments = _FLIGHTS
    training = ppo.training_environment(small)
    training.set_conditions(curriculum.conditions())
    training.reset()
