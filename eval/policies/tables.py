"""Tables and figures of outcomes by policy and condition, the same for every study.

An outcome is what `flying.summary` counts: shares with their intervals, medians with their quantiles, by the
names of `MEASURES`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator

from inclined_landing.envs.shared.tables import share_cell, spread_cell
from inclined_landing.eval.base.claims import Table
from inclined_landing.eval.base.style import MUTED, colour, literal, marker, percent, share_curve, styled

Row = tuple[tuple[str, ...], Mapping[str, Any]]  # labels and outcome


def _median(found: dict, factor: float = 1.0) -> str:
    return "-" if found["median"] is None else f"{factor * found['median']:.2f}"


def _count(share: dict) -> str:
    return str(share["count"])


def _centimetres(key: str) -> Callable[[dict], str]:
    return lambda error: f"{100 * error[key]:.2f}"


STRICT = (
    "Strict success: the vehicle reaches the goal box within 300 steps without touching anything first. "
    "Shares have 95 % Wilson intervals."
)
# What may be counted: heading, and the text of a cell.
MEASURES: dict[str, tuple[str, Callable[[dict], str]]] = {
    "strict": ("strict [%]", share_cell),
    "success": ("success [%]", share_cell),
    "touched": ("touched", _count),
    "at_rest": ("at rest [%]", share_cell),
    "at_rest_on_feet": ("at rest on feet [%]", share_cell),
    "within": ("< 5 cm [%]", share_cell),
    "error": ("error after 3 s [cm]", _centimetres("mean")),
    "time_to_goal": ("time [s]", spread_cell),
    "time": ("time [s]", _median),
    "normal_speed": ("normal speed [m/s]", _median),
    "tangential_speed": ("tangential speed [m/s]", _median),
    "tilt": ("tilt [deg]", lambda found: _median(found, math.degrees(1.0))),
    "peak_normal_force": ("peak force [N]", _median),
    "reward": ("reward", spread_cell),
    "duration": ("duration [s]", spread_cell),
}


def outcomes_table(heads: Sequence[str], rows: Sequence[Row]) -> Table:
    """Return a table with a row for each outcome: labels under `heads`, number of flights, measures.

    In the first column, a label that repeats the one above is left out.
    """
    shown = [name for name in MEASURES if rows and name in rows[0][1]]
    counted = shown[0] if shown else ""
    cells, before = [], ""
    for labels, found in rows:
        first = "" if labels[0] == before and len(labels) > 1 else labels[0]
        before = labels[0]
        texts = (MEASURES[name][1](found[name]) if name in found else "-" for name in shown)
        cells.append((first, *labels[1:], str(found[counted]["of"]), *texts))
    return Table("", (*heads, "flights", *(MEASURES[name][0] for name in shown)), cells)


def size_words(parameters: dict) -> str:
    """Return parameter values with their units: "x 0.5, y -0.3 m/s"."""
    units = {p["unit"] for p in parameters.values()}
    common = units.pop() if len(units) == 1 else None
    texts = []
    for name, p in parameters.items():
        unit = "" if p["unit"] in ("1", common) else f" {p['unit']}"
        texts.append(f"{name} {p['value']:g}{unit}")
    return ", ".join(texts) + (f" {common}" if common not in (None, "1") else "")


def slope_words(options: dict) -> str:
    """Return the slopes of a task: "-25.7 deg", "up to +-25.7 deg" or "up to 30 deg, any heading"."""
    if options.get("steepest") is None:
        return f"{math.degrees(options['inclination']):.1f} deg"
    steepest = f"{math.degrees(options['steepest']):.3g} deg"
    return f"up to +-{steepest}" if options.get("dimensions", 2) == 2 else f"up to {steepest}, any heading"


@dataclasses.dataclass(frozen=True)
class Panel:
    """Shares with their 95 % intervals, of every policy by its name.

    Shares at numbers are drawn as lines over a quantity, shares under named conditions as marks in rows.
    """

    title: str
    shares: Mapping[str, Mapping[Any, dict]]  # by policy, by number or condition
    quantity: str = ""  # with its unit; "": of conditions with names
    logarithmic: bool = False

    @property
    def conditions(self) -> list[str]:
        """Return the names of the conditions of any policy."""
        return list(dict.fromkeys(name for found in self.shares.values() for name in found))


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
