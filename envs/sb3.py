"""`BatchVecEnv`: a `BatchEnv` as a vector environment of Stable-Baselines3."""

from __future__ import annotations

import math
import time

import gymnasium as gym
import numpy as np

from inclined_landing.envs.batch import BatchEnv, check_seed
from inclined_landing.envs.spaces import action_space, observation_space
from inclined_landing.models.base.errors import UserError, optional, shown

with optional():
    from stable_baselines3.common.vec_env import VecEnv


class BatchVecEnv(VecEnv):
    """Stable-Baselines3 vector environment with automatic resets and episode statistics.

    `infos[i]` is an empty dictionary except at the end of an episode, where it contains
    `terminal_observation`, `TimeLimit.truncated`, `is_success`, `touched` (was the platform touched),
    `start_x` (of its start [m]) and `episode` {r, l, t} as SB3's Monitor writes it.

    Call `torch.set_num_threads(1)` before training: with small networks PyTorch's threads mostly wait for one
    another, on a shared machine more than ten times as long as the computation takes.
    """

    def __init__(self, env: BatchEnv, *, reward_scale: float = 1.0):
        if not isinstance(env, BatchEnv):
            raise UserError(
                f"BatchVecEnv takes a BatchEnv, as make_batch returns, not {shown(repr(env), 40)}"
            )
        if not (isinstance(reward_scale, (int, float)) and 0 < reward_scale < math.inf):
            raise UserError(f"reward_scale must be a positive number, not {shown(repr(reward_scale), 40)}")
        self.env = env
        self.reward_scale = reward_scale
        self.render_mode = None
        self._began = time.monotonic()
        self._actions: np.ndarray | None = None
        super().__init__(env.n, observation_space(env.task), action_space(env.task))

    def seed(self, seed: int | None = None):
        """Set the seed of the next reset."""
        check_seed(seed)
        return super().seed(seed)

    def set_options(self, options: dict | list[dict] | None = None) -> None:
        """Raise UserError: `BatchEnv.reset` starts vehicles from given states, as in `env.env.reset`."""
        if options:
            raise UserError("a BatchVecEnv has no options of a reset; start from states with env.env.reset")

    def reset(self) -> np.ndarray:
        """Begin new episodes of all vehicles; honours `VecEnv.seed`."""
        if self._seeds[0] is not None:
            self.env.seed(self._seeds[0])
        self._reset_seeds()
        return self.env.reset()

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self):
        """Return (observations, rewards, dones, infos) of the actions given to `step_async`."""
        env = self.env
        step = env.step(self._actions)
        infos: list[dict] = [{} for _ in range(self.num_envs)]
        done = step.terminated | step.truncated
        observation = step.observation
        if done.any():
            ids = np.flatnonzero(done)
            seconds, starts = round(time.monotonic() - self._began, 6), env.start_x
            for i in ids:
                infos[i].update(
                    {
                        "terminal_observation": observation[i].copy(),
                        "TimeLimit.truncated": bool(step.truncated[i]),
                        "is_success": bool(step.success[i]),
                        "touched": bool(env.touched[i]),
                        "start_x": float(starts[i]),
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

    def get_images(self) -> list[None]:
        """Return no pictures; single environments of `gymnasium.make` render."""
        return [None] * self.num_envs

    def get_attr(self, attr_name, indices=None):
        return [getattr(self, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name, value, indices=None) -> None:
        """Set an attribute of all vehicles.

        Raises UserError for a subset of them, AttributeError if there is no such attribute.
        """
        self._check_all(attr_name, indices)
        getattr(self, attr_name)
        setattr(self, attr_name, value)

    def env_method(self, method_name, *method_args, indices=None, **method_kwargs):
        """Call a method for all vehicles together; raise UserError for a subset of them.

        `reset` and `step`, whose results are for the whole batch, must be called directly.
        """
        self._check_all(method_name, indices)
        if method_name in ("reset", "step"):
            raise UserError(
                f"call {method_name} directly, not through env_method, because it acts on all vehicles"
            )
        return [getattr(self, method_name)(*method_args, **method_kwargs)] * self.num_envs

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper], indices=None) -> list[bool]:
        return [False] * len(list(self._get_indices(indices)))

    def _check_all(self, name: str, indices) -> None:
        if set(self._get_indices(indices)) != set(range(self.num_envs)):
            raise UserError(f"{shown(name, 40)} applies to all vehicles of the batch; omit indices")
