"""One training run: from a configuration to a run folder that holds everything about it.

run.json         resolved configuration, command, versions
vehicle.toml     the vehicle file, if one was given
randomise.toml   the file of ranges, if one was given
learning.csv     one row per iteration; the same curves stand in tensorboard/
evaluations.csv  one row per periodic evaluation, hybrid plant, no training aids, own starts
checkpoint.pt    for --resume of PPO: policy, optimizer, vehicles, random states, histories
best.zip         the policy of the best periodic evaluation
final.zip        the policy at the end; this is the result
videos/          one flight every --video-every iterations
metrics.json     what the run reached
"""

from __future__ import annotations

import csv
import dataclasses
import io
import itertools
import json
import math
import os
import shlex
import shutil
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat
from torch.utils.tensorboard import SummaryWriter

from inclined_landing.envs.flights import record_flight, record_flights
from inclined_landing.envs.policy import Policy, load_policy, write_metadata
from inclined_landing.envs.randomise import read_ranges
from inclined_landing.envs.shared import runs
from inclined_landing.envs.tasks import is_path
from inclined_landing.envs.tasks.guard import TaskError
from inclined_landing.models import storage
from inclined_landing.models.attitude import LAG
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import make_plant
from inclined_landing.train import checkpoint, off_policy, ppo, warm_start
from inclined_landing.train.callbacks import (
    Clock,
    CriticFirst,
    CurriculumCallback,
    Every,
    Iterations,
    ProgressCallback,
)
from inclined_landing.train.checkpoint import Checkpoint
from inclined_landing.train.config import COPIED, TrainConfig, flag_of
from inclined_landing.train.curriculum import make_curriculum
from inclined_landing.train.evaluation import look_up
from inclined_landing.train.rehearsal import rehearse

RECORD = "run.json"
CHECKPOINT = "checkpoint.pt"
VEHICLE = COPIED["vehicle"]
EVALUATION_STARTS = 64
ENDING_STARTS = 256  # of evaluations that end a run
RISING = (
    0.01  # share of drawn vehicles that two evaluations land more than the two before, or it rises no more
)
COMPLETE = 1.0 - 1e-9  # level of a curriculum that is
NOT_REACHED = 3  # exit code
TARGET = 0.99  # success that "time to 99 %" means
_FREE = (
    "out",
    "max_seconds",
    "max_cpu_seconds",
    "report",
    "threads",
)  # options that may differ from a checkpoint's
_BEFORE = {RECORD, *COPIED.values(), "tensorboard"}  # all that a run folder holds before its first checkpoint


class _Reached(Exception):
    """The asked success is there."""


class Run:
    """The state of one training run; `execute` carries it to its end.

    Making one reads and checks everything, and changes nothing on disk. `metrics` is what a run that is
    finished reached, otherwise None.
    """

    def __init__(self, config: TrainConfig):
        given, config = config, config.resolved()
        self.folder = config.folder
        self.resumed = config.resume
        if config.resume:
            config, self.record = stored(dataclasses.replace(given, out=config.folder))
        else:
            _check_new(config.folder)
            self.record = _record(config)
        self.config = config
        if config.video_every:
            look_up("film")
        ppo.check_memory(config)
        if is_path(config.task):
            rehearse(config)
        saved = self._read_checkpoint() if self.resumed else None
        try:
            self._make(config, fresh=saved is None)
        except UserError as error:
            if not self.resumed:
                raise
            raise _refused(self.folder / RECORD, error) from error
        if saved is not None:
            self._restore(saved)
        self.metrics = self._finished() if self._begun >= 0 else None

    def _make(self, config: TrainConfig, fresh: bool) -> None:
        """Make vehicles, model, curriculum and evaluator as they are at the beginning."""
        self.env = ppo.training_environment(config)
        self.teacher = None
        if config.start_from and fresh:
            vehicle = load_vehicle(config.vehicle) if config.vehicle is not None else None
            self.teacher = warm_start.teacher(config.start_from, self.env.env.task, vehicle)
        self.curriculum = make_curriculum(
            config.curriculum,
            config.task,
            config.gamma,
            config.without or "",
            drawn=config.randomise is not None and config.dimensions != 3,
        )
        build = ppo.build_model if config.algorithm == "ppo" else off_policy.build_model
        self.model = build(config, self.env)
        if isinstance(self.teacher, Policy):
            warm_start.take_over(self.model, self.teacher)
            if self.teacher.task.name == self.env.env.task.name:
                self.curriculum.skip()
        self.history: list[dict] = []
        self.evaluations: list[dict] = []
        self.best: bytes | None = None  # the policy file of the best evaluation
        self.clock = Clock()
        self._per_iteration = config.environments * config.rollout
        self._begun = -1  # the iteration of the checkpoint that was resumed
        self._stopped = False
        self._judge = _Judge(config, self.env.env.task.vehicle)

    def execute(self) -> dict:
        """Train to the end (or the wall-time limit) and return the metrics."""
        runs.new_run(self.folder, resumable=RECORD if self.resumed else None)
        with runs.held(self.folder):
            storage.remove_parts(self.folder)
            if self.metrics is not None:
                return self.metrics
            try:
                if self._begun >= 0:
                    self._return_to_checkpoint()
                else:
                    self._begin()
                self._learn()
                return self._end()
            except TaskError as error:
                raise UserError(f"{error}; {self._left()}") from error

    def _begin(self) -> None:
        """Begin from nothing, perhaps a run that was stopped before its first checkpoint."""
        if not self.resumed:
            storage.write_json(self.folder / RECORD, self.record)
        for file, given in self.config.copied().items():
            if given != self.folder / file:
                storage.write_text(self.folder / file, given.read_text("utf-8"))
        shutil.rmtree(self.folder / "tensorboard", ignore_errors=True)
        if self.teacher is not None:
            warm_start.teach(self.model, self.env.env, self.teacher, self.config.seed)

    def _return_to_checkpoint(self) -> None:
        """Bring the folder back to what it held at the checkpoint."""
        self._write_histories()
        if self.best is not None:
            storage.write_bytes(self.folder / "best.zip", self.best)
        for video in (self.folder / "videos").glob("iteration_*.mp4"):
            number = video.stem.removeprefix("iteration_")
            if number.isdecimal() and int(number) > self._begun:
                video.unlink()

    def _learn(self) -> None:
        config, model = self.config, self.model
        self.progress = progress = ProgressCallback(config.most_steps(), self.curriculum)

        def every(interval, action, first=1):
            return Every(interval, action, self._per_iteration, max(first, self._begun + 1))

        callbacks = [
            CurriculumCallback(self.curriculum, config.steps, config.learning_rate),
            _History(self),
            progress,
            every(config.evaluate_every, self._evaluate_or_end),
            every(config.video_every, self.film),
        ]
        if config.resumable:
            callbacks.append(every(config.checkpoint_every, self.checkpoint, first=0))
        if config.start_from:
            callbacks.append(CriticFirst(warm_start.CRITIC_FIRST))
        if config.max_seconds is not None or config.max_cpu_seconds is not None:
            callbacks.append(every(1, self._in_time))
        resumed = self._begun >= 0
        curves = TensorBoardOutputFormat(str(self.folder / "tensorboard"))
        if resumed:  # hides what the curves show after the checkpoint
            curves.writer = SummaryWriter(curves.writer.log_dir, purge_step=model.num_timesteps + 1)
        model.set_logger(Logger(str(self.folder), [curves]))
        remaining = 0 if self._reached() else config.most_steps() - model.num_timesteps
        whole = math.ceil(remaining / self._per_iteration) * self._per_iteration
        self.clock.switch("training")
        try:
            if remaining > 0:
                model.learn(
                    whole,
                    Iterations(callbacks, self._per_iteration),
                    log_interval=1 if config.resumable else None,
                    reset_num_timesteps=not resumed,
                )
        except _Reached:  # before a rollout: policy, vehicles and random states belong together
            progress.finished = True
        finally:
            progress.close()
            model.logger.close()

    def _end(self) -> dict:
        """Write the last evaluation, checkpoint, policy and metrics, and return the metrics."""
        self.check_weights()
        self.clock.switch("evaluation")
        steps = self.model.num_timesteps
        judged = self.evaluations and self.evaluations[-1]["steps"] == steps
        if self.config.evaluate_every and not judged:
            self.evaluate(math.ceil(steps / self._per_iteration))
        if not self._stopped:  # then the checkpoint lies at the beginning of the dropped rollout
            self.checkpoint(math.ceil(steps / self._per_iteration))
        storage.write_bytes(self.folder / "final.zip", self.policy_file())
        self.clock.switch("training")
        metrics = self._metrics()
        storage.write_json(self.folder / "metrics.json", metrics)
        return metrics

    def _left(self) -> str:
        """Return a sentence on what is left of a run that cannot go on."""
        steps, folder = self.model.num_timesteps, shown(self.folder, 100)
        if not self.config.resumable:
            return f"{folder} stays as it is after {steps} steps; nothing goes on from it"
        return f"after {steps} steps; {folder} has a checkpoint: with the task corrected, --resume goes on"

    def _finished(self) -> dict | None:
        """Return metrics.json of a run that has come to its end, otherwise None."""
        if not (self.folder / "final.zip").is_file() or not self._over():
            return None
        try:
            metrics = storage.read_json(self.folder / "metrics.json", "file")
        except UserError:
            return None
        if not isinstance(metrics, dict) or metrics.get("finished") is not True:
            return None
        return metrics | {"config": self._as_recorded()}

    def _over(self) -> bool:
        return self._reached() or self.model.num_timesteps >= self.config.most_steps()

    def _reached(self) -> bool:
        """Return whether the last two evaluations, both after the curriculum, reach the success asked for."""
        config, last = self.config, self.evaluations[-2:]
        if config.success is None or len(last) < 2 or self.model.num_timesteps < config.min_steps:
            return False
        complete = {row["steps"] for row in self.history if row["level"] >= COMPLETE}
        which = "score" if config.randomise is None else "score_nominal"
        if not all(e["steps"] in complete and e[which] >= config.success for e in last):
            return False
        if config.randomise is None:
            return True
        drawn = [e["score_drawn"] for e in self.evaluations[-4:]]
        return len(drawn) == 4 and sum(drawn[2:]) <= sum(drawn[:2]) + 2.0 * RISING

    def _ended(self) -> str:
        """Return how the run ended, in one sentence."""
        config, steps = self.config, self.model.num_timesteps
        if config.success is None:
            return f"{'ended' if self._over() else 'stopped'} after {steps} of {config.steps} steps"
        asked = f"two evaluations in a row at {100 * config.success:g} %"
        if config.randomise is not None:
            drawn = f", now {100 * self.evaluations[-1]['score_drawn']:.0f} %," if self.evaluations else ""
            asked += f" on the model's vehicle while the share of drawn ones{drawn} no longer rises"
        if self._reached():
            return f"{asked} after {steps} steps"
        last = f"the last one said {self._judge.task.score_words(self.evaluations[-1])}"
        most = f" of at most {config.max_steps}" if not self._over() else ""
        level = f"the curriculum stood at level {self.curriculum.level:.2f}"
        return f"ended without {asked}: after {steps} steps{most} {last}, and {level}"

    def _as_recorded(self) -> dict:
        """Return the configuration as run.json has it; only the limits of time may be others."""
        limits = ("max_seconds", "max_cpu_seconds")
        return self.record["config"] | {name: getattr(self.config, name) for name in limits}

    def check_weights(self) -> None:
        """Raise UserError when the network has become infinite."""
        if not all(bool(tensor.isfinite().all()) for tensor in self.model.policy.parameters()):
            raise UserError(
                f"training diverged at step {self.model.num_timesteps}: the network is no longer finite; "
                "lower --learning-rate, --reward-scale or --log-std-init"
            )

    def policy_file(self) -> bytes:
        """Return the present policy with its metadata, as a file."""
        with storage.scratch(self.folder / "policy.zip") as path:
            ppo.save_model(self.model, path)
            write_metadata(path, self.metadata())
            return path.read_bytes()

    def metadata(self) -> dict:
        """Return what a policy file says of itself."""
        config = self.config
        return {
            "task": self.env.env.task.name,
            **({"task_from": config.task} if is_path(config.task) else {}),
            "task_options": self.env.env.task.options,
            "plant": config.plant,
            "algorithm": config.algorithm.upper(),
            "curriculum": self.curriculum.name,
            "seed": config.seed,
            "steps": int(self.model.num_timesteps),
            **({"vehicle": self._vehicle()} if self.config.vehicle is not None else {}),
            **({"ranges": self._ranges()} if self.config.randomise is not None else {}),
            **{k: v for k, v in self.record.items() if k != "config"},
        }

    def _vehicle(self) -> dict:
        """Return the entries in which the vehicle is not the shipped one, JSON types only."""
        shipped, own = (dataclasses.asdict(v) for v in (load_vehicle(), self.env.env.task.vehicle))
        return json.loads(storage.to_json({k: value for k, value in own.items() if value != shipped[k]}))

    def _ranges(self) -> dict:
        """Return what differs from episode to episode, as the file says it."""
        return {} if self.config.randomise is None else read_ranges(self.config.randomise).given

    def _evaluate_or_end(self, iteration: int) -> None:
        if self.config.success is not None and self.curriculum.level < COMPLETE:
            return  # policies that have not seen the whole task fail at it, at length
        self.evaluate(iteration)
        if self._reached():
            raise _Reached

    def evaluate(self, iteration: int) -> None:
        """Fly the deterministic policy from the run's own starts: hybrid plant, no training aids."""
        self.clock.switch("evaluation")
        result = self._judge(self._policy())
        row = {
            "steps": int(self.model.num_timesteps),
            "training_seconds": self.clock.spent["training"],
            "cpu_seconds": self.clock.cpu,
            **result,
        }
        if not self.evaluations or result["score"] >= max(e["score"] for e in self.evaluations):
            self.best = self.policy_file()
            storage.write_bytes(self.folder / "best.zip", self.best)
        self.evaluations.append(row)
        for name, value in result.items():
            self.model.logger.record(f"evaluation/{name}", value)
        self.progress.notice = f", evaluation {self._judge.task.score_words(result)}"
        if not self.config.resumable:  # others write them with every checkpoint
            self._write_histories()
        self.clock.switch("training")

    def film(self, iteration: int) -> None:
        """Write a video of one flight."""
        self.clock.switch("video")
        policy = self._policy()
        plant = make_plant("mujoco", 1, policy.task.vehicle, **policy.task.plant_options)
        flight = record_flight(policy, plant, self._judge.film_start)
        (self.folder / "videos").mkdir(exist_ok=True)
        look_up("film")(flight, self.folder / "videos" / f"iteration_{iteration:04d}.mp4")
        self.clock.switch("training")

    def _in_time(self, iteration: int) -> bool:
        """Return False, with a checkpoint, when the wall time or the CPU time is used up."""
        limits = (self.config.max_seconds, self.config.max_cpu_seconds)
        used = (self.clock.total(), self.clock.cpu)
        if not any(limit is not None and time >= limit for time, limit in zip(used, limits)):
            return True
        self.checkpoint(iteration)
        self._stopped = True
        return False

    def checkpoint(self, iteration: int) -> None:
        """Write everything that a continuation needs, in one file that appears whole; then the curves.

        A replay buffer is too large for that: of such a run only the curves.
        """
        if not self.config.resumable:
            self._write_histories()
            return
        numbers, arrays = ppo.training_state(self.model, self.env)
        state = numbers | {
            "config": self._as_recorded(),
            "vehicle": self._vehicle(),
            "ranges": self._ranges(),
            "curriculum": self.curriculum.state(),
            "history": self.history,
            "evaluations": self.evaluations,
            "spent": dict(self.clock.spent),
            "cpu": self.clock.cpu,
        }
        checkpoint.write(self.folder / CHECKPOINT, Checkpoint(state, arrays, self.best))
        self._write_histories()

    def _write_histories(self) -> None:
        for name, rows in (("learning", self.history), ("evaluations", self.evaluations)):
            storage.write_text(self.folder / f"{name}.csv", _csv(rows))

    def _read_checkpoint(self) -> Checkpoint | None:
        """Return the checkpoint of the run to resume; None if it was stopped before the first."""
        path = self.folder / CHECKPOINT
        if os.path.lexists(path):
            return checkpoint.read(path)
        others = {p.name for p in self.folder.iterdir() if not storage.is_part(p)} - _BEFORE
        if others:
            raise UserError(
                f"nothing to resume: {self.folder} lacks its {CHECKPOINT}, though it holds {min(others)}; "
                "begin a new run with another --out"
            )
        return None

    def _restore(self, saved: Checkpoint) -> None:
        """Carry the new model, vehicles and curriculum on to a checkpoint; UserError if it is wrong."""
        state = dict(saved.state)
        own = self.record["config"]
        try:
            checkpoint.check_names(state, _STATE, "it")
            checkpoint.check_names(state["config"], own, "its configuration")
            for name in own:
                if name not in _FREE and state["config"][name] != own[name]:
                    raise UserError(f"belongs to another configuration: {name} differs from {RECORD}")
            if state["vehicle"] != self._vehicle():
                raise UserError(f"belongs to another vehicle than {VEHICLE}")
            if state["ranges"] != self._ranges():
                raise UserError(f"belongs to other ranges than {COPIED['randomise']}")
            ppo.restore(self.model, self.env, state, saved.arrays)
            steps = state["steps"]
            self._restore_histories(state, steps)
            self._restore_curriculum(state["curriculum"])
            checkpoint.check_names(state["spent"], self.clock.spent, "spent")
            for name, seconds in state["spent"].items():
                checkpoint.check_number(seconds, f"spent on {name}", 0, 1e12, whole=False)
            checkpoint.check_number(state["cpu"], "cpu", 0, 1e12, whole=False)
            if (saved.best is None) != (not self.evaluations):
                raise UserError("best.zip and evaluations do not belong together")
            if saved.best is not None:
                _check_policy(saved.best, self.env.env.task.name)
        except UserError as error:
            raise checkpoint.refused(self.folder / CHECKPOINT, f"cannot be continued: {error}") from error
        self.best = saved.best
        self.clock = Clock(state["spent"], state["cpu"])
        self._begun = steps // self._per_iteration

    def _restore_histories(self, state: dict, steps: int) -> None:
        """Restore one row for each iteration until now, and one for each evaluation."""
        common = {"steps", "training_seconds", "cpu_seconds"}
        columns = common | {"episode_reward", "episode_length", *self.curriculum.log()}
        for name in ("history", "evaluations"):
            if not isinstance(state[name], list):
                raise UserError(f"{name} is not a list")
            for row in state[name]:
                if name == "evaluations" and isinstance(row, dict):
                    columns = common | {"score", *state[name][0]}
                checkpoint.check_names(row, columns, f"a row of {name}")
                for column, value in row.items():
                    if value != value and column in ("episode_reward", "episode_length"):
                        continue  # no episode had ended
                    checkpoint.check_number(value, column, -1e300, 1e300, whole=column == "steps")
        self.history, self.evaluations = state["history"], state["evaluations"]
        made = [(k + 1) * self._per_iteration for k in range(len(self.history))]
        if [row["steps"] for row in self.history] != made or steps != len(made) * self._per_iteration:
            raise UserError("history has not one row for each iteration")
        looked = [0, *(row["steps"] for row in self.evaluations)]
        if any(b <= a for a, b in itertools.pairwise(looked)) or looked[-1] > steps:
            raise UserError("evaluations are not in order")

    def _restore_curriculum(self, state) -> None:
        like = self.curriculum.state()
        checkpoint.check_names(state, like, "curriculum")
        for name, value in state.items():
            if isinstance(like[name], list):
                if not isinstance(value, list) or not all(isinstance(x, bool) for x in value):
                    raise UserError(f"curriculum's {name} is not a list of true and false")
            elif not (value is None and like[name] is None):
                whole = not isinstance(like[name], float)
                checkpoint.check_number(value, f"curriculum's {name}", 0, 2**53 if whole else 1, whole)
        self.curriculum.restore(state)

    def _policy(self) -> Policy:
        """Return the present policy, as it will be read from its file."""
        with storage.scratch(self.folder / "current.zip") as path:
            ppo.save_model(self.model, path)
            return load_policy(path, self._judge.task)

    def _metrics(self) -> dict:
        reached = [e for e in self.evaluations if e["score"] >= TARGET]
        return {
            "finished": self._over(),
            "reached": None if self.config.success is None else self._reached(),
            "ended": self._ended(),
            "steps": int(self.model.num_timesteps),
            "seconds": {name: round(value, 2) for name, value in self.clock.spent.items()},
            "cpu_seconds": round(self.clock.cpu, 2),
            "steps_per_second": self.model.num_timesteps / max(1e-9, self.clock.spent["training"]),
            "evaluations": {
                "starts": len(self._judge.starts.state),
                "final": self.evaluations[-1] if self.evaluations else None,
                "best": max(self.evaluations, key=lambda e: e["score"], default=None),
                "first_at_99_percent": reached[0] if reached else None,
            },
            "seed": self.config.seed,
            "config": self._as_recorded(),
            "versions": runs.versions(),
        }


class _Judge:
    """Periodic evaluation: random starts of a stream of its own, hybrid plant in RK4, no training aids.

    Of a randomised run two of three flights have a vehicle of a pool of its own, hovering at first: the score
    is that of all flights, and beside it stands that of either kind.
    """

    def __init__(self, config: TrainConfig, vehicle):
        self.task = ppo.build_task(config)
        rng = np.random.default_rng(ppo.evaluation_seed(config))
        count = EVALUATION_STARTS if config.success is None else ENDING_STARTS
        count += 0 if config.randomise is None else count // 2
        start = self.task.evaluation_starts(rng, count)
        self.starts = start
        drawn = ppo.drawn(config, vehicle, ppo.evaluation_seed(config), 2 * (count // 3))
        self.plant = make_plant(
            "hybrid", count, vehicle, threads=config.threads, **drawn | self.task.plant_options
        )
        if self.plant.pool:
            others = np.flatnonzero(np.arange(count) % 3)
            self.plant.assign(others, 1 + np.arange(len(others)))
            self.starts.state[:, LAG] *= self.plant.hover_share
        self.film_start = self.task.states_at(self.task.film_starts[:1])

    def __call__(self, policy: Policy) -> dict:
        flights = record_flights(policy, self.plant, self.starts, steps=self.task.judged_steps)
        score = self.task.score(flights)
        if self.plant.pool:
            kinds = {
                "score_nominal": flights[::3],
                "score_drawn": [f for k, f in enumerate(flights) if k % 3],
            }
            score |= {name: self.task.score(some)["score"] for name, some in kinds.items()}
        return score


class _History(BaseCallback):
    """One row per iteration for learning.csv."""

    def __init__(self, run: Run):
        super().__init__()
        self.run = run

    def _on_rollout_start(self) -> None:
        self.run.check_weights()

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        finished = self.model.ep_info_buffer or []
        mean = {k: float(np.mean([e[k] for e in finished])) if finished else np.nan for k in "rl"}
        self.run.clock.switch("training")
        self.run.history.append(
            {
                "steps": int(self.num_timesteps),
                "training_seconds": self.run.clock.spent["training"],
                "cpu_seconds": self.run.clock.cpu,
                "episode_reward": mean["r"],
                "episode_length": mean["l"],
                **self.run.curriculum.log(),
            }
        )


def _csv(rows: Sequence[Mapping[str, float]]) -> str:
    """Return rows as CSV; a number that is missing or NaN is empty."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(dict.fromkeys(itertools.chain(*rows))), lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: "" if x != x else x for name, x in row.items()} for row in rows)
    return text.getvalue()


def train(config: TrainConfig) -> tuple[Path, dict]:
    """Run a configuration to its end; returns the run folder and the metrics."""
    run = Run(config)
    return run.folder, run.execute()


_STATE = (
    *("steps", "updates", "start_rng", "numpy_rng", "ended", "successes"),
    *("config", "vehicle", "ranges", "curriculum", "history", "evaluations", "spent", "cpu"),
)


def stored(config: TrainConfig) -> tuple[TrainConfig, dict]:
    """Return configuration and run.json of the run to resume; the limits of time are taken anew."""
    path = config.folder / RECORD
    if os.path.exists(config.folder) and not config.folder.is_dir():
        raise UserError(f"nothing to resume: {config.folder} is a file, not a run folder")
    if not os.path.lexists(path):
        raise UserError(f"nothing to resume: {config.folder} holds no {RECORD}")
    storage.check_folder(config.folder)
    record = storage.read_json(path, "run record", storage.LARGEST)
    try:
        checkpoint.check_names(record, ("config", "command", "versions"), "it")
        names = {field.name for field in dataclasses.fields(TrainConfig)}
        checkpoint.check_names(record["config"], names, "its configuration")
        if not isinstance(record["command"], str) or not isinstance(record["versions"], dict):
            raise UserError("command is not text, or versions no table")
        for package, now in runs.packages().items():
            then = record["versions"].get(package)
            if then != now:
                raise UserError(f"it was begun with {package} {then}, and {now} would go on otherwise")
        given = TrainConfig(**record["config"])
        _check_named(config, given)
        if given.resolved().as_json() != record["config"]:
            raise UserError("its configuration is not as it was written")
    except _NotNamed:
        raise
    except UserError as error:
        raise _refused(path, error) from error
    _check_same(config, given)
    if not given.resumable:
        raise UserError(
            f"{config.folder} was trained with {given.algorithm}, and a replay buffer is not kept: begin a "
            "new run with another --out"
        )
    seconds, cpu_seconds = config.max_seconds, config.max_cpu_seconds
    given = dataclasses.replace(
        given, out=config.folder, max_seconds=seconds, max_cpu_seconds=cpu_seconds, resume=False
    )
    for name, file in COPIED.items():
        copy, first = config.folder / file, getattr(given, name)
        if first is not None:  # its copy, unless the run was stopped before it was made
            setattr(given, name, copy if copy.is_file() else Path(first))
    return given, record


class _NotNamed(UserError):
    """A run folder alone does not have code imported."""


def _check_named(config: TrainConfig, begun: TrainConfig) -> None:
    if is_path(begun.task) and begun.task != config.task:
        task, out = shlex.quote(shown(begun.task, 60)), shlex.quote(str(config.out))
        raise _NotNamed(
            f"{config.out} trains the task {task}; if you trust that code, name it: "
            f"landing-train {task} --resume --out {out}"
        )


def _check_same(config: TrainConfig, begun: TrainConfig) -> None:
    """Raise UserError where options were given with --resume that are not those of the run."""
    for field in dataclasses.fields(TrainConfig):
        asked, own = getattr(config, field.name), getattr(begun, field.name)
        if field.name in (*_FREE, "resume") or asked in (field.default, own) or str(asked) == str(own):
            continue
        was = f"has {shown(own, 40)}" if own is not None else "has none"
        final = shlex.quote(str(config.folder / "final.zip"))
        raise UserError(
            f"--resume goes on with the options of the run, which {was} for {flag_of(field.name)}, not "
            f"{shown(asked, 40)}; begin a new run with another --out, perhaps --from {final}"
        )


def _refused(path: Path, error: UserError) -> UserError:
    """Return the error for a run.json that cannot be continued."""
    why = shown(error, 120)
    return UserError(f"run record {path} cannot be continued: {why}; begin a new run with another --out")


def _check_new(folder: Path) -> None:
    """Raise UserError if `folder` could not become a new run folder."""
    if os.path.isfile(folder / RECORD) and not os.path.isfile(folder / "metrics.json"):
        raise UserError(
            f"the run folder {folder} exists and is not empty; choose another name, or go on with its run: "
            f"landing-train --resume --out {shlex.quote(str(folder))}"
        )
    runs.check_new_run(folder)


def _record(config: TrainConfig) -> dict:
    """Return the content of run.json of a new run."""
    return {
        "config": config.as_json(),
        "command": shlex.join(["landing-train", *sys.argv[1:]]),
        "versions": runs.versions(),
    }


def _check_policy(content: bytes, task: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "best.zip"
        path.write_bytes(content)
        try:
            load_policy(path, task)
        except UserError as error:
            raise UserError("best.zip in it is no policy for the task") from error
