"""Pictures of the stages of a curriculum: starts, goal pose, goal box and platform."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from inclined_landing.envs.rendering.sprite import SpriteRenderer
from inclined_landing.envs.tasks.landing import InclinedLanding, LandingConditions
from inclined_landing.eval.base.colours import GREEN, INK, MUTED
from inclined_landing.eval.base.style import panel, styled
from inclined_landing.eval.pictures.figures.scene import (
    GOAL_COLOUR,
    draw_background,
    draw_platform,
    draw_vehicle,
)
from inclined_landing.models.attitude import PITCH, X, Z
from inclined_landing.models.base.errors import UserError

_START = (0.10, 0.42, 0.75)  # tint of the vehicles at their starts
_COLUMNS = 2
STARTS = 8
_PAGE, _LEFT, _RIGHT, _GAP = 7.4, 0.58, 0.10, 0.18  # in
_FOOT = 0.66  # in; axis label and note
_SCALE = 4.0  # of the drawn vehicles; a panel shows the whole width of the arena
_LOWEST = 0.5  # m; the panels are cut off here, unless starts lie lower


def curriculum_figure(
    stages: Sequence[tuple[str, LandingConditions]], *, task: InclinedLanding | None = None
) -> Figure:
    """Return a figure with one panel for each stage (title, conditions), in reading order.

    A panel shows STARTS starts sampled by the task under these conditions, the box from which they come, the
    goal pose in green with the goal box, and the platform if there is one. Raises UserError for no stages.
    """
    if not stages:
        raise UserError("a curriculum figure needs at least one stage")
    task = copy.copy(task) if task is not None else InclinedLanding()
    columns = min(_COLUMNS, len(stages))
    rows = -(-len(stages) // columns)
    v = task.vehicle
    x = v.arena_x
    z = (min([_LOWEST, *(conditions.lowest_start - 0.2 for _, conditions in stages)]), v.arena_z[1])
    page = _PAGE if columns > 1 else 0.6 * _PAGE
    width = (page - _LEFT - _RIGHT - (columns - 1) * _GAP) / columns
    height = width * (z[1] - z[0]) / (x[1] - x[0])
    deep = height + 0.36
    with styled():
        figure = Figure(figsize=(page, rows * deep + _FOOT))
        sprites = SpriteRenderer(v, scale=_SCALE, pixels=256)
        for k, (title, conditions) in enumerate(stages):
            row, column = divmod(k, columns)
            left = _LEFT + column * (width + _GAP)
            axes = panel(figure, left, _FOOT + (rows - 1 - row) * deep, width, height)
            task.conditions = conditions
            rng = np.random.default_rng([0, k])
            _draw_stage(axes, task, sprites, task.sample(rng, STARTS).state, x, z)
            axes.set_title(f"{k + 1}  {title}", loc="left", pad=4)
            axes.set_yticks(np.arange(np.ceil(2 * z[0]) / 2, z[1], 0.5))
            if column:
                axes.set_ylabel("")
                axes.tick_params(labelleft=False)
            if k + columns < len(stages):
                axes.set_xlabel("")
                axes.tick_params(labelbottom=False)
        note = f"quadrotors drawn at {_SCALE:g}× size; dashed: starts; green: goal"
        figure.text(1.0 - _RIGHT / page, 0.08 / figure.get_figheight(), note, color=MUTED, ha="right")
    return figure


def _draw_stage(axes: Axes, task: InclinedLanding, sprites: SpriteRenderer, states, x, z) -> None:
    c = task.conditions
    inclination = task.inclination * c.tilt
    draw_background(axes, x, z)
    for spine in ("top", "right"):
        axes.spines[spine].set_visible(True)
    if c.platform:
        draw_platform(axes, inclination, task.vehicle)
    low, high = (corner[[0, -1]] for corner in task.start_box())  # x, z
    box = Rectangle(low, *(high - low), fill=False, ec=INK, lw=1.1, ls=(0, (4, 2)), zorder=3, gid="starts")
    axes.add_patch(box)
    for state in states:
        draw_vehicle(axes, sprites, state, colour=_START, alpha=0.8, zorder=4, gid="start")
    goal, centre = np.zeros(13), np.array(task.goal_position)[[0, -1]]
    goal[[X, Z]], goal[PITCH] = centre, inclination
    d = c.goal_size
    corner = centre - d
    axes.add_patch(Rectangle(corner, 2 * d, 2 * d, fc=GREEN, alpha=0.16, lw=0, zorder=4.4))
    axes.add_patch(Rectangle(corner, 2 * d, 2 * d, fill=False, ec=GREEN, lw=1.1, zorder=4.5, gid="goal box"))
    draw_vehicle(axes, sprites, goal, colour=GOAL_COLOUR, zorder=4.6, gid="target")
    note = f"tilt {abs(np.degrees(inclination)):.0f}°\ngoal box ±{100 * d:.0f} cm"
    axes.text(0.012, 0.05, note, transform=axes.transAxes, size=8.5, color=MUTED)
