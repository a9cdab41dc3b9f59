"""One training run, from a configuration to a complete run folder.

run.json         resolved configuration, command, versions
vehicle.toml     the vehicle file, if one was given
randomise.toml   the file of ranges, if one was given
from.zip         the policy that it starts from, if one was given
learning.csv     one row per iteration; tensorboard/ contains the same curves
evaluations.csv  one row per periodic evaluation: hybrid plant, no training aids, separate starts
checkpoint.pt    for --resume: policy, optimizer, vehicles, random states, histories
best.zip         the policy of the best periodic evaluation
final.zip        the policy at the end; this is the result
metrics.json     the results of the run
"""

from __future__ import annotations

import dataclasses
import math
import shutil
from collections.abc import Container
from pathlib import Path

from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger

from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.progress import Tick, stages
from inclined_landing.envs.tasks.guard import TaskError
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.train import checkpoint, ppo, warm_start
from inclined_landing.train.callbacks import (
    Averaging,
    CriticFirst,
    CurriculumCallback,
    Every,
    LearningCurve,
)
from inclined_landing.train.config import TrainConfig
from inclined_landing.train.ending import COMPLETE, Ending
from inclined_landing.train.evaluation import PeriodicEvaluation
from inclined_landing.train.events import EventFile
from inclined_landing.train.learner import Learner
from inclined_landing.train.record import RECORD, as_csv, cannot_continue, new_record, run_to_resume

TARGET = 0.99  # success that "time to 99 %" means


def train(config: TrainConfig) -> tuple[Path, dict]:
    """Train with a configuration until the end; return the run folder and the metrics."""
    run = Run(config)
    return run.folder, run.execute()


class _Ended(Exception):
    """Raised by a callback, before a rollout, to leave the model's `learn`."""


class Run:
    """The state of one training run; `execute` runs it to the end.

    The constructor reads and checks everything, and changes nothing on disk. `metrics` are the results of a
    finished run, otherwise None. given: as in `record.run_to_resume`.
    """

    def __init__(self, config: TrainConfig, given: Container[str] = ()):
        resolved = config.resolved()
        self.resumed, self.folder = config.resume, resolved.folder
        try:
            str(self.folder).encode()
        except UnicodeEncodeError as error:
            raise UserError(
                f"the run folder {self.folder} has a name that is not UTF-8, which TensorBoard needs; choose "
                "another name"
            ) from error
        if config.resume:
            self.config, self.record = run_to_resume(dataclasses.replace(config, out=self.folder), given)
        else:
            self.config, self.record = resolved, new_record(resolved)
        ppo.check_memory(self.config)
        saved = checkpoint.of_run(self.folder) if self.resumed else None
        try:
            self.learner = Learner(self.config, self.record, fresh=saved is None)
            self.evaluation = PeriodicEvaluation(self.config)
        except UserError as error:
            if not self.resumed:
                raise
            raise cannot_continue(self.folder / RECORD, error) from error
        self.resumed_at: int | None = None  # the iteration of the checkpoint that was resumed
        if saved is not None:
            checkpoint.resume(saved, self.learner, self.evaluation, self.record["config"])
            self.resumed_at = self.learner.steps // self.config.per_iteration
        # Only now: `checkpoint.resume` replaces both lists of rows, and the ending follows them as they grow.
        learner, rows = self.learner, self.evaluation.rows
        least = self.config.least_steps(learner.task)
        self.ending = Ending(self.config, least, learner.curriculum, learner.history, rows)
        self.metrics = None if saved is None else self._finished()
        self.curve: LearningCurve | None = None

    @property
    def is_reported(self) -> bool:
        """Whether the report of a finished run is written."""
        return self.metrics is not None and runs.REPORTED in self.metrics

    def execute(self) -> dict:
        """Train to the end (or the wall-time limit) and return the metrics."""
        with runs.owned(self.folder, RECORD if self.resumed else None):
            storage.remove_parts(self.folder)
            if self.metrics is not None:
                return self.metrics
            try:
                self._prepare_folder()
                if self.resumed_at is None:
                    self.learner.teach()
                self._learn()
                return self._end()
            except TaskError as error:
                after, folder = self.learner.steps, shown(self.folder, 100)
                raise UserError(
                    f"{error}; after {after} steps; {folder} has a checkpoint: correct the task and continue "
                    "with --resume"
                ) from error

    def _prepare_folder(self) -> None:
        """Write the first files of a new run, or restore the folder to its content at the checkpoint."""
        storage.write_json(self.folder / RECORD, self.record)
        if self.resumed_at is None:  # new, or stopped before the first checkpoint
            for file, source in self.config.copied().items():
                if source != self.folder / file:
                    storage.write_bytes(self.folder / file, source.read_bytes())
            shutil.rmtree(self.folder / "tensorboard", ignore_errors=True)
            return
        (self.folder / "metrics.json").unlink(missing_ok=True)
        self._write_histories()
        if self.evaluation.best is not None:
            storage.write_bytes(self.folder / "best.zip", self.evaluation.best)

    def _learn(self) -> None:
        """Train until the end, in SB3's `learn`: all else, the end of a run too, is done by callbacks."""
        config, learner, model = self.config, self.learner, self.learner.model
        done, resumed = learner.steps, self.resumed_at is not None
        events = EventFile(self.folder / "tensorboard", done if resumed else None)
        model.set_logger(Logger(str(self.folder), [events]))
        remaining = 0 if self.ending.reached(done) else config.most_steps() - done
        whole = math.ceil(remaining / config.per_iteration) * config.per_iteration
        learner.clock.switch("training")
        try:
            if remaining > 0:
                steps = "steps" if config.success is None else "steps at most"
                with stages(config.most_steps(), steps, done) as tick:
                    model.learn(whole, self._callbacks(tick), log_interval=1, reset_num_timesteps=not resumed)
        except _Ended:
            pass
        finally:
            model.logger.close()

    def _callbacks(self, tick: Tick) -> list[BaseCallback]:
        """Return what happens between the iterations, in this order.

        The curve has the new level of the curriculum, and the checkpoint the evaluation; weights that are not
        finite are refused before both.
        """
        config, learner = self.config, self.learner
        assert config.learning_rate is not None and config.evaluate_every is not None
        undone = 0 if self.resumed_at is None else self.resumed_at + 1

        def every(interval: int, action, first: int = 1) -> Every:
            return Every(interval, action, config.per_iteration, max(first, undone))

        self.curve = LearningCurve(
            learner.history, learner.curriculum, learner.clock, tick, config.most_steps()
        )
        callbacks = [
            CurriculumCallback(learner.curriculum, config.steps, config.learning_rate),
            self.curve,
            every(config.evaluate_every, self._evaluate_or_end),
            every(config.checkpoint_every, self.checkpoint, first=0),
        ]
        if learner.averages is not None:
            callbacks.append(Averaging(learner.averages))
        if config.start_from:
            callbacks.append(CriticFirst(warm_start.CRITIC_FIRST))
        return [*callbacks, every(1, self._check_time)]

    def _evaluate_or_end(self, iteration: int) -> None:
        steps, curriculum = self.learner.steps, self.learner.curriculum
        if self.config.success is not None:
            if curriculum.level < COMPLETE:
                return  # policies that have not seen the whole task fail at it, at length
            if self.config.randomise is not None and not curriculum.is_ready(steps):
                return  # the share of varied vehicles still rises
        self.evaluate()
        if self.ending.reached(steps):
            raise _Ended
        if self.ending.has_stalled():
            curriculum.learn_again()
        elif self.ending.should_explore():
            curriculum.explore_again(steps)

    def evaluate(self) -> None:
        """Evaluate the present policy, and log and show its score."""
        score = self.evaluation.evaluate(self.learner)
        for name, value in score.items():
            self.learner.model.logger.record(f"evaluation/{name}", value)
        if self.curve is not None:
            self.curve.notice = f", evaluation {self.evaluation.last_in_words}"

    def checkpoint(self, iteration: int) -> None:
        """Write everything needed to continue to one file, atomically; then write the curves."""
        checkpoint.save(self.learner, self.evaluation, self._as_recorded())
        self._write_histories()

    def _check_time(self, iteration: int) -> None:
        """End the training, after writing a checkpoint, if the wall time is used up."""
        if self.config.max_seconds is not None and self.learner.clock.total() >= self.config.max_seconds:
            self.checkpoint(iteration)
            raise _Ended

    def _end(self) -> dict:
        """Write the last evaluation, checkpoint, policy and metrics, and return the metrics."""
        learner, rows = self.learner, self.evaluation.rows
        learner.clock.switch("evaluation")
        steps = learner.steps
        if self.config.evaluate_every and not (rows and rows[-1]["steps"] == steps):
            self.evaluate()
        if self.ending.is_over(steps):  # else `_check_time` wrote it, before this evaluation
            self.checkpoint(math.ceil(steps / self.config.per_iteration))
        storage.write_bytes(self.folder / "final.zip", learner.policy_file())
        learner.clock.switch("training")
        metrics = {
            "finished": self.ending.is_over(steps),
            "reached": None if self.config.success is None else self.ending.reached(steps),
            "ended": self.ending.words(steps, self.evaluation.last_in_words),
            "steps": steps,
            "seconds": {name: round(value, 2) for name, value in learner.clock.spent.items()},
            "cpu_seconds": round(learner.clock.cpu, 2),
            "steps_per_second": steps / max(1e-9, learner.clock.spent["training"]),
            "evaluations": {
                "starts": self.evaluation.plant.n,
                "final": rows[-1] if rows else None,
                "best": max(rows, key=lambda row: row["score"], default=None),
                "first_at_99_percent": next((row for row in rows if row["score"] >= TARGET), None),
            },
            "seed": self.config.seed,
            "config": self._as_recorded(),
            "versions": runs.versions(),
        }
        storage.write_json(self.folder / "metrics.json", metrics)
        return metrics

    def _finished(self) -> dict | None:
        """Return metrics.json of a finished run, otherwise None."""
        if not (self.folder / "final.zip").is_file() or not self.ending.is_over(self.learner.steps):
            return None
        try:
            metrics = storage.read_json(self.folder / "metrics.json", "file")
        except UserError:
            return None
        if not isinstance(metrics, dict) or metrics.get("finished") is not True:
            return None
        return metrics | {"config": self._as_recorded()}

    def _as_recorded(self) -> dict:
        """Return the configuration in run.json, with the time limit of this command."""
        return self.record["config"] | {"max_seconds": self.config.max_seconds}

    def _write_histories(self) -> None:
        for name, rows in (("learning", self.learner.history), ("evaluations", self.evaluation.rows)):
            storage.write_text(self.folder / f"{name}.csv", as_csv(rows))
