"""Callbacks between the iterations of a training: curriculum, curves, evaluation, checkpoints, progress."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from torch.optim.swa_utils import AveragedModel

from inclined_landing.envs.shared.progress import Tick
from inclined_landing.models.base.errors import UserError
from inclined_landing.train.curriculum import Curriculum

LEAST_RATE = 1e-3  # least learning rate, as a share of the initial one
# Parts of the names of the actor's parameters in SB3's `ActorCriticPolicy`.
ACTOR = ("policy_net", "action_net", "log_std")


class TimeSpent:
    """Separate seconds of training and evaluation, continued after a resume.

    `cpu` contains the CPU seconds of the process during training, summed over all cores.
    """

    def __init__(self, spent: dict[str, float] | None = None, cpu: float = 0.0):
        self.spent = {"training": 0.0, "evaluation": 0.0, **(spent or {})}
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

    def columns(self) -> dict[str, float]:
        """Return the columns of the tables of a run."""
        return {"training_seconds": self.spent["training"], "cpu_seconds": self.cpu}


class _BetweenRollouts(BaseCallback):
    """A callback with nothing to do in a single step."""

    def _on_step(self) -> bool:
        return True


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
            info = infos[i]
            self.curriculum.episode(info["is_success"], info["episode"]["l"], info.get("start_x", 0.0))
        return True

    def _on_rollout_start(self) -> None:
        divergence = self.model.logger.name_to_value.get("train/approx_kl")  # of the update before
        if divergence is not None:
            self.curriculum.follow(float(divergence))
        if self.curriculum.least_noise:
            self.model.policy.log_std.data.clamp_(min=math.log(self.curriculum.least_noise))

    def _on_rollout_end(self) -> None:
        self.curriculum.advance(self.num_timesteps)
        self._apply()
        for name, value in self.curriculum.log().items():
            self.logger.record(f"curriculum/{name}", value)

    def _apply(self) -> None:
        conditions = self.curriculum.conditions()
        if conditions is not None:
            # SB3 calls methods of its environments by their names.
            self.training_env.env_method("set_conditions", conditions)
        gamma = self.curriculum.gamma(self.num_timesteps)
        self.model.gamma = gamma
        if isinstance(self.model, OnPolicyAlgorithm):
            self.model.rollout_buffer.gamma = gamma
        share = self.curriculum.learning_rate_share(self.num_timesteps, self.total)
        rate = max(self.rate * share * self.curriculum.pace, LEAST_RATE * self.rate)
        self.model.lr_schedule = lambda _: rate  # SB3 asks by the share of steps that remain


class LearningCurve(_BetweenRollouts):
    """Appends one row per iteration to `rows`, for learning.csv; refuses weights that are not finite.

    It also shows the number of environment steps, with the curriculum's level and `notice`, by `tick`.
    """

    def __init__(
        self, rows: list[dict], curriculum: Curriculum, clock: TimeSpent, tick: Tick, most_steps: int
    ):
        super().__init__()
        self.rows, self.curriculum, self.clock = rows, curriculum, clock
        self.tick, self.most_steps = tick, most_steps
        self.notice = ""

    def _on_rollout_start(self) -> None:
        self.check_weights()

    def _on_training_end(self) -> None:
        self.check_weights()

    def check_weights(self) -> None:
        """Raise UserError if a weight of the network is not finite."""
        if not all(bool(tensor.isfinite().all()) for tensor in self.model.policy.parameters()):
            raise UserError(
                f"training diverged at step {self.model.num_timesteps}: the network is no longer finite; "
                "lower --learning-rate, --reward-scale or --log-std-init"
            )

    def _on_rollout_end(self) -> None:
        finished = self.model.ep_info_buffer or []
        mean = {k: float(np.mean([e[k] for e in finished])) if finished else np.nan for k in "rl"}
        self.clock.switch("training")
        self.rows.append(
            {
                "steps": int(self.num_timesteps),
                **self.clock.columns(),
                "episode_reward": mean["r"],
                "episode_length": mean["l"],
                **self.curriculum.log(),
            }
        )
        # The last iteration is a whole one, which may end after the steps that were requested.
        done = min(self.num_timesteps, self.most_steps)
        self.tick(f"level {self.curriculum.level:.2f}{self.notice}", done)


class Averaging(_BetweenRollouts):
    """Updates moving averages of the policy's weights, at the end of a rollout.

    A resumed run begins with a rollout, so that no update is averaged twice.
    """

    def __init__(self, averages: AveragedModel):
        super().__init__()
        self.averages = averages

    def _on_rollout_end(self) -> None:
        self.averages.update_parameters(self.model.policy)


class CriticFirst(_BetweenRollouts):
    """Freezes the actor until `steps` environment steps, so that a new critic does not spoil a good actor."""

    def __init__(self, steps: int):
        super().__init__()
        self.steps = steps

    def _on_rollout_start(self) -> None:
        learns = self.num_timesteps >= self.steps
        for name, parameter in self.model.policy.named_parameters():
            if any(part in name for part in ACTOR):
                parameter.requires_grad_(learns)


class Every(_BetweenRollouts):
    """Calls `action(iteration)` before a rollout, every `interval` iterations from `first` on; 0: never.

    The previous iteration's update is then finished, so that the policy, the vehicles and the random states
    are consistent. An `action` ends the training by an exception.
    """

    def __init__(self, interval: int, action: Callable[[int], None], per_iteration: int, first: int):
        super().__init__()
        self.interval, self.action, self.per_iteration, self.first = interval, action, per_iteration, first

    def _on_rollout_start(self) -> None:
        iteration = self.num_timesteps // self.per_iteration
        if self.interval and iteration >= self.first and iteration % self.interval == 0:
            self.action(iteration)
