"""The picture of a report on vehicles: strict success of drawn and of named vehicles."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from inclined_landing.eval.base.statistics import proportion
from inclined_landing.eval.base.style import BLUE, GREEN, INK, MUTED, ORANGE, PURPLE, literal, styled

_COLOURS, _MARKS = (BLUE, ORANGE, GREEN, PURPLE, MUTED), ("o", "s", "^", "D", "v")
_BINS = 8
_BAR = 95.0  # %: what one policy for all is asked for


def vehicles_figure(report: dict) -> Figure:
    """Strict success over mass and over thrust to weight.

    Lines with 95 % intervals: drawn vehicles in groups of equal size; marks: the named vehicles.
    """
    axis = {"mass": "mass [g]", "thrust_to_weight": "thrust to weight"}
    factor = {"mass": 1e3, "thrust_to_weight": 1.0}
    with styled():
        figure = Figure(figsize=(9.2, 3.8), layout="constrained")
        panels = figure.subplots(1, 2, sharey=True)
        for axes, key in zip(panels, axis):
            axes.grid(True)
            axes.axhline(_BAR, color=INK, lw=0.9, ls=(0, (2, 2)))
            for k, label in enumerate(report["labels"]):
                _draw(axes, report, label, key, factor[key], _COLOURS[k % 5], _MARKS[(k + k // 5) % 5])
            axes.set_xlabel(axis[key])
            axes.set_ylim(-3, 103)
        panels[0].set_xscale("log")
        ticks = [30, 50, 100, 200, 500]
        panels[0].set_xticks(ticks, [f"{tick}" for tick in ticks])
        panels[0].minorticks_off()
        panels[0].set_ylabel("strict success [%]")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=min(4, len(labels)))
    return figure


def _draw(axes: Axes, report: dict, label: str, key: str, factor: float, colour: str, mark: str) -> None:
    draws = report["draws"]
    name = literal(label)
    if draws is not None and label in draws["outcomes"]:
        where = np.array([member[key] for member in draws["members"]]) * factor
        landed = np.array([member["strict"][label] for member in draws["members"]])
        groups = np.array_split(np.argsort(where), min(_BINS, len(where)))
        each = draws["flown_each"][label]
        found = [proportion(landed[rows].sum(), each * len(rows)) for rows in groups]
        low, high = 100 * np.array([p["interval"] for p in found]).T
        x = [np.median(where[rows]) for rows in groups]
        axes.fill_between(x, low, high, color=colour, alpha=0.18, lw=0)
        axes.plot(x, [100 * p["share"] for p in found], color=colour, lw=1.6, label=name, gid="drawn")
        name = None
    points = [
        (row[key] * factor, 100 * row["outcomes"][label]["strict"]["share"])
        for row in report["vehicles"]
        if label in row["outcomes"]
    ]
    if points:
        style = {"mec": colour, "mfc": "white", "mew": 1.4, "ms": 6, "ls": "none", "gid": "named"}
        axes.plot(*zip(*points), marker=mark, label=name, **style)
