"""Stable-Baselines3's SAC and TD3 on the batched environment."""

from __future__ import annotations

import numpy as np
from stable_baselines3 import SAC, TD3
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from inclined_landing.envs.sb3 import BatchVecEnv
from inclined_landing.train.config import TrainConfig
from inclined_landing.train.ppo import initial_gamma, scaled_observation, set_torch_up

# Of SAC's price of entropy, which then adjusts itself. From SB3's 1 it falls for thousands of updates, while
# randomness is worth more than the scaled rewards, and an episode that goes on more than one that succeeds.
ENTROPY = 0.01
KINDS: dict[str, type[OffPolicyAlgorithm]] = {"sac": SAC, "td3": TD3}


def build_model(config: TrainConfig, env: BatchVecEnv) -> OffPolicyAlgorithm:
    """Return a new model: 64x64 ReLU as in the policies of PPO, scaled observation, Adam.

    After each step of all vehicles come `gradient_steps` updates: fewer than samples, as is usual with many
    parallel environments, since an update takes longer than the step. Episodes that are cut are bootstrapped
    by SB3's replay buffer.
    """
    set_torch_up()
    kind, own = KINDS[config.algorithm], {}
    if kind is TD3:
        zero = np.zeros(env.action_space.shape)
        own["action_noise"] = NormalActionNoise(zero, np.full_like(zero, config.action_noise))
    if kind is SAC:
        own["ent_coef"] = f"auto_{ENTROPY}"
    return kind(
        "MlpPolicy",
        env,
        seed=config.seed,
        device="cpu",
        learning_rate=config.learning_rate,
        gamma=initial_gamma(config),
        batch_size=config.batch_size,
        buffer_size=config.buffer_size,
        learning_starts=config.learning_starts,
        train_freq=1,  # step of all vehicles
        tau=0.02,  # SB3's 0.005 is for an update after every sample, and these have fewer
        gradient_steps=config.gradient_steps,
        policy_kwargs={
            "net_arch": [64, 64],
            **scaled_observation(env.env.task),
            "optimizer_kwargs": {"fused": True},
        },
        **own,
    )
