"""Tables for the terminal, of one look in all rooms."""

from __future__ import annotations

from rich import box
from rich.console import Console
from rich.table import Table

_PIPED_WIDTH = 120  # columns, where the output is no terminal


def printer(console: Console | None = None) -> Console:
    """A console that prints text as it is; into a pipe or a file in lines of a fixed width."""
    console = console or Console(markup=False, highlight=False)
    if not console.is_terminal:
        console.width = _PIPED_WIDTH
    return console


def new_table(title: str | None, *columns: str, left: int = 1) -> Table:
    """An empty table; the first `left` columns stand to the left, the others, with numbers, to the right."""
    result = Table(title=title, box=box.SIMPLE_HEAD, title_justify="left", title_style="bold")
    for k, column in enumerate(columns):
        result.add_column(column, justify="left" if k < left else "right")
    return result
