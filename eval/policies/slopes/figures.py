"""The picture of a slopes report: strict success over the inclination, and over all directions in space."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from inclined_landing.eval.base.style import (
    BLUE,
    GREEN,
    INK,
    MUTED,
    ORANGE,
    PURPLE,
    RULE,
    literal,
    styled,
)

_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, MUTED)
_MARKS = ("o", "s", "^", "D", "v")
_HEAT = LinearSegmentedColormap.from_list("lost", ["#8f3205", "#e66f22", "#fbc58e", "#fdf0e2", "#f4f8fb"])
_MAPS = 3  # at most
_ROUND = 10  # parts that a cell's arc is drawn in


def slopes_figure(report: dict) -> Figure:
    """Figure: a line for each policy that observes the slope, marks for single slopes, maps in space."""
    entries = report["policies"]
    maps = [entry for entry in entries if len(entry.get("azimuths", ())) > 2][:_MAPS]
    shares = [p["strict"]["share"] for e in entries for p in (*e.get("curve", ()), *e["single"])]
    lowest = 100 * min(0.9 if share is None else share for share in (0.9, *shares))
    with styled():
        figure = Figure(figsize=(6.4 + 3.1 * len(maps), 4.3), layout="constrained")
        axes = figure.add_subplot(1, 2 + len(maps), (1, 2))
        _curves(axes, entries, lowest)
        for k, entry in enumerate(maps):
            _map(figure, figure.add_subplot(1, 2 + len(maps), 3 + k, projection="polar"), entry)
    return figure


def _curves(axes: Axes, entries: list[dict], lowest: float) -> None:
    axes.grid(True)
    for k, entry in enumerate(entries):
        colour, mark = _COLOURS[k % 5], _MARKS[(k + k // 5) % 5]
        curve = [p for p in entry.get("curve", []) if p["strict"]["of"]]
        if len(curve) > 1:
            angle = np.degrees([0.5 * (p["from"] + p["to"]) for p in curve])
            share = 100 * np.array([p["strict"]["share"] for p in curve])
            low, high = 100 * np.array([p["strict"]["interval"] for p in curve]).T
            axes.fill_between(angle, low, high, color=colour, alpha=0.15, lw=0)
            axes.plot(angle, share, color=colour, marker=mark, ms=4, label=literal(entry["name"]))
        alone = entry["single"]
        if alone:
            share = 100 * np.array([p["strict"]["share"] for p in alone])
            low, high = 100 * np.array([p["strict"]["interval"] for p in alone]).T
            axes.errorbar(
                np.degrees([p["inclination"] for p in alone]), share, (share - low, high - share),
                fmt=mark, ms=6.5, mfc="white", mec=colour, ecolor=colour, elinewidth=1.2, capsize=3,
                label=None if len(curve) > 1 else literal(entry["name"]),
            )  # fmt: skip
    axes.set_ylim(max(-3.0, lowest - 8.0), 101.5)
    axes.set_xlabel("inclination [deg]")
    axes.set_ylabel("strict success [%]")
    handles, labels = axes.get_legend_handles_labels()
    axes.figure.legend(
        [*handles, Patch(fc=MUTED, alpha=0.3), axes.plot([], [], "o", mfc="white", mec=INK, ms=6.5)[0]],
        [*labels, "95 % interval", "one slope alone, frozen grid"],
        loc="outside lower center",
        ncols=3,
    )


def _map(figure: Figure, axes: Axes, entry: dict) -> None:
    """Azimuth as the direction, inclination as the radius."""
    share = 100 * np.array([[cell["share"] for cell in row] for row in entry["cells"]], float)
    fine = np.linspace(entry["azimuths"][0], entry["azimuths"][-1], share.shape[1] * _ROUND + 1)
    share = share.repeat(_ROUND, axis=1)  # for round edges
    edges = fine, np.degrees(entry["inclinations"])
    lowest = 10 * np.floor(np.nanmin([80.0, *share.ravel()]) / 10)
    mesh = axes.pcolormesh(*edges, share, cmap=_HEAT, vmin=lowest, vmax=100)
    for angle in edges[1][1:]:
        axes.plot(fine, np.full(len(fine), angle), color=RULE, lw=0.5)
    for azimuth in entry["azimuths"]:
        axes.plot([azimuth] * 2, edges[1][[0, -1]], color=RULE, lw=0.5)
    axes.grid(False)
    axes.set_rlabel_position(15)
    axes.set_yticks([t for t in (10, 20, 30, 40, 50) if t <= edges[1][-1] + 0.1])
    axes.set_yticklabels([f"{t:.0f}°" for t in axes.get_yticks()], size=7.5, color=INK)
    axes.tick_params(axis="x", labelsize=7.5, pad=-1)
    axes.set_title(literal(entry["name"]), pad=10)
    axes.set_xlabel("direction: azimuth, radius: inclination", size=8, color=MUTED)
    bar = figure.colorbar(mesh, ax=axes, shrink=0.75, pad=0.09)
    bar.set_label("strict success [%]", size=8)
    bar.ax.tick_params(labelsize=7.5)
