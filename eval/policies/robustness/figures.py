"""The pictures of a robustness report: the curve over thrust, and the matrix of policies and effects."""

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
    panel,
    styled,
)
from inclined_landing.eval.policies.robustness.study import SIZES
from inclined_landing.eval.policies.success_table import size_words

# What is shown of an outcome: its key, and what it is called.
SHOWN = {
    "strict": "Goal box reached without a touch",
    "at_rest_on_feet": "At rest on the feet, motors cut there",
}
_COLOURS = (ORANGE, BLUE, GREEN, PURPLE, MUTED)
_LINES = ("-", "--", "-.", ":")  # from the sixth policy on
_MARKS = ("o", "s", "^", "D", "v")
# Nothing to see where all land.
_HEAT = LinearSegmentedColormap.from_list("lost", ["#8f3205", "#e66f22", "#fbc58e", "#fdf0e2", "#f4f8fb"])
_DARK = 0.35  # share up to which cells are dark
_CELL, _ROW, _APART = 0.44, 0.215, 0.06  # in
_TITLE = 3.1  # in, of a panel at least
_NAMES, _GAP, _HEAD, _FOOT = 3.15, 0.16, 0.75, 0.55  # in


def thrust_figure(report: dict) -> Figure:
    """Figure of both shares over the thrust, each with its 95 % interval; a line for each policy."""
    rows, names = report["thrust"], [policy["name"] for policy in report["policies"]]
    scale = [row["parameters"]["scale"]["value"] for row in rows]
    with styled():
        figure = Figure(figsize=(8.6, 3.7), layout="constrained")
        panels = figure.subplots(1, 2, sharex=True, sharey=True)
        for axes, (key, label) in zip(panels, SHOWN.items()):
            axes.grid(True)
            known = axes.axvline(1.0, color=INK, lw=1.1, ls=(0, (2, 2)), zorder=1)
            for k, name in enumerate(names):
                found = [row["outcomes"][k][key] for row in rows]
                share = 100 * np.array([p["share"] for p in found])
                low, high = 100 * np.array([p["interval"] for p in found]).T
                colour, mark = _COLOURS[k % len(_COLOURS)], _MARKS[k % len(_MARKS)]
                axes.fill_between(scale, low, high, color=colour, alpha=0.2, lw=0, gid="interval")
                line = _LINES[k // len(_COLOURS) % len(_LINES)]
                axes.plot(
                    scale, share, line, color=colour, marker=mark, ms=4, label=literal(name), gid="share"
                )
            axes.set_title(label, loc="left")
            axes.set_xlabel("thrust of the vehicle over the known one")
            axes.set_ylim(-3, 103)
        panels[0].set_ylabel("share of the starts [%]")
        handles, labels = axes.get_legend_handles_labels()
        figure.legend(
            [*handles, Patch(fc=MUTED, alpha=0.35), known],
            [*labels, "95 % interval", "known thrust"],
            loc="outside upper center", ncols=min(5, len(names) + 2),
        )  # fmt: skip
    return figure


def matrix_figure(report: dict) -> Figure:
    """Figure of both shares for every effect in every size; a block of columns for each policy.

    Effects stand in the order of what all policies lose to them, the worst at the top.
    """
    table, names = matrix(report), [policy["name"] for policy in report["policies"]]
    effects = list(table)
    columns = len(names) * len(SIZES)
    cell = max(_CELL, _TITLE / columns)
    width = cell * columns + _APART * (len(names) - 1)
    height = _ROW * len(effects)
    with styled():
        figure = Figure(figsize=(_NAMES + 2 * width + _GAP + 0.1, height + _HEAD + _FOOT))
        for p, (key, label) in enumerate(SHOWN.items()):
            axes = panel(figure, _NAMES + p * (width + _GAP), _FOOT, width, height)
            _draw(axes, [[row["outcomes"] for row in table[name]] for name in effects], key, names, cell)
            axes.text(0, -1.75, f"{label} [%]", size=9.5, weight="bold", va="bottom")
            if p == 0:
                axes.set_yticks(np.arange(len(effects)) + 0.5)
                axes.set_yticklabels([_row_name(table[name]) for name in effects], size=8)
        intervals = [
            row["outcomes"][k]["strict"]["interval"] for row in report["effects"] for k in range(len(names))
        ]
        widest = max((high - low) / 2 for low, high in intervals)
        note = (
            "In brackets: the effect's medium size, as a real vehicle may well have it; weak is half as far "
            "from none, strong twice.\nShare of the starts, the darker the fewer; "
            f"{report['starts']} starts a cell: 95 % intervals reach {100 * widest:.0f} points at most."
        )
        w, h = figure.get_size_inches()
        figure.text(0.1 / w, 0.12 / h, note, size=8, color=MUTED, linespacing=1.5)
    return figure


def matrix(report: dict) -> dict[str, list[dict]]:
    """The entries of each effect, one for each size, effects in the order of what is lost to them."""
    table: dict[str, list[dict]] = {}
    for row in report["effects"]:
        table.setdefault(row["effect"], []).append(row)
    share = {
        name: np.mean([outcome["strict"]["share"] for row in rows for outcome in row["outcomes"]])
        for name, rows in table.items()
    }
    return {name: table[name] for name in sorted(table, key=lambda name: share[name])}


def _row_name(rows: list[dict]) -> str:
    """An effect with its medium size."""
    size = size_words(rows[list(SIZES).index("medium")]["parameters"])
    return f"{rows[0]['effect']} ({size})" if len(size) < 22 else rows[0]["effect"]


def _draw(axes: Axes, cells: list[list[list[dict]]], key: str, names: list[str], step: float) -> None:
    """cells: by effect, size and policy; step: width of one [in]."""
    axes.set_xlim(0, step * len(SIZES) * len(names) + _APART * (len(names) - 1))
    axes.set_ylim(len(cells), 0)
    axes.tick_params(length=0)
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)
    for k, name in enumerate(names):
        left = k * (step * len(SIZES) + _APART)
        share = np.array([[sizes[k][key]["share"] for sizes in row] for row in cells])
        axes.pcolormesh(
            left + step * np.arange(len(SIZES) + 1), np.arange(len(cells) + 1), share,
            cmap=_HEAT, vmin=0, vmax=1, edgecolors=RULE, linewidth=0.4, gid="cells",
        )  # fmt: skip
        for (i, j), value in np.ndenumerate(share):
            # Not all, however nearly, is never 100.
            text = f"{100 * value:.0f}" if value in (0.0, 1.0) else f"{min(99, max(1, round(100 * value)))}"
            colour = "white" if value < _DARK else INK
            axes.text(
                left + step * (j + 0.5),
                i + 0.5,
                text,
                color=colour,
                size=7.5,
                ha="center",
                va="center_baseline",
            )
        for j, size in enumerate(SIZES):
            axes.text(left + step * (j + 0.5), -0.18, size, size=7, color=MUTED, ha="center", va="bottom")
        short = name if len(name) <= 20 else name[:19] + "…"
        axes.text(left, -0.95, literal(short), size=8.5, va="bottom")
