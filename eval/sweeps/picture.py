"""The numbers of every variant as a figure: seeds as dots, median and range."""

from __future__ import annotations

import textwrap

import numpy as np
from matplotlib.figure import Figure

from inclined_landing.envs.shared.measured import Measured, Result
from inclined_landing.envs.shared.recipe import Number, Recipe
from inclined_landing.eval.base.style import BLUE, INK, MUTED, ORANGE, styled

_ROW, _PANEL = 0.27, 2.1  # inches: of a variant, of a number
_ACROSS = 6  # panels beside each other at most
_ABOVE, _HEAD, _FOOT, _RIGHT = 0.42, 0.33, 0.62, 0.2  # over all panels; over, under and beside each
_LETTER, _BOLD, _LINE = 0.078, 0.095, 0.16  # width of one, height of one more line


def variants_figure(recipe: Recipe, result: Result) -> Figure:
    """A panel for each number, a row for each variant; a seed that never got there stands as a cross at the
    worse end, and the bar is a dashed line. Of true and false there is the share alone."""
    variants, numbers = list(recipe.variants), list(recipe.numbers.values())
    left = 0.35 + _LETTER * max(map(len, variants))
    across = min(len(numbers), _ACROSS)
    width = left + across * _PANEL + _RIGHT
    head = _HEAD + _LINE * max(_wrapped(number).count("\n") for number in numbers)
    band = head + _ROW * len(variants) + _FOOT  # from the top of a row of panels to the next
    seeds = len(recipe.seeds)
    said = f"{seeds} seeds: median, range; cross: never" if seeds > 1 else "one seed"
    title = textwrap.wrap(recipe.title, int((width - 0.24) / _BOLD))
    if len(title) > 1 or _BOLD * len(recipe.title) + _LETTER * len(said) > width - 0.5:
        title.append("")  # a line of its own for what is said
    above = _ABOVE + _LINE * (len(title) - 1)
    height = above + band * -(-len(numbers) // across)
    with styled():
        figure = Figure(figsize=(width, height))
        for k, line in enumerate(title):
            figure.text(0.12 / width, 1 - (0.22 + _LINE * k) / height, line, weight="bold", va="center")
        last = 1 - (0.22 + _LINE * (len(title) - 1)) / height
        figure.text(1 - 0.12 / width, last, said, color=MUTED, va="center", ha="right")
        for k, number in enumerate(numbers):
            row, column = divmod(k, across)
            low = height - above - (row + 1) * band + _FOOT
            box = (left + column * _PANEL + 0.1, low, _PANEL - 0.3, band - head - _FOOT)
            axes = figure.add_axes((box[0] / width, box[1] / height, box[2] / width, box[3] / height))
            _panel(axes, number, [result.of(variant, number.name) for variant in variants])
            axes.set_yticks(range(len(variants)), variants if column == 0 else [])
        return figure


def _panel(axes, number: Number, found: list[Measured]) -> None:
    worse = _worse_end(number, found)
    for row, measured in enumerate(found):
        share = measured.kind == "share"
        if measured.present and not share:
            axes.hlines(row, min(measured.present), max(measured.present), color=BLUE, alpha=0.35, lw=5)
        dots = [] if share else measured.present
        alpha = 0.8 if len(dots) <= 12 else 0.3  # of many the dense places show
        axes.plot(dots, np.full(len(dots), row), "o", color=BLUE, ms=3.5, alpha=alpha)
        missing = len(measured.values) - len(measured.present)
        if missing:
            axes.plot(worse, row, "x", color=ORANGE, ms=6, mew=1.6)
            if len(measured.values) > 1:
                axes.annotate(
                    f"{missing}", (worse, row), (5, 0), textcoords="offset points", color=ORANGE, va="center"
                )
        middle = measured.mean if share else measured.median
        if middle is not None:
            axes.plot(middle, row, "|", color=INK, ms=13, mew=2)
    if number.bar is not None:
        axes.axvline(number.bar, color=MUTED, lw=1, ls="--", zorder=0)
    axes.set_ylim(len(found) - 0.5, -0.5)
    axes.grid(axis="x")
    axes.margins(x=0.08)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.locator_params(axis="x", nbins=4)
    low, high = axes.get_xlim()
    if max(abs(low), abs(high)) >= 1e4:
        axes.xaxis.set_major_formatter(lambda value, _: f"{value / 1000:g}k")
    axes.set_title(_wrapped(number), fontsize=9)
    axes.set_xlabel(number.unit if number.unit != "1" else "")


def _wrapped(number: Number) -> str:
    """Return the title of a panel, in lines as long as it is wide."""
    return textwrap.fill(number.title, 26)


def _worse_end(number: Number, found: list[Measured]) -> float:
    """Return the place of a seed that never got there."""
    present = [value for measured in found for value in measured.present] or [0.0, 1.0]
    low, high = min(present), max(present)
    aside = 0.12 * (high - low or abs(high) or 1.0)
    return high + aside if number.better == "lower" else low - aside
