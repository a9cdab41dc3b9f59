"""Which colour and words stand for the legs of a mission, in all its pictures."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import to_rgb

from inclined_landing.envs.mission import LEGS, Mission
from inclined_landing.eval.base.style import BLUE, GREEN, ORANGE, PURPLE
from inclined_landing.eval.pictures.labels import Label

LEG_COLOURS = (PURPLE, BLUE, ORANGE, GREEN)  # of LEGS


def leg_label(mission: Mission, k: int) -> Label:
    """Return the label of the leg of row k, with its colour."""
    leg = mission.leg[k]
    policy = mission.plan.policies[max(leg - 1, 0)]
    return f"{LEGS[leg]}: policy {policy.name}", LEG_COLOURS[leg]


def leg_colours(mission: Mission) -> np.ndarray:
    """Return the leg colours (T, 3) of a mission's rows."""
    return np.array([to_rgb(colour) for colour in LEG_COLOURS])[mission.leg]
