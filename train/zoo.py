"""The hyper-parameters of `landing-train` for rl-baselines3-zoo, and what its environments need besides.

    python -m rl_zoo3.train --algo ppo --env InclinedLanding-v0 --gym-packages inclined_landing \\
        --conf-file inclined_landing.train.zoo --eval-freq -1 --num-threads 1
    landing-eval success logs/ppo/InclinedLanding-v0_1/InclinedLanding-v0.zip --task landing

The zoo steps plain Gymnasium environments one by one, which takes many times as long as `landing-train`.
"""

from __future__ import annotations

from typing import Any

from inclined_landing.envs.ids import TASK_CLASSES
from inclined_landing.envs.tasks import make_task
from inclined_landing.train.callbacks import CurriculumCallback
from inclined_landing.train.config import TrainConfig
from inclined_landing.train.curriculum import make_curriculum
from inclined_landing.train.ppo import ppo_kwargs

_TASKS = {
    "landing": 500_000,
    "setpoint": 1_000_000,
}  # environment steps; a touchdown begins at a landing policy
_ENVIRONMENTS = 16


class TaskCurriculum(CurriculumCallback):
    """The curriculum that a task is trained with by default, for a model that was built elsewhere."""

    def __init__(self, task: str):
        super().__init__(make_curriculum(make_task(task).training.curriculum, task, 1.0), None, 0.0)
        self.task = task

    def _on_training_start(self) -> None:
        name = make_task(self.task).training.curriculum
        self.curriculum = make_curriculum(name, self.task, self.model.gamma)
        self.total, self.rate = self.model._total_timesteps, self.model.lr_schedule(1.0)
        super()._on_training_start()


def scaled(reward: float) -> float:
    """Return a reward as PPO sees it."""
    return TrainConfig.reward_scale * reward


def _parameters(name: str, steps: int) -> dict[str, Any]:
    """Return those of one task: rollouts as long as those of `landing-train`, of fewer environments."""
    task = make_task(name)
    arguments = ppo_kwargs(task)
    arguments["n_steps"] *= task.training.environments // _ENVIRONMENTS
    del arguments["device"]  # an option of the zoo
    engine = {"integrator": task.training.integrator, "keep_out": task.training.keep_out}
    return {
        "n_timesteps": steps,
        "n_envs": _ENVIRONMENTS,
        "policy": "MlpPolicy",
        "env_kwargs": {"plant": TrainConfig.plant, "plant_options": engine},
        "env_wrapper": [{"gymnasium.wrappers.TransformReward": {"func": scaled}}],
        "callback": [{f"{__name__}.{TaskCurriculum.__name__}": {"task": name}}],
        **arguments,
    }


hyperparams = {f"{TASK_CLASSES[name]}-v0": _parameters(name, steps) for name, steps in _TASKS.items()}
