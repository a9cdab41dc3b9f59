"""Uniform terminal output of all commands: tables and sentences."""

from __future__ import annotations

import os

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table

_PIPED_WIDTH = 120  # columns, where the output is no terminal
_PAD = 3  # columns of a table around a cell


def printer(console: Console | None = None) -> Console:
    """Return a console that prints text unchanged; in a pipe or a file its width is COLUMNS, or 120."""
    console = console or Console(markup=False, highlight=False)
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = _PIPED_WIDTH
    return console


def say(*sentences: str, style: str | None = None) -> None:
    """Print sentences, wrapped on a terminal, and each as one line in a pipe or a file."""
    console = printer()
    for sentence in sentences:
        console.print(sentence, style=style, soft_wrap=not console.is_terminal)


def new_table(title: str | None, *columns: str, labels: int = 1) -> Table:
    """Return an empty table; its first `labels` columns are aligned left, the others, with numbers, right."""
    result = Table(title=title, box=box.SIMPLE_HEAD)
    for k, column in enumerate(columns):
        result.add_column(column, justify="left" if k < labels else "right")
    return result


def show_table(table: Table) -> None:
    """Print a table of `new_table` without wrapping its numbers.

    Columns that do not fit on the screen are printed below, with the same labels.
    """
    console = printer()
    labels = [k for k, column in enumerate(table.columns) if column.justify == "left"]
    numbers = [k for k, column in enumerate(table.columns) if column.justify != "left"]
    heads = [str(column.header) for column in table.columns]
    cells = [max((cell_len(str(cell)) for cell in column.cells), default=0) for column in table.columns]
    natural = [_PAD + max(cell_len(head), cell) for head, cell in zip(heads, cells)]
    blocks: list[list[int]] = [numbers]
    widths: list[int | None] = [None] * len(heads)
    if numbers and sum(natural) >= console.width:
        least = [_PAD + max(cell, *map(cell_len, head.split() or [""])) for head, cell in zip(heads, cells)]
        widths = [width - _PAD if k in numbers else None for k, width in enumerate(least)]
        labels_width = sum(natural[k] for k in labels)
        labels_width = min(
            labels_width, max(console.width // 2, console.width - sum(least[k] for k in numbers) - 1)
        )
        blocks = [[]]
        for k in numbers:
            if blocks[-1] and labels_width + sum(least[j] for j in (*blocks[-1], k)) >= console.width:
                blocks.append([])
            blocks[-1].append(k)
    if table.title:
        console.print(table.title, style="bold")
    for block in blocks:
        part = Table(box=table.box, show_header=table.show_header)
        for k in (*labels, *block):
            part.add_column(heads[k], justify=table.columns[k].justify, width=widths[k], overflow="fold")
        for row, texts in zip(table.rows, zip(*(table.columns[k].cells for k in (*labels, *block)))):
            part.add_row(*texts, end_section=row.end_section)
        console.print(part)
    if table.caption:
        say(str(table.caption))
