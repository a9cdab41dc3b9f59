"""The figure of a study: shares of every policy over a quantity, or under named conditions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator

from inclined_landing.eval.base.style import MUTED, colour, literal, marker, percent, share_curve, styled
from inclined_landing.eval.policies.tables import Panel


def draw_panels(panels: Sequence[Panel], share: str) -> Figure:
    """Return the figure of panels side by side; share: what the shares count, in words."""
    names = list(panels[0].shares)
    rows = max([0, *(len(panel.conditions) for panel in panels if not panel.quantity)])
    label = f"{share} [%]"
    with styled():
        width = 3.7 if len(panels) < 3 else 2.9  # inches; a wider figure is hard to read on a page
        size = 1.5 + width * len(panels), max(3.7, 1.3 + 0.3 * rows)
        figure = Figure(figsize=size, layout="constrained")
        before = None
        for k, (panel, axes) in enumerate(zip(panels, figure.subplots(1, len(panels), squeeze=False)[0])):
            axes.set_title(panel.title, loc="left")
            axes.grid(True, axis="both" if panel.quantity else "x")
            _draw_lines(axes, panel, names) if panel.quantity else _draw_rows(axes, panel, names)
            (axes.set_ylim if panel.quantity else axes.set_xlim)(-3, 103)
            if panel.quantity:
                axes.set_xlabel(panel.quantity)
                axes.set_ylabel(label)
            else:
                axes.set_xlabel(label)
                axes.tick_params(labelleft=k == 0 or panel.conditions != before)
            before = panel.conditions
        handles, labels = figure.axes[0].get_legend_handles_labels()
        figure.legend(
            [*handles, Patch(fc=MUTED, alpha=0.35)], [*labels, "95 % interval"],
            loc="outside upper center", ncols=min(5, len(names) + 1) if len(panels) > 1 else 2,
        )  # fmt: skip
    return figure


def _draw_lines(axes: Axes, panel: Panel, names: Sequence[str]) -> None:
    for k, name in enumerate(names):
        found = {x: share for x, share in panel.shares.get(name, {}).items() if share["of"]}
        if found:
            share_curve(axes, list(found), list(found.values()), k, name)
    if panel.logarithmic:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.minorticks_off()


def _draw_rows(axes: Axes, panel: Panel, names: Sequence[str]) -> None:
    apart = min(0.13, 0.8 / len(names))
    for k, name in enumerate(names):
        found = panel.shares.get(name, {})
        rows = [i for i, condition in enumerate(panel.conditions) if condition in found]
        if not rows:
            continue
        share, low, high = percent(list(found.values()))
        around = np.maximum(0.0, [share - low, high - share])
        at = np.array(rows) + apart * (k - 0.5 * (len(names) - 1))
        style: dict[str, Any] = {"color": colour(k), "fmt": marker(k), "label": literal(name)}
        axes.errorbar(share, at, xerr=around, ms=4, lw=1.2, **style)
    axes.set_yticks(range(len(panel.conditions)), [literal(x.replace("_", " ")) for x in panel.conditions])
    axes.set_ylim(len(panel.conditions) - 0.5, -0.5)
