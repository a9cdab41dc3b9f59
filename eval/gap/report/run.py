"""A run of `gap` or `identify`: its flights with a bar of its progress, and its record."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from inclined_landing.eval.base.options import FlightSource
from inclined_landing.eval.base.progress import stages
from inclined_landing.eval.gap.flights.usable import check_apart, read_flights
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models import storage


@contextlib.contextmanager
def read_run(source: FlightSource, parts: int, reference_files: Sequence[str] = ()) -> Iterator[tuple]:
    """Yield flights to fit, held-out flights, notes, the tick of a progress bar, and reference flights.

    parts: stages of the work after reading, each announced by the tick.
    """
    with stages(len(source.files) + len(source.heldout) + len(reference_files) + parts) as tick:
        read = functools.partial(read_flights, mapping=source.mapping, units=source.unit, tick=tick)
        reference_logs: list[FlightLog] = []
        reference_notes: tuple[str, ...] = ()
        if reference_files:
            reference_logs, _, reference_notes = read(reference_files)
            check_apart(source.files, source.heldout, reference_files)
        logs, heldout, notes = read(source.files, source.heldout)
        yield logs, heldout, (*reference_notes, *notes), tick, reference_logs


def write(
    folder: Path, command: str, page: str, answer: dict, source: FlightSource, began: float, versions: dict
) -> None:
    """Write report.html, report.json and run.json: the command, its options, its time, the versions."""
    storage.write_text(folder / "report.html", page)
    storage.write_json(folder / "report.json", answer)
    statistics = {"seconds": round(time.monotonic() - began, 1), "versions": versions}
    storage.write_json(folder / "run.json", {"command": command, **dataclasses.asdict(source), **statistics})
