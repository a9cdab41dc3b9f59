"""The figure of missions: paths from the side and from above, coloured by leg."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle

from inclined_landing.envs.hover import TOLERANCE
from inclined_landing.envs.mission import LEGS, Mission
from inclined_landing.envs.rendering.sprite import SpriteRenderer
from inclined_landing.eval.base.colours import BASE, INK, MUTED, SLAB
from inclined_landing.eval.base.style import halo, legend_below, panel, styled
from inclined_landing.eval.pictures.figures.scene import draw_background, draw_platform, draw_vehicle
from inclined_landing.eval.pictures.labels import LEG_COLOURS, leg_colours
from inclined_landing.eval.pictures.path import select_copies
from inclined_landing.models.attitude import X, Y, Z

_WIDTH, _LEFT, _RIGHT = 7.0, 0.60, 0.14  # in
_COPIES, _SPACING, _TURN = 12, 0.25, 0.12  # see `select_copies`
_MARGIN = 0.1  # m around the arena's part that is shown
_MOST_PATHS = 100  # ways of others that are drawn


def mission_figure(mission: Mission, others: Sequence[Mission] = ()) -> Figure:
    """Return a figure of one mission from the side, with copies of the vehicle, and from above.

    others: missions of the same plan, of which at most the first hundred are drawn as thin lines behind it.
    """
    others = [other for other in others if other is not mission][:_MOST_PATHS]
    points = np.concatenate([track.state[:, :3] for track in (mission, *others)])
    vehicle = mission.plan.vehicle
    low = np.minimum(points.min(axis=0), (-1.0, vehicle.arena_y[0], 0.0)) - _MARGIN
    high = np.maximum(points.max(axis=0), (1.0, vehicle.arena_y[1], vehicle.arena_z[1])) + _MARGIN
    low[Z] = 0.0
    width = _WIDTH - _LEFT - _RIGHT
    side, top = (width * (high[axis] - low[axis]) / (high[X] - low[X]) for axis in (Z, Y))
    foot, gap = 0.82, 0.56
    with styled():
        figure = Figure(figsize=(_WIDTH, foot + top + gap + side + 0.36))
        above = panel(figure, _LEFT, foot, width, top)
        side_view = panel(figure, _LEFT, foot + top + gap, width, side)
        for axes, plane in ((side_view, [X, Z]), (above, [X, Y])):
            across, up = ((low[axis], high[axis]) for axis in plane)
            draw_background(axes, across, up)
            for other in others:
                _draw_path(axes, other, plane, lw=0.6, alpha=0.3, zorder=2.6, gid="other way")
            _draw_path(axes, mission, plane, lw=2.2, zorder=3, path_effects=halo(4.0), gid="way")
        above.set_ylabel("y [m]")
        draw_platform(side_view, mission.plan.task.inclination, vehicle)
        half = vehicle.slab_half_length * np.cos(mission.plan.task.inclination), 0.5 * vehicle.platform_depth
        slab = Rectangle(
            (-half[0], -half[1]), 2 * half[0], 2 * half[1], facecolor=SLAB, edgecolor=BASE, lw=0.5
        )
        above.add_patch(slab)
        _draw_vehicle_and_box(side_view, above, mission)
        _draw_annotations(side_view, above, mission, others)
    return figure


def _draw_path(axes, mission: Mission, plane, **look) -> None:
    place = mission.state[:, plane]
    segments = np.stack([place[:-1], place[1:]], axis=1)
    axes.add_collection(
        LineCollection(segments, colors=leg_colours(mission)[:-1], capstyle="round", **look), autolim=False
    )


def _draw_vehicle_and_box(side_view, above, mission: Mission) -> None:
    """Draw copies of the vehicle, its start and end, and the hand-over box."""
    sprites, colours = SpriteRenderer(mission.plan.vehicle), leg_colours(mission)
    for order, k in enumerate(select_copies(mission.state, _COPIES, _SPACING, _TURN)):
        draw_vehicle(
            side_view,
            sprites,
            mission.state[k],
            colour=tuple(colours[k]),
            alpha=0.95,
            zorder=4 + 0.01 * order,
        )
    x, _, z = mission.plan.point
    for axes, other in ((side_view, z), (above, 0.0)):
        box = Circle((x, other), TOLERANCE, fill=False, ec=INK, lw=0.9, zorder=5, gid="hand-over box")
        axes.add_patch(box)
    start, end = mission.state[0], mission.state[-1]
    above.plot(*start[[X, Y]], "o", ms=6, color=colours[0], zorder=5, gid="start")
    above.plot(*end[[X, Y]], "o", ms=6, color=colours[-1], mec="white", zorder=5, gid="end")


def _draw_annotations(side_view, above, mission: Mission, others: Sequence[Mission]) -> None:
    lines, names = [], []
    for colour, name in zip(LEG_COLOURS, LEGS):
        flown_leg = mission.find_leg(name)
        if flown_leg is not None or any(other.find_leg(name) for other in others):
            lines.append(Line2D([], [], color=colour, lw=2.2))
            names.append(name if flown_leg is None else f"{name} {flown_leg.duration:.2f} s")
    lines.append(Line2D([], [], color=INK, marker="o", mfc="none", ls="", mew=0.9))
    names.append("hand-over box")
    legend_below(above, handles=lines, labels=names, ncols=len(names), columnspacing=1.1, handlelength=1.3)
    start = mission.state[0]
    title = f"From x {start[X]:.2f}, y {start[Y]:.2f}, z {start[Z]:.2f} m: {mission.summary}"
    side_view.set_title(title, loc="left", pad=6)
    scale = SpriteRenderer(mission.plan.vehicle).scale
    behind = f"; thin: {len(others)} other mission{'s' * (len(others) != 1)}" if others else ""
    notes = {side_view: f"from the side; quadrotor drawn {scale:g}×", above: f"from above{behind}"}
    for axes, note in notes.items():
        axes.text(0.012, 0.97, note, transform=axes.transAxes, va="top", size=8.5, color=MUTED)
