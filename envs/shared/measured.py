"""The numbers of a recipe over its seeds: taken from the runs' files, summed up, held against the bar.

A number is found as

- a number: mean with its bootstrap interval over the seeds;
- true or false: the share of the seeds, with its Wilson interval;
- a share as `statistics.proportion` writes it (`count` and `of`): the share of all flights of all seeds, with
  its Wilson interval;
- null: this run never got there. It counts as worse than every number.
"""

from __future__ import annotations

import dataclasses
import math
import shlex
import string
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import UNSET, Meta, UnsetType, structs

from inclined_landing.envs.shared.recipe import Number, Recipe
from inclined_landing.envs.shared.statistics import bootstrap, proportion
from inclined_landing.envs.shared.statistics import number as rounded
from inclined_landing.models import schema, storage
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.schema import Real, Table

Text = Annotated[str, Meta(max_length=2000)]
Kind = Literal["number", "share", "flights"]  # what a value is: see above
VERDICTS = {True: "met", False: "missed", None: ""}  # on a bar


@dataclasses.dataclass(frozen=True)
class Measured:
    """One number of one variant over the seeds, in the unit of the recipe."""

    variant: str
    number: Number
    kind: Kind
    values: tuple[float | None, ...]  # by seed; None: never
    mean: float | None  # of share and flights: the share of all; None where a value is missing
    interval: tuple[float, float] | None  # 95 %, of the mean

    @property
    def present(self) -> list[float]:
        """Return the values that are there."""
        return [value for value in self.values if value is not None]

    @property
    def median(self) -> float | None:
        """Return the median, missing values being the worst; None where one of them decides."""
        return _finite(np.median(self._ranked))

    @property
    def held(self) -> float | None:
        """Return what is held against the bar: median, mean or worst, as the recipe says; None: never."""
        if self.number.over == "median":
            return self.median
        if self.number.over == "mean":
            return self.mean
        return _finite(max(self._ranked) if self.number.better == "lower" else min(self._ranked))

    @property
    def met(self) -> bool | None:
        """Return whether the bar is met; None where there is none."""
        if self.number.bar is None:
            return None
        if self.held is None:
            return False
        return self.held <= self.number.bar if self.number.better == "lower" else self.held >= self.number.bar

    @property
    def words(self) -> str:
        """Return median and range with the unit: "99.6 (99.2 to 100) %"."""
        unit = f" {self.number.unit}" if self.number.unit != "1" and self.present else ""
        return f"{self.range_words}{unit}{self.never_words}"

    @property
    def range_words(self) -> str:
        """Return median and range: "99.6 (99.2 to 100)"; of true and false the share alone."""
        if not self.present:
            return "–"
        if self.kind == "share":
            return "–" if self.mean is None else rounded(self.mean)
        low, high = rounded(min(self.present)), rounded(max(self.present))
        text = "never" if self.median is None else rounded(self.median)
        ends = low if low == high else f"{low} to {high}"
        return text if text == ends else f"{text} ({ends})"

    @property
    def never_words(self) -> str:
        """Return how many seeds never got there: ", never in 1 of 3"."""
        missing = len(self.values) - len(self.present)
        return f", never in {missing} of {len(self.values)}" if missing else ""

    @property
    def interval_words(self) -> str:
        """Return mean and interval: "99.5 [98.9, 99.9]"."""
        if self.mean is None:
            return "–"
        ends = "" if self.interval is None else f" [{', '.join(map(rounded, self.interval))}]"
        return rounded(self.mean) + ends

    def record(self) -> dict:
        """Return plain data; `read` gives it back."""
        entry: dict[str, Any] = {"variant": self.variant} if self.variant else {}
        values = [math.nan if value is None else value for value in self.values]
        entry |= {"number": self.number.name, "kind": self.kind, "values": values}
        for name in ("median", "mean"):
            if (value := getattr(self, name)) is not None:
                entry[name] = value
        return entry if self.interval is None else entry | {"interval": list(self.interval)}

    @property
    def _ranked(self) -> list[float]:
        worst = math.inf if self.number.better == "lower" else -math.inf
        return [worst if value is None else value for value in self.values]


class Ran(Table, frozen=True, kw_only=True):
    """What one run took."""

    variant: Text = ""
    seed: int
    cpu_seconds: Annotated[float, Meta(ge=0, le=1e300)]  # of its processes, training and evaluation
    wall_seconds: Annotated[float, Meta(ge=0, le=1e300)]
    ended: Text = ""  # how


class Entry(Table, frozen=True, kw_only=True):
    """One number of one variant as the file has it: NaN (of JSON: null) where a seed never got there."""

    variant: Text = ""
    number: str
    kind: Kind
    values: tuple[float | None, ...]
    median: float | UnsetType = UNSET
    mean: float | None = None
    interval: tuple[Real, Real] | None = None


class File(Table, frozen=True, kw_only=True):
    """Table [result] of a recipe, or a sweep's result.json."""

    command: Text
    machine: Text = ""
    versions: dict[str, str]
    load: tuple[Real, Real]
    measured: list[Entry]
    runs: tuple[Ran, ...]


@dataclasses.dataclass(frozen=True)
class Result:
    """What a sweep found: table [result] of a recipe."""

    command: str
    machine: str
    versions: dict[str, str]
    load: tuple[float, float]  # of the machine while it ran, least and most (average of a minute)
    measured: tuple[Measured, ...]
    runs: tuple[Ran, ...]

    @property
    def cost(self) -> str:
        """Return what the runs took, and on which machine, in one sentence."""
        cpu, wall = (
            _range([getattr(ran, name) for ran in self.runs]) for name in ("cpu_seconds", "wall_seconds")
        )
        return (
            f"A run took {cpu} s of CPU and {wall} s of wall time, training and evaluation, "
            f"on {self.machine} at a load of {_range(self.load, 1)}."
        )

    def answer(self, template: str) -> str:
        """Return a recipe's answer with its numbers filled in; "" where it has none."""
        texts = {f"{m.variant}.{m.number.name}".removeprefix("."): m.words for m in self.measured}
        parts = string.Formatter().parse(template)
        return "".join(text + ("" if name is None else texts[name]) for text, name, _, _ in parts)

    @property
    def verdict(self) -> str:
        """Return how many of the bars are met."""
        bars = [m.met for m in self.measured if m.met is not None]
        if not bars:
            return "no bar was set"
        return f"{sum(bars)} of {len(bars)} bars met" if len(bars) > 1 else f"bar {VERDICTS[bars[0]]}"

    def of(self, variant: str, number: str) -> Measured:
        """Return one of `measured`."""
        return next(m for m in self.measured if (m.variant, m.number.name) == (variant, number))

    def record(self) -> dict[str, Any]:
        """Return plain data; `read` gives it back."""
        runs = [
            {key: value for key, value in structs.asdict(ran).items() if value != ""} for ran in self.runs
        ]
        return {
            "command": self.command,
            "machine": self.machine,
            "versions": self.versions,
            "load": list(self.load),
            "measured": [measured.record() for measured in self.measured],
            "runs": runs,
        }


def bar_words(number: Number) -> str:
    """Return the bar and what is held against it: "worst at least 99"."""
    if number.bar is None:
        return "–"
    return f"{number.over} {'at most' if number.better == 'lower' else 'at least'} {rounded(number.bar)}"


def take(number: Number, folder: Path) -> tuple[Kind, Any]:
    """Return kind and raw value of a number of one run; raises UserError where its file does not have it."""
    path = folder / number.file
    value = storage.read_json(path, f"number {number.name}: file")
    for k, step in enumerate(number.path):
        try:
            value = value[step]
        except (KeyError, IndexError, TypeError) as error:
            way = ".".join(map(str, number.path[: k + 1]))
            if value is None:  # what holds the number is null: it is not there either
                return "number", None
            raise UserError(f"number {number.name}: {path} has no {shown(way, 80)}") from error
    if isinstance(value, dict) and {"count", "of"} <= set(value):
        if all(type(value[key]) is int for key in ("count", "of")) and 0 <= value["count"] <= value["of"] > 0:
            return "flights", (value["count"], value["of"])
    elif isinstance(value, bool):
        return "share", value
    elif value is None or (type(value) in (int, float) and abs(value) < 1e300):
        return "number", value
    raise UserError(f"number {number.name}: {path} has {shown(repr(value), 60)} there, which is no number")


def sum_up(variant: str, number: Number, taken: list[tuple[Kind, Any]]) -> Measured:
    """Return a number over the seeds, from what `take` gave for each; raises UserError where kinds differ."""
    kinds: set[Kind] = {kind for kind, value in taken if value is not None} or {"number"}
    if len(kinds) > 1:
        raise UserError(f"number {number.name} is {' in one run and '.join(sorted(kinds))} in another")
    (kind,), factor = kinds, number.factor
    values = [value for _, value in taken]
    here = [value for value in values if value is not None]
    if kind == "flights":
        found = proportion(sum(count for count, _ in here), sum(of for _, of in here))
        values = [None if value is None else value[0] / value[1] for value in values]
    elif kind == "share":
        found = proportion(sum(here), len(here))
    else:
        found = bootstrap(here) if here else {}
    mean, interval = found.get("mean", found.get("share")), found.get("interval")
    if len(here) < len(values):
        mean = interval = None
    return Measured(
        variant=variant,
        number=number.of(variant),
        kind=kind,
        values=tuple(None if value is None else factor * value for value in values),
        mean=None if mean is None else factor * mean,
        interval=None if interval is None else (factor * interval[0], factor * interval[1]),
    )


def read(recipe: Recipe, data: Any) -> Result:
    """Return the table [result] of a recipe; raises UserError where it is missing or wrong."""
    if not isinstance(data, dict):
        raise UserError(
            f"recipe {recipe.name}: it has no [result] yet; landing-train sweep --record writes it"
        )
    try:
        return _read(recipe, data)
    except UserError as error:
        raise UserError(f"recipe {recipe.name}: [result] {error}") from error


def _read(recipe: Recipe, data: dict) -> Result:
    file = schema.parse(data, File)
    if not _is_sweep(file.command):
        raise UserError("command must be that of the sweep, landing-train sweep RECIPE")
    measured = tuple(_measured(recipe, entry) for entry in file.measured)
    wanted = [(variant, number) for variant in recipe.variants for number in recipe.numbers]
    if sorted((m.variant, m.number.name) for m in measured) != sorted(wanted):
        raise UserError("measured has not every number of every variant once; run the sweep again")
    if sorted((r.variant, r.seed) for r in file.runs) != sorted(recipe.runs()):
        raise UserError("runs are not those of the recipe; run the sweep again")
    return Result(
        command=shown(file.command, 2000),
        machine=shown(file.machine, 2000),
        versions={shown(name, 60): shown(text, 200) for name, text in file.versions.items()},
        load=file.load,
        measured=measured,
        runs=tuple(structs.replace(ran, ended=shown(ran.ended, 2000)) for ran in file.runs),
    )


def _is_sweep(command: str) -> bool:
    """Return whether a shell would run `landing-train sweep` and nothing else: it is copied from the page."""
    try:
        words = shlex.split(command)
    except ValueError:
        return False
    return words[:2] == ["landing-train", "sweep"] and len(words) > 2 and shlex.join(words) == command


def _measured(recipe: Recipe, entry: Entry) -> Measured:
    if entry.number not in recipe.numbers:
        raise UserError("measured: number is none of the recipe")
    if len(entry.values) != len(recipe.seeds):
        raise UserError(f"measured: {len(entry.values)} values for {len(recipe.seeds)} seeds")
    result = Measured(
        variant=entry.variant,
        number=recipe.numbers[entry.number].of(entry.variant),
        kind=entry.kind,
        values=tuple(map(_value, entry.values)),
        mean=_value(entry.mean),
        interval=entry.interval,
    )
    median, found = entry.median, result.median
    # All are recorded with six digits: 5e-6 each, of the median and of the two values it lies between.
    if median is not UNSET and (found is None or not math.isclose(median, found, rel_tol=1e-5)):
        raise UserError(f"measured: median is {median:g}, not that of the values")
    return result


def _value(value: float | None) -> float | None:
    """Return a number of the file, None for NaN; raises UserError for one that is infinite."""
    if value is None or math.isnan(value):
        return None
    if math.isinf(value):
        raise UserError(f"measured: {value} is no number")
    return value


def _finite(value) -> float | None:
    return float(value) if math.isfinite(value) else None


def _range(values: Sequence[float], digits: int = 0) -> str:
    low, high = (f"{end:.{digits}f}" for end in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"
