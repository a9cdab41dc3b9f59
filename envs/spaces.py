"""Spaces of a task, shared by the Gymnasium and Stable-Baselines3 environments."""

import numpy as np
from gymnasium.spaces import Box

from inclined_landing.envs.history import input_names


def observation_space(task) -> Box:
    """Return the unbounded Box, float32, of `input_names`; positions outside the arena are only penalised."""
    return Box(-np.inf, np.inf, (len(input_names(task)),), np.float32)


def action_space(task) -> Box:
    """Return the Box (a,) from -1 to 1, float32."""
    return Box(-1.0, 1.0, (len(task.action_names),), np.float32)
