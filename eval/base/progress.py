"""Progress of a command in stages: a bar on a terminal, elsewhere a line now and then."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

_COLUMNS = (TextColumn("{task.description:22}"), BarColumn(), TimeElapsedColumn())
EVERY = 10.0  # s between two lines, at least


@contextlib.contextmanager
def stages(total: int | None = None) -> Iterator[Callable[[str], None]]:
    """Yield a function that is called with the name of each stage as it begins; total: how many there are.

    Written to stderr. Without a terminal, at most one line every EVERY seconds.
    """
    console, began = Console(stderr=True), time.monotonic()
    last = began
    with Progress(*_COLUMNS, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=total)

        def tick(stage: str) -> None:
            nonlocal last
            bar.update(task, description=stage, advance=1)
            now = time.monotonic()
            if not console.is_terminal and now - last >= EVERY:
                console.print(f"{now - began:.0f} s: {stage}", highlight=False, markup=False)
                last = now

        yield tick
