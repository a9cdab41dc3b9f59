"""Measures: quantities of flights, each with unit, statistic and its format in tables.

All statistics have the same form: value, interval or quantiles, range, and the number of flights.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from inclined_landing.envs.shared.statistics import mean, median, proportion

if TYPE_CHECKING:
    import pandas as pd

Row = Mapping[str, Any]  # labels, and the statistic of one measure
SIZES = ("value", "low", "high", "min", "max", "count", "flights")


def share(values: np.ndarray) -> dict[str, Any]:
    """Return the share of true values with its Wilson 95 % interval; `count` are true."""
    return proportion(int(values.sum()), len(values))


def with_ends(row: Row, factor: float, digits: int) -> str:
    """Return a share as `99.6 [97.8, 99.9]` and a median as `2.31 (1.90 to 2.84)`; one value has no range."""
    # z: no minus sign before zero
    value, low, high = (f"{factor * row[key]:z,.{digits}f}" for key in ("value", "low", "high"))
    if row["statistic"] == "share":
        return f"{value} [{low}, {high}]"
    return value if row["count"] == 1 else f"{value} ({low} to {high})"


def alone(row: Row, factor: float, digits: int) -> str:
    """Return the value without its interval."""
    return f"{factor * row['value']:z.{digits}f}"


def counted(row: Row, factor: float, digits: int) -> str:
    """Return the count behind a share."""
    return str(row["count"])


@dataclasses.dataclass(frozen=True, kw_only=True)
class Measure:
    """One quantity of flights. Tables and figures show it multiplied by `factor`, in `shown_unit`."""

    name: str  # in rows
    title: str  # in the heading of a column
    statistic: Callable[[np.ndarray], dict[str, Any]]
    column: str = ""  # of the flights; "": that of its name
    among: str = ""  # a column: only flights where it is true are counted; "": all
    unit: str = "1"
    shown_unit: str = ""
    factor: float = 1.0
    digits: int = 2
    cell: Callable[[Row, float, int], str] = with_ends
    said: str = ""  # the word for counted flights: "landed"
    note: str = ""  # an explanation under tables

    @property
    def heading(self) -> str:
        """Return the heading of its column."""
        return f"{self.title} [{self.shown_unit}]" if self.shown_unit else self.title

    def of(self, flights: pd.DataFrame) -> dict[str, Any]:
        """Return its statistic for flights, as part of a row."""
        among = flights[flights[self.among].astype(bool)] if self.among else flights
        found = self.statistic(among[self.column or self.name].to_numpy())
        about = {"measure": self.name, "unit": self.unit, "statistic": self.statistic.__name__}
        return about | {size: found.get(size) for size in SIZES} | {"flights": len(among)}

    def text(self, row: Row | None) -> str:
        """Return a row of this measure as the cell of a table."""
        return "-" if row is None or row["value"] is None else self.cell(row, self.factor, self.digits)


def share_of(name: str, title: str, **others: Any) -> Measure:
    """Return the measure of the share of flights in which a column is true, shown in per cent."""
    style: dict[str, Any] = {"shown_unit": "%", "factor": 100.0, "digits": 1}
    return Measure(name=name, title=title, statistic=share, **style | others)


def median_of(name: str, title: str, unit: str, **others: Any) -> Measure:
    """Return the measure of the median of a column."""
    return Measure(name=name, title=title, statistic=median, **{"unit": unit, "shown_unit": unit} | others)


# What every flight of a policy has.
SUCCESS = share_of("success", "success", said="succeeded")
STRICT = share_of(
    "strict",
    "strict",
    said="reached the goal box",
    note="strict: the vehicle reaches the goal box within 300 steps without touching anything first; "
    "the column success, which allows touches, is shown only where it differs",
)
TOUCHED = share_of("touched", "touched", cell=counted, shown_unit="")
TIME_TO_GOAL = median_of("time_to_goal", "time", "s")
DURATION = median_of("duration", "duration", "s", column="time")
REWARD = median_of("reward", "reward", "1", shown_unit="")
MEAN_REWARD = Measure(name="mean_reward", title="mean reward", statistic=mean, column="reward", cell=alone)


def count_words(row: Row, what: str = "flights") -> str:
    """Return a share in words: `250 of 251 flights (99.6 % [97.8, 99.9])`."""
    count = f"{row['count']} of {row['flights']} {what}"
    return count if row["value"] is None else f"{count} ({with_ends(row, 100.0, 1).replace(' [', ' % [')})"
