"""The figures of the reports: curve over thrust, matrix of effects, slopes with maps, vehicles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from inclined_landing.envs.shared.statistics import proportion
from inclined_landing.eval.base.style import (
    INK,
    MUTED,
    RULE,
    colour,
    literal,
    marker,
    panel,
    percent,
    share_curve,
    styled,
)
from inclined_landing.eval.policies.success_table import size_words
from inclined_landing.eval.robustness.changes import SIZES

# What is shown of an outcome: its key, and what it is called.
SHOWN = {
    "strict": "Goal box reached without a touch",
    "at_rest_on_feet": "At rest on the feet, motors cut there",
}
# Nearly white where all land.
_HEAT = LinearSegmentedColormap.from_list("lost", ["#8f3205", "#e66f22", "#fbc58e", "#fdf0e2", "#f4f8fb"])
_DARK = 0.35  # share up to which cells are dark
_CELL, _ROW, _APART = 0.44, 0.215, 0.06  # in
_TITLE = 3.1  # in, of a panel at least
_NAMES, _GAP, _HEAD, _FOOT = 3.15, 0.16, 0.75, 0.55  # in
_MAPS = 3  # at most
_ROUND = 10  # parts that a map's arc is drawn in
_BINS = 8  # groups of drawn vehicles
_BAR = 95.0  # %: what is asked of one policy for all vehicles


def thrust_figure(report: dict[str, Any]) -> Figure:
    """Return the figure of both shares over the thrust with 95 % intervals; a line for each policy."""
    rows, names = report["thrust"], [policy["name"] for policy in report["policies"]]
    scale = [row["parameters"]["scale"]["value"] for row in rows]
    with styled():
        figure = Figure(figsize=(8.6, 3.7), layout="constrained")
        panels = figure.subplots(1, 2, sharex=True, sharey=True)
        for axes, (key, label) in zip(panels, SHOWN.items()):
            axes.grid(True)
            known = axes.axvline(1.0, color=INK, lw=1.1, ls=(0, (2, 2)), zorder=1)
            for k, name in enumerate(names):
                share_curve(axes, scale, [row["outcomes"][k][key] for row in rows], k, name)
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


def matrix_figure(report: dict[str, Any]) -> Figure:
    """Return the figure of both shares for every effect in every size; a block of columns for each policy.

    Effects are sorted by what all policies lose to them, the worst at the top.
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
            _heat_map(axes, [[row["outcomes"] for row in table[name]] for name in effects], key, names, cell)
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


def matrix(report: dict[str, Any]) -> dict[str, list[dict]]:
    """Return the entries of each effect, one for each size, the effects sorted by what is lost to them."""
    table: dict[str, list[dict]] = {}
    for row in report["effects"]:
        table.setdefault(row["effect"], []).append(row)
    share = {
        name: np.mean([outcome["strict"]["share"] for row in rows for outcome in row["outcomes"]])
        for name, rows in table.items()
    }
    return {name: table[name] for name in sorted(table, key=lambda name: share[name])}


def _row_name(rows: list[dict]) -> str:
    """Return an effect with its medium size as text."""
    size = size_words(rows[list(SIZES).index("medium")]["parameters"])
    return f"{rows[0]['effect']} ({size})" if len(size) < 22 else rows[0]["effect"]


def _heat_map(axes: Axes, cells: list[list[list[dict]]], key: str, names: list[str], step: float) -> None:
    """Draw the cells, by effect, size and policy; step: width of one [in]."""
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


def slopes_figure(report: dict[str, Any]) -> Figure:
    """Return the figure of strict success over the inclination, with maps of all directions.

    Lines: policies that observe the slope; marks: single slopes; maps: policies that fly in space.
    """
    entries = report["policies"]
    maps = [entry for entry in entries if len(entry.get("azimuths", ())) > 2][:_MAPS]
    drawn = [p["strict"] for e in entries for p in (*e.get("curve", ()), *e["single"])]
    lowest = 100 * min([0.9, *(share["interval"][0] for share in drawn if share["of"])])
    with styled():
        figure = Figure(figsize=(6.4 + 3.1 * len(maps), 4.3), layout="constrained")
        axes = figure.add_subplot(1, 2 + len(maps), (1, 2))
        _curves(axes, entries, lowest)
        for k, entry in enumerate(maps):
            _map(figure, figure.add_subplot(1, 2 + len(maps), 3 + k, projection="polar"), entry)
    return figure


def _curves(axes: Axes, entries: list[dict], lowest: float) -> None:
    """Draw strict success [%] over the inclination [deg]; lowest: of all intervals [%]."""
    axes.grid(True)
    for k, entry in enumerate(entries):
        curve = [p for p in entry.get("curve", []) if p["strict"]["of"]]
        if len(curve) > 1:
            angle = np.degrees([0.5 * (p["from"] + p["to"]) for p in curve])
            share_curve(axes, angle, [p["strict"] for p in curve], k, entry["name"])
        alone = entry["single"]
        if alone:
            share, low, high = percent([p["strict"] for p in alone])
            axes.errorbar(
                np.degrees([p["inclination"] for p in alone]), share, (share - low, high - share),
                fmt=marker(k), ms=6.5, mfc="white", mec=colour(k), ecolor=colour(k), elinewidth=1.2,
                capsize=3, label=None if len(curve) > 1 else literal(entry["name"]),
            )  # fmt: skip
    axes.set_ylim(max(-3.0, lowest - 1.5), 101.5)
    axes.set_xlabel("inclination [deg]")
    axes.set_ylabel("strict success [%]")
    handles, labels = axes.get_legend_handles_labels()
    axes.figure.legend(
        [*handles, Patch(fc=MUTED, alpha=0.3), axes.plot([], [], "o", mfc="white", mec=INK, ms=6.5)[0]],
        [*labels, "95 % interval", "one slope alone, frozen grid"],
        loc="outside lower center",
        ncols=3,
    )


def _map(figure: Figure, axes: Any, entry: dict) -> None:
    """Draw strict success over azimuth, the direction, and inclination, the radius."""
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


def vehicles_figure(report: dict[str, Any]) -> Figure:
    """Return the figure of strict success over mass and over thrust to weight.

    Lines with 95 % intervals: drawn vehicles in groups of equal size; marks: the named vehicles.
    """
    columns = {"mass": ("mass [g]", 1e3), "thrust_to_weight": ("thrust over weight [1]", 1.0)}
    with styled():
        figure = Figure(figsize=(9.2, 3.8), layout="constrained")
        panels = figure.subplots(1, 2, sharey=True)
        for axes, (key, (label, factor)) in zip(panels, columns.items()):
            axes.grid(True)
            axes.axhline(_BAR, color=INK, lw=0.9, ls=(0, (2, 2)), label=f"bar of {_BAR:g} %")
            for k, name in enumerate(report["labels"]):
                drawn = _drawn(axes, report["draws"], name, key, factor, k)
                _named(axes, report["vehicles"], name, key, factor, k, labelled=not drawn)
            axes.set_xlabel(label)
            axes.set_ylim(-3, 103)
        panels[0].set_xscale("log")
        ticks = [30, 50, 100, 200, 500]
        panels[0].set_xticks(ticks, [f"{tick}" for tick in ticks])
        panels[0].minorticks_off()
        panels[0].set_ylabel("strict success [%]")
        handles, _ = panels[0].get_legend_handles_labels()
        if report["draws"] is not None:
            handles += panels[0].plot([], [], "s", mec=INK, mfc="white", label="one named vehicle")
            handles.append(Patch(color=MUTED, alpha=0.25, lw=0, label="95 % interval, drawn vehicles"))
        figure.legend(handles=handles, loc="outside upper center", ncols=min(5, len(handles)))
    return figure


def _drawn(axes: Axes, draws: dict | None, name: str, key: str, factor: float, k: int) -> bool:
    """Draw the line of the drawn vehicles of one policy; return whether it has any."""
    if draws is None or name not in draws["outcomes"]:
        return False
    where = np.array([member[key] for member in draws["members"]]) * factor
    landed = np.array([member["strict"][name] for member in draws["members"]])
    groups = np.array_split(np.argsort(where), min(_BINS, len(where)))
    each = draws["flown_each"][name]
    found = [proportion(landed[rows].sum(), each * len(rows)) for rows in groups]
    (line,) = share_curve(axes, [np.median(where[rows]) for rows in groups], found, k, name)
    line.set(marker="", linewidth=1.6, gid="drawn")
    return True


def _named(
    axes: Axes, vehicles: Sequence[dict], name: str, key: str, factor: float, k: int, *, labelled: bool
) -> None:
    """Draw a mark for each named vehicle that the policy flew."""
    points = [
        (row[key] * factor, 100 * row["outcomes"][name]["strict"]["share"])
        for row in vehicles
        if name in row["outcomes"]
    ]
    if points:
        style: dict[str, Any] = {
            "mec": colour(k),
            "mfc": "white",
            "mew": 1.4,
            "ms": 6,
            "ls": "none",
            "gid": "named",
        }
        axes.plot(*zip(*points), marker=marker(k), label=literal(name) if labelled else None, **style)
