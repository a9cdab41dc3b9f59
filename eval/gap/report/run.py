"""The progress of a run of `gap` or `identify`, and its record."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from inclined_landing.eval.base.options import FlightSource
from inclined_landing.models import storage

_COLUMNS = (TextColumn("{task.description:22}"), BarColumn(), TimeElapsedColumn())


@contextlib.contextmanager
def progress(total: int) -> Iterator[Callable[[str], None]]:
    """A bar of `total` parts; calling what it gives names the next one."""
    console = Console(stderr=True)
    with Progress(*_COLUMNS, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=total)
        yield lambda what: bar.update(task, description=what, advance=1)


def write_run(folder: Path, command: str, began: float, versions: dict, source: FlightSource) -> None:
    """run.json: the command, its options, what it took and the versions."""
    given = dataclasses.asdict(source)
    seconds = round(time.monotonic() - began, 1)
    storage.write_json(
        folder / "run.json", {"command": command, **given, "seconds": seconds, "versions": versions}
    )
