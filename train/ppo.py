"""Stock Stable-Baselines3 PPO on the batched environment: construction and checkpoints."""

from __future__ import annotations

import numpy as np
import torch
from stable_baselines3 import PPO

from inclined_landing.envs.batch import BatchEnv
from inclined_landing.envs.features import ScaledObservation
from inclined_landing.envs.sb3 import BatchVecEnv
from inclined_landing.envs.tasks import Task, make_task
from inclined_landing.envs.tasks.base import resolve_pwm_centre
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import Snapshot, make_plant
from inclined_landing.train.config import TrainConfig

# Saved policies must not drag training code along: the schedule is set anew by the callback.
_NOT_SAVED = ("lr_schedule",)
_EVALUATION_SEED = 1_000_003  # apart from every training seed's stream


def training_environment(config: TrainConfig) -> BatchVecEnv:
    """The vehicles a run trains on, in the plant the configuration names."""
    options = {"keep_out": config.keep_out}
    if config.plant == "mujoco":
        options |= {"integrator": config.integrator, "threads": config.threads}
    task = build_task(config)
    plant = make_plant(config.plant, config.environments, task.vehicle, **options)
    return BatchVecEnv(BatchEnv(task, plant, config.seed), reward_scale=config.reward_scale)


def build_task(config: TrainConfig) -> Task:
    """The task with the configured vehicle and action map."""
    if config.vehicle is None:
        return make_task(config.task, pwm_centre=config.pwm_centre)
    # A policy to go on from keeps the thrust at action 0 that it was trained with: the shipped vehicle's.
    vehicle = load_vehicle(config.vehicle)
    centre = resolve_pwm_centre(config.pwm_centre, load_vehicle() if config.start_from else vehicle)
    return make_task(config.task, vehicle, pwm_centre=centre)


def evaluation_seed(config: TrainConfig) -> int:
    """Seed of the periodic evaluation's starts: never those of training, never the frozen grid."""
    return _EVALUATION_SEED + config.seed


def build_model(config: TrainConfig, env: BatchVecEnv) -> PPO:
    """A new PPO: 64x64 tanh, scaled observation, Adam."""
    set_torch_up()
    task = env.env.task
    return PPO(
        "MlpPolicy",
        env,
        n_steps=config.rollout,
        batch_size=min(config.batch_size, config.environments * config.rollout),
        n_epochs=config.epochs,
        learning_rate=config.learning_rate,
        gamma=config.gamma,
        gae_lambda=config.gae_lambda,
        ent_coef=config.entropy,
        seed=config.seed,
        device="cpu",
        policy_kwargs={
            "net_arch": [64, 64],
            "activation_fn": torch.nn.Tanh,
            "log_std_init": config.log_std_init,
            "features_extractor_class": ScaledObservation,
            "features_extractor_kwargs": {
                "centre": task.observation_centre.tolist(),
                "scale": task.observation_scale.tolist(),
            },
            "optimizer_kwargs": {"fused": True},
        },
    )


def set_torch_up() -> None:
    """Small networks on a CPU: one thread is faster than two, denormals and checks cost time."""
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)
    torch.distributions.Distribution.set_default_validate_args(False)


def save_model(model: PPO, path) -> None:
    """Write the policy with its optimizer to `path` (.zip)."""
    model.save(path, exclude=_NOT_SAVED)


def training_state(model: PPO, env: BatchVecEnv) -> dict:
    """What the policy file lacks for an exact continuation: random states, vehicles, episodes."""
    batch = env.env
    return {
        "torch_rng": torch.get_rng_state(),
        "numpy_rng": np.random.get_state(),  # noqa: NPY002 (SB3 shuffles with it)
        "start_rng": batch.rng.bit_generator.state,
        "plant": batch.plant.save().arrays,
        "episodes": batch.episode_state(),
        "last_obs": model._last_obs,
        "last_episode_starts": model._last_episode_starts,
        "num_timesteps": model.num_timesteps,
        "updates": model._n_updates,
    }


def restore_model(path, state: dict, env: BatchVecEnv) -> PPO:
    """The PPO of a checkpoint, ready to `learn(..., reset_num_timesteps=False)` bit for bit."""
    set_torch_up()
    model = PPO.load(path, env=env, device="cpu")
    batch = env.env
    batch.plant.restore(Snapshot(state["plant"]))
    batch.restore_episodes(state["episodes"])
    batch.rng.bit_generator.state = state["start_rng"]
    model._last_obs = state["last_obs"]
    model._last_episode_starts = state["last_episode_starts"]
    model.num_timesteps = state["num_timesteps"]
    model._n_updates = state["updates"]
    np.random.set_state(state["numpy_rng"])  # noqa: NPY002
    torch.set_rng_state(state["torch_rng"])
    return model
