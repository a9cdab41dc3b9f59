"""The starts of the evaluation of landing policies; training never uses them.

`starts/landing_grid.csv` is the frozen set: a grid over the upper half of the arena without the
starts whose shapes lie closer than 5 cm to the platform. `make_grid` says how it was made.

`over_slopes` is the frozen set for policies that observe the slope: random starts, as many for every cell of
the angles, from a fixed seed.
"""

from __future__ import annotations

import dataclasses
import io
import math
from importlib import resources

import numpy as np

from inclined_landing.envs.tasks.base import Start, Task, hover_states
from inclined_landing.envs.tasks.landing import PAPER_STARTS, START_CLEARANCE
from inclined_landing.envs.tasks.slopes import SlopeLanding
from inclined_landing.models.errors import UserError

_FILE = "shipped/landing_grid.csv"
_X = np.arange(-33, 34, 3) / 10.0  # m
_Z = np.arange(125, 226, 10) / 100.0  # m
_OFFSET = 0.1  # m, of the scattered starts, in x and in z
_SCATTERED = 10  # flights from each of the paper's starts
_SLOPES_SEED = 25_700_550  # of `over_slopes`: never changed, and of no training
_CELLS = 20  # of the inclination in the plane, and in space
_SPACE_CELLS, _AZIMUTHS = 6, 12
_EACH, _SPACE_EACH = 50, 15  # starts of a cell


def grid() -> np.ndarray:
    """Return the frozen starts (k, 2): x, z [m]."""
    text = resources.files("inclined_landing.envs").joinpath(_FILE).read_text("utf-8")
    return np.loadtxt(io.StringIO(text), delimiter=",", comments="#", ndmin=2)


def make_grid(task: Task) -> np.ndarray:
    """Return the starts (k, 2) of the grid that lie clear of the task's platform, x by x."""
    x, z = np.meshgrid(_X, _Z, indexing="ij")
    return clear(task, np.column_stack([x.ravel(), z.ravel()]))


def clear(task: Task, starts: np.ndarray) -> np.ndarray:
    """Return those of `starts` (k, 2) with at least 5 cm clearance to the platform."""
    states = at_rest(task, starts)
    return starts[task.start_clearance(task.start(states)) >= START_CLEARANCE]


def paper() -> np.ndarray:
    """Return the paper's three starts (3, 2): x, z [m]."""
    return np.array(PAPER_STARTS)


def scattered(seed: int) -> np.ndarray:
    """Return the paper's starts with offsets uniform within 0.1 m in x and z, ten each (30, 2)."""
    rng = np.random.default_rng(seed)
    starts = np.repeat(paper(), _SCATTERED, axis=0)
    return starts + rng.uniform(-_OFFSET, _OFFSET, starts.shape)


@dataclasses.dataclass(frozen=True)
class Slopes:
    """Stratified starts over many slopes, equally many in each cell of the angles, azimuths innermost."""

    start: Start
    cell: np.ndarray  # (2, k) which of the inclination, and which of the azimuth
    inclinations: np.ndarray  # (a + 1,) rad, edges of the cells
    azimuths: np.ndarray  # (b + 1,) rad; of one cell from 0 to 0 in the plane


def over_slopes(task: Task, steepest: float | None = None, every: int = 1) -> Slopes:
    """Return the frozen starts of a task over slopes up to `steepest` [rad], by default the task's own.

    In the plane 20 cells of the inclination with 50 starts each; in space 6 of the inclination and 12 of the
    azimuth with 15 each. Angles are uniform within their cells, starts within the upper half of the arena.
    A task in space with a single slope has only that one. every: each k-th start only. Raises UserError for a
    task that does not observe the slope.
    """
    if not isinstance(task, SlopeLanding):
        raise UserError(f"the {task.name} task of this policy has one slope and does not observe it")
    steepest = task.steepest if steepest is None else steepest
    rng = np.random.default_rng(_SLOPES_SEED)
    if steepest is None:
        inclinations, azimuths = np.full(2, task.inclination), np.full(2, task.azimuth)
        each = _CELLS * _EACH
    elif task.is_planar:
        inclinations, azimuths, each = np.linspace(-steepest, steepest, _CELLS + 1), np.zeros(2), _EACH
    else:
        inclinations, each = np.linspace(0.0, steepest, _SPACE_CELLS + 1), _SPACE_EACH
        azimuths = np.linspace(-math.pi, math.pi, _AZIMUTHS + 1)
    cells = np.indices((len(inclinations) - 1, len(azimuths) - 1)).reshape(2, -1).repeat(each, axis=1)
    drawn = [
        edges[k] + np.diff(edges)[k] * rng.random(len(k)) for edges, k in zip((inclinations, azimuths), cells)
    ]
    return Slopes(task.sample_over(rng, *drawn)[::every], cells[:, ::every], inclinations, azimuths)


def at_rest(task: Task, starts: np.ndarray) -> np.ndarray:
    """Return states (k, 13) of a vehicle hovering at `starts` (k, 2): x, z [m]."""
    positions = np.zeros((len(starts), 3))
    positions[:, [0, 2]] = starts
    return hover_states(positions, task.vehicle)
