"""`BatchVecEnv`: Stable-Baselines3's view of a `BatchEnv`. All vehicles step in one batch call."""

from __future__ import annotations

import math
import time
from pathlib import Path

import gymnasium as gym
import numpy as np

from inclined_landing.envs.batch import BatchEnv, check_seed
from inclined_landing.envs.policy import write_metadata
from inclined_landing.envs.spaces import action_space, observation_space
from inclined_landing.envs.tasks.base import OWN
from inclined_landing.models.errors import UserError, optional, shown

with optional():
    from stable_baselines3.common.vec_env import VecEnv


def save_policy(model, path: str | Path) -> None:
    """Save a Stable-Baselines3 model trained on a `BatchVecEnv`, with the metadata for `load_policy`."""
    task = model.get_env().env.task
    model.save(path, exclude=["lr_schedule"])  # perhaps of a callback, and not needed
    action_map = {"pwm_centre": OWN if task.per_vehicle_hover else task.pwm_centre, "pwm_span": task.pwm_span}
    write_metadata(
        Path(path).with_suffix(".zip"),
        {
            "task": task.name,
            "task_options": task.options | action_map,
            "algorithm": type(model).__name__,
            "seed": model.seed,
            "steps": int(model.num_timesteps),
        },
    )


class BatchVecEnv(VecEnv):
    """Stable-Baselines3 vector environment with automatic resets and episode statistics.

    `infos[i]` is an empty dictionary except at the end of an episode, where it holds
    `terminal_observation`, `TimeLimit.truncated`, `is_success`, `touched` (was the platform touched)
    and `episode` {r, l, t} as SB3's Monitor writes it. `info_terms=True` adds `reward_terms` to every
    step's info.
    """

    def __init__(self, env: BatchEnv, *, reward_scale: float = 1.0, info_terms: bool = False):
        if not isinstance(env, BatchEnv):
            raise UserError(f"BatchVecEnv takes a BatchEnv, as make_batch gives, not {shown(repr(env), 40)}")
        if not (isinstance(reward_scale, (int, float)) and 0 < reward_scale < math.inf):
            raise UserError(f"reward_scale must be a positive number, not {shown(repr(reward_scale), 40)}")
        self.env = env
        self.reward_scale = reward_scale
        self.info_terms = info_terms
        self.render_mode = None
        self._began = time.monotonic()
        self._actions: np.ndarray | None = None
        super().__init__(env.n, observation_space(env.task), action_space(env.task))

    def seed(self, seed: int | None = None):
        """Set the seed of the next reset."""
        check_seed(seed)
        return super().seed(seed)

    def reset(self) -> np.ndarray:
        """Begin new episodes everywhere; honours `VecEnv.seed`."""
        if self._seeds[0] is not None:
            self.env.seed(self._seeds[0])
        self._reset_seeds()
        self._reset_options()
        return self.env.reset()

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self):
        """Return (observations, rewards, dones, infos) of the actions given to `step_async`."""
        env = self.env
        step = env.step(self._actions)
        infos: list[dict] = [{} for _ in range(self.num_envs)]
        if self.info_terms:
            for i, info in enumerate(infos):
                info["reward_terms"] = {name: float(term[i]) for name, term in step.terms.items()}
        done = step.terminated | step.truncated
        observation = step.observation
        if done.any():
            ids = np.flatnonzero(done)
            seconds = round(time.monotonic() - self._began, 6)
            for i in ids:
                infos[i].update(
                    {
                        "terminal_observation": observation[i].copy(),
                        "TimeLimit.truncated": bool(step.truncated[i]),
                        "is_success": bool(step.success[i]),
                        "touched": bool(env.touched[i]),
                        "episode": {"r": float(env.total[i]), "l": int(env.length[i]), "t": seconds},
                    }
                )
            observation[ids] = env.reset(ids)
        rewards = (self.reward_scale * step.reward).astype(np.float32)
        return observation, rewards, done, infos

    def set_conditions(self, conditions) -> None:
        """Begin the next episodes under the conditions of a curriculum (`train/curriculum.py`)."""
        self.env.task.conditions = conditions

    def close(self) -> None:
        """Do nothing: the plant's threads end with the object."""

    def get_attr(self, attr_name, indices=None):
        return [getattr(self, attr_name)] * len(self._indices(indices))

    def set_attr(self, attr_name, value, indices=None) -> None:
        setattr(self, attr_name, value)

    def env_method(self, method_name, *method_args, indices=None, **method_kwargs):
        value = getattr(self, method_name)(*method_args, **method_kwargs)
        return [value] * len(self._indices(indices))

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper], indices=None) -> list[bool]:
        return [False] * len(self._indices(indices))

    def _indices(self, indices):
        return list(self._get_indices(indices))
