"""One training run: from a configuration to a run folder that holds everything about it.

run.json         resolved configuration, command, versions
vehicle.toml     the vehicle file, if one was given
learning.csv     one row per iteration; the same curves stand in tensorboard/
evaluations.csv  one row per periodic evaluation, in the plain plant, on starts of its own
checkpoint.pt    for --resume: policy, optimizer, vehicles, random states, histories
best.zip         the policy of the best periodic evaluation
final.zip        the policy at the end; this is the result
videos/          one flight every --video-every iterations
metrics.json     what the run reached
"""

from __future__ import annotations

import dataclasses
import io
import json
import math
import shlex
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure

from inclined_landing.envs.flights import record_flight, record_flights
from inclined_landing.envs.policy import Policy, load_policy, stamp
from inclined_landing.envs.tasks import task_class
from inclined_landing.eval.base import runs
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import make_plant
from inclined_landing.train import ppo, warm_start
from inclined_landing.train.callbacks import Clock, CriticFirst, CurriculumCallback, Every, ProgressCallback
from inclined_landing.train.config import TrainConfig
from inclined_landing.train.curriculum import make_curriculum

CHECKPOINT = "checkpoint.pt"
VEHICLE = "vehicle.toml"
EVALUATION_STARTS = 64
TARGET = 0.99  # success that "time to 99 %" means


class Run:
    """The state of one training run; `execute` carries it to its end."""

    def __init__(self, config: TrainConfig):
        config = config.resolved()
        if config.resume:
            config = self._stored(config)
        else:
            runs.check_new_run(config.out)
        self.config = config
        teacher = None
        if config.start_from:
            vehicle = load_vehicle(config.vehicle) if config.vehicle is not None else None
            wanted = task_class(config.task).training.start_from
            teacher = load_policy(config.start_from, wanted, vehicle=vehicle)
        self.env = ppo.training_environment(config)
        self.curriculum = make_curriculum(config.curriculum, config.task, config.gamma)
        if not config.resume:
            self.model = ppo.build_model(config, self.env)
            if teacher is not None:
                warm_start.take_over(self.model, teacher)
        self.folder = runs.new_run(config.out, resumable=CHECKPOINT if config.resume else None)
        self._stopped = False
        self.history: list[dict] = []
        self.evaluations: list[dict] = []
        spent = None
        if config.resume:
            saved = torch.load(self.folder / CHECKPOINT, weights_only=False)
            self.curriculum.restore(saved["curriculum"])
            self.history, self.evaluations = saved["history"], saved["evaluations"]
            spent = saved["spent"]
            self.model = ppo.restore_model(io.BytesIO(saved["policy"]), saved["training"], self.env)
        else:
            if teacher is not None:
                warm_start.teach(self.model, self.env.env, teacher, config.seed)
            if config.vehicle is not None:
                storage.write_text(self.folder / VEHICLE, config.vehicle.read_text("utf-8"))
            storage.write_json(self.folder / "run.json", self._record())
        self.clock = Clock(spent)
        self._judge = _Judge(config, self.env.env.task.vehicle)

    @staticmethod
    def _stored(config: TrainConfig) -> TrainConfig:
        """The configuration of the run to resume; only the wall-time limit is taken anew."""
        if not (config.out / CHECKPOINT).is_file():
            raise UserError(f"nothing to resume: {config.out} holds no {CHECKPOINT}")
        stored = json.loads((config.out / "run.json").read_text("utf-8"))["config"]
        stored |= {"out": config.out, "resume": True, "max_seconds": config.max_seconds}
        if stored.get("vehicle") is not None:
            stored["vehicle"] = config.out / VEHICLE
        return TrainConfig(**stored)

    def _record(self) -> dict:
        return {
            "config": self.config.as_json(),
            "command": shlex.join(["landing-train", *sys.argv[1:]]),
            "versions": runs.versions(),
        }

    def execute(self) -> dict:
        """Train to the end (or the wall-time limit) and return the metrics."""
        config, model = self.config, self.model
        per_iteration = config.environments * config.rollout
        progress = ProgressCallback(config.steps, self.curriculum)
        self.progress = progress

        def every(interval, action):
            return Every(interval, action, per_iteration)

        callbacks = [
            CurriculumCallback(self.curriculum, config.steps, config.learning_rate),
            _History(self),
            progress,
            every(config.evaluate_every, self.evaluate),
            every(config.video_every, self.film),
            every(config.checkpoint_every, self.checkpoint),
        ]
        if config.start_from:
            callbacks.append(CriticFirst(warm_start.CRITIC_FIRST))
        if config.max_seconds is not None:
            callbacks.append(every(1, self._in_time))
        model.set_logger(configure(str(self.folder / "tensorboard"), ["tensorboard"]))
        remaining = config.steps - model.num_timesteps
        self.clock.switch("training")
        try:
            if remaining > 0:
                model.learn(remaining, callbacks, reset_num_timesteps=not config.resume)
        finally:
            progress.close()
            model.logger.close()
        self.clock.switch("evaluation")
        finished = model.num_timesteps >= config.steps
        if config.evaluate_every:
            self.evaluate(math.ceil(model.num_timesteps / per_iteration))
        if not self._stopped:  # then the checkpoint lies at the beginning of the dropped rollout
            self.checkpoint(0)
        self.save_policy(self.folder / "final.zip")
        self.clock.switch("training")
        return self._metrics(finished)

    def save_policy(self, path: Path) -> None:
        """Write the present policy with its stamp."""
        with storage.atomic(path) as part:
            ppo.save_model(self.model, part)
            stamp(part, self.stamp())

    def stamp(self) -> dict:
        """What a policy file says of itself."""
        config = self.config
        return {
            "task": config.task,
            "task_options": self.env.env.task.options,
            "plant": config.plant,
            "curriculum": self.curriculum.name,
            "seed": config.seed,
            "steps": int(self.model.num_timesteps),
            **self._vehicle_stamp(),
            **{k: v for k, v in self._record().items() if k != "config"},
        }

    def _vehicle_stamp(self) -> dict:
        """Where the vehicle is not the shipped one: its name and what differs."""
        if self.config.vehicle is None:
            return {}
        shipped, own = (dataclasses.asdict(v) for v in (load_vehicle(), self.env.env.task.vehicle))
        changed = {field: value for field, value in own.items() if value != shipped[field]}
        return {"vehicle": changed}

    def evaluate(self, iteration: int) -> None:
        """Fly the deterministic policy in the plain plant from the run's own evaluation starts."""
        self.clock.switch("evaluation")
        result = self._judge(self._policy())
        row = {
            "steps": int(self.model.num_timesteps),
            "training_seconds": self.clock.spent["training"],
            **result,
        }
        if not self.evaluations or result["score"] >= max(e["score"] for e in self.evaluations):
            self.save_policy(self.folder / "best.zip")
        self.evaluations.append(row)
        for name, value in result.items():
            self.model.logger.record(f"evaluation/{name}", value)
        self.progress.notice = f", evaluation {self._judge.task.score_words(result)}"
        self.clock.switch("training")

    def film(self, iteration: int) -> None:
        """A video of one flight."""
        from inclined_landing.eval.pictures.video import render_flight, write_video

        self.clock.switch("video")
        policy = self._policy()
        plant = make_plant("mujoco", 1, policy.task.vehicle)
        flight = record_flight(policy, plant, self._judge.film_start)
        (self.folder / "videos").mkdir(exist_ok=True)
        frames = render_flight(flight, camera="hero")
        write_video(self.folder / "videos" / f"iteration_{iteration:04d}.mp4", frames)
        self.clock.switch("training")

    def _in_time(self, iteration: int) -> bool:
        """False, with a checkpoint, when the wall time is used up."""
        if self.clock.total() < self.config.max_seconds:
            return True
        self.checkpoint(iteration)
        self._stopped = True
        return False

    def checkpoint(self, iteration: int) -> None:
        """Everything that a continuation needs, in one file that appears whole."""
        buffer = io.BytesIO()
        ppo.save_model(self.model, buffer)
        saved = {
            "policy": buffer.getvalue(),
            "training": ppo.training_state(self.model, self.env),
            "curriculum": self.curriculum.state(),
            "history": self.history,
            "evaluations": self.evaluations,
            "spent": dict(self.clock.spent),
        }
        with storage.atomic(self.folder / CHECKPOINT) as part:
            torch.save(saved, part)
        for name, rows in (("learning", self.history), ("evaluations", self.evaluations)):
            storage.write_text(self.folder / f"{name}.csv", pd.DataFrame(rows).to_csv(index=False))

    def _policy(self) -> Policy:
        path = self.folder / ".current.zip"
        ppo.save_model(self.model, path)
        try:
            return load_policy(path, self._judge.task)
        finally:
            path.unlink()

    def _metrics(self, finished: bool) -> dict:
        reached = [e for e in self.evaluations if e["score"] >= TARGET]
        return {
            "finished": finished,
            "steps": int(self.model.num_timesteps),
            "seconds": {name: round(value, 2) for name, value in self.clock.spent.items()},
            "steps_per_second": self.model.num_timesteps / max(1e-9, self.clock.spent["training"]),
            "evaluations": {
                "starts": EVALUATION_STARTS,
                "final": self.evaluations[-1] if self.evaluations else None,
                "best": max(self.evaluations, key=lambda e: e["score"], default=None),
                "first_at_99_percent": reached[0] if reached else None,
            },
            "seed": self.config.seed,
            "config": self.config.as_json(),
            "versions": runs.versions(),
        }


class _Judge:
    """Periodic evaluation: random starts of a stream of its own, plain MuJoCo plant, RK4."""

    def __init__(self, config: TrainConfig, vehicle):
        self.task = ppo.build_task(config)
        rng = np.random.default_rng(ppo.evaluation_seed(config))
        start = self.task.evaluation_starts(rng, EVALUATION_STARTS)
        self.starts = start.state
        self.plant = make_plant("mujoco", EVALUATION_STARTS, vehicle, threads=config.threads)
        if start.contact is not None:
            self.plant.set_contact(np.arange(EVALUATION_STARTS), **start.contact)
        self.film_start = self.task.states_at(self.task.film_starts[:1])

    def __call__(self, policy: Policy) -> dict:
        flights = record_flights(policy, self.plant, self.starts, steps=self.task.judged_steps)
        return self.task.score(flights)


class _History(BaseCallback):
    """One row per iteration for learning.csv."""

    def __init__(self, run: Run):
        super().__init__()
        self.run = run

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
                "episode_reward": mean["r"],
                "episode_length": mean["l"],
                **self.run.curriculum.log(),
            }
        )


def train(config: TrainConfig) -> tuple[Path, dict]:
    """Run a configuration to its end; returns the run folder and the metrics."""
    run = Run(config)
    metrics = run.execute()
    storage.write_json(run.folder / "metrics.json", metrics)
    return run.folder, metrics
