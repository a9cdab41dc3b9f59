"""Flights that a training makes itself: periodic evaluation, and a rehearsal of a task of one's own."""

from __future__ import annotations

import dataclasses

import numpy as np

from inclined_landing.envs.flights import record_flights
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.tasks import Task
from inclined_landing.envs.tasks.guard import TaskError
from inclined_landing.models.attitude import LAG
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.plants import make_plant
from inclined_landing.models.vehicle import Vehicle
from inclined_landing.train import ppo
from inclined_landing.train.config import TrainConfig

EVALUATION_STARTS = 64
ENDING_STARTS = 256  # of evaluations that end a run
_STEPS, _FLIGHTS = 20, 2  # of a rehearsal


class PeriodicEvaluation:
    """Random starts of a stream of its own, hybrid plant in RK4, no training aids.

    Of a randomised run two of three flights have a vehicle of another pool than the training's, hovering at
    first: the score is that of all flights, and after it stands that of either kind.
    """

    def __init__(self, config: TrainConfig, vehicle: Vehicle):
        self.task = ppo.build_task(config)
        rng = np.random.default_rng(ppo.evaluation_seed(config))
        count = EVALUATION_STARTS if config.success is None else ENDING_STARTS
        count += 0 if config.randomise is None else count // 2
        self.starts = self.task.evaluation_starts(rng, count)
        drawn = ppo.drawn(config, vehicle, ppo.evaluation_seed(config), 2 * (count // 3))
        self.plant = make_plant(
            "hybrid", count, vehicle, threads=config.threads, **drawn | self.task.plant_options
        )
        if self.plant.pool:
            others = np.flatnonzero(np.arange(count) % 3)
            self.plant.assign(others, 1 + np.arange(len(others)))
            self.starts.state[:, LAG] *= self.plant.hover_share
        self.film_start = self.task.states_at(self.task.film_starts[:1])

    def score(self, policy: Policy) -> dict:
        """Return the task's score of flights from all starts."""
        flights = record_flights(policy, self.plant, self.starts, steps=self.task.judged_steps)
        score = self.task.score(flights)
        if self.plant.pool:
            kinds = {
                "score_nominal": flights[::3],
                "score_drawn": [f for k, f in enumerate(flights) if k % 3],
            }
            score |= {name: self.task.score(some)["score"] for name, some in kinds.items()}
        return score


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
        reason = f"{type(error).__name__}: {shown(error, 120)}"
        raise TaskError(
            f"task {shown(config.task, 60)}: what it says of itself does not fit: {reason}"
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
    env = ppo.training_environment(dataclasses.replace(config, threads=1, environments=_FLIGHTS))
    env.set_conditions(ppo.build_curriculum(config).conditions())
    env.reset()
