"""`trust`: the figure of docs/trust.md, from the table of docs/evidence/known_causes.md."""

from __future__ import annotations

import re
from pathlib import Path

from matplotlib.figure import Figure

from inclined_landing.eval.base import style

PAGE = Path(__file__).parents[2] / "docs" / "evidence" / "known_causes.md"
# Beginning of a row of the table: its name in the figure, its colour.
BARS = {
    "causes of medium size or more": ("right cause named, sure", style.GREEN),
    "the same, sure or possible": ("right cause named, sure or possible", "#7fceb8"),
    "parameter tuning": ("right cause named by tuning all parameters", style.MUTED),
    "sure names that are wrong": ("sure names that are wrong", style.ORANGE),
}


def command(*, out: Path = Path("docs/trust.png")) -> None:
    """Draw how often the gap workflow names the right cause of recorded flights, from the recorded counts.

    Args:
        out: the figure (.png or .pdf).
    """
    style.save_figure(draw(*recorded(PAGE.read_text("utf-8"))), out)


def recorded(page: str) -> tuple[list[str], dict[str, list[tuple[int, int]]]]:
    """Return the groups of flights and, for each of BARS, how many of how many in every group."""
    header = re.search(r"^\| +\|(.*)\| bar \|$", page, re.MULTILINE)[1]
    rows = {key: re.search(rf"^\| {key}.*", page, re.MULTILINE)[0] for key in BARS}
    counts = {key: re.findall(r"(\d+) of (\d+)", row) for key, row in rows.items()}
    return [name.strip().replace(", ", ",\n") for name in header.split("|")], {
        key: [(int(n), int(of)) for n, of in found] for key, found in counts.items()
    }


def draw(groups: list[str], counts: dict[str, list[tuple[int, int]]]) -> Figure:
    """Return the bars of each group of flights: share, with how many of how many written above."""
    with style.styled():
        figure = Figure(figsize=(6.6, 3.5), layout="constrained")
        axes = figure.subplots()
        for k, (key, (label, colour)) in enumerate(BARS.items()):
            places = [g + 0.21 * (k - 1.5) for g in range(len(groups))]
            shares = [100 * n / of for n, of in counts[key]]
            bars = axes.bar(places, shares, 0.19, color=colour, label=label)
            axes.bar_label(bars, [f"{n}/{of}" for n, of in counts[key]], padding=2)
        axes.set_xticks(range(len(groups)), groups)
        axes.tick_params(axis="x", length=0)
        axes.set(ylim=(0, 108), yticks=range(0, 101, 25), ylabel="share [%]")
        axes.grid(axis="y")
        figure.legend(loc="outside lower center", ncols=2)
    return figure
