"""`BatchVecEnv`: Stable-Baselines3's view of a `BatchEnv`. All vehicles step in one batch call."""

from __future__ import annotations

import math
import re
import time
from pathlib import Path

import gymnasium as gym
import numpy as np

from inclined_landing.envs.batch import BatchEnv, as_floats, check_seed, reset_option
from inclined_landing.envs.features import ScaledObservation
from inclined_landing.envs.policy import write_metadata
from inclined_landing.envs.spaces import action_space, observation_space
from inclined_landing.envs.tasks.base import OWN, Task
from inclined_landing.models.errors import UserError, optional, shown

with optional():
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env import (
        VecCheckNan,
        VecEnv,
        VecEnvWrapper,
        VecMonitor,
        VecNormalize,
        VecVideoRecorder,
    )

# Wrappers that change neither what a policy observes nor what it commands: of vector environments, and the
# names of those of single ones.
_LOOKING_ON = (VecCheckNan, VecMonitor, VecVideoRecorder)
_LOOKING_ON_ONE = {
    *("Monitor", "TimeLimit", "OrderEnforcing", "PassiveEnvChecker", "Autoreset", "HumanRendering"),
    *("RecordEpisodeStatistics", "RecordVideo", "RenderCollection", "AddRenderObservation"),
    *("TransformReward", "ClipReward", "NormalizeReward"),
}


def save_policy(model, path: str | Path) -> None:
    """Save a Stable-Baselines3 model with the metadata for `load_policy`.

    It was trained on a `BatchVecEnv`, or on environments of `gymnasium.make`. The statistics of a
    `VecNormalize` around these are taken along as they are. Raises UserError for other environments, and for
    wrappers that change what the policy observes or commands.
    """
    if not isinstance(model, BaseAlgorithm):
        raise UserError(f"save_policy takes a Stable-Baselines3 model, not {shown(repr(model), 40)}")
    task, normalisation = _trained_on(model)
    if normalisation is not None and any(isinstance(m, ScaledObservation) for m in model.policy.modules()):
        raise UserError("VecNormalize and ScaledObservation both scale the observations: take one of them")
    model.save(path, exclude=["lr_schedule"])  # perhaps of a callback, and not needed
    action_map = {"pwm_centre": OWN if task.per_vehicle_hover else task.pwm_centre, "pwm_span": task.pwm_span}
    path = Path(path)
    write_metadata(
        path if path.suffix else path.with_suffix(".zip"),
        {
            "task": task.name,
            "task_options": task.options | action_map,
            "algorithm": type(model).__name__,
            "seed": model.seed,
            "steps": int(model.num_timesteps),
            "normalisation": normalisation,
        },
    )


def _trained_on(model: BaseAlgorithm) -> tuple[Task, dict | None]:
    """Return the task of a model's environments, and how `VecNormalize` scales their observations."""
    env, normalisation = model.get_env(), None
    while isinstance(env, VecEnvWrapper):
        if isinstance(env, VecNormalize) and normalisation is None:
            normalisation = _scaling(env) if env.norm_obs else None
        elif not isinstance(env, _LOOKING_ON):
            raise _cannot_follow(type(env).__name__)
        env = env.venv
    if isinstance(env, BatchVecEnv):
        return env.env.task, normalisation
    if env is None:
        raise UserError("the model has no environment: load it with the one that it was trained on, env=...")
    # Of single environments, perhaps in other processes: "<Monitor<TimeLimit<TaskEnv<InclinedLanding-v0>>>>"
    *wrappers, _, _ = re.findall(r"[^<>]+", env.env_method("__str__", indices=0)[0]) or [""] * 2
    for name in wrappers:
        if name not in _LOOKING_ON_ONE:
            raise _cannot_follow(name)
    task = env.get_attr("task", indices=0)[0] if env.has_attr("task") else None
    if not isinstance(task, Task):
        raise UserError("the model was not trained on an environment of this package: it has no task")
    return task, normalisation


def _scaling(env: VecNormalize) -> dict:
    """Return centre, scale and limit of the observations: clip((o - centre)/scale, -limit, limit)."""
    if isinstance(env.obs_rms, dict):
        raise _cannot_follow("VecNormalize of several observations")
    scale = np.sqrt(env.obs_rms.var + env.epsilon)
    return {"centre": env.obs_rms.mean, "scale": scale, "limit": float(env.clip_obs)}


def _cannot_follow(name: str) -> UserError:
    return UserError(
        f"the wrapper {shown(name, 60)} may change what the policy observes or commands, and a policy file "
        "cannot hold it: train without it, or make it part of the task"
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
        self._states: list[np.ndarray | None] = [None] * env.n  # that the next episodes start from
        super().__init__(env.n, observation_space(env.task), action_space(env.task))

    def seed(self, seed: int | None = None):
        """Set the seed of the next reset."""
        check_seed(seed)
        return super().seed(seed)

    def set_options(self, options: dict | list[dict] | None = None) -> None:
        """Set the options of the next reset: of all vehicles, or a list with those of each.

        {"state": start state (13,)}, or of all together (n, 13). Raises UserError for others.
        """
        if isinstance(options, (list, tuple)):
            if len(options) != self.num_envs:
                raise UserError(f"{self.num_envs} vehicles need as many options, not {len(options)}")
            states = [reset_option(one, "state", ("state",)) for one in options]
        else:
            state = reset_option(options, "state", ("state",))
            state = None if state is None else as_floats(state, "the start state")
            each = state is not None and state.ndim == 2
            if each and len(state) != self.num_envs:
                raise UserError(f"{self.num_envs} vehicles need as many start states, not {len(state)}")
            states = list(state) if each else [state] * self.num_envs
        self._states = [None if s is None else as_floats(s, "the start state") for s in states]

    def reset(self) -> np.ndarray:
        """Begin new episodes everywhere; honours `VecEnv.seed` and `set_options`."""
        if self._seeds[0] is not None:
            self.env.seed(self._seeds[0])
        self._reset_seeds()
        states, self._states = self._states, [None] * self.num_envs
        given = np.array([state is not None for state in states])
        observation = self.env.observe() if given.all() else self.env.reset()
        if given.any():
            ids = np.flatnonzero(given)
            sizes = {np.shape(states[i]) for i in ids}
            if len(sizes) > 1:
                raise UserError("the start states of the vehicles are not of one size")
            observation[ids] = self.env.reset(ids, np.stack([states[i] for i in ids]))
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

    def get_attr(self, attr_name, indices=None):
        return [getattr(self, attr_name)] * len(self._indices(indices))

    def set_attr(self, attr_name, value, indices=None) -> None:
        self._check_all(attr_name, indices)
        getattr(self, attr_name)  # AttributeError for one that nothing would read
        setattr(self, attr_name, value)

    def env_method(self, method_name, *method_args, indices=None, **method_kwargs):
        self._check_all(method_name, indices)
        value = getattr(self, method_name)(*method_args, **method_kwargs)
        return [value] * len(self._indices(indices))

    def _check_all(self, name: str, indices) -> None:
        if set(self._indices(indices)) != set(range(self.num_envs)):
            raise UserError(f"{shown(name, 40)} is of all vehicles of the batch: leave indices out")

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper], indices=None) -> list[bool]:
        return [False] * len(self._indices(indices))

    def _indices(self, indices):
        return list(self._get_indices(indices))
