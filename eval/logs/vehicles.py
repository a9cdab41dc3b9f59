"""Tables with rows of several vehicles: selecting one, and finding the column that distinguishes them."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence

import numpy as np

from inclined_landing.eval.logs.record import Record
from inclined_landing.models.base.errors import UserError, choices, shown

MOST_VEHICLES = 50
# A column distinguishes vehicles where it changes so often per value, as rows alternate, and where at
# most this share of the distance from row to row lies within its values: vehicles are further apart than each
# moves from row to row. Of another column, such as a mode, the whole distance lies within its values.
CHANGES, WITHIN = 4, 0.5


def choose(records: Sequence[Record], where: Mapping[str, str | float]) -> list[Record]:
    """Return the records of one flight with only the rows that have these values in these columns.

    A record without the column keeps its rows. Raises UserError if no record has the column, or no row the
    value.
    """
    records = list(records)
    for column, wanted in where.items():
        if not any(column in _cells(record) for record in records):
            known = [name for record in records for name in _cells(record)]
            none = "" if known else "; rows are chosen in tables only: a mapping file names a bag's topics"
            named = f"; {choices(dict.fromkeys(known), column)}" if known else none
            raise UserError(f"{records[0].path}: no column {shown(column)} to choose rows by{named}")
        for k, record in enumerate(records):
            if (values := _cells(record).get(column)) is not None:
                text = _text(wanted)
                rows = np.array([_text(value) == text for value in values])
                if not rows.any():
                    found = [shown(_text(value), 40) for value in _distinct(values)]
                    never = f"{record.path}: column {shown(column)} is never {shown(wanted, 40)}"
                    raise UserError(f"{never}; {choices(found, str(wanted))}" if found else never)
                records[k] = record.rows(rows)
    return records


def check_one(record: Record, t: np.ndarray, position: Sequence[str]) -> None:
    """Raise UserError if a column distinguishes the rows of several vehicles.

    t: time (m,) of the rows. position: columns with the position.
    """
    order = np.argsort(t, kind="stable")
    way = np.array([record.columns[name][order] for name in position if name in record.columns])
    for name, values in _cells(record).items():
        values = values[order]
        distinct = _distinct(values)
        changes = int((values[1:] != values[:-1]).sum())
        if not 2 <= len(distinct) <= MOST_VEHICLES or changes < CHANGES * len(distinct):
            continue
        within = sum(_length(way[:, values == value]) for value in distinct)
        if within < WITHIN * _length(way):
            said = [shown(_text(value), 40) for value in distinct]
            listed = f"{len(said)} values ({', '.join(said[:5])}{', ...' * (len(said) > 5)})"
            option = shlex.quote(f"{name}={said[0]}")
            raise UserError(
                f"{record.path}: column {shown(name)} has {listed}, whose rows are those of different "
                f"vehicles; choose one with --where {option}"
            )


def _length(way: np.ndarray) -> float:
    """Return the length of the path through points (k, m)."""
    return float(np.nansum(np.abs(np.diff(way, axis=1))))


def _cells(record: Record) -> dict[str, np.ndarray]:
    """Return the columns (m,) of a table by name, with words where it has them; nothing of other formats."""
    is_table = record.is_table or not record.times
    return {**record.labels, **record.columns, **record.labels} if is_table else {}


def _distinct(values: np.ndarray) -> list:
    """Return the sorted values of a column that may contain names; none for any other column."""
    if values.dtype != object:
        found = np.unique(values[np.isfinite(values)])
        return list(found) if len(found) <= MOST_VEHICLES and (found % 1.0 == 0.0).all() else []
    return sorted({*values} - {""})


def _text(cell: str | float) -> str:
    """Return a cell as text, numbers in their shortest form."""
    try:
        return f"{float(cell):.15g}"
    except ValueError:
        return str(cell)
