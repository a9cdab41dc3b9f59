"""Which colour and words stand for the legs of a mission, in all its pictures."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import to_rgb

from inclined_landing.envs.mission import LEGS, Mission
from inclined_landing.eval.base.style import BLUE, GREEN, ORANGE, PURPLE
from inclined_landing.eval.pictures.labels import Label

COLOURS = (PURPLE, BLUE, ORANGE, GREEN)  # of LEGS


def named(mission: Mission, k: int) -> Label:
    """The leg of row k and its colour, in words for a label."""
    leg = mission.leg[k]
    policy = mission.plan.policies[max(leg - 1, 0)]
    return f"{LEGS[leg]}: policy {policy.name}", COLOURS[leg]


def along(mission: Mission) -> np.ndarray:
    """Colours (T, 3) of its rows."""
    return np.array([to_rgb(colour) for colour in COLOURS])[mission.leg]
