"""`BatchVecEnv`: a `BatchEnv` as a vector environment of Stable-Baselines3."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable

import gymnasium as gym
import numpy as np

from inclined_landing.envs.batch import BatchEnv, as_floats, check_seed, is_whole, reset_option
from inclined_landing.envs.spaces import action_space, observation_space
from inclined_landing.models.base.errors import UserError, optional, shown

with optional():
    from stable_baselines3.common.vec_env import VecEnv


class BatchVecEnv(VecEnv):
    """Stable-Baselines3 vector environment with automatic resets and episode statistics.

    `infos[i]` is an empty dictionary except at the end of an episode, where it contains
    `terminal_observation`, `TimeLimit.truncated`, `is_success`, `touched` (was the platform touched) and
    `episode` {r, l, t} as SB3's Monitor writes it. `info_terms=True` adds `reward_terms` to every step's
    info.

    Call `torch.set_num_threads(1)` before training: with small networks PyTorch's threads mostly wait for one
    another, on a shared machine more than ten times as long as the computation takes.
    """

    def __init__(self, env: BatchEnv, *, reward_scale: float = 1.0, info_terms: bool = False):
        if not isinstance(env, BatchEnv):
            raise UserError(
                f"BatchVecEnv takes a BatchEnv, as make_batch returns, not {shown(repr(env), 40)}"
            )
        if not (isinstance(reward_scale, (int, float)) and 0 < reward_scale < math.inf):
            raise UserError(f"reward_scale must be a positive number, not {shown(repr(reward_scale), 40)}")
        self.env = env
        self.reward_scale = reward_scale
        self.info_terms = info_terms
        self.render_mode = None
        self._began = time.monotonic()
        self._actions: np.ndarray | None = None
        self._states: list[np.ndarray | None] = [None] * env.n  # that the next episodes start from
        super().__init__(env.n, observation_space(env.task), action_space(env.task))

    def seed(self, seed: int | None = None):
        """Set the seed of the next reset."""
        check_seed(seed)
        return super().seed(seed)

    def set_options(self, options: dict | list[dict] | None = None) -> None:
        """Set the options of the next reset: one for all vehicles, or a list with one for each.

        {"state": array} starts from given states, (13,) or (n, 13) for all vehicles. Raises UserError for
        other options.
        """
        if not isinstance(options, (list, tuple)):
            self._states = self._start_states(options, self.num_envs)
        elif len(options) == self.num_envs:
            self._states = [state for one in options for state in self._start_states(one, 1)]
        else:
            raise UserError(f"{self.num_envs} vehicles need {self.num_envs} options, not {len(options)}")

    def _start_states(self, options, n: int) -> list[np.ndarray | None]:
        """Return the start states (13,) of n vehicles in options of a reset, or n times None."""
        state = reset_option(options, "state", ("state",))
        if state is None:
            return [None] * n
        state, size = as_floats(state, "the start state"), self.env.plant.state.shape[1]
        if state.shape not in ((size,), (1, size), (n, size)):
            raise UserError(f"start states must have shape ({size},) or ({n}, {size}), not {state.shape}")
        return list(np.array(np.broadcast_to(state, (n, size))))

    def reset(self) -> np.ndarray:
        """Begin new episodes of all vehicles; honours `VecEnv.seed` and `set_options`."""
        if self._seeds[0] is not None:
            self.env.seed(self._seeds[0])
        self._reset_seeds()
        states, self._states = self._states, [None] * self.num_envs
        chosen = {i: state for i, state in enumerate(states) if state is not None}
        if len(chosen) < self.num_envs:
            observation = self.env.reset()
        if chosen:
            self.env.reset(list(chosen), np.array(list(chosen.values())))
            observation = self.env.observe()
        return observation

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

    def get_images(self) -> list[None]:
        """Return no pictures; single environments of `gymnasium.make` render."""
        return [None] * self.num_envs

    def get_attr(self, attr_name, indices=None):
        return [getattr(self, attr_name)] * len(self._indices(indices))

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
        value = getattr(self, method_name)(*method_args, **method_kwargs)
        return [value] * len(self._indices(indices))

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper], indices=None) -> list[bool]:
        return [False] * len(self._indices(indices))

    def _check_all(self, name: str, indices) -> None:
        if set(self._indices(indices)) != set(range(self.num_envs)):
            raise UserError(f"{shown(name, 40)} applies to all vehicles of the batch; omit indices")

    def _indices(self, indices) -> list[int]:
        every = range(self.num_envs)
        if indices is None:
            return list(every)
        numbers = list(indices) if isinstance(indices, Iterable) else [indices]
        if not all(is_whole(i) and -self.num_envs <= i < self.num_envs for i in numbers):
            raise UserError(
                f"indices must be vehicle numbers below {self.num_envs}, not {shown(repr(indices), 40)}"
            )
        return [every[i] for i in numbers]
