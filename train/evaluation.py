"""Periodic evaluation during a training run: flights of the present policy, scored by the task."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from inclined_landing.envs.flights import record_flights
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.randomise import read_ranges
from inclined_landing.envs.shared.user_code import blame
from inclined_landing.envs.tasks import is_path
from inclined_landing.envs.tasks.base import VEHICLE_KINDS, Start, kind_column
from inclined_landing.envs.tasks.guard import TaskError
from inclined_landing.models.attitude import LAG
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.models.plants import make_plant
from inclined_landing.train import ppo
from inclined_landing.train.config import TrainConfig

if TYPE_CHECKING:
    from inclined_landing.train.learner import Learner

# Flights of an evaluation, and of one that may end a run; a randomised run adds those of the nominal vehicle.
EVALUATION_STARTS, ENDING_STARTS = 64, 256
NOMINAL_EVERY = 3  # in a randomised run, every third flight has the nominal vehicle
_SEED = 1_000_003  # apart from every training seed's stream, and from the frozen grid


class PeriodicEvaluation:
    """Evaluates from new random starts each time, in the hybrid plant with RK4, without training aids.

    The starts have a separate random stream. In a randomised run two of three flights have a vehicle with one
    deviation (see `Ranges.each_alone`) and begin in hover; the score of all flights comes first, followed by
    that of each kind. `rows` are the evaluations so far and `best` is the policy file of the best one.
    """

    def __init__(self, config: TrainConfig):
        self.rows: list[dict] = []
        self.best: bytes | None = None
        self.task, self.seed = ppo.build_task(config), _SEED + config.seed
        count = EVALUATION_STARTS if config.success is None else ENDING_STARTS
        if config.randomise is not None:
            count += count // (NOMINAL_EVERY - 1)
        options: dict[str, Any] = {"threads": config.threads, **self.task.plant_options}
        if config.randomise is not None:
            pool = read_ranges(config.randomise).each_alone(self.task.vehicle)
            options |= ppo.pool_options(pool, self.seed)
        self.plant = make_plant("hybrid", count, self.task.vehicle, **options)
        # Flights of the pool's vehicles, if there is one.
        self.is_varied = np.arange(count) % NOMINAL_EVERY > 0
        if self.plant.pool:
            varied = np.flatnonzero(self.is_varied)
            self.plant.assign(varied, 1 + np.arange(len(varied)) % len(self.plant.pool))
        if is_path(config.task):
            self.rehearse()

    def evaluate(self, learner: Learner) -> dict:
        """Fly the learner's deterministic policy, keep the file of the best one, and return the score."""
        learner.clock.switch("evaluation")
        with learner.averaged():
            score = self.fly(learner.policy(self.task), len(self.rows))
        if not self.rows or score["score"] >= max(row["score"] for row in self.rows):
            self.best = learner.policy_file()
            storage.write_bytes(learner.config.folder / "best.zip", self.best)
        self.rows.append({"steps": learner.steps, **learner.clock.columns(), **score})
        learner.clock.switch("training")
        return score

    @property
    def last_in_words(self) -> str:
        """The last evaluation in a few words; empty before the first one."""
        return self.words(self.rows[-1]) if self.rows else ""

    def starts(self, number: int) -> Start:
        """Return the starts of one of the run's evaluations, numbered from 0."""
        starts = self.task.evaluation_starts(np.random.default_rng([self.seed, number]), self.plant.n)
        starts.state[:, LAG] *= self.plant.hover_share
        return starts

    def fly(self, policy: Policy, number: int) -> dict:
        """Return the task's score of flights from the starts of one of the run's evaluations."""
        task, starts = self.task, self.starts(number)
        flights = record_flights(
            policy, self.plant, starts, steps=task.judged_steps, contact_limit=task.contact_limit
        )
        score = self.task.score(flights)
        if self.plant.pool:
            for kind, chosen in (("nominal", ~self.is_varied), ("varied", self.is_varied)):
                some = [flights[k] for k in np.flatnonzero(chosen)]
                score |= {kind_column(name, kind): value for name, value in self.task.score(some).items()}
        return score

    def words(self, score: dict) -> str:
        """Return a result of `score` in a few words; for a randomised run, for both kinds of vehicles."""
        if not self.plant.pool:
            return self.task.score_words(score)
        parts = []
        for kind, name in VEHICLE_KINDS.items():
            columns = {column: kind_column(column, kind) for column in score}
            of_kind = {column: score[own] for column, own in columns.items() if own in score}
            parts.append(f"{self.task.score_words(score | of_kind)} ({name})")
        return ", ".join(parts)

    def rehearse(self) -> None:
        """Call the methods that evaluation needs, on two flights of 20 steps; raises TaskError."""
        task = self.task
        idle = SimpleNamespace(task=task, predict=lambda seen: np.zeros((len(seen), len(task.action_names))))
        try:
            plant = make_plant("hybrid", 2, task.vehicle, threads=1, **task.plant_options)
            starts = task.evaluation_starts(np.random.default_rng(0), 2)
            flights = record_flights(idle, plant, starts, steps=min(20, task.judged_steps or 20))
            task.score_words(task.score(flights))
            task.flight_words(flights[0])
        except (UserError, MemoryError, FloatingPointError):
            raise
        except Exception as error:
            reason = blame(error) or f"{type(error).__name__}: {shown(error, 120)}"
            raise TaskError(f"task {task.name} does not fit the interface of tasks: {reason}") from error
