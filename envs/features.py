"""The features extractor of policy networks: it scales observations by fixed numbers.

A policy file therefore takes the task's raw observation and needs no separate statistics.
"""

import numpy as np
from gymnasium.spaces import Box

from inclined_landing.models.base.errors import optional

with optional():
    import torch
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor


class ScaledObservation(BaseFeaturesExtractor):
    """Features (observation - centre) / scale, clipped to +-10."""

    LIMIT = 10.0

    def __init__(self, observation_space: Box, centre: list[float], scale: list[float]):
        super().__init__(observation_space, features_dim=int(np.prod(observation_space.shape)))
        self.register_buffer("centre", torch.tensor(centre, dtype=torch.float32))
        self.register_buffer("scale", torch.tensor(scale, dtype=torch.float32))

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        return ((observations - self.centre) / self.scale).clamp(-self.LIMIT, self.LIMIT)
