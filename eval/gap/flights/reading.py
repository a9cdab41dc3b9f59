"""Flight logs given to a command: read, checked alone and together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

from inclined_landing.eval.logs import FlightLog, read_log
from inclined_landing.eval.logs.checks import check_fleet
from inclined_landing.eval.logs.command import parse_units
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown


def read_flights(
    files: Sequence[str],
    heldout: Sequence[str] = (),
    *,
    mapping: str | None = None,
    units: Sequence[str] = (),
    tick: Callable[[str], None] = lambda name: None,
) -> tuple[list[FlightLog], list[FlightLog], tuple[str, ...]]:
    """Return the flights to fit, the held-out flights, and notes on their common limits.

    units: as `roll=deg`. tick: called with the name of each file before it is read.
    Raises UserError, naming the file, for a log that cannot be used, one given twice, and flights of
    different vehicles.
    """
    given = parse_units(units)
    every = [*files, *heldout]
    check_apart(every)
    logs = []
    for file, name in zip(every, _names(every)):
        tick(name)
        logs.append(read_log(file, mapping=mapping, units=given, name=name))
    together = check_fleet(logs)
    for finding in together:
        if finding.decision == "refuse":
            raise UserError(finding.text)
    notes = tuple(finding.text for finding in together if finding.decision == "limit")
    return logs[: len(files)], logs[len(files) :], notes


def check_apart(*groups: Sequence[str]) -> None:
    """Raise UserError for a file that is given more than once."""
    every = [file for group in groups for file in group]
    where = [storage.real(file) for file in every]
    for file, path in zip(every, where):
        if where.count(path) > 1:
            raise UserError(f"{file} is given more than once; fit and judgement need different flights")


def _names(files: Sequence[str]) -> list[str]:
    """Return the file names without suffix; with their folder where two are equal."""

    def stem(file: str) -> str:
        return shown(Path(file).name).removesuffix(".gz").removesuffix(".csv")

    count = Counter(map(stem, files))
    return [stem(f) if count[stem(f)] == 1 else f"{shown(Path(f).parent.name)}/{stem(f)}" for f in files]
