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
import os
import shutil
from collections.abc import Container
from pathlib import Path

import torch
from stable_baselines3.common.logger import Logger

from inclined_landing.envs.policy import Policy
from inclined_landing.envs.save import actor_of, write_policy
from inclined_landing.envs.shared import runs
from inclined_landing.envs.tasks import is_path
from inclined_landing.envs.tasks.guard import TaskError
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.train import checkpoint, ppo, warm_start
from inclined_landing.train.callbacks import (
    Averaging,
    CriticFirst,
    CurriculumCallback,
    Every,
    LearningCurve,
    ProgressCallback,
    TimeSpent,
    with_weights,
)
from inclined_landing.train.checkpoint import Checkpoint
from inclined_landing.train.config import COPIED, ENDING, TrainConfig
from inclined_landing.train.ending import COMPLETE, Ending
from inclined_landing.train.evaluation import PeriodicEvaluation
from inclined_landing.train.events import EventFile
from inclined_landing.train.record import (
    FREE,
    RECORD,
    as_csv,
    cannot_continue,
    changed_entries,
    new_record,
    ranges_of,
    stored,
)

CHECKPOINT = "checkpoint.pt"
VEHICLE = COPIED["vehicle"]
NOT_REACHED = 3  # exit code
TARGET = 0.99  # success that "time to 99 %" means
_BEFORE = {RECORD, *COPIED.values(), "tensorboard"}  # all that a run folder holds before its first checkpoint


def train(config: TrainConfig) -> tuple[Path, dict]:
    """Train with a configuration until the end; return the run folder and the metrics."""
    run = Run(config)
    return run.folder, run.execute()


class _Reached(Exception):
    """Raised when the desired success rate is reached."""


class Run:
    """The state of one training run; `execute` runs it to the end.

    The constructor reads and checks everything, and changes nothing on disk. `metrics` are the results of a
    finished run, otherwise None. given: as in `record.stored`.
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
            self.config, self.record = stored(dataclasses.replace(config, out=self.folder), given)
        else:
            self.config, self.record = resolved, new_record(resolved)
        ppo.check_memory(self.config)
        saved = _read_checkpoint(self.folder) if self.resumed else None
        self.history: list[dict] = []
        self.evaluations: list[dict] = []
        self.best: bytes | None = None  # the policy file of the best evaluation
        self.clock = TimeSpent()
        self.averages: dict[str, torch.Tensor] = {}  # of the weights, by name; none without averaging
        self.begun_at: int | None = None  # the iteration of the checkpoint that was resumed
        self.metrics: dict | None = None
        self._stopped = False
        try:
            self._make(fresh=saved is None)
        except UserError as error:
            if not self.resumed:
                raise
            raise cannot_continue(self.folder / RECORD, error) from error
        if saved is not None:
            self._restore(saved)
        self.ending = Ending(self.config, self.curriculum, self.history, self.evaluations)
        if saved is not None:
            self.metrics = self._finished()

    def _make(self, fresh: bool) -> None:
        """Make vehicles, model, curriculum and evaluation in their initial state."""
        config = self.config
        self.env = ppo.training_environment(config)
        self.task = self.env.env.task
        self.curriculum = ppo.build_curriculum(config)
        self.teacher = None
        if config.start_from and fresh:
            vehicle = load_vehicle(config.vehicle) if config.vehicle is not None else None
            self.teacher = warm_start.teacher(config.start_from, self.task, vehicle)
        self.model = ppo.build_model(config, self.env)
        if isinstance(self.teacher, Policy):
            warm_start.take_over(self.model, self.teacher)
            if self.teacher.task.name == self.task.name:
                self.curriculum.skip()
        self.evaluation = PeriodicEvaluation(config)
        if is_path(config.task):
            self.evaluation.rehearse()

    def _restore(self, saved: Checkpoint) -> None:
        """Set the new model, vehicles and curriculum to a checkpoint; raise UserError if it does not fit."""
        try:
            state = checkpoint.restore(self.model, self.env, saved)
            for name, value in self.record["config"].items():
                if name not in (*FREE, *ENDING) and state.config.get(name, value) != value:
                    raise UserError(f"belongs to another configuration: {name} differs from {RECORD}")
            if state.vehicle != changed_entries(self.task.vehicle):
                raise UserError(f"belongs to a different vehicle than {VEHICLE}")
            if state.ranges != ranges_of(self.config):
                raise UserError(f"belongs to different ranges than {COPIED['randomise']}")
            self.curriculum.restore(state.curriculum)
            self.curriculum.log()
            self.averages = checkpoint.averages(self.model, saved)
            # The last iteration is a whole one, which may end after the steps that were requested.
            if self.config.most_steps() <= state.steps - self.config.per_iteration:
                raise UserError(
                    f"has {state.steps} steps, more than the {self.config.most_steps()} requested"
                )
        except UserError as error:
            raise checkpoint.refused(self.folder / CHECKPOINT, f"cannot be continued: {error}") from error
        except (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
            why = "cannot be continued: its numbers do not fit together"
            raise checkpoint.refused(self.folder / CHECKPOINT, why) from error
        self.history, self.evaluations, self.best = state.history, state.evaluations, saved.best
        self.clock = TimeSpent(state.spent, state.cpu)
        self.begun_at = state.steps // self.config.per_iteration

    def execute(self) -> dict:
        """Train to the end (or the wall-time limit) and return the metrics."""
        with runs.owned(self.folder, RECORD if self.resumed else None):
            storage.remove_parts(self.folder)
            if self.metrics is not None:
                return self.metrics
            try:
                self._prepare_folder()
                if self.begun_at is None and self.teacher is not None:
                    warm_start.teach(self.model, self.env.env, self.teacher, self.config.seed)
                self._learn()
                return self._end()
            except TaskError as error:
                after, folder = self.model.num_timesteps, shown(self.folder, 100)
                raise UserError(
                    f"{error}; after {after} steps; {folder} has a checkpoint: correct the task and continue "
                    "with --resume"
                ) from error

    def _prepare_folder(self) -> None:
        """Write the first files of a new run, or restore the folder to its content at the checkpoint."""
        storage.write_json(self.folder / RECORD, self.record)
        if self.begun_at is None:  # new, or stopped before the first checkpoint
            for file, source in self.config.copied().items():
                if source != self.folder / file:
                    storage.write_bytes(self.folder / file, source.read_bytes())
            shutil.rmtree(self.folder / "tensorboard", ignore_errors=True)
            return
        (self.folder / "metrics.json").unlink(missing_ok=True)
        self._write_histories()
        if self.best is not None:
            storage.write_bytes(self.folder / "best.zip", self.best)

    def _learn(self) -> None:
        """Train until the end, with all callbacks."""
        config, model = self.config, self.model
        self.progress = progress = ProgressCallback(config.most_steps(), self.curriculum)
        assert config.learning_rate is not None and config.evaluate_every is not None
        first = 0 if self.begun_at is None else self.begun_at + 1

        def every(interval: int, action, least: int = 1) -> Every:
            return Every(interval, action, self.config.per_iteration, max(least, first))

        callbacks = [
            CurriculumCallback(self.curriculum, config.steps, config.learning_rate),
            LearningCurve(self.history, self.curriculum, self.clock),
            Averaging(self.averages, self.curriculum.averaging),
            progress,
            every(config.evaluate_every, self._evaluate_or_end),
            every(config.checkpoint_every, self.checkpoint, least=0),
        ]
        if config.start_from:
            callbacks.append(CriticFirst(warm_start.CRITIC_FIRST))
        if config.max_seconds is not None:
            callbacks.append(every(1, self._in_time))
        resumed_at = None if self.begun_at is None else model.num_timesteps
        model.set_logger(Logger(str(self.folder), [EventFile(self.folder / "tensorboard", resumed_at)]))
        begun = model.num_timesteps
        remaining = 0 if self.ending.reached(begun) else config.most_steps() - begun
        whole = math.ceil(remaining / self.config.per_iteration) * self.config.per_iteration
        reached = False
        self.clock.switch("training")
        try:
            if remaining > 0:
                model.learn(whole, callbacks, log_interval=1, reset_num_timesteps=self.begun_at is None)
        except _Reached:  # before a rollout: policy, vehicles and random states belong together
            reached = True
        finally:
            progress.close(reached)
            model.logger.close()

    def _evaluate_or_end(self, iteration: int) -> None:
        if self.config.success is not None:
            if self.curriculum.level < COMPLETE:
                return  # policies that have not seen the whole task fail at it, at length
            if self.config.randomise is not None and not self.curriculum.is_ready(self.model.num_timesteps):
                return  # the share of varied vehicles still rises
        self.evaluate()
        if self.ending.reached(self.model.num_timesteps):
            raise _Reached
        if self.ending.has_stalled():
            self.curriculum.learn_again()

    def evaluate(self) -> None:
        """Fly the deterministic policy from the evaluation's starts: hybrid plant, no training aids."""
        self.clock.switch("evaluation")
        with with_weights(self.model.policy, self.averages):
            score = self.evaluation.score(self._policy(), len(self.evaluations))
        if not self.evaluations or score["score"] >= max(e["score"] for e in self.evaluations):
            self.best = self.policy_file()
            storage.write_bytes(self.folder / "best.zip", self.best)
        self.evaluations.append({"steps": int(self.model.num_timesteps), **self.clock.columns(), **score})
        for name, value in score.items():
            self.model.logger.record(f"evaluation/{name}", value)
        self.progress.notice = f", evaluation {self._words()}"
        self.clock.switch("training")

    def _words(self) -> str:
        """Return the last evaluation in a few words; empty before the first one."""
        return self.evaluation.words(self.evaluations[-1]) if self.evaluations else ""

    def checkpoint(self, iteration: int) -> None:
        """Write everything needed to continue to one file, atomically; then write the curves."""
        numbers, arrays = checkpoint.training_state(self.model, self.env)
        arrays |= {f"{checkpoint.AVERAGE}{name}": tensor.numpy() for name, tensor in self.averages.items()}
        state = numbers | {
            "config": self._as_recorded(),
            "vehicle": changed_entries(self.task.vehicle),
            "ranges": ranges_of(self.config),
            "curriculum": self.curriculum.state(),
            "history": self.history,
            "evaluations": self.evaluations,
            "spent": dict(self.clock.spent),
            "cpu": self.clock.cpu,
        }
        checkpoint.write(self.folder / CHECKPOINT, Checkpoint(state, arrays, self.best))
        self._write_histories()

    def _in_time(self, iteration: int) -> bool:
        """Return False, after writing a checkpoint, if the wall time is used up."""
        if self.clock.total() < (self.config.max_seconds or math.inf):
            return True
        self.checkpoint(iteration)
        self._stopped = True
        return False

    def _end(self) -> dict:
        """Write the last evaluation, checkpoint, policy and metrics, and return the metrics."""
        self.clock.switch("evaluation")
        steps = self.model.num_timesteps
        evaluated = self.evaluations and self.evaluations[-1]["steps"] == steps
        if self.config.evaluate_every and not evaluated:
            self.evaluate()
        if not self._stopped:  # then the checkpoint lies at the beginning of the dropped rollout
            self.checkpoint(math.ceil(steps / self.config.per_iteration))
        storage.write_bytes(self.folder / "final.zip", self.policy_file())
        self.clock.switch("training")
        best = max(self.evaluations, key=lambda e: e["score"], default=None)
        metrics = {
            "finished": self.ending.is_over(steps),
            "reached": None if self.config.success is None else self.ending.reached(steps),
            "ended": self.ending.words(steps, self._words()),
            "steps": int(steps),
            "seconds": {name: round(value, 2) for name, value in self.clock.spent.items()},
            "cpu_seconds": round(self.clock.cpu, 2),
            "steps_per_second": steps / max(1e-9, self.clock.spent["training"]),
            "evaluations": {
                "starts": self.evaluation.plant.n,
                "final": self.evaluations[-1] if self.evaluations else None,
                "best": best,
                "first_at_99_percent": next((e for e in self.evaluations if e["score"] >= TARGET), None),
            },
            "seed": self.config.seed,
            "config": self._as_recorded(),
            "versions": runs.versions(),
        }
        storage.write_json(self.folder / "metrics.json", metrics)
        return metrics

    def _finished(self) -> dict | None:
        """Return metrics.json of a finished run, otherwise None."""
        if not (self.folder / "final.zip").is_file() or not self.ending.is_over(self.model.num_timesteps):
            return None
        try:
            metrics = storage.read_json(self.folder / "metrics.json", "file")
        except UserError:
            return None
        if not isinstance(metrics, dict) or metrics.get("finished") is not True:
            return None
        return metrics | {"config": self._as_recorded()}

    def policy_file(self) -> bytes:
        """Return the present policy with its metadata, as a file."""
        config = self.config
        metadata = {
            "task": self.task.name,
            **({"task_from": config.task} if is_path(config.task) else {}),
            "task_options": self.task.options,
            "plant": config.plant,
            "algorithm": "PPO",
            "curriculum": self.curriculum.name,
            "seed": config.seed,
            "steps": int(self.model.num_timesteps),
            **({"vehicle": changed_entries(self.task.vehicle)} if config.vehicle is not None else {}),
            **({"ranges": ranges_of(config)} if config.randomise is not None else {}),
            **{name: value for name, value in self.record.items() if name != "config"},
        }
        with storage.scratch(self.folder / "policy.zip") as path:
            with with_weights(self.model.policy, self.averages):
                write_policy(self.model, path, metadata, actor_of(self.model))
            return path.read_bytes()

    def _policy(self) -> Policy:
        """Return the present policy for evaluation."""
        task, path = self.evaluation.task, self.folder / "final.zip"
        return Policy(task=task, metadata={}, path=path, **actor_of(self.model))

    def _as_recorded(self) -> dict:
        """Return the configuration in run.json, with the time limit of this command."""
        return self.record["config"] | {"max_seconds": self.config.max_seconds}

    def _write_histories(self) -> None:
        for name, rows in (("learning", self.history), ("evaluations", self.evaluations)):
            storage.write_text(self.folder / f"{name}.csv", as_csv(rows))


def _read_checkpoint(folder: Path) -> Checkpoint | None:
    """Return the checkpoint of the run to resume; None if it was stopped before the first one."""
    if os.path.lexists(folder / CHECKPOINT):
        return checkpoint.read(folder / CHECKPOINT)
    if others := {p.name for p in folder.iterdir() if not storage.is_part(p)} - _BEFORE:
        raise UserError(
            f"nothing to resume: {folder} lacks its {CHECKPOINT}, though it holds {min(others)}; "
            "start a new run with another --out"
        )
    return None
