"""What the commands share: tables in Markdown, and studies of cases answered in processes."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.progress import stages
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError


def check_folder(data: Path) -> None:
    """Raise UserError unless there is a folder with the clones of the public sets."""
    if not data.is_dir():
        raise UserError(f"{data}: no folder; it must hold the clones of the repositories")


def table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return a table in Markdown."""
    lines = [header, ["---"] * len(header), *(map(cell, row) for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines).replace("| --- ", "|---") + "\n"


def table_of(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return a table in Markdown of mappings with the same keys."""
    return table([key.replace("_", " ") for key in rows[0]], [list(row.values()) for row in rows])


def cell(value: Any) -> str:
    """Return a number with four digits, a proportion with its interval, a median with its quantiles."""
    if isinstance(value, dict) and "of" in value:
        if value["value"] is None:
            return ""
        low, high = 100 * value["low"], 100 * value["high"]
        return f"{value['count']} of {value['of']} [{low:.0f}, {high:.0f} %]"
    if isinstance(value, dict) and value["value"] is None:
        return "-"
    if isinstance(value, dict):
        return "{value:z,.2f} ({low:z,.2f} to {high:z,.2f})".format(**value)
    if isinstance(value, float):
        return f"{value:.4g}"
    return "" if value is None else str(value)


def study(
    out: Path,
    work: Callable[..., Any],
    calls: Mapping[str, tuple],
    processes: int,
    score: Callable[[dict[str, Any]], tuple[str, dict]],
    **settings: Any,
) -> None:
    """Call `work` for every case in processes, score what it answers, and write and print the table.

    Raises UserError where a process is killed.

    Args:
        out: folder for answers/NAME.json, each kept as soon as it is there, results.json and table.md; an
            interrupted study goes on in it.
        score: returns the table, in Markdown, of the answers by name, in the order of `calls`, and what
            results.json has of them.
        settings: what results.json begins with, before the versions.
    """
    files = {name: out / "answers" / f"{name}.json" for name in calls}
    todo = {name: call for name, call in calls.items() if not files[name].exists()}
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"  # the processes share the cores already
    # A spawned process starts clean: threads of libraries do not survive a fork.
    pool = ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn"))
    done = len(calls) - len(todo)
    with storage.made(out / "answers"), stages(len(calls), "cases", done) as tick, pool:
        jobs = {pool.submit(work, *call): name for name, call in todo.items()}
        try:
            for job in as_completed(jobs):
                storage.write_json(files[jobs[job]], job.result())
                tick(jobs[job])
        except BrokenProcessPool as error:
            raise UserError(f"a process was killed ({error}); the same command goes on") from error
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    text, scored = score({name: storage.read_json(file, "answer") for name, file in files.items()})
    storage.write_json(out / "results.json", settings | {"versions": runs.versions()} | scored)
    storage.write_text(out / "table.md", text)
    print(text)
