"""Tables as text: the documented CSV, that of the Crazyflie client, and anything a mapping describes."""

from __future__ import annotations

import csv
import dataclasses
import io
import itertools
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas

from inclined_landing.eval.logs.limits import MOST_COLUMNS, read_table
from inclined_landing.eval.logs.record import Record
from inclined_landing.models.base.errors import UserError, shown

_MISSING = {"", "-", "--", "?", "nan(ind)", "-nan(ind)"}  # besides the marks that pandas knows


@dataclasses.dataclass(frozen=True)
class _Layout:
    """The lines above the rows of a table."""

    names: list[str]
    units: dict[str, str]
    separator: str
    start: int  # of the rows, in bytes


def read(path: Path) -> Record:
    """Read a table with one header line and, optionally, comments above it and a line of units under it.

    The separator is a comma, semicolon, tab or blanks. A column of lists becomes one column for each element.
    Columns of text are NaN. Raises UserError for anything else.
    """
    data = read_table(path)
    layout = _layout(path, data)
    try:
        table = _parse(data[layout.start :], layout)
    except (pandas.errors.ParserError, pandas.errors.ParserWarning) as error:
        reason = str(error).removeprefix("Error tokenizing data. C error: ").strip()
        raise UserError(f"{path}: rows of different length ({reason}) below the header") from error
    except pandas.errors.EmptyDataError as error:
        raise UserError(f"{path}: a header and no rows") from error
    columns, unreadable = {}, {}
    for name in layout.names:
        for key, part in _parts(path, table[name]).items():
            values, words = _numbers(part)
            if not words.empty:
                row, cell = int(words.index[0]), shown(words.iloc[0], 40)
                where = f"line {_line(data, layout, row)}, column {shown(key)}"
                unreadable[key] = f"{where}: {cell!r} is not a number"
            if not np.isfinite(values).sum() > len(words) > 0:  # words among numbers are mistakes
                columns[key] = values
    return Record(str(path), columns, units=layout.units, unreadable=unreadable)


def _layout(path: Path, data: bytes) -> _Layout:
    """Return the lines above the rows: comments, the header, and a line of units."""
    comment: tuple[str, int] | None = None
    header: tuple[list[str], str, int] | None = None
    for raw, end in _lines(data):
        line = raw.decode()
        mark = _separator(line) if header is None else header[1]
        cells = _cells(path, line, mark)
        if not line.strip():
            continue
        if header is not None:
            if _are_units(cells):
                names = _names(path, header[0])
                return _Layout(names, dict(zip(names, cells)), mark, end)
            break
        if line.lstrip().startswith("#"):
            comment = (line.lstrip(" #"), end)
        elif not any(map(_is_number, cells)):
            header = (cells, mark, end)
        elif comment is not None:  # as numpy.savetxt writes the names
            mark = _separator(comment[0])
            header = (_cells(path, comment[0], mark), mark, comment[1])
            break
        else:
            raise UserError(f"{path}: the first line contains numbers; expected column names")
    if header is None:
        raise UserError(f"{path}: empty; expected a line of column names and rows of numbers")
    return _Layout(_names(path, header[0]), {}, *header[1:])


def _separator(line: str) -> str:
    """Return the separator of a line's cells: a blank if there is no other, a comma for a single cell."""
    mark = max(",;\t", key=line.count)
    return mark if mark in line or len(line.split()) < 2 else " "


def _lines(data: bytes) -> Iterator[tuple[bytes, int]]:
    """Yield the lines, each with the start of the next one."""
    start = 0
    while start < len(data):
        end = data.find(b"\n", start)
        end = len(data) if end < 0 else end
        yield data[start:end], end + 1
        start = end + 1


def _cells(path: Path, line: str, separator: str) -> list[str]:
    if separator == " ":
        return [cell.strip('"') for cell in line.split()]
    try:
        cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    except csv.Error as error:
        raise UserError(f"{path}: not a readable text table ({error})") from error
    return [cell.strip().strip('"') for cell in cells]


def _are_units(cells: Sequence[str]) -> bool:
    """Return whether the cells are units: text, of which some may be missing or 1."""
    texts = sum(not _is_number(cell) for cell in cells if cell)
    return all(cell in ("", "1") or not _is_number(cell) for cell in cells) and texts > cells.count("1")


def _names(path: Path, cells: list[str]) -> list[str]:
    """Return the names of the columns; unnamed ones are numbered."""
    if not any(cells):
        raise UserError(f"{path}: empty; expected a line of column names and rows of numbers")
    if len(cells) > MOST_COLUMNS:
        raise UserError(f"{path}: {len(cells)} columns; at most {MOST_COLUMNS} are read")
    names = [name or f"column {k + 1}" for k, name in enumerate(cells)]
    for name in names:
        if names.count(name) > 1:
            raise UserError(f"{path}: column {shown(name)} appears twice")
    return names


def _parse(rows: bytes, layout: _Layout) -> pandas.DataFrame:
    with warnings.catch_warnings():
        # A row too long is an error, not the first column turned into an index.
        warnings.simplefilter("error", pandas.errors.ParserWarning)
        return pandas.read_csv(
            io.BytesIO(rows),
            sep=r"\s+" if layout.separator == " " else layout.separator,
            names=layout.names,
            index_col=False,
            skipinitialspace=True,
            low_memory=False,
        )


def _line(data: bytes, layout: _Layout, row: int) -> int:
    """Return the line in the file of a row of the data, counted from 0."""
    filled = (k for k, (line, end) in enumerate(_lines(data), 1) if end > layout.start and line.strip())
    return next(itertools.islice(filled, row, None))


def _parts(path: Path, column: pandas.Series) -> dict[str, pandas.Series]:
    """Return a column by its name; of lists such as `[0.1, 0.2]`, the elements as NAME.0, NAME.1 ..."""
    name = str(column.name)
    if pandas.api.types.is_numeric_dtype(column) or not str(column.head(1).squeeze()).startswith("["):
        return {name: column}
    plain = column.astype("string").str.replace(r"[\[\]]", " ", regex=True).str.strip()
    parts = plain.str.replace(r"\s*,\s*|\s+", ",", regex=True).str.split(",", expand=True)
    if parts.shape[1] > MOST_COLUMNS or parts.isna().to_numpy().any():
        raise UserError(f"{path}: the lists in column {shown(name)} differ in length")
    return {f"{name}.{k}": parts[k].rename(f"{name}.{k}") for k in parts}


def _numbers(column: pandas.Series) -> tuple[np.ndarray, pandas.Series]:
    """Return a column's numbers, with NaN instead of words, and the words by row."""
    if pandas.api.types.is_numeric_dtype(column):
        return column.to_numpy(float), pandas.Series()
    text = column.astype("string").str.strip()
    lower = text.str.lower()
    text = text.mask(lower.isin(_MISSING).fillna(False))
    if lower[text.notna()].isin(["true", "false"]).all():
        return lower.map({"true": 1.0, "false": 0.0}).to_numpy(float, na_value=np.nan), pandas.Series()
    values = pandas.to_numeric(text, errors="coerce")
    return values.to_numpy(float, na_value=np.nan), text[values.isna() & text.notna()]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
