"""What happens around the iterations of a training: curriculum, evaluation, checkpoints, video, progress."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from stable_baselines3.common.callbacks import BaseCallback, CallbackList
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm

from inclined_landing.train.curriculum import Curriculum


class Clock:
    """Seconds of training, evaluation and video apart, continued after a resume.

    `cpu` has those that the process computed for the training, on all cores together.
    """

    def __init__(self, spent: dict[str, float] | None = None, cpu: float = 0.0):
        self.spent = {"training": 0.0, "evaluation": 0.0, "video": 0.0, **(spent or {})}
        self.cpu = cpu
        self._name, self._since, self._cpu_since = "training", time.monotonic(), time.process_time()

    def switch(self, name: str) -> None:
        """Charge the time since the last switch, then charge to `name`."""
        now, cpu = time.monotonic(), time.process_time()
        self.spent[self._name] += now - self._since
        if self._name == "training":
            self.cpu += cpu - self._cpu_since
        self._name, self._since, self._cpu_since = name, now, cpu

    def total(self) -> float:
        """Return the seconds charged to anything so far."""
        self.switch(self._name)
        return sum(self.spent.values())


class Iterations(CallbackList):
    """Tells the callbacks in it of whole iterations of `steps` environment steps.

    SB3's off-policy algorithms call every step of all vehicles a rollout. PPO's rollouts are iterations.
    """

    def __init__(self, callbacks: list[BaseCallback], steps: int):
        super().__init__(callbacks)
        self.steps = steps

    def _on_rollout_start(self) -> None:
        if self.num_timesteps % self.steps == 0:
            super()._on_rollout_start()

    def _on_rollout_end(self) -> None:
        if self.num_timesteps % self.steps == 0:
            super()._on_rollout_end()
            if isinstance(self.model, OffPolicyAlgorithm):  # others do it themselves
                self.model.dump_logs()


class CurriculumCallback(BaseCallback):
    """Feeds finished episodes to the curriculum and applies its conditions once per rollout."""

    def __init__(self, curriculum: Curriculum, total_steps: int | None, learning_rate: float):
        super().__init__()
        self.curriculum, self.total, self.rate = curriculum, total_steps, learning_rate

    def _on_training_start(self) -> None:
        self._apply()

    def _on_step(self) -> bool:
        infos = self.locals["infos"]
        for i in np.flatnonzero(self.locals["dones"]):
            self.curriculum.episode(infos[i]["is_success"], infos[i]["episode"]["l"])
        return True

    def _on_rollout_end(self) -> None:
        self.curriculum.advance(self.num_timesteps)
        self._apply()
        for name, value in self.curriculum.log().items():
            self.logger.record(f"curriculum/{name}", value)

    def _apply(self) -> None:
        conditions = self.curriculum.conditions()
        if conditions is not None:
            self.training_env.env_method("set_conditions", conditions)
        gamma = self.curriculum.gamma(self.num_timesteps)
        self.model.gamma = gamma
        if isinstance(self.model, OnPolicyAlgorithm):
            self.model.rollout_buffer.gamma = gamma
        share = self.curriculum.learning_rate_share(self.num_timesteps, self.total)
        rate = max(self.rate * share, 1e-3 * self.rate)
        self.model.lr_schedule = lambda _: rate


class CriticFirst(BaseCallback):
    """Leaves the actor alone until `steps` environment steps: a new critic must not spoil a good actor."""

    def __init__(self, steps: int):
        super().__init__()
        self.steps = steps

    def _on_rollout_start(self) -> None:
        learns = self.num_timesteps >= self.steps
        for name, parameter in self.model.policy.named_parameters():
            if any(part in name for part in ("policy_net", "action_net", "log_std")):
                parameter.requires_grad_(learns)

    def _on_step(self) -> bool:
        return True


class Every(BaseCallback):
    """Calls `action(iteration)` before a rollout, every `interval` iterations from `first` on; 0: never.

    At that moment the previous iteration's update is done, so that the policy, the vehicles and the
    random states belong together. `action` returns False to stop the training.
    """

    def __init__(self, interval: int, action: Callable[[int], bool | None], per_iteration: int, first: int):
        super().__init__()
        self.interval, self.action, self.per_iteration, self.first = interval, action, per_iteration, first
        self.stop = False

    def _on_rollout_start(self) -> None:
        iteration = self.num_timesteps // self.per_iteration
        if self.interval and iteration >= self.first and iteration % self.interval == 0:
            self.stop = self.action(iteration) is False

    def _on_step(self) -> bool:
        return not self.stop


class ProgressCallback(BaseCallback):
    """A rich progress bar over environment steps with the curriculum's level beside it."""

    def __init__(self, total_steps: int, curriculum: Curriculum):
        super().__init__()
        self.total, self.curriculum = total_steps, curriculum
        self.notice = ""
        self.finished = False  # did the run come to its end

    def _on_training_start(self) -> None:
        self.bar = Progress(
            TextColumn("training"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[notice]}"),
            console=Console(stderr=True),
        )
        self.bar.start()
        self.item = self.bar.add_task("", total=self.total, notice="", completed=self.num_timesteps)

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        notice = f"level {self.curriculum.level:.2f}{self.notice}"
        done = min(self.num_timesteps, self.total)
        self.bar.update(self.item, completed=done, notice=notice)

    def _on_training_end(self) -> None:
        self.close()

    def close(self) -> None:
        """Stop drawing (also after an interruption)."""
        if getattr(self, "bar", None) is not None:
            done = self.bar.tasks[0].completed
            if self.finished:  # success ends a run before its most steps
                self.bar.update(self.item, total=done)
            self.bar.stop()
