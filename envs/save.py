"""`save_policy`: save a model of Stable-Baselines3 as a policy file, or report what prevents it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium.wrappers as of_gymnasium
import numpy as np

from inclined_landing.envs import policy_file
from inclined_landing.envs.features import ScaledObservation
from inclined_landing.envs.gym_env import TaskEnv
from inclined_landing.envs.history import input_centre, input_scale
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.sb3 import BatchVecEnv
from inclined_landing.envs.spaces import action_space, observation_space
from inclined_landing.envs.tasks.base import OWN, Task
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError, optional, shown

with optional():
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.torch_layers import FlattenExtractor
    from stable_baselines3.common.vec_env import (
        DummyVecEnv,
        SubprocVecEnv,
        VecCheckNan,
        VecEnvWrapper,
        VecMonitor,
        VecNormalize,
        VecVideoRecorder,
    )
    from torch import nn

# Wrappers that change neither what a policy observes nor what it commands, by exact type: of vector
# environments, and of single ones (the last two where they leave the spaces alone).
_HARMLESS = (VecCheckNan, VecMonitor, VecVideoRecorder)
_HARMLESS_OF_ONE = (
    *(Monitor, of_gymnasium.TimeLimit, of_gymnasium.OrderEnforcing, of_gymnasium.PassiveEnvChecker),
    *(of_gymnasium.Autoreset, of_gymnasium.HumanRendering, of_gymnasium.RenderCollection),
    *(of_gymnasium.RecordEpisodeStatistics, of_gymnasium.RecordVideo),
    *(of_gymnasium.TransformReward, of_gymnasium.ClipReward, of_gymnasium.NormalizeReward),
    *(of_gymnasium.FlattenObservation, of_gymnasium.RescaleAction),
)
# What the actors of Stable-Baselines3's algorithms evaluate after the features extractor, in this order.
_PARTS = ("mlp_extractor.policy_net", "action_net", "latent_pi", "mu")
_NOT_SAVED = ("lr_schedule", "threads")  # of a model: perhaps functions of its program, and not needed
_DRAWN = 256  # observations for which actions are compared
# Stable-Baselines3 sums in float32: an action within [-1, 1] out of 256 terms of up to 1000 is off by up to
# 6e-8 x 1000 x sqrt(256).
_TOLERANCE = 1e-3


def save_policy(model, path: str | Path) -> None:
    """Save a Stable-Baselines3 model of any algorithm as a policy file.

    The model must have been trained on a `BatchVecEnv`, or on environments of `gymnasium.make`; the
    statistics of a `VecNormalize` around them are saved as well. The file's actions are compared with those
    of `model.predict`. Raises UserError, and writes nothing, for a policy, an environment or a wrapper that a
    file cannot represent. Stable-Baselines3 can also load the file, to continue the training.
    """
    if not isinstance(model, BaseAlgorithm):
        raise UserError(f"save_policy takes a Stable-Baselines3 model, not {shown(repr(model), 40)}")
    if not isinstance(path, (str, os.PathLike)):
        raise UserError(f"save_policy takes the path of a file, not {shown(repr(path), 40)}")
    task, normalised = _trained_on(model)
    network = actor_of(model)
    if normalised is not None:
        if np.isfinite(network["limit"]):
            raise UserError(
                "VecNormalize and ScaledObservation both scale the observations; use "
                "VecNormalize(..., norm_obs=False), or no ScaledObservation"
            )
        # clip((o - centre)/scale, -limit, limit)
        scale = np.sqrt(normalised.obs_rms.var + normalised.epsilon)
        network |= {"centre": normalised.obs_rms.mean, "scale": scale, "limit": float(normalised.clip_obs)}
    path = Path(path) if Path(path).suffix else Path(f"{path}.zip")
    storage.check_file(path)
    action_map = {"pwm_centre": OWN if task.per_vehicle_hover else task.pwm_centre, "pwm_span": task.pwm_span}
    metadata = {
        "task": task.name,
        "task_options": task.options | action_map,
        "algorithm": type(model).__name__,
        "seed": model.seed,
        "steps": int(model.num_timesteps),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    with storage.atomic(path) as part:
        write_policy(model, part, metadata, network)
        with policy_file.open_file(part) as archive:
            written = policy_file.read(archive, path)[1] or {}
        _compare(model, Policy(task=task, metadata=metadata, path=path, **written), normalised)


def write_policy(model: BaseAlgorithm, path: Path, metadata: dict, network: dict[str, Any]) -> None:
    """Write a model to `path` as Stable-Baselines3 does, and its network as `policy_file` does."""
    model.save(path, exclude=_NOT_SAVED)
    policy_file.write(path, metadata, network)


def actor_of(model: BaseAlgorithm) -> dict[str, Any]:
    """Return the fields of `Policy` that make up a model's actor.

    Raises UserError for networks other than dense layers with one activation.
    """
    actor = getattr(model.policy, "actor", model.policy)  # the policy itself in PPO and its like
    named = dict(actor.named_modules(remove_duplicate=False))
    modules = [module for part in _PARTS if part in named for module in _modules(named[part])]
    squashed, bound = bool(model.policy.squash_output), np.inf
    if squashed and modules and type(modules[-1]) is nn.Tanh:
        modules.pop()
    if modules and type(modules[-1]) is nn.Hardtanh:
        bound = float(modules.pop().max_val)
    layers, between = modules[::2], modules[1::2]
    extractor: Any = named.get("pi_features_extractor", named.get("features_extractor"))
    strange = [module for module in layers if type(module) is not nn.Linear]
    strange += [module for module in between if type(module) not in (nn.Tanh, nn.ReLU)]
    strange += [extractor] if type(extractor) not in (FlattenExtractor, ScaledObservation) else []
    if strange:
        raise _not_evaluated(model, f"has {shown(type(strange[0]).__name__, 60)} in its actor")
    one_kind = len({type(module) for module in between}) <= 1
    if len(layers) != len(between) + 1 or not one_kind or layers[0].in_features != extractor.features_dim:
        raise _not_evaluated(model, "has another actor than dense layers with one activation")
    inputs, scaled = layers[0].in_features, type(extractor) is ScaledObservation
    return {
        "centre": _array(extractor.centre) if scaled else np.zeros(inputs),
        "scale": _array(extractor.scale) if scaled else np.ones(inputs),
        "limit": extractor.LIMIT if scaled else np.inf,
        "weights": tuple(np.ascontiguousarray(_array(layer.weight).T) for layer in layers),
        "biases": tuple(np.zeros(n.out_features) if n.bias is None else _array(n.bias) for n in layers),
        "activation": type(between[0]).__name__ if between else "Tanh",
        "squashed": squashed,
        "bound": bound,
    }


def _modules(part: nn.Module) -> Iterator[nn.Module]:
    """Yield the modules that a sequence evaluates, one by one."""
    if type(part) is nn.Sequential:
        for inner in part:
            yield from _modules(inner)
    else:
        yield part


def _array(tensor) -> np.ndarray:
    return np.array(tensor.detach().cpu().double().numpy())


def _compare(model: BaseAlgorithm, policy: Policy, normalised: VecNormalize | None) -> None:
    """Raise UserError unless a policy's actions are those of `model.predict`."""
    rng, task = np.random.default_rng(0), policy.task
    size = 10.0 ** rng.uniform(-1.0, 1.5, (_DRAWN, 1)) * input_scale(task)  # some beyond every limit
    rows = (input_centre(task) + size * rng.normal(size=(_DRAWN, len(policy.centre)))).astype(np.float32)
    seen = rows if normalised is None else normalised.normalize_obs(rows)
    wanted, _ = model.predict(seen, deterministic=True)
    difference = float(np.abs(policy.predict(rows) - wanted).max())
    if not difference <= _TOLERANCE:
        raise _not_evaluated(
            model, f"commands otherwise than its dense layers do (by up to {difference:.2g} in actions of 1)"
        )


def _not_evaluated(model: BaseAlgorithm, why: str) -> UserError:
    return UserError(f"a policy file cannot hold the policy of this {type(model).__name__}, which {why}")


def _trained_on(model: BaseAlgorithm) -> tuple[Task, VecNormalize | None]:
    """Return the task of a model's environments, and the `VecNormalize` that the policy observes through."""
    env = model.get_env()
    if env is None:
        raise UserError(
            "the model has no environment; load it with env=ENV, the environment it was trained on"
        )
    normalising: list[VecNormalize] = []
    while isinstance(env, VecEnvWrapper):
        if type(env) is VecNormalize and not normalising:
            normalising.append(env)
        elif type(env) not in _HARMLESS:
            raise _not_held(type(env).__name__)
        env = env.venv
    task = env.env.task if type(env) is BatchVecEnv else _task_of_single(env)
    if not normalising:
        _check_never_normalised(model)
        return task, None
    if not normalising[0].norm_obs:
        return task, None
    if model.num_timesteps and normalising[0].obs_rms.count < 1.0:
        raise UserError(
            "the VecNormalize around the model's environment has no statistics; use "
            "VecNormalize.load(STATISTICS, ENV)"
        )
    return task, normalising[0]


def _check_never_normalised(model: BaseAlgorithm) -> None:
    """Raise UserError if a model that has no VecNormalize may have been trained behind one."""
    # The observation before VecNormalize; without one None or, of algorithms with a replay buffer, the one
    # that was stored there last.
    raw, buffer = model._last_original_obs, getattr(model, "replay_buffer", None)
    if raw is None or (buffer and np.array_equal(raw, buffer.observations[buffer.pos - 1])):
        return
    sentence = (
        f"this {type(model).__name__} was trained with VecNormalize, and its environment has none; load it "
        "with env=VecNormalize.load(STATISTICS, ENV)"
    )
    if buffer is not None:
        sentence += "; if it was trained without one, load its replay buffer, which shows that"
    raise UserError(sentence)


def _task_of_single(env) -> Task:
    """Return the task of a vector environment that Stable-Baselines3 makes of single ones."""
    foreign = UserError("the model was not trained on an environment of this package and has no task")
    if not (type(env) in (DummyVecEnv, SubprocVecEnv) and env.has_attr("task")):
        raise foreign
    if any(env.env_is_wrapped(_MayChange)):
        stack = env.env_method("__str__")[0]  # such as <Monitor<TimeLimit<TaskEnv<InclinedLanding-v0>>>>
        *names, last = stack.strip("<>").split("<")
        wrappers = set(names if last.endswith(" instance") else names[:-1])
        unusual = wrappers - {kind.__name__ for kind in _HARMLESS_OF_ONE}
        raise _not_held(" or ".join(sorted(unusual)) or f"in {stack}")
    task, *others = env.get_attr("task")
    if not isinstance(task, Task):
        raise foreign
    if any(
        (one.name, one.options, one.pwm_centre) != (task.name, task.options, task.pwm_centre)
        for one in others
    ):
        raise UserError(
            "the model's environments have different options, but a policy file can only store one set"
        )
    spaces = observation_space(task), action_space(task)
    if (env.observation_space, env.action_space) != spaces:
        raise _not_held("that changes its spaces (RescaleAction?)")
    return task


class _Unknown(type):
    """The type of `_MayChange`."""

    def __instancecheck__(cls, wrapper) -> bool:
        """Return whether a wrapper, or the environment in it, is not a known one."""
        known = type(wrapper.unwrapped).__module__ == TaskEnv.__module__
        return not (known and type(wrapper) in _HARMLESS_OF_ONE)


class _MayChange(metaclass=_Unknown):
    """Matches every wrapper except the harmless ones, for `env_is_wrapped`, also in other processes."""


def _not_held(name: str) -> UserError:
    return UserError(
        f"a policy file cannot hold the wrapper {shown(name, 60)}, which may change what the policy observes "
        "or commands; train without it (the task option history adds past steps). If it only changes "
        "rewards, call model.set_env with the environment without it, and save again"
    )
