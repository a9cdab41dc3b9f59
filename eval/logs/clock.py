"""The clock of a table: its column and unit, wrap-arounds, and the order of rows."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Mapping

import numpy as np

from inclined_landing.eval.logs import limits, units
from inclined_landing.eval.logs.record import Record
from inclined_landing.models.base.errors import UserError, shown

# What time is called, in lower case and without its unit; of several, the first is taken.
NAMES = (
    *("t", "time", "timestamp", "time_stamp", "time stamp", "stamp", "header.stamp", "tick", "ticks"),
    *("elapsed", "elapsed_time", "elapsed time", "time_boot", "time_since_boot", "clock"),
)
_SECONDS_AND_REST = (("secs", "nsecs"), ("sec", "nanosec"), ("sec", "nsec"), ("seconds", "nanoseconds"))
# s between rows, at most: of a column t, which is in seconds unless no flight has so few rows, and of others,
# where 0.3 s tells 3.3 rows per second from 3 300 in a unit a thousand times smaller.
_LONGEST_STEP = {"t": 1.0 / limits.FEWEST_PER_SECOND, "": 0.3}
LATEST_ROW = 1.0  # s that rows may come late and are still sorted


def named(names: Iterable[str]) -> str | None:
    """Return the column whose name means time, the most likely of several, or None.

    Seconds and nanoseconds of a stamp are `secs + nsecs`.
    """
    names, called = list(names), dict[int, str]()
    for name in names:
        plain, _ = units.split(name)
        if plain in NAMES:
            called.setdefault(NAMES.index(plain), name)
        elif len(name) > 1 and units.known("t", name):  # a column called ms
            called.setdefault(len(NAMES), name)
        for first, rest in _SECONDS_AND_REST:
            other = re.sub(rf"(^|(?<=\W|_)){first}$", rest, name)
            if other != name and other in names:
                return f"{name} + {other}"
    return called[min(called)] if called else None


def with_clock(record: Record, wanted: Mapping[str, str | None], stated: str | None) -> Record:
    """Return the record with a clock; if the expected columns are missing, time under another name.

    A unit that neither name nor file states is inferred from the time step; a clock that wraps is unwrapped.
    wanted: the mapping's columns and their units. stated: the unit stated by the user. Changes are noted.
    """
    here = next((name for name in wanted if name in record.columns), None)
    name = here or named(record.columns)
    if name is None:
        return record
    notes = list(record.notes)
    if name in record.columns:
        values = record.columns[name]
        alias = units.split(name)[1] or (name if units.known("t", name) else None)
        unit = stated or record.units.get(name) or (wanted[name] if here else alias)
    else:
        first, rest = name.split(" + ")
        values, unit = record.columns[first] + 1e-9 * record.columns[rest], "s"
    inferred = ""
    if unit is None and (here or name) == "t":
        _check_counts(record, name, values)
    if unit is None:
        unit = _unit_by_step(values, _LONGEST_STEP["t" if here or name == "t" else ""])
        inferred = "" if here and unit == "s" else " (inferred from the time step)"
    if not here or inferred:
        notes.append(f"time is the column {shown(name)}, in {unit}{inferred}")
    values, wraps = _unwrapped(values, units.factor("t", unit, record.path))
    if wraps:
        notes.append(f"the clock {shown(name)} wraps around ({wraps}); it was unwrapped")
    key = here or next(iter(wanted), "t")
    return dataclasses.replace(
        record, columns={**record.columns, key: values}, units={**record.units, key: unit}, notes=tuple(notes)
    )


def _check_counts(record: Record, name: str, values: np.ndarray) -> None:
    """Raise UserError for a column t, without a unit, that counts the rows."""
    if len(values) < 10 or not (np.diff(values) == 1.0).all():
        return
    other = named(column for column in record.columns if column != name)
    rather = f", or omit it for {shown(other)}" if other else ""
    raise UserError(
        f"{record.path}: column {shown(name)} increases by exactly 1 per row: a frame number, or ticks? "
        f"State its unit, for example --unit t='0.01 s' at 100 rows per second{rather}"
    )


def _unit_by_step(t: np.ndarray, longest: float) -> str:
    """Return the first unit in which rows are at most `longest` seconds apart; s if there is none."""
    steps = np.diff(np.sort(t[np.isfinite(t)]))
    steps = steps[steps > 0.0]
    step = np.median(steps) if len(steps) else 0.0
    return next((unit for unit, size in units.UNITS["time"].items() if step * size <= longest), "s")


def _unwrapped(t: np.ndarray, scale: float) -> tuple[np.ndarray, int]:
    """Return the unwrapped clock, and how often it had wrapped."""
    back = np.flatnonzero(np.diff(t) < 0.0)
    for wrap in (2.0**32, 86400.0 / scale):  # of 32 bits in any unit, and times of day
        step = scale * (np.diff(t)[back] + wrap)
        over = back[(step >= 0.0) & (step <= LATEST_ROW)]
        if len(over):
            turns = np.zeros(len(t))
            turns[over + 1] = wrap
            return t + np.cumsum(turns), len(over)
    return t, 0


def order(t: np.ndarray, columns: Iterable[np.ndarray]) -> np.ndarray | None:
    """Return the rows (m,) sorted by time if they are in order of arrival; None if no sorting is needed.

    Sorting is safe if the rows of each column are in order, as for log blocks that share a table, or late by
    less than LATEST_ROW. The result is also None if a clock went back, because an instant then has two rows.
    """
    if not np.isfinite(t).all() or (np.diff(t) >= 0.0).all():
        return None
    if not all(_in_order(t[np.isfinite(values)]) for values in columns):
        return None
    return np.argsort(t, kind="stable")


def _in_order(t: np.ndarray) -> bool:
    """Return whether times increase, except for late rows."""
    latest = np.maximum.accumulate(t)
    late = np.flatnonzero(np.diff(t) < 0.0) + 1
    if not len(late):
        return True
    behind = latest[late] - t[late]
    ordered = np.sort(t)
    step = np.median(np.diff(ordered))
    if behind.max() >= LATEST_ROW or step <= 0.0:
        return False
    between = np.searchsorted(ordered, latest[late]) - np.searchsorted(ordered, t[late])
    return bool((between <= 1.5 * behind / step + 3).all())


def check(where: str, t: np.ndarray, column: str, is_table: bool = True) -> None:
    """Raise UserError, with a remedy, for times that cannot be those of a flight."""
    bad = np.flatnonzero(~np.isfinite(t))
    if bad.size:
        raise UserError(f"{where}: {column} is not a number in row {bad[0] + 1} of the data")
    back = np.flatnonzero(t[1:] < t[:-1])
    if back.size:
        k = back[0] + 1
        more = f", and in {back.size - 1} more" if back.size > 1 else ""
        remedy = (
            "correct that row, sort the rows by it, or cut the file where the next flight begins"
            if is_table
            else "the clock was reset; extract the flight before or after it"
        )
        back_to = f"{column} goes back from {t[k - 1]:g} to {t[k]:g} s in row {k + 1} of the data"
        raise UserError(f"{where}: {back_to}{more}: {remedy}")
    if t[-1] - t[0] > limits.LONGEST:
        row = int(np.argmax(np.diff(t)))
        raise UserError(
            f"{where}: {column} runs over {t[-1] - t[0]:.3g} s, in one step from {t[row]:.6g} to "
            f"{t[row + 1]:.6g} s; a flight lasts at most {limits.LONGEST:g} s: state the unit of time, "
            "or extract the flight"
        )
