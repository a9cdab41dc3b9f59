"""`trust`: the figure of docs/trust.md, from the counts recorded in recorded.toml."""

from __future__ import annotations

import tomllib
from pathlib import Path

from matplotlib.figure import Figure

from inclined_landing.eval.base import style

RECORDED = Path(__file__).parent / "recorded.toml"
BARS = {
    "right sure": ("right cause named, sure", style.GREEN),
    "right": ("right cause named, sure or possible", "#7fceb8"),
    "tuning": ("right cause named by tuning all parameters", style.MUTED),
    "wrong sure": ("sure names that are wrong", style.ORANGE),
}


def command(*, out: Path = Path("docs/trust.png")) -> None:
    """Draw how often the gap workflow names the right cause of recorded flights, from recorded counts.

    Args:
        out: the figure (.png or .pdf).
    """
    style.save_figure(draw(tomllib.loads(RECORDED.read_text("utf-8"))), out)


def draw(groups: dict[str, dict[str, list[int]]]) -> Figure:
    """Return the bars of each group of flights: share, with how many of how many written above."""
    with style.styled():
        figure = Figure(figsize=(6.6, 3.5), layout="constrained")
        axes = figure.subplots()
        for k, (key, (label, colour)) in enumerate(BARS.items()):
            counts = [group[key] for group in groups.values()]
            places = [g + 0.21 * (k - 1.5) for g in range(len(groups))]
            bars = axes.bar(places, [100 * n / of for n, of in counts], 0.19, color=colour, label=label)
            axes.bar_label(bars, [f"{n}/{of}" for n, of in counts], padding=2)
        axes.set_xticks(range(len(groups)), list(groups))
        axes.tick_params(axis="x", length=0)
        axes.set(ylim=(0, 108), yticks=range(0, 101, 25), ylabel="share [%]")
        axes.grid(axis="y")
        figure.legend(loc="outside lower center", ncols=2)
    return figure
