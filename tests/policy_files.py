"""Policies and their files for tests: small ones, of models of no task, and with other metadata."""

import json
import zipfile
from pathlib import Path

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO

from inclined_landing.envs import save_policy
from inclined_landing.envs.history import input_centre, input_names, input_scale
from inclined_landing.envs.policy import Policy, locate
from inclined_landing.envs.policy_file import METADATA
from inclined_landing.envs.save import actor_of, write_policy


def written(path: Path, model, metadata: dict) -> Path:
    """Write a policy file as training does; return its path."""
    write_policy(model, path, metadata, actor_of(model))
    return path


def restamp(path: Path, metadata: dict) -> None:
    """Replace what a policy file says of its training, or add it to a file of Stable-Baselines3 alone."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    before = json.loads(members.get(METADATA, "{}"))
    members[METADATA] = json.dumps({k: v for k, v in before.items() if k == "network"} | metadata).encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)


def hovering(path: Path) -> Path:
    """Write the file of a policy that hovers, all weights zero; return its path."""
    network = PPO("MlpPolicy", "InclinedLanding-v0", seed=0, device="cpu")
    with torch.no_grad():
        for parameter in network.policy.parameters():
            parameter.zero_()
    save_policy(network, path)
    return path


def pilot(task, seed: int = 0) -> Policy:
    """Return a linear policy that hovers nearly, and answers to all that it is given."""
    count = len(task.action_names)
    weight = np.random.default_rng(seed).normal(0.0, 0.1, (len(input_names(task)), count))
    scaling = input_centre(task), input_scale(task), 10.0
    return Policy(task, {}, locate("landing-nominal"), *scaling, (weight,), (np.zeros(count),), "Tanh")


class Spaces(gymnasium.Env):
    """An environment of given shapes, for building networks only."""

    def __init__(self, observations: int = 5, actions: int = 2):
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (observations,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (actions,), np.float32)
