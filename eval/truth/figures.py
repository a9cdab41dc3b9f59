"""The figures of both sets of claims: panels side by side, with curves over a common axis."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import LogLocator, NullLocator

from inclined_landing.eval.base.colours import BLUE, GREEN, INK, MUTED, ORANGE, PURPLE
from inclined_landing.eval.base.style import styled

DASHED: dict[str, Any] = {"color": MUTED, "lw": 1.2, "ls": (0, (5, 2))}
# Colour, marker and its size: of equal curves each shows behind the next.
_LOOKS = ((BLUE, "o", 6.5), (ORANGE, "s", 5.2), (GREEN, "^", 4.4), (PURPLE, "D", 3.0), (INK, "v", 2.6))


def panels(count: int, width: float = 3.5, height: float = 3.15):
    """Return a decorator that makes a function of data and `count` axes one of the data alone.

    width, height [in]: of each panel. The decorated function returns the figure.
    """

    def decorate(draw: Callable[..., None]) -> Callable[..., Figure]:
        @functools.wraps(draw)
        def drawn(*data) -> Figure:
            with styled(), matplotlib.rc_context({"axes.grid": True, "lines.markersize": 4}):
                figure = Figure(figsize=(width * count, height), layout=ConstrainedLayoutEngine(wspace=0.05))
                draw(*data, *figure.subplots(1, count, squeeze=False)[0])
            return figure

        return drawn

    return decorate


def curves(axes: Axes, x: Sequence[float], curves: Mapping[str, Sequence[float]], **labels: Any) -> None:
    """Draw curves by name over x; labels: labels, limits and scales of the axes."""
    for (name, values), (colour, marker, size) in zip(curves.items(), _LOOKS):
        axes.plot(x, values, color=colour, marker=marker, ms=size, lw=1.2, label=name)
    axes.set(**labels)
    if "xscale" in labels:
        axes.set_xticks(x, [f"{tick:g}" for tick in x])
        axes.xaxis.set_minor_locator(NullLocator())
    if "yscale" in labels:
        low, high = axes.get_ylim()
        axes.yaxis.set_minor_locator(NullLocator())
        if high < 100.0 * low:
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.yaxis.set_major_formatter("{x:g}")
