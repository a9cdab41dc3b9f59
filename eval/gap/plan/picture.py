"""The figure of a plan: its path in the arena, its pieces in time, and the probabilities before and after."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle

from inclined_landing.eval.base.style import (
    AIR,
    BASE,
    BLUE,
    GREEN,
    INK,
    MUTED,
    ORANGE,
    PURPLE,
    RULE,
    SLAB,
    panel,
    styled,
    time_colours,
)
from inclined_landing.eval.gap.plan.design import Plan
from inclined_landing.eval.gap.plan.doubt import InDoubt
from inclined_landing.eval.gap.report.words import label
from inclined_landing.models.vehicle import Vehicle

WIDTH = 7.0  # inches
_LETTERS = 18  # in a line of the name of an effect


def picture(plan: Plan, found: Sequence[InDoubt], platform: bool) -> Figure:
    """Return the figure; found: the effects in doubt; platform: the slab stands in the arena."""
    vehicle = plan.discrimination.vehicle
    with styled():
        rows = 0.36 * len(found) + 0.1
        below = rows + 2.9
        figure = Figure(figsize=(WIDTH, below + 3.1))
        for k, title in ((1, "path from above"), (2, "path from the side")):
            axes = panel(figure, 0.7 + 3.4 * (k - 1), below + 0.2, 2.6, 2.6)
            _path(axes, plan, vehicle, platform, k)
            axes.set_title(title, loc="left")
        _probabilities(panel(figure, 1.7, 2.35, 2.6, rows), found)
        _timeline(panel(figure, 0.7, 0.5, WIDTH - 1.5, 1.15), plan)
    return figure


def _path(axes: Axes, plan: Plan, v: Vehicle, platform: bool, across: int) -> None:
    """Draw the path from above (across 1: y over x) or from the side (2: z over x), dark to light in time."""
    axes.set_facecolor(AIR)
    axes.grid(True)
    if platform:
        _slab(axes, v, across)
    for states in plan.trajectories:
        for flight in states:
            axes.plot(flight[:, 0], flight[:, across], color=MUTED, lw=0.5, alpha=0.4)
    x, y = plan.path.position[:, 0], plan.path.position[:, across]
    colours = time_colours(np.linspace(0, 1, len(x) - 1)[::10])
    for k, colour in zip(range(0, len(x) - 1, 10), colours):
        axes.plot(x[k : k + 11], y[k : k + 11], color=colour, lw=1.6)
    axes.plot(x[0], y[0], "o", color=INK, ms=4)
    middle = [0.5 * (p.min() + p.max()) for p in (x, y)]
    half = max(0.6, *(0.5 * np.ptp(p) + 0.25 for p in (x, y)))
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half))
    axes.set(aspect="equal", xlabel="x [m]", ylabel=f"{'xyz'[across]} [m]")


def _slab(axes: Axes, v: Vehicle, across: int) -> None:
    half = 0.5 * v.platform_width
    if across == 1:
        axes.add_patch(
            Rectangle(
                (-half, -0.5 * v.platform_depth), 2 * half, v.platform_depth, fc=SLAB, ec=BASE, zorder=1
            )
        )
        return
    rise = -half * math.tan(v.platform_inclination)
    top = v.platform_surface_height
    corners = [(-half, 0.0), (-half, top - rise), (half, top + rise), (half, 0.0)]
    axes.add_patch(Polygon(corners, fc=SLAB, ec=BASE, zorder=1))


def _probabilities(axes: Axes, found: Sequence[InDoubt]) -> None:
    """Draw the probability of each effect before the flight and the expected ones after it."""
    y = np.arange(len(found))
    for ends, value in zip(zip([x.if_not for x in found], [x.if_missing for x in found]), y):
        axes.plot(ends, [value] * 2, color=RULE, lw=4, solid_capstyle="round", zorder=1)
    for name, attribute, colour, marker in (
        ("before", "probability", MUTED, "o"),
        ("after, if the model lacks it", "if_missing", GREEN, ">"),
        ("after, if not", "if_not", ORANGE, "<"),
    ):
        x = [getattr(one, attribute) for one in found]
        axes.plot(x, y, marker, color=colour, ms=7, label=name, zorder=2, clip_on=False)
    axes.set_yticks(y, [textwrap.fill(label(one.name), _LETTERS) for one in found], fontsize=9)
    axes.set(xlim=(0, 1), ylim=(len(found) - 0.5, -0.5), xticks=[0, 0.5, 1], xlabel="probability")
    axes.grid(axis="x")
    axes.set_title("Does the model lack it?", loc="left")
    axes.legend(loc="center left", bbox_to_anchor=(1.02, 0.5))


def _timeline(axes: Axes, plan: Plan) -> None:
    t, path = plan.path.t, plan.path
    turned = axes.twinx()
    speed = np.linalg.norm(plan.points.velocity, axis=1)
    lines = [
        *axes.plot(t, path.position[:, 2], color=BLUE, lw=1.4, label="height (left)"),
        *axes.plot(t, speed, color=ORANGE, lw=1.4, label="speed (left)"),
        *turned.plot(
            t, np.degrees(path.yaw), color=PURPLE, lw=1.4, ls=(0, (5, 1.5)), label="heading (right)"
        ),
    ]
    low, high = axes.get_ylim()
    high += 0.28 * (high - low)
    for k, span in enumerate(path.spans):
        axes.axvspan(span.start, span.stop, color=RULE, alpha=0.7 if k % 2 else 0.4, lw=0, zorder=0)
        middle = 0.5 * (span.start + span.stop)
        name, leaning = span.piece.kind.replace("_", " "), 0 if span.stop - span.start > 1.6 else 35
        axes.text(middle, high, name, ha="center", va="top", fontsize=8, color=INK, rotation=leaning)
    axes.set(xlim=(0, path.seconds), ylim=(low, high), xlabel="time [s]", ylabel="height [m], speed [m/s]")
    low, high = turned.get_ylim()
    low, high = min(low, -10.0), max(high, 10.0)  # a heading that is held is a line, not its rounding
    turned.set(ylim=(low, high + 0.28 * (high - low)), ylabel="heading [deg]")
    turned.spines["right"].set_visible(True)
    axes.legend(handles=lines, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, borderpad=0.1)
