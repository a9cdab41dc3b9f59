"""The figure of a plan: its path in the arena, its pieces in time, and the probabilities before and after."""

from __future__ import annotations

import math
import textwrap

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
from inclined_landing.models.vehicle import Vehicle

WIDTH, HEIGHT = 9.6, 7.9  # inches
_LETTERS = 24  # in a line of the names of a set


def picture(plan: Plan, platform: bool) -> Figure:
    """Return the figure; platform: the slab stands in the arena."""
    vehicle = plan.discrimination.vehicle
    with styled():
        figure = Figure(figsize=(WIDTH, HEIGHT))
        above = panel(figure, 0.7, 5.4, 4.6, 1.95)
        side = panel(figure, 0.7, 3.4, 4.6, 1.7)
        _way(above, plan, vehicle, platform, 1)
        _way(side, plan, vehicle, platform, 2)
        above.set_xlabel("")
        above.set_title("Planned path (time: dark to light);\nsimulated flights in grey", loc="left")
        _probabilities(panel(figure, 7.35, 3.4, 2.1, 3.95), plan)
        _timeline(panel(figure, 0.7, 0.5, 8.1, 1.6), plan)
    return figure


def _way(axes: Axes, plan: Plan, v: Vehicle, platform: bool, across: int) -> None:
    """Draw the path from above (across 1: y over x) or from the side (2: z over x)."""
    ends = (v.arena_y, v.arena_z)[across - 1]
    axes.set_facecolor(AIR)
    axes.grid(True)
    if platform:
        _slab(axes, v, across)
    for states in plan.trajectories:
        for flight in states:
            axes.plot(flight[:, 0], flight[:, across], color=MUTED, lw=0.4, alpha=0.4)
    position = plan.path.position
    colours = time_colours(np.linspace(0, 1, len(position) - 1)[::10])
    for k, colour in zip(range(0, len(position) - 1, 10), colours):
        axes.plot(position[k : k + 11, 0], position[k : k + 11, across], color=colour, lw=1.6)
    axes.plot(position[0, 0], position[0, across], "o", color=INK, ms=4)
    axes.set(xlim=v.arena_x, ylim=ends, aspect="equal", xlabel="x [m]", ylabel=f"{'xyz'[across]} [m]")
    axes.add_patch(
        Rectangle(
            (v.arena_x[0], ends[0]), np.ptp(v.arena_x), np.ptp(ends), fill=False, ec=INK, lw=1.2, zorder=5
        )
    )


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


def _probabilities(axes: Axes, plan: Plan) -> None:
    sets = plan.discrimination.hypotheses
    y = np.arange(len(sets))
    after = np.diag(plan.expected)
    axes.barh(y - 0.19, [h.probability for h in sets], 0.36, color=MUTED, label="before the flight")
    axes.barh(y + 0.19, after, 0.36, color=GREEN, label="expected after it, if true")
    for k, (h, a) in enumerate(zip(sets, after)):
        for at, x in ((k - 0.19, h.probability), (k + 0.19, a)):
            axes.text(min(x, 1.0) + 0.02, at, f"{x:.2f}", va="center")
    names = [" + ".join(h.effects).replace("_", " ") or "nothing" for h in sets]
    axes.set_yticks(y, [textwrap.fill(name, _LETTERS) for name in names], fontsize=8.5)
    axes.set(xlim=(0, 1.15), ylim=(len(sets) - 0.45, -0.55), xticks=[0, 0.5, 1], xlabel="probability")
    axes.set_title("Probability of each set\nof effects", loc="left")
    axes.legend(loc="upper right", bbox_to_anchor=(1.0, -0.12))


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
