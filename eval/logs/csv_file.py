"""Comma-separated tables: the documented CSV, the Crazyflie client's, anything a mapping describes."""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas

from inclined_landing.eval.logs.limits import LARGEST_VALUE, MOST_COLUMNS, check_file, read_table
from inclined_landing.eval.logs.record import Record
from inclined_landing.models.errors import UserError, shown

_FEWEST_ROWS = 100  # of a flight without mapping


def read(path: Path) -> Record:
    """Read a table with one header line and, optionally, a line of units under it.

    `.gz` is unpacked on the way; comma, semicolon or tab separate. A column of lists becomes one for each of
    their numbers. Text columns become NaN: none is ever asked for.
    Raises UserError for what is not such a table, and for text among numbers.
    """
    data = read_table(path)
    try:
        file = io.TextIOWrapper(data, encoding="utf-8-sig")
        first, second = file.readline(), file.readline()
        file.detach()  # or the text layer closes the bytes with itself
        separator = next((mark for mark in ",;\t" if mark in first), ",")
        header = _header(path, first, separator)
        cells = [cell.strip().strip('"') for cell in second.strip().split(separator)]
        units = {}
        if second.strip() and not any(_is_number(cell) or not cell for cell in cells):
            units = dict(zip(header, cells))
        data.seek(0)
        with warnings.catch_warnings():
            # A row too long is an error below, not the first column turned into an index.
            warnings.simplefilter("error", pandas.errors.ParserWarning)
            table = pandas.read_csv(
                data,
                sep=separator,
                names=header,
                skiprows=2 if units else 1,
                index_col=False,
                skipinitialspace=True,
                encoding="utf-8-sig",
                low_memory=False,
            )
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: not a readable text table ({error})") from error
    except (pandas.errors.ParserError, pandas.errors.ParserWarning) as error:
        raise UserError(f"{path}: rows of different length ({str(error).strip()})") from error
    except pandas.errors.EmptyDataError as error:
        raise UserError(f"{path}: a header and no rows") from error
    columns: dict[str, np.ndarray] = {}
    for name in header:
        parts = _parts(path, table[name])
        columns |= {key: _numbers(path, part, bool(units)) for key, part in parts.items()}
    return Record(str(path), columns, units=units)


def read_columns(path: Path, names: Sequence[str]) -> pandas.DataFrame:
    """Return the columns `names` of a table without mapping; raise UserError for one missing or infinite."""
    if check_file(path):
        raise UserError(f"{path}: a folder, not a file")
    columns = read(path).columns
    for name in names:
        if name not in columns:
            raise UserError(f"{path} lacks the column {name}")
    rows = len(columns[names[0]])
    if rows < _FEWEST_ROWS:
        raise UserError(f"{path} has {rows} rows; at least {_FEWEST_ROWS} are needed")
    for name in names:
        wrong = ~(np.abs(columns[name]) <= LARGEST_VALUE)
        if wrong.any():
            raise UserError(f"{path}: column {name} is not a number of a flight in row {wrong.argmax() + 1}")
    return pandas.DataFrame({name: columns[name] for name in names})


def _header(path: Path, line: str, separator: str) -> list[str]:
    """Return the names of the columns; unnamed ones are numbered."""
    names = [name.strip().strip('"') for name in line.strip("\r\n").split(separator)]
    if not any(names):
        raise UserError(f"{path}: empty; expected a line of column names and rows of numbers")
    if len(names) > MOST_COLUMNS:
        raise UserError(f"{path}: {len(names)} columns; at most {MOST_COLUMNS} are read")
    if any(_is_number(name) for name in names):
        raise UserError(f"{path}: the first line holds numbers; expected column names")
    names = [name or f"column {k + 1}" for k, name in enumerate(names)]
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise UserError(f"{path}: column {shown(name)} appears twice")
        seen.add(name)
    return names


def _parts(path: Path, column: pandas.Series) -> dict[str, pandas.Series]:
    """Return a column by its name; one of lists, as `[0.1, 0.2]`, as NAME.0, NAME.1 and so on."""
    name = str(column.name)
    if pandas.api.types.is_numeric_dtype(column) or not str(column.head(1).squeeze()).startswith("["):
        return {name: column}
    plain = column.astype("string").str.replace(r"[\[\]\s]", "", regex=True)
    parts = plain.str.split(",", expand=True)
    if parts.shape[1] > MOST_COLUMNS or parts.isna().to_numpy().any():
        raise UserError(f"{path}: the lists in column {shown(name)} are not all of one length")
    return {f"{name}.{k}": parts[k].rename(f"{name}.{k}") for k in parts}


def _numbers(path: Path, column: pandas.Series, has_units: bool) -> np.ndarray:
    if pandas.api.types.is_numeric_dtype(column):
        return column.to_numpy(float)
    text = column.astype("string").str.strip()
    lower = text.str.lower()
    text = text.mask(lower == "true", "1").mask(lower == "false", "0")
    values = pandas.to_numeric(text, errors="coerce")
    bad = values.isna() & text.notna() & ~lower.isin(["nan", ""]).fillna(False)
    if bad.any() and values.notna().mean() > 0.5:  # numbers with text among them, not a text column
        line = int(np.argmax(bad.to_numpy())) + (3 if has_units else 2)
        cell = shown(text[bad].iloc[0], 40)
        raise UserError(f"{path}: line {line}, column {shown(column.name)}: {cell!r} is not a number")
    return values.to_numpy(float, na_value=np.nan)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
