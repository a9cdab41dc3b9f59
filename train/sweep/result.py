"""The numbers of a recipe over its seeds, read from the files of the runs and summarised.

A number in a file can be

- a number: mean with its bootstrap interval over the seeds;
- true or false: the share of the seeds, with its Wilson interval;
- a row of shares of a study: the share of all flights of all seeds, with its Wilson interval;
- null, if the run never reached it: it counts as larger than every number.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal

import numpy as np

from inclined_landing.envs.shared.statistics import bootstrap, proportion
from inclined_landing.envs.shared.statistics import number as rounded
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.models.base.schema import Table
from inclined_landing.train.sweep.recipe import Number, Recipe, filled

Kind = Literal["number", "share", "flights"]  # of a value: see above
_KINDS: dict[type, Kind] = {int: "number", float: "number", bool: "share", tuple: "flights"}


class Measured(Table, frozen=True, kw_only=True):
    """One number of one variant over the seeds, in the unit of the recipe."""

    variant: str
    number: str
    kind: Kind
    values: tuple[float | None, ...]  # by seed; None: never
    median: float | None  # None: never
    mean: float | None  # of share and flights: the share of all; None where a value is missing
    interval: tuple[float, float] | None  # 95 %, of the mean

    def range_words(self, number: Number) -> str:
        """Return median and range with the unit, "99.6 (99.2 to 100) %"; for true and false, the share."""
        there = [value for value in self.values if value is not None]
        never = len(self.values) - len(there)
        text = "–"
        if self.kind == "share" and self.mean is not None:
            text = rounded(self.mean)
        elif there and self.kind != "share":
            low, high = rounded(min(there)), rounded(max(there))
            ends = low if low == high else f"{low} to {high}"
            text = "never" if self.median is None else rounded(self.median)
            text = text if text == ends else f"{text} ({ends})"
        unit = f" {number.unit}" if number.unit != "1" and there else ""
        return f"{text}{unit}" + f", never in {never} of {len(self.values)}" * (never > 0)

    def mean_words(self) -> str:
        """Return mean and interval: "99.5 [98.9, 99.9]"."""
        if self.mean is None:
            return "–"
        return rounded(self.mean) + (
            "" if self.interval is None else " [{}, {}]".format(*map(rounded, self.interval))
        )


class Result(Table, frozen=True, kw_only=True):
    """The result of a sweep, as in result.json."""

    command: str  # the command that repeats the sweep
    versions: dict[str, Any]  # of packages and machine, as `runs.versions` gives them
    cpu_seconds: tuple[float, ...]  # of every run
    measured: tuple[Measured, ...]

    def cost(self) -> str:
        """Return a sentence with the CPU time of the runs and the machine."""
        least, most = (f"{end(self.cpu_seconds):.0f}" for end in (min, max))
        seconds = least if least == most else f"{least} to {most}"
        return f"A run took {seconds} s of CPU on {self.versions['cpu']}."

    def rows(self, recipe: Recipe) -> list[tuple[str, ...]]:
        """Return the cells of the columns HEADS for every number of every variant."""
        rows: list[tuple[str, ...]] = []
        for one in self.measured:
            number = recipe.numbers[one.number]
            cells = (one.variant, number.title, one.range_words(number), one.mean_words())
            bar = number.at_least
            met = bar is not None and all(value is not None and value >= bar for value in one.values)
            rows.append((*cells, "" if bar is None else f"{rounded(bar)}: {'met' if met else 'missed'}"))
        return rows

    def answer(self, recipe: Recipe) -> str:
        """Return the answer of the recipe with its numbers filled in."""
        words = ((one, one.range_words(recipe.numbers[one.number])) for one in self.measured)
        return filled(recipe.answer, {f"{one.variant}.{one.number}".lstrip("."): text for one, text in words})


HEADS = ("variant", "number", "median (range)", "mean [95 %]", "each at least")


def take(name: str, number: Number, folder: Path) -> float | bool | tuple[int, int] | None:
    """Return the raw value of a number of one run, of a share of flights their count and the number of all.

    Raises UserError if its file does not contain it.
    """
    path = folder / number.file
    value = storage.read_json(path, f"number {name}: file")
    if number.row:
        return _value_of_row(name, number, path, value)
    for key in number.path.split("."):
        if value is None:  # the entry around the number is null, so the number is missing too
            break
        try:
            value = value[int(key) if isinstance(value, list) else key]
        except (KeyError, IndexError, TypeError, ValueError) as error:
            raise UserError(f"number {name}: {path} has no {shown(number.path, 80)}") from error
    if value is None or (isinstance(value, (int, float)) and math.isfinite(value)):
        return value
    raise UserError(f"number {name}: {path} has {shown(repr(value), 60)} there, which is not a number")


def _value_of_row(name: str, number: Number, path: Path, report: Any) -> Any:
    """Return the value of the first row of a study's report with the entries of `number.row`."""
    rows = report.get("rows", ()) if isinstance(report, dict) else ()
    for row in rows:
        if all(row.get(key) == value for key, value in number.row.items()):
            return (row["count"], row["flights"]) if row["statistic"] == "share" else row[number.entry]
    raise UserError(f"number {name}: {path} has no row with {shown(number.row, 120)}")


def sum_up(variant: str, name: str, number: Number, values: list) -> Measured:
    """Return a number over the seeds from what `take` returned; raises UserError if kinds differ."""
    there = [value for value in values if value is not None]
    kinds = {_KINDS[type(value)] for value in there} or {"number"}
    if len(kinds) > 1:
        raise UserError(f"number {name} is {' in one run and '.join(sorted(kinds))} in another")
    (kind,) = kinds
    if kind == "flights":
        found = proportion(sum(count for count, _ in there), sum(of for _, of in there))
        values = [None if value is None else value[0] / value[1] for value in values]
    elif kind == "share":
        found = proportion(sum(there), len(there))
    else:
        found = bootstrap(there) if there else {}
    whole = len(there) == len(values)
    ends = whole and found["low"] is not None
    median = float(np.median([math.inf if value is None else value for value in values]))
    factor = number.factor
    return Measured(
        variant=variant,
        number=name,
        kind=kind,
        values=tuple(None if value is None else factor * value for value in values),
        median=factor * median if math.isfinite(median) else None,
        mean=factor * found["value"] if whole else None,
        interval=(factor * found["low"], factor * found["high"]) if ends else None,
    )
