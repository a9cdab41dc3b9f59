"""Outcome maps over two parameters, and their boundaries."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import LinearSegmentedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from scipy.ndimage import gaussian_filter

from inclined_landing.eval.base.colours import INK, MUTED
from inclined_landing.eval.base.style import halo, styled
from inclined_landing.eval.landings.landing import OUTCOMES, RESTS
from inclined_landing.eval.landings.parameters import Parameter

# Distinguishable with any colour vision and in greys: each is a step darker or lighter than every other.
COLOURS = dict(zip(OUTCOMES, ("#0b7a6b", "#ee9b2f", "#a9d6f5", "#6a1b6b", "#f3efe2", "#161616")))
_PER_CELL = 12  # landings, of a Latin hypercube
_CELLS = (6, 24)  # least and most in a row
_LEVELS = 60  # more different values than these are binned
_SHARES = LinearSegmentedColormap.from_list("rests", ["#fbf0d0", "#bfdfc0", "#5fb3a0", "#0b7a6b", "#053d3c"])


@dataclasses.dataclass(frozen=True)
class Map:
    """Outcome shares in cells over two parameters, in report units."""

    x: Parameter
    y: Parameter
    x_edges: np.ndarray  # (a + 1,)
    y_edges: np.ndarray  # (b + 1,)
    counts: np.ndarray  # (b, a, outcomes) landings
    levels: bool  # cells are levels of a factorial; otherwise bins

    @property
    def centres(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the centres of the columns (a,) and rows (b,)."""
        return 0.5 * (self.x_edges[1:] + self.x_edges[:-1]), 0.5 * (self.y_edges[1:] + self.y_edges[:-1])

    @property
    def rests(self) -> np.ndarray:
        """Return the share (b, a) of landings that rest; NaN in empty cells."""
        total = self.counts.sum(axis=2)
        with np.errstate(invalid="ignore"):
            return self.counts[:, :, RESTS] / total

    def smooth(self) -> np.ndarray:
        """Return `rests` (b, a) smoothed for contours: bins averaged with their neighbours."""
        if self.levels:
            return self.rests
        total = gaussian_filter(self.counts.sum(axis=2).astype(float), 1.0, mode="nearest")
        good = gaussian_filter(self.counts[:, :, RESTS].astype(float), 1.0, mode="nearest")
        return good / np.maximum(total, 1e-9)


def make_map(x: Parameter, y: Parameter, xs: np.ndarray, ys: np.ndarray, outcome: np.ndarray) -> Map:
    """Count outcomes (n,) in cells over xs and ys (n,) [SI]."""
    xs, ys = xs / x.factor, ys / y.factor
    bins = int(np.clip(math.sqrt(len(xs) / _PER_CELL), *_CELLS))
    (x_edges, x_level), (y_edges, y_level) = _edges(xs, bins), _edges(ys, bins)
    counts = np.zeros((len(y_edges) - 1, len(x_edges) - 1, len(OUTCOMES)), int)
    np.add.at(counts, (_cells(ys, y_edges), _cells(xs, x_edges), outcome), 1)
    return Map(x, y, x_edges, y_edges, counts, x_level and y_level)


def _edges(values: np.ndarray, bins: int) -> tuple[np.ndarray, bool]:
    """Return the edges of cells, and whether they enclose one level each."""
    levels = np.unique(values)
    if len(levels) > _LEVELS:
        return np.linspace(levels[0], levels[-1], bins + 1), False
    middle = 0.5 * (levels[1:] + levels[:-1])
    if not len(middle):
        return np.array([levels[0] - 0.5, levels[0] + 0.5]), True
    first, last = levels[0] - (middle[0] - levels[0]), levels[-1] + (levels[-1] - middle[-1])
    return np.concatenate([[first], middle, [last]]), True


def _cells(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return the cell of each value."""
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)


def quasi_static(one: Map, fixed: dict[str, float]) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the line tan(inclination) = friction in the map's units; None if it does not apply.

    fixed: values [SI] of the parameters that do not vary.
    """
    names = one.x.name, one.y.name
    if set(names) == {"inclination", "friction"}:
        slope = 0 if names[0] == "inclination" else 1
        span = np.linspace(*(one.x_edges, one.y_edges)[slope][[0, -1]], 200)
        line = span, np.tan(np.radians(span))
        return line if slope == 0 else line[::-1]
    for axis, name in enumerate(names):
        if name == "friction" and "inclination" in fixed:
            value = math.tan(fixed["inclination"])
        elif name == "inclination" and "friction" in fixed:
            value = math.degrees(math.atan(fixed["friction"]))
        else:
            continue
        line = np.array([value, value])
        return (line, one.y_edges[[0, -1]]) if axis == 0 else (one.x_edges[[0, -1]], line)
    return None


def boundary(one: Map, along: str) -> list[dict]:
    """Return where half of the landings rest, along "x" in each row or along "y" in each column.

    One entry for each row or column: its `place` on the other axis and its crossings, each with
    `rests_above`: whether more than half rest on the upper side. Values are in report units.
    """
    walked, places = one.centres if along == "x" else one.centres[::-1]
    lines = one.smooth() if along == "x" else one.smooth().T
    rows = []
    for place, share in zip(places, lines):
        above = share >= 0.5
        crossings = []
        for j in np.flatnonzero(above[1:] != above[:-1]):
            t = (0.5 - share[j]) / (share[j + 1] - share[j])
            at = walked[j] + t * (walked[j + 1] - walked[j])
            crossings.append({"at": float(at), "rests_above": bool(above[j + 1])})
        rows.append({"place": float(place), "crossings": crossings})
    return rows


def map_words(one: Map, fixed: dict[str, float]) -> str:
    """Return the caption of `map_figure`."""
    smooth = "" if one.levels else ", cells averaged with their neighbours"
    text = f"On the thick line half of the landings come to rest{smooth}. "
    if quasi_static(one, fixed):
        text += "On the dashed line friction just holds a vehicle at rest. "
    share = 100 * one.counts[:, :, RESTS].sum() / one.counts.sum()
    return f"{text}Hatched cells contain no landings. Of all landings in this map {share:.1f} % come to rest."


def map_figure(one: Map, fixed: dict[str, float]) -> Figure:
    """Return the figure of a map: most frequent outcome and share at rest, both with the boundaries."""
    total = one.counts.sum(axis=2)
    with styled():
        figure = Figure(figsize=(8.6, 4.75), layout="constrained")
        left, right = figure.subplots(1, 2, sharex=True, sharey=True)
        colours = np.array([to_rgb(COLOURS[name]) for name in OUTCOMES])
        picture = colours[one.counts.argmax(axis=2)]
        left.pcolormesh(one.x_edges, one.y_edges, picture, rasterized=True)
        mesh = right.pcolormesh(
            one.x_edges, one.y_edges, 100 * one.rests, cmap=_SHARES, vmin=0, vmax=100, rasterized=True
        )
        bar = figure.colorbar(mesh, ax=right, label="landings at rest [%]", pad=0.02)
        bar.outline.set_visible(False)
        seen = one.counts.any(axis=(0, 1))
        handles: list[Any] = [
            Patch(fc=COLOURS[name], ec=MUTED, lw=0.5, label=name)
            for name, there in zip(OUTCOMES, seen)
            if there
        ]
        empty: dict[str, Any] = {"facecolor": "white", "edgecolor": "#9aa5b1", "hatch": "////", "lw": 0}
        i, j = np.nonzero(total == 0)
        x, y = one.x_edges, one.y_edges
        around = (x[j], y[i]), (x[j + 1], y[i]), (x[j + 1], y[i + 1]), (x[j], y[i + 1])
        cells = np.array(around).transpose(2, 0, 1)
        for axes in (left, right):
            axes.add_collection(PolyCollection(cells, gid="empty", **empty))
        handles += [Patch(**empty, label="no landings")] * (not total.all())
        handles += _lines(left, one, fixed, (0.5,))
        _lines(right, one, fixed, (0.1, 0.5, 0.9) if one.levels else (0.5,))
        left.set_ylabel(one.y.title())
        left.set_title("Most frequent outcome", loc="left")
        lines = " (lines: 10, 50, 90 %)" if one.levels else ""
        right.set_title(f"Share at rest on the feet{lines}", loc="left")
        for axes in (left, right):
            axes.set(xlabel=one.x.title(), xlim=one.x_edges[[0, -1]], ylim=one.y_edges[[0, -1]])
        figure.legend(handles=handles, loc="outside lower center", ncols=4, columnspacing=1.6)
        text = f"{total.sum()} landings; all other parameters vary as stated in the study file"
        figure.suptitle(text, x=0.01, ha="left", size=8.5, color=MUTED)
    return figure


def _lines(axes: Axes, one: Map, fixed: dict[str, float], shares: tuple[float, ...]) -> list:
    """Draw contours of the share at rest and the quasi-static prediction; return the legend handles."""
    handles = []
    x, y = one.centres
    share = one.smooth()
    if min(share.shape) > 1 and np.isfinite(share).all() and share.min() < 0.5 < share.max():
        widths = [1.0 if s != 0.5 else 2.0 for s in shares]
        lines = axes.contour(x, y, share, levels=shares, colors=INK, linewidths=widths)
        lines.set_path_effects(halo(3.0))
        handles += axes.plot([], [], color=INK, lw=2.0, label="half of the landings at rest")
    predicted = quasi_static(one, fixed)
    if predicted:
        look: dict[str, Any] = {"color": "black", "lw": 1.8, "ls": (0, (4, 2)), "path_effects": halo(3.4)}
        handles += axes.plot(*predicted, label="tan(inclination) = friction", **look)
    return handles
