"""What the commands share: tables in Markdown, names that are known, work in processes."""

from __future__ import annotations

import dataclasses
import multiprocessing
import os
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from inclined_landing.models.base.errors import UserError


def check_known(what: str, names: Iterable[str], known: Collection[str]) -> None:
    """Raise UserError unless all names are known."""
    for name in names:
        if name not in known:
            raise UserError(f"unknown {what} {name!r}; choose from {', '.join(known)}")


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines).replace("| --- ", "|---") + "\n"


def table_of(rows: Sequence[Any]) -> str:
    """Return a table in Markdown of mappings or records with the same keys, whose numbers are rounded."""
    plain = [row if isinstance(row, Mapping) else dataclasses.asdict(row) for row in rows]
    if not plain:
        return ""
    return table(
        [key.replace("_", " ") for key in plain[0]], [list(map(cell, row.values())) for row in plain]
    )


def cell(value: Any) -> str:
    """Return a number with four digits, a pair as a value with the half-width of its interval."""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, tuple) and len(value) == 2:
        return f"{value[0]:.4g} ± {value[1]:.2g}"
    return "" if value is None else str(value)


def progress() -> Progress:
    """Return a bar on stderr that disappears at its end."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    return Progress(*columns, console=Console(stderr=True), transient=True)


def in_processes(
    work: Callable, calls: Sequence[tuple], processes: int, done: int = 0
) -> Iterator[tuple[tuple, Any]]:
    """Yield (arguments, result) of every call as it ends, with a bar.

    done: calls that were made before. Raises UserError where a process is killed.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"  # the processes share the cores already
    # A spawned process starts clean: threads of libraries do not survive a fork.
    context = multiprocessing.get_context("spawn")
    with progress() as bar, ProcessPoolExecutor(processes, mp_context=context) as pool:
        task = bar.add_task("cases", total=done + len(calls), completed=done)
        jobs = {pool.submit(work, *call): call for call in calls}
        try:
            for job in as_completed(jobs):
                yield jobs[job], job.result()
                bar.advance(task)
        except BrokenProcessPool as error:
            raise UserError(f"a process was killed ({error}); the same command goes on") from error
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
