"""Progress of a command: a bar on a terminal, otherwise occasional lines."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Column

from inclined_landing.envs.shared.tables import printer

EVERY = 10.0  # s between two lines, at least
FORESEEN = 0.02  # share of the stages after which the rest is estimated: the first may compile kernels
_WORDS = Column(no_wrap=True, overflow="ellipsis", ratio=1)


class Tick(Protocol):
    """The function that a command calls as a stage begins or ends."""

    def __call__(self, words: str = "", done: float | None = None) -> None:
        """Show the words; done: the number done, if it is not one more than before."""


@contextlib.contextmanager
def stages(total: float | None = None, what: str = "", done: float = 0) -> Iterator[Tick]:
    """Yield a function to be called at each of `total` stages, with a description of the stage.

    what: the unit of the count, such as "cases"; done: how many are already done. Output goes to stderr;
    without a terminal, it is at most one line every EVERY seconds.
    """
    console, began = printer(Console(stderr=True, markup=False, highlight=False)), time.monotonic()
    last, before, count = began, done, done
    counts = (MofNCompleteColumn(), TimeRemainingColumn()) if total else ()
    shown = TextColumn("{task.description}", table_column=_WORDS)
    columns = (TextColumn(what), BarColumn(30), *counts, shown)

    def line(spent: float, words: str) -> str:
        if not (total and what and count > before):
            return words
        left = spent / (count - before) * (total - count)
        about = f"about {left / 60:.0f} min left" if left > 90 else f"about {left:.0f} s left"
        if count >= total or count - before < FORESEEN * total:
            about = ""
        return ", ".join(filter(None, (f"{round(count, 3):.12g} of {total:.12g} {what}", about, words)))

    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=total, completed=int(done))

        def tick(words: str = "", done: float | None = None) -> None:
            nonlocal last, count
            count = count + 1 if done is None else done
            bar.update(task, description=words, completed=count)
            now = time.monotonic()
            if not console.is_terminal and now - last >= EVERY:
                last = now
                console.print(f"{now - began:.0f} s: {line(now - began, words)}", soft_wrap=True)

        yield tick
