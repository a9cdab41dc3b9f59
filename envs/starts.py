"""The starts that landing policies are judged from; training never uses them.

`starts/landing_grid.csv` is the frozen set: a grid over the upper half of the arena without the
starts whose shapes lie closer than 5 cm to the platform. `make_grid` says how it was made.
"""

from __future__ import annotations

import io
from importlib import resources

import numpy as np

from inclined_landing.envs.tasks.base import hover_states
from inclined_landing.envs.tasks.landing import PAPER_STARTS, START_CLEARANCE, InclinedLanding

_FILE = "shipped/landing_grid.csv"
_X = np.arange(-33, 34, 3) / 10.0  # m
_Z = np.arange(125, 226, 10) / 100.0  # m
_OFFSET = 0.1  # m, of the scattered starts, in x and in z
_SCATTERED = 10  # flights from each of the paper's starts


def grid() -> np.ndarray:
    """The frozen starts (k, 2): x, z [m]."""
    text = resources.files("inclined_landing.envs").joinpath(_FILE).read_text("utf-8")
    return np.loadtxt(io.StringIO(text), delimiter=",", comments="#", ndmin=2)


def make_grid(task: InclinedLanding) -> np.ndarray:
    """The starts (k, 2) of the grid that lie clear of the task's platform, x by x."""
    x, z = np.meshgrid(_X, _Z, indexing="ij")
    return clear(task, np.column_stack([x.ravel(), z.ravel()]))


def clear(task: InclinedLanding, starts: np.ndarray) -> np.ndarray:
    """Those of `starts` (k, 2) whose shapes keep 5 cm to the platform."""
    states = at_rest(task, starts)
    return starts[task.start_clearance(task.start(states)) >= START_CLEARANCE]


def grid_text(starts: np.ndarray) -> str:
    """The frozen file's text for `starts` (k, 2)."""
    lines = [
        "# Frozen evaluation starts of the landing task, vehicle level, at rest, thrust at hover.",
        f"# x from {_X[0]:g} to {_X[-1]:g} m, z from {_Z[0]:g} to {_Z[-1]:g} m, without the starts "
        f"closer than {100 * START_CLEARANCE:g} cm",
        "# to the platform at its default inclination. Made by landing_starts.make_grid; never",
        "# trained on, never edited.",
        "# x [m], z [m]",
    ]
    lines += [f"{x:.2f},{z:.2f}" for x, z in starts]
    return "\n".join(lines) + "\n"


def paper() -> np.ndarray:
    """The paper's three starts (3, 2): x, z [m]."""
    return np.array(PAPER_STARTS)


def scattered(seed: int) -> np.ndarray:
    """The paper's starts with offsets uniform within 0.1 m in x and z, ten each (30, 2)."""
    rng = np.random.default_rng(seed)
    starts = np.repeat(paper(), _SCATTERED, axis=0)
    return starts + rng.uniform(-_OFFSET, _OFFSET, starts.shape)


def at_rest(task: InclinedLanding, starts: np.ndarray) -> np.ndarray:
    """States (k, 13) of a vehicle hovering at `starts` (k, 2): x, z [m]."""
    positions = np.zeros((len(starts), 3))
    positions[:, [0, 2]] = starts
    return hover_states(positions, task.vehicle)
