"""The frozen starts: those from which landing policies are evaluated, and which training never uses.

`landing_grid.csv` is the frozen set: a grid over the upper half of the arena, of 30 cm in x and 10 cm in
z, without the starts at which the vehicle is closer than 5 cm to the platform.
"""

from __future__ import annotations

import io
from importlib import resources

import numpy as np

from inclined_landing.envs.tasks.base import Task, hover_states

START_CLEARANCE = 0.05  # m, that starts keep to the platform
PAPER_STARTS = ((0.0, 2.0), (-1.5, 1.6), (1.5, 1.8))  # x, z of the paper's table
_FILE = "shipped/landing_grid.csv"
_OFFSET = 0.1  # m, of the scattered starts, in x and in z
_SCATTERED = 10  # flights from each of the paper's starts


def grid() -> np.ndarray:
    """Return the frozen starts (k, 2): x, z [m]."""
    text = resources.files("inclined_landing.envs").joinpath(_FILE).read_text("utf-8")
    return np.loadtxt(io.StringIO(text), delimiter=",", comments="#", ndmin=2)


def clear(task: Task, starts: np.ndarray) -> np.ndarray:
    """Return those of `starts` (k, 2) with at least 5 cm clearance to the platform."""
    start = task.start(hover_states(starts, task.vehicle))
    return starts[task.start_clearance(start) >= START_CLEARANCE]


def paper() -> np.ndarray:
    """Return the paper's three starts (3, 2): x, z [m]."""
    return np.array(PAPER_STARTS)


def scattered(seed: int) -> np.ndarray:
    """Return the paper's starts with offsets uniform within 0.1 m in x and z, ten each (30, 2)."""
    rng = np.random.default_rng(seed)
    starts = np.repeat(paper(), _SCATTERED, axis=0)
    return starts + rng.uniform(-_OFFSET, _OFFSET, starts.shape)
