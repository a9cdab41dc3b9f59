"""PPO of Stable-Baselines3, compiled or original, on the batched environment, from a configuration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import psutil
import torch
from stable_baselines3 import PPO

from inclined_landing.envs.batch import BatchEnv
from inclined_landing.envs.features import ScaledObservation
from inclined_landing.envs.history import input_centre, input_scale
from inclined_landing.envs.randomise import read_ranges
from inclined_landing.envs.sb3 import BatchVecEnv
from inclined_landing.envs.tasks import Task, make_task
from inclined_landing.envs.tasks.base import OWN, resolve_pwm_centre
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import make_plant
from inclined_landing.models.vehicle import Vehicle
from inclined_landing.train.config import NET_ARCH, TrainConfig
from inclined_landing.train.curriculum import ALONE, BalancedCurriculum, discount
from inclined_landing.train.fast.ppo import FastPPO

# Measured memory in bytes: a sample and its copies, each past step that is part of a sample, and a vehicle
# with its engine data and records.
_SAMPLE, _PAST, _VEHICLE = 100, 80, 20_000
# Up to this many environments one engine thread suffices: on average 3 of 128 vehicles are near a surface.
_FEW = 256
_FROM_TRAINING = ("rollout", "batch_size", "epochs", "learning_rate", "gamma", "gae_lambda", "log_std_init")


def check_memory(config: TrainConfig) -> None:
    """Raise UserError if vehicles and rollout do not fit into the free memory."""
    assert config.history is not None and config.environments is not None
    needed = (_SAMPLE + _PAST * config.history) * config.per_iteration + _VEHICLE * config.environments
    free = psutil.virtual_memory().available
    if needed > free:
        raise UserError(
            f"--environments {config.environments} and --rollout {config.rollout} need about "
            f"{needed / 1e9:.0f} GB of memory, and {free / 1e9:.0f} GB are free; choose fewer"
        )


def training_environment(config: TrainConfig) -> BatchVecEnv:
    """Return the vehicles on which a run trains, in the configured plant."""
    assert config.environments is not None
    task = build_task(config)
    options: dict[str, Any] = {"keep_out": task.training.keep_out if task.has_platform else 0.0}
    if config.plant != "analytic":
        # If contact ends the episode, few vehicles are near a surface at a time. 0 threads: all cores.
        few = config.plant == "hybrid" and options["keep_out"] > 0.0 and config.environments <= _FEW
        options |= {"integrator": task.training.integrator, "threads": config.threads or (1 if few else 0)}
    nominal, balanced = None, config.curriculum == BalancedCurriculum.name
    if config.randomise is not None:
        ranges = read_ranges(config.randomise)
        nominal = ranges.nominal
        # In space, where more vehicles are hard to land, denser ends gained nothing.
        alone = ALONE if balanced else 0.0
        pool = ranges.draw(task.vehicle, config.seed, to_the_ends=config.is_planar, alone=alone)
        options |= pool_options(pool, config.seed)
    options |= task.plant_options
    plant = make_plant(config.plant, config.environments, task.vehicle, **options)
    return BatchVecEnv(
        BatchEnv(task, plant, config.seed, nominal, by_failure=balanced), reward_scale=config.reward_scale
    )


def pool_options(pool: Sequence[Vehicle], seed: int) -> dict[str, Any]:
    """Return options of a plant whose vehicles are selected from a pool; seed: seed of their disturbances."""
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
    # The PWM that an action commands must not depend on the vehicle flown later, unless the user asks for it.
    if config.vehicle and config.pwm_centre != OWN:
        options["pwm_centre"] = resolve_pwm_centre(config.pwm_centre, vehicle)
    return make_task(config.task, vehicle, **options)


def build_model(config: TrainConfig, env: BatchVecEnv) -> PPO:
    """Return a new PPO: tanh networks, scaled observation, Adam.

    PyTorch is configured for small networks on a CPU: one thread is faster, and denormals and checks cost
    time.
    """
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)
    torch.distributions.Distribution.set_default_validate_args(False)
    kind = FastPPO if config.update == "fast" else PPO
    return kind("MlpPolicy", env, seed=config.seed, **_arguments(config, env.env.task))


def ppo_kwargs(task: Task) -> dict:
    """Return the arguments of Stable-Baselines3's PPO that `landing-train` uses for a task and 64
    environments.

    Use them as in `PPO("MlpPolicy", env, **ppo_kwargs(task))`; rewards must be scaled by 0.1 in the
    environment.
    """
    return _arguments(TrainConfig(**{name: getattr(task.training, name) for name in _FROM_TRAINING}), task)


def scaled_observation(task: Task) -> dict:
    """Return the part of SB3's `policy_kwargs` that scales observations inside the network."""
    scaling = {"centre": input_centre(task).tolist(), "scale": input_scale(task).tolist()}
    return {"features_extractor_class": ScaledObservation, "features_extractor_kwargs": scaling}


def _arguments(config: TrainConfig, task: Task) -> dict:
    assert config.gamma is not None
    return {
        "n_steps": config.rollout,
        "batch_size": config.batch_size,
        "n_epochs": config.epochs,
        "learning_rate": config.learning_rate,
        "gamma": discount(config.gamma, 0),
        "gae_lambda": config.gae_lambda,
        "device": "cpu",
        "policy_kwargs": {
            "net_arch": list(config.net_arch or NET_ARCH),
            "activation_fn": torch.nn.Tanh,
            "log_std_init": config.log_std_init,
            **scaled_observation(task),
            "optimizer_kwargs": {"fused": True},
        },
    }
