"""Stable-Baselines3's PPO, fast or stock, on the batched environment: construction and checkpoints."""

from __future__ import annotations

import dataclasses
from collections import deque
from typing import Any

import numpy as np
import psutil
import torch
from stable_baselines3 import PPO

from inclined_landing.envs.batch import BatchEnv
from inclined_landing.envs.features import ScaledObservation
from inclined_landing.envs.history import input_centre, input_scale
from inclined_landing.envs.randomise import POOL, read_ranges
from inclined_landing.envs.sb3 import BatchVecEnv
from inclined_landing.envs.tasks import Task, make_task
from inclined_landing.envs.tasks.base import OWN, resolve_pwm_centre
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import Snapshot, make_plant
from inclined_landing.models.vehicle import Vehicle
from inclined_landing.train.checkpoint import check_array, check_names, check_number
from inclined_landing.train.config import ALGORITHMS, TrainConfig, flag_of
from inclined_landing.train.curriculum import RISING, rising_gamma
from inclined_landing.train.fast.ppo import FastPPO

# Saved policies must not drag training code along: the schedule is set anew by the callback.
_NOT_SAVED = ("lr_schedule", "threads")
_MOST = 2**53  # of anything counted
_SAMPLE, _VEHICLE = 100, 20_000  # bytes, measured: a buffer with its copies; engine and records
_PAST = (
    80  # bytes more for each past step in a sample: seven numbers, as many as in the buffer and its copies
)
_EVALUATION_SEED = 1_000_003  # apart from every training seed's stream


def check_memory(config: TrainConfig) -> None:
    """Raise UserError when vehicles and rollout (or replay buffer) do not fit into the free memory."""
    kept = "rollout" if config.buffer_size is None else "buffer_size"
    samples = config.buffer_size or config.environments * config.rollout
    needed = (_SAMPLE + _PAST * config.history) * samples + _VEHICLE * config.environments
    free = psutil.virtual_memory().available
    if needed > free:
        raise UserError(
            f"--environments {config.environments} and {flag_of(kept)} {getattr(config, kept)} need about "
            f"{needed / 1e9:.0f} GB of memory, and {free / 1e9:.0f} GB are free; choose fewer"
        )


def training_environment(config: TrainConfig) -> BatchVecEnv:
    """Return the vehicles a run trains on, in the plant the configuration names."""
    options = {"keep_out": config.keep_out}
    if config.plant != "analytic":
        options |= {"integrator": config.integrator, "threads": config.threads}
    task = build_task(config)
    options |= drawn(config, task.vehicle, config.seed) | task.plant_options
    plant = make_plant(config.plant, config.environments, task.vehicle, **options)
    assert config.reward_scale is not None  # a resolved configuration
    nominal = None if config.randomise is None else read_ranges(config.randomise).nominal
    return BatchVecEnv(BatchEnv(task, plant, config.seed, nominal), reward_scale=config.reward_scale)


def drawn(config: TrainConfig, vehicle: Vehicle, seed: int, count: int = POOL) -> dict[str, Any]:
    """Return options of a plant with `count` vehicles that a randomised run draws from `seed`, else {}."""
    if config.randomise is None:
        return {}
    pool = read_ranges(config.randomise).draw(vehicle, seed, count)
    moved = any(any(v.disturbance_acceleration) or any(v.disturbance_angular) for v in pool)
    return {"pool": pool} | ({"disturbance": seed} if moved else {})


def build_task(config: TrainConfig) -> Task:
    """Return the task with the configured vehicle, platform and action map."""
    vehicle, options = load_vehicle(config.vehicle), config.task_options()
    if "inclination" in options:
        try:
            vehicle.check_inclination(options["inclination"])
        except UserError as error:
            raise UserError(f"--inclination: {error}") from error
    # What a policy's actions command must not depend on the vehicle that it is flown with later, unless that
    # is asked for.
    if config.vehicle and config.pwm_centre != OWN:
        options["pwm_centre"] = resolve_pwm_centre(config.pwm_centre, vehicle)
    return make_task(config.task, vehicle, **options)


def evaluation_seed(config: TrainConfig) -> int:
    """Return the seed of the periodic evaluation's starts: never those of training or the frozen grid."""
    return _EVALUATION_SEED + config.seed


def build_model(config: TrainConfig, env: BatchVecEnv) -> PPO:
    """Return a new PPO: 64x64 tanh, scaled observation, Adam."""
    set_torch_up()
    kind = FastPPO if config.update == "fast" else PPO
    model = kind("MlpPolicy", env, seed=config.seed, **_arguments(config, env.env.task))
    if config.threads == 1:
        model.threads = 1
    return model


def ppo_kwargs(task: Task) -> dict:
    """Return what `landing-train` gives to Stable-Baselines3's PPO for a task, for 64 environments.

    `PPO("MlpPolicy", env, **ppo_kwargs(task))`; rewards are scaled by 0.1, in the environment.
    """
    of_the_task = {f.name for f in dataclasses.fields(TrainConfig)} & set(vars(task.training))
    config = TrainConfig(**ALGORITHMS["ppo"] | {name: getattr(task.training, name) for name in of_the_task})
    return _arguments(config, task)


def scaled_observation(task: Task) -> dict:
    """Return the part of `policy_kwargs` (PPO, SAC or TD3) that scales observations inside the network."""
    scaling = {"centre": input_centre(task).tolist(), "scale": input_scale(task).tolist()}
    return {"features_extractor_class": ScaledObservation, "features_extractor_kwargs": scaling}


def _arguments(config: TrainConfig, task: Task) -> dict:
    return {
        "n_steps": config.rollout,
        "batch_size": config.batch_size,
        "n_epochs": config.epochs,
        "learning_rate": config.learning_rate,
        "gamma": initial_gamma(config),
        "gae_lambda": config.gae_lambda,
        "ent_coef": config.entropy,
        "device": "cpu",
        "policy_kwargs": {
            "net_arch": [64, 64],
            "activation_fn": torch.nn.Tanh,
            "log_std_init": config.log_std_init,
            **scaled_observation(task),
            "optimizer_kwargs": {"fused": True},
        },
    }


def initial_gamma(config: TrainConfig) -> float:
    """Return the discount of the first rollout; the curriculum says the others."""
    return rising_gamma(0) if config.gamma == RISING else config.gamma


def set_torch_up() -> None:
    """Set PyTorch up for small networks on a CPU: one thread is faster, denormals and checks cost time."""
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)
    torch.distributions.Distribution.set_default_validate_args(False)


def save_model(model: PPO, path) -> None:
    """Write the policy with its optimizer to `path` (.zip)."""
    model.save(path, exclude=_NOT_SAVED)


def training_state(model: PPO, env: BatchVecEnv) -> tuple[dict, dict[str, np.ndarray]]:
    """Return what an exact continuation needs: numbers (JSON types) and arrays."""
    batch = env.env
    _, key, position, has_gauss, gauss = np.random.get_state()  # noqa: NPY002 (SB3 shuffles with it)
    numbers = {
        "steps": int(model.num_timesteps),
        "updates": int(model._n_updates),
        "start_rng": batch.rng.bit_generator.state,
        "numpy_rng": [int(position), int(has_gauss), float(gauss)],
        "ended": [[e["r"], e["l"]] for e in model.ep_info_buffer],
        "successes": [bool(success) for success in model.ep_success_buffer],
    }
    arrays = _arrays(model, env) | {
        "numpy_rng": key,
        "last_obs": model._last_obs,
        "last_episode_starts": model._last_episode_starts,
    }
    for k, moments in model.policy.optimizer.state_dict()["state"].items():
        arrays |= {f"optimizer.{k}.{name}": moment.numpy() for name, moment in moments.items()}
    return numbers, arrays


def _arrays(model: PPO, env: BatchVecEnv) -> dict[str, np.ndarray]:
    """Return the arrays that a new model has as well."""
    batch = env.env
    parts = {"policy": {name: tensor.numpy() for name, tensor in model.policy.state_dict().items()}}
    parts |= {"plant": batch.plant.save().arrays, "episodes": batch.episode_state()}
    arrays = {f"{part}.{name}": array for part in parts for name, array in parts[part].items()}
    return arrays | {"torch_rng": torch.get_rng_state().numpy()}


def restore(model: PPO, env: BatchVecEnv, numbers: dict, arrays: dict[str, np.ndarray]) -> None:
    """Carry a new model on to a `training_state`, for `learn(..., reset_num_timesteps=False)`.

    Raises UserError for whatever is not of the names, shapes, types and ranges that this model and this
    environment would have written.
    """
    batch = env.env
    batch.reset()  # which makes room for the waves of moving platforms
    moments = _check_arrays(model, env, arrays)
    _check_numbers(numbers)

    def part(name):
        return {k.removeprefix(f"{name}."): a for k, a in arrays.items() if k.startswith(f"{name}.")}

    model.policy.load_state_dict({name: torch.as_tensor(a) for name, a in part("policy").items()})
    optimizer = model.policy.optimizer
    optimizer.load_state_dict(optimizer.state_dict() | {"state": moments})
    batch.plant.restore(Snapshot(part("plant")))
    batch.restore_episodes(part("episodes"))
    model._last_obs = arrays["last_obs"]
    model._last_episode_starts = arrays["last_episode_starts"]
    model.num_timesteps, model._n_updates = numbers["steps"], numbers["updates"]
    size = model._stats_window_size
    model.ep_info_buffer = deque(({"r": r, "l": l} for r, l in numbers["ended"]), maxlen=size)  # noqa: E741
    model.ep_success_buffer = deque(numbers["successes"], maxlen=size)
    try:
        batch.rng.bit_generator.state = numbers["start_rng"]
        torch.set_rng_state(torch.as_tensor(arrays["torch_rng"]))
    except (RuntimeError, ValueError, TypeError, KeyError, OverflowError) as error:
        raise UserError("a random generator's state is none") from error
    np.random.set_state(("MT19937", arrays["numpy_rng"], *numbers["numpy_rng"]))  # noqa: NPY002


def _check_arrays(model: PPO, env: BatchVecEnv, arrays: dict) -> dict[int, dict[str, torch.Tensor]]:
    """Check every array of a checkpoint; returns the optimizer's moments by parameter."""
    n, observations = env.num_envs, env.observation_space.shape[0]
    like = _arrays(model, env) | {
        "numpy_rng": np.zeros(624, np.uint32),
        "last_obs": np.zeros((n, observations), np.float32),
        "last_episode_starts": np.zeros(n, bool),
    }
    moments: dict[int, dict[str, torch.Tensor]] = {}
    for k, parameter in enumerate(model.policy.optimizer.param_groups[0]["params"]):
        if f"optimizer.{k}.step" in arrays:  # the optimizer knows what has had a gradient
            weights = np.zeros(parameter.shape, np.float32)
            own = {"step": np.zeros((), np.float32), "exp_avg": weights, "exp_avg_sq": weights}
            like |= {f"optimizer.{k}.{name}": array for name, array in own.items()}
            moments[k] = {name: arrays.get(f"optimizer.{k}.{name}") for name in own}
    check_names(arrays, like, "it")
    for name, array in arrays.items():
        check_array(array, like[name], name)
        if name.endswith((".step", ".exp_avg_sq")) and (array < 0).any():
            raise UserError(f"{name} is negative")
    return {k: {name: torch.as_tensor(a) for name, a in own.items()} for k, own in moments.items()}


def _check_numbers(numbers: dict) -> None:
    check_number(numbers["steps"], "steps", 0, _MOST)
    check_number(numbers["updates"], "updates", 0, _MOST)
    for name in ("numpy_rng", "ended", "successes"):
        if not isinstance(numbers[name], list):
            raise UserError(f"{name} is not a list")
    if len(numbers["numpy_rng"]) != 3:
        raise UserError("numpy_rng has not three numbers")
    position, has_gauss, gauss = numbers["numpy_rng"]
    check_number(position, "numpy_rng", 0, 624)
    check_number(has_gauss, "numpy_rng", 0, 1)
    check_number(gauss, "numpy_rng", -1e3, 1e3, whole=False)
    for pair in numbers["ended"]:
        if not isinstance(pair, list) or len(pair) != 2:
            raise UserError("ended is not a list of reward and length")
        check_number(pair[0], "an episode's reward", -1e300, 1e300, whole=False)
        check_number(pair[1], "an episode's length", 1, _MOST)
    if not all(isinstance(success, bool) for success in numbers["successes"]):
        raise UserError("successes is not a list of true and false")
    state = numbers["start_rng"]
    inner = state.get("state") if isinstance(state, dict) else None
    if not isinstance(inner, dict) or not isinstance(inner.get("inc"), int) or inner["inc"] % 2 == 0:
        raise UserError("start_rng is no state of a PCG64 generator")
