"""The figures of a diagnosis. Each `draw_*` draws on given axes; the others return a whole figure."""

from __future__ import annotations

import base64
import io
import math
import textwrap
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, LogNorm, to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

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
from inclined_landing.eval.gap.report.tracks import Track
from inclined_landing.eval.gap.report.words import REGIMES, label, shown
from inclined_landing.eval.gap.result import (
    Diagnosis,
    HorizonCurve,
    NamedEffect,
    PlantGap,
    RegimeError,
    ResidualAnalysis,
    WindowCurves,
)

BEFORE, AFTER = ORANGE, GREEN
CHANNELS = ("x", "y", "z", "roll", "pitch", "yaw", "touchdown")
WIDTH = 10.4  # inches, of a page
PANEL = 3.6  # inches, of figures that stand side by side, below each other on a phone
_ENDS = (10.0, 30.0, 100.0, 300.0, 1000.0)  # times the noise level, where the colour scale may end
_HEAT = LinearSegmentedColormap.from_list(
    "heat", ["#f4f8fb", "#fde3c8", "#f9b071", "#e66f22", "#a63c06", "#5e1f04"]
)
_MAPS = {"before": "before", "after": "after", "floor": "noise and disturbance alone"}
_STEPS = (PURPLE, BLUE, "#56b4e9", "#8a8f98", "#c9b458")  # between before and after


def svg(figure: Figure) -> str:
    """Return the figure as the data address of an SVG image for a page."""
    file = io.BytesIO()
    with styled(), matplotlib.rc_context({"svg.hashsalt": "gap", "svg.fonttype": "path"}):
        figure.savefig(file, format="svg", metadata={"Date": None})
    return "data:image/svg+xml;base64," + base64.b64encode(file.getvalue()).decode("ascii")


# ---- where


def where_tables(rows: Sequence[RegimeError]) -> dict[str, Any]:
    """Return tables of the error by regime and channel: before, after, and by noise and disturbance alone.

    Cells are (text, background, ink); `scale` has the same for multiples of the noise level.
    """
    if not rows:
        return {}
    regimes, channels = _axes_of(rows)
    cells = {(row.regime, row.channel): row for row in rows}
    norm, last = _where_norm(rows)
    lines = {
        what: [[_cell(cells.get((r, c)), what, norm, last) for c in channels] for r in regimes]
        for what in _MAPS
    }
    steps = [1.0, 3.0, *(end for end in _ENDS if end <= last)]
    return {
        "channels": ["touch" if c == "touchdown" else c for c in channels],
        "maps": [(_MAPS[what], list(zip(_regime_names(rows), lines[what]))) for what in _MAPS],
        "scale": [(f"{times:g} ×", *_heat(times, norm, last)) for times in steps],
        "units": _where_units(rows),
    }


def _heat(times: float, norm: LogNorm, last: float) -> tuple[str, str]:
    """Return background and ink of a cell whose error is so many times the noise level."""
    share = float(norm(min(max(times, 1.0), last)))
    return to_hex(_HEAT(share)), "#ffffff" if share > 0.62 else INK


def _cell(row: RegimeError | None, what: str, norm: LogNorm, last: float) -> tuple[str, str, str]:
    if row is None or not math.isfinite(value := getattr(row, what)):
        return "–", "none", MUTED if what == "floor" else INK
    text = _number(shown(row.unit)[0] * value)
    if what == "floor" or row.floor <= 0:
        return text, "none", MUTED if what == "floor" else INK
    return text, *_heat(value / row.floor, norm, last)


def _regime_names(rows: Sequence[RegimeError]) -> list[str]:
    """Return the names of the regimes with their number of windows."""
    counts = {r: max(row.windows for row in rows if row.regime == r) for r in _axes_of(rows)[0]}
    return [f"{REGIMES.get(r, label(r))} ({n})" for r, n in counts.items()]


def draw_where(
    axis: Axes, rows: Sequence[RegimeError], what: str, *, size: float = 7.5, named: bool = True
) -> None:
    """Draw one map; what: before, after or floor; colour: error over noise level; named: label regimes."""
    regimes, channels = _axes_of(rows)
    cells = {(row.regime, row.channel): row for row in rows}
    norm, last = _where_norm(rows)
    for i, regime in enumerate(regimes):
        for j, channel in enumerate(channels):
            text, colour, ink = _cell(cells.get((regime, channel)), what, norm, last)
            axis.add_patch(Rectangle((j, i), 1, 1, facecolor=colour, edgecolor="white", linewidth=1.2))
            axis.text(j + 0.5, i + 0.52, text, ha="center", va="center", fontsize=size, color=ink)
    axis.set(xlim=(0, len(channels)), ylim=(len(regimes), 0))
    axis.set_xticks(np.arange(len(channels)) + 0.5, ["touch" if c == "touchdown" else c for c in channels])
    axis.set_yticks([])
    if named:
        axis.set_yticks(np.arange(len(regimes)) + 0.5, _regime_names(rows))
    axis.tick_params(length=0, labelsize=9, top=False)
    axis.spines[:].set_visible(False)
    axis.set_title(_MAPS[what], fontsize=9.5)


def _where_norm(rows: Sequence[RegimeError]) -> tuple[LogNorm, float]:
    """Return one scale for all maps and its end, the first of _ENDS beyond the worst cell."""
    worst = max((max(row.before, row.after) / row.floor for row in rows if row.floor > 0), default=1.0)
    end = next((end for end in _ENDS if end >= worst), _ENDS[-1])
    return LogNorm(1.0, end), end


def _where_scale(
    figure: Figure, rows: Sequence[RegimeError], left: float, bottom: float, width: float
) -> None:
    axis = panel(figure, left, bottom, width, 0.09)
    norm, last = _where_norm(rows)
    bar = figure.colorbar(ScalarMappable(norm, _HEAT), cax=axis, orientation="horizontal")
    bar.outline.set_visible(False)
    ends = [end for end in _ENDS if end <= last]
    bar.set_ticks([1, 3, *ends], labels=[f"{times:g} ×" for times in (1, 3, *ends)])
    bar.ax.tick_params(labelsize=8.5, length=0, colors=MUTED)
    bar.minorticks_off()


def _where_units(rows: Sequence[RegimeError]) -> str:
    units: dict[str, list[str]] = {}
    for channel in _axes_of(rows)[1]:
        unit = next(row.unit for row in rows if row.channel == channel)
        units.setdefault(shown(unit)[1], []).append(channel)
    return "; ".join(f"{', '.join(names)} in {unit}" for unit, names in units.items())


def _axes_of(rows: Sequence[RegimeError]) -> tuple[list[str], list[str]]:
    regimes = [r for r in REGIMES if any(row.regime == r for row in rows)]
    regimes += sorted({row.regime for row in rows} - set(regimes))
    return regimes, [c for c in CHANNELS if any(row.channel == c for row in rows)]


def _number(value: float) -> str:
    for limit, digits in ((0.0995, 3), (9.95, 2), (99.5, 1)):
        if abs(value) < limit:
            return f"{value:.{digits}f}"
    return f"{value:.0f}"


# ---- show


def horizon(curves: Sequence[HorizonCurve], gap: dict[str, PlantGap]) -> Figure:
    """Return the position error against the horizon as the effects are added, with the noise floor."""
    figure = Figure(figsize=(7.0, 3.7))
    draw_horizon(panel(figure, 0.75, 0.55, 3.9, 3.0), curves, gap)
    return figure


def draw_horizon(axis: Axes, curves: Sequence[HorizonCurve], gap: dict[str, PlantGap]) -> None:
    """Draw the curves with their names at the right end."""
    ends = []
    for k, curve in enumerate(curves):
        colour = BEFORE if k == 0 else AFTER if k == len(curves) - 1 else _STEPS[(k - 1) % len(_STEPS)]
        axis.plot(curve.horizon, 100 * curve.error, color=colour, linewidth=2.2, zorder=3 + k)
        name = "nominal model" if k == 0 else curve.label.replace("_", " ")
        ends.append((100 * curve.error[-1], f"{name}  {100 * curve.error[-1]:.1f} cm", colour))
    if curves:
        last = curves[-1]
        axis.plot(last.horizon, 100 * last.floor, color=INK, linewidth=1.3, linestyle=(0, (1, 1.6)), zorder=3)
        axis.fill_between(last.horizon, 0, 100 * last.floor, color=RULE, alpha=0.6, linewidth=0)
        ends.append((100 * last.floor[-1], f"noise alone  {100 * last.floor[-1]:.1f} cm", INK))
    if "mujoco" in gap:
        g = gap["mujoco"]
        look: dict[str, Any] = {"color": "white", "markeredgewidth": 1.6, "markersize": 5.5}
        look |= {"zorder": 20, "clip_on": False}
        for value, colour, text in ((g.before, BEFORE, "the same in MuJoCo"), (g.after, AFTER, None)):
            axis.plot(g.horizon, 100 * value, "D", markeredgecolor=colour, label=text, **look)
        axis.legend(loc="upper left", handletextpad=0.2)
    top = max([value for value, *_ in ends] + [1e-3]) * 1.06
    end = max((curve.horizon[-1] for curve in curves), default=1.0)
    axis.set(xlim=(0, end), ylim=(0, top), xlabel="horizon [s]", ylabel="position error [cm, RMS]")
    axis.grid(axis="y")
    _name_ends(axis, ends, top)


def _name_ends(axis: Axes, ends, top: float) -> None:
    """Write names right of the axes at the height of their curves, without overlaps."""
    figure = axis.get_figure(root=True)
    assert figure is not None
    inches = axis.get_position().height * figure.get_figheight()
    least = 0.17 / inches * top
    ends = sorted(ends, key=lambda e: e[0])
    heights = [value for value, *_ in ends]
    for k in range(1, len(heights)):
        heights[k] = max(heights[k], heights[k - 1] + least)
    beside = axis.get_yaxis_transform()
    for height, (value, text, colour) in zip(heights, ends):
        arrow = {"arrowstyle": "-", "color": colour, "linewidth": 0.7, "shrinkA": 1, "shrinkB": 0}
        axis.annotate(
            *(text, (1.0, value), (1.035, height), beside, beside, arrow | {"relpos": (0, 0.5)}),
            **{"fontsize": 8.5, "color": colour, "va": "center"},
        )


def track(one: Track) -> Figure:
    """Return a held-out flight with the predictions from every second of it, before and after."""
    figure = Figure(figsize=(WIDTH, 4.6))
    low = panel(figure, 0.75, 0.5, WIDTH - 0.9, 1.75)
    high = panel(figure, 0.75, 2.45, WIDTH - 0.9, 1.75)
    first, second = one.worst_axes()
    draw_track(high, one, first)
    draw_track(low, one, second)
    high.set_xticklabels([])
    low.set_xlabel("time [s]")
    high.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
    high.set_title(_flown(one), loc="left")
    return figure


def _flown(one: Track) -> str:
    return f"{literal(one.flight)}, {'left out of' if one.held_out else 'part of'} the fit"


def draw_track(axis: Axes, one: Track, k: int) -> None:
    """Draw one coordinate (0, 1, 2: x, y, z) of a flight and its predictions."""
    drawn = [("measured", [(one.t, one.position)], INK, 3.4)]
    for word, which, colour in (("before", one.before, BEFORE), ("after", one.after, AFTER)):
        pieces = list(zip(one.times, which))
        drawn.append((f"predicted {one.seconds:g} s ahead, {word}", pieces, colour, 1.5))
    for name, pieces, colour, width in drawn:
        for j, (t, p) in enumerate(pieces):
            look: dict[str, Any] = {"linewidth": width, "label": None if j else name}
            axis.plot(t, p[:, k], color=colour, solid_capstyle="round", **look)
            if colour != INK:
                axis.plot(t[-1], p[-1, k], "o", color=colour, markersize=3)
    low, high = np.nanmin(one.position[:, k]), np.nanmax(one.position[:, k])
    # All of the measurement, and of the predictions what lies within its range once more.
    reach = np.concatenate([p[:, k] for p in (*one.before, *one.after)])
    span = max(high - low, 0.1)
    low = max(low - 0.8 * span, min(low, reach.min())) - 0.04 * span
    high = min(high + 0.8 * span, max(high, reach.max())) + 0.04 * span
    axis.set(xlim=(one.t[0], one.t[-1]), ylim=(low, high), ylabel=f"{'xyz'[k]} [m]")
    axis.grid()


def window_curves(windows: Sequence[WindowCurves]) -> list[Figure]:
    """Return the coordinate and the angle of the largest error in each of the worst windows."""
    worst = sorted(windows, key=lambda w: -np.max(np.abs(w.before[:, :3] - w.measured[:, :3])))
    regimes: dict[tuple[str, float], list[str]] = {}
    for w in worst:
        regimes.setdefault((w.flight, w.start), []).append(REGIMES.get(w.regime, w.regime))
    figures = []
    for w in list({(w.flight, w.start): w for w in worst}.values())[:4]:
        figure = Figure(figsize=(PANEL, 4.45))
        high = panel(figure, 0.65, 2.3, PANEL - 0.8, 1.2)
        low = panel(figure, 0.65, 0.5, PANEL - 0.8, 1.5)
        _draw_window(high, w, (0, 1, 2), 100.0, "cm")
        _draw_window(low, w, (3, 4, 5), 180 / np.pi, "deg")
        title = textwrap.fill(", ".join(regimes[w.flight, w.start]), 38)
        high.set_title(f"{title}\n{literal(w.flight)}, {w.start:.1f} s", loc="left", fontsize=9)
        low.set_xlabel("time in the window [s]")
        lines = high.get_legend_handles_labels()
        figure.legend(*lines, loc="upper left", ncols=3, handlelength=1.2, columnspacing=0.9)
        figures.append(figure)
    return figures


def _draw_window(axis: Axes, w: WindowCurves, channels: Sequence[int], factor: float, unit: str) -> None:
    """Draw the one of `channels` with the largest error of the nominal vehicle."""
    k = max(channels, key=lambda c: np.max(np.abs(w.before[:, c] - w.measured[:, c])))
    start = w.measured[0, k] if k < 3 else 0.0
    wide = 2.8 if k < 3 else 1.1  # angles are noisy
    axis.plot(w.t, factor * (w.measured[:, k] - start), color=INK, linewidth=wide, label="measured")
    axis.plot(w.t, factor * (w.before[:, k] - start), color=BEFORE, label="before")
    axis.plot(w.t, factor * (w.after[:, k] - start), color=AFTER, label="after")
    axis.set_ylabel(f"{CHANNELS[k]} [{unit}]", labelpad=2)
    axis.set_xlim(w.t[0], w.t[-1])
    axis.grid()


def estimates(effects: Sequence[NamedEffect], flights: Sequence[str]) -> list[Figure]:
    """Return each parameter's estimates in single flights with 95 % intervals, over that of all flights."""
    line = max(1.1, 0.17 * len(flights))
    figures = []
    parts = [(e, name, p) for e in effects for name, p in e.parameters.items()]
    for effect, name, p in parts if flights else []:
        figure = Figure(figsize=(PANEL, line + 1.05))
        axis = panel(figure, 0.85, 0.55, PANEL - 1.0, line)
        factor, unit = shown(p.unit)
        y = np.arange(len(p.per_flight))
        value, error = factor * np.array(p.per_flight), 1.96 * factor * np.array(p.per_flight_error)
        axis.axvspan(*(factor * np.array(p.ci95)), color=BLUE, alpha=0.18, linewidth=0)
        axis.axvline(factor * p.value, color=BLUE, linewidth=1.4)
        axis.errorbar(value, y, xerr=error, fmt="o", color=INK, markersize=3.2, linewidth=1.0)
        _mark_neutral(axis, factor * p.neutral, unit)
        names = [literal(f) for f in flights[: len(y)]]
        name_rows(axis, [n if len(n) <= 12 else f"{n[:5]}…{n[-6:]}" for n in names], 8.5)
        axis.locator_params(axis="x", nbins=5)
        axis.grid(axis="y")
        what = label(effect.name) + (f": {label(name)}" if len(effect.parameters) > 1 else "")
        axis.set_title(what + (" (at its bound)" if p.at_bound else ""), loc="left", pad=16)
        axis.set_xlabel(f"{label(name)} [{unit or 1}]", labelpad=1)
        figures.append(figure)
    return figures


def _mark_neutral(axis: Axes, neutral: float, unit: str) -> None:
    """Draw a dashed line at the nominal value; a note at the edge where that is far off."""
    low, high = axis.get_xlim()
    span = high - low
    if low - span < neutral < high + span:
        axis.axvline(neutral, color=MUTED, linewidth=1.0, linestyle=(0, (2, 2)))
        return
    right = neutral > high
    text = f"nominal: {neutral:.3g} {unit}".rstrip()
    x, text, side = (0.99, f"{text} →", "right") if right else (0.01, f"← {text}", "left")
    style: dict[str, Any] = {"ha": side, "va": "bottom", "fontsize": 8.5, "color": MUTED}
    axis.text(x, 1.02, text, transform=axis.transAxes, **style)
    axis.set_xlim(low, high)


def name_rows(axis: Axes, names: Sequence[str], size: float = 9.0) -> None:
    """Label one row for each name, the first at the top."""
    axis.set_ylim(len(names) - 0.4, -0.6)
    axis.set_yticks(range(len(names)), names, fontsize=size)
    axis.tick_params(axis="y", length=0)


def residual(left: ResidualAnalysis) -> list[Figure]:
    """Return the functions of the residual over the input that explains most of each."""
    figures = []
    for d in [d for d in left.depends_on if len(d.x)][:4]:
        figure = Figure(figsize=(PANEL, 2.6))
        plot = panel(figure, 0.75, 0.55, PANEL - 0.9, 1.7)
        factor, unit = shown(d.unit)
        plot.axhline(0, color=RULE, linewidth=1)
        plot.plot(d.x, factor * np.asarray(d.y), "o-", color=ORANGE, markersize=3, linewidth=1.4)
        plot.set_xlabel(d.against)
        plot.set_ylabel(f"{d.channel} [{unit}]", labelpad=1)
        plot.set_title(f"{_number(factor * d.size)} {unit}", loc="left")
        plot.grid()
        figures.append(figure)
    return figures


# ---- all in one


def overview(d: Diagnosis, one: Track | None) -> Figure:
    """Return the overview: error against horizon, errors by regime and channel, a held-out flight."""
    wide, below = 9.6, 2.9 if one is not None else 0.0
    rows = [r for r in d.where if r.regime != "all" and r.channel != "touchdown"]
    maps = 0.3 * len(_axes_of(rows)[0])
    low = below + 0.65
    high = low + maps + 1.35
    figure = Figure(figsize=(wide, high + 2.75))
    draw_horizon(panel(figure, 0.75, high, 6.1, 2.3), d.horizon, d.gap)
    titles = [(high + 2.45, "Position error as effects are added")]
    if rows:
        width = 3.3
        for k, what in enumerate(("before", "after")):
            axis = panel(figure, 2.05 + k * (width + 0.15), low, width, maps)
            draw_where(axis, rows, what, size=9, named=k == 0)
        _where_scale(figure, rows, 2.05, low - 0.35, 2 * width + 0.15)
        titles.append((low + maps + 0.38, "Errors by regime and channel"))
        note = f"{_where_units(rows)}; colour: error over noise level"
        figure.text((wide - 0.1) / wide, (low + maps + 0.4) / (high + 2.75), note, color=MUTED, ha="right")
    if one is not None:
        axis = panel(figure, 0.75, 0.5, wide - 0.85, 1.8)
        draw_track(axis, one, one.worst_axes()[0])
        axis.set_xlabel("time [s]")
        axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
        titles.append((2.4, _flown(one)))
    for y, text in titles:
        place = (0.1 / wide, y / (high + 2.75))
        figure.text(*place, text, fontsize=11, fontweight="bold", va="bottom")
    return figure
