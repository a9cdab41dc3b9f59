"""Tables for the terminal, of one look in all commands."""

from __future__ import annotations

from rich import box
from rich.console import Console
from rich.table import Table

_PIPED_WIDTH = 120  # columns, where the output is no terminal


def printer(console: Console | None = None) -> Console:
    """Return a console that prints text as it is; into a pipe or a file in lines of a fixed width."""
    console = console or Console(markup=False, highlight=False)
    if not console.is_terminal:
        console.width = _PIPED_WIDTH
    return console


def new_table(title: str | None, *columns: str, left: int = 1) -> Table:
    """Return an empty table; its first `left` columns are left-aligned, the others, with numbers, right."""
    result = Table(title=title, box=box.SIMPLE_HEAD, title_justify="left", title_style="bold")
    for k, column in enumerate(columns):
        result.add_column(column, justify="left" if k < left else "right")
    return result


def share_cell(proportion: dict) -> str:
    """Return a share with its interval [%], as `statistics.proportion` gives it."""
    if proportion["share"] is None:
        return "-"
    low, high = proportion["interval"]
    return f"{100 * proportion['share']:.1f} [{100 * low:.1f}, {100 * high:.1f}]"


def spread_cell(
    spread: dict, digits: int = 2, factor: float = 1.0, ends: tuple[str, str] = ("p5", "p95")
) -> str:
    """Return a median with the ends of its range, as `statistics.spread` gives them."""
    if spread["median"] is None:
        return "-"
    middle, low, high = (f"{factor * spread[key]:,.{digits}f}" for key in ("median", *ends))
    return f"{middle} ({low} to {high})"
