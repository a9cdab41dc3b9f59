"""Tables as text: the documented CSV, the Crazyflie client's, anything a mapping describes."""

from __future__ import annotations

import csv
import dataclasses
import io
import itertools
import re
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas

from inclined_landing.eval.logs.limits import MOST_COLUMNS, read_table
from inclined_landing.eval.logs.record import Record
from inclined_landing.models.errors import UserError, shown

_COMMENT = ("#", "%", "//")
# Cells without a value, in lower case, besides those that pandas knows.
_MISSING = {"", "nan", "-", "--", "---", "?", "*", ".", "nat", "\\n", "missing", "undefined", "invalid"}
_MISSING |= {"nan(ind)", "-nan(ind)", "#num!", "#div/0!", "#value!"}
_DECIMAL_COMMA = r"(?![+-]?[1-9]\d{0,2}(?:,\d{3})+$)[+-]?\d*,\d+(?:[eE][+-]?\d+)?"
_GROUPED = r"[+-]?\d{{1,3}}(?:([{marks}])\d{{3}})(?:\1\d{{3}})*(?:{point}\d*)?"  # 37,721.9
_DATE = r"\d{4}-\d\d-\d\d[ T]\d\d:\d\d.*"
_TIME_OF_DAY = r"\d{1,2}:\d\d:\d\d(?:\.\d+)?"


@dataclasses.dataclass(frozen=True)
class _Layout:
    """The lines above the rows of a table."""

    names: list[str]
    units: dict[str, str]
    separator: str
    start: int  # of the rows, in bytes
    lines: int  # above the rows
    header: bytes


def read(path: Path) -> Record:
    """Read a table with one header line and, optionally, comments above it and a line of units under it.

    Packed files are unpacked on the way; comma, semicolon, tab, bar or blanks separate. A column of lists
    becomes one for each of their numbers, dates and times of day become seconds. Columns of text are NaN.
    Raises UserError for anything else.
    """
    data, encoding, notes = read_table(path)
    layout = _layout(path, data, encoding)
    if encoding != "utf-8":
        notes.append("the file is not UTF-8 and was read as Latin-1")
    rows = _without_comments(data[layout.start :], layout, notes)
    try:
        table = _parse(rows, layout, encoding)
        decimal = "," if _has_decimal_commas(table) else "."
        if decimal == ",":
            notes.append("the decimal sign is a comma")
            table = _parse(rows, layout, encoding, decimal)
    except (pandas.errors.ParserError, pandas.errors.ParserWarning) as error:
        reason = str(error).removeprefix("Error tokenizing data. C error: ").strip()
        raise UserError(f"{path}: rows of different length ({reason}) below the header") from error
    except pandas.errors.EmptyDataError as error:
        raise UserError(f"{path}: a header and no rows") from error
    columns: dict[str, np.ndarray] = {}
    unreadable: dict[str, str] = {}
    units = dict(layout.units)
    for name in layout.names:
        for key, part in _parts(path, table[name]).items():
            values, unit, problem = _numbers(part, decimal, notes, cut=not data.endswith(b"\n"))
            if unit:
                units[key] = unit
            if problem is not None:
                row, cell = problem
                line = _line(data, layout, row)
                unreadable[key] = f"line {line}, column {shown(key)}: {shown(cell, 40)!r} is not a number"
            if values is not None:
                columns[key] = values
    return Record(str(path), columns, units=units, unreadable=unreadable, notes=tuple(notes))


def _layout(path: Path, data: bytes, encoding: str) -> _Layout:
    """Return the lines above the rows: `sep=`, comments and titles, the header, and a line of units."""
    separator, comment, header = "", None, None
    for count, (raw, end) in enumerate(_lines(data), 1):
        line = raw.decode(encoding, "replace")
        said = re.fullmatch(r'"?sep=(.)"?', line, re.IGNORECASE)
        marked = line.lstrip().startswith(_COMMENT)
        if said:
            separator = said[1]
        elif not line.strip():
            pass
        elif header is None and marked:
            comment = (line.lstrip(" #%/"), raw, end, count)
        elif header is None:
            mark = separator or _separator(line)
            cells = _cells(path, line, mark)
            numbers = sum(map(_is_number, cells))
            if not numbers or (mark == " " and 2 * numbers < len(cells)):
                header = (cells, mark, raw, end, count)
            elif comment is not None:  # as numpy.savetxt has it
                mark = separator or _separator(comment[0])
                header = (_cells(path, comment[0], mark), mark, *comment[1:])
                break
            else:
                raise UserError(f"{path}: the first line contains numbers; expected column names")
        else:
            mark = separator or _separator(line)
            cells = _cells(path, line.lstrip(" #%/") if marked else line, header[1])
            other = _cells(path, line, mark)
            titled = len(other) > max(len(header[0]), 2) or (header[1] == " " != mark and len(other) > 1)
            if titled and not any(map(_is_number, other)):
                header = (other, mark, raw, end, count)  # what was above is a title
            elif _are_units(cells) and (not marked or len(cells) == len(header[0])):
                names = _names(path, header[0])
                return _Layout(names, dict(zip(names, cells)), header[1], end, count, header[2])
            else:
                break
    if header is None:
        raise UserError(f"{path}: empty; expected a line of column names and rows of numbers")
    return _Layout(_names(path, header[0]), {}, header[1], header[3], header[4], header[2])


def _separator(line: str) -> str:
    """Return the mark that separates a line's cells, a blank without any; a comma for one cell."""
    mark = max(",;\t", key=line.count)
    if mark not in line and "|" in line:
        return "|"
    return mark if mark in line or len(line.split()) < 2 else " "


def _lines(data: bytes) -> Iterator[tuple[bytes, int]]:
    """Yield the lines and where the next one starts."""
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
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise UserError(f"{path}: column {shown(name)} appears twice")
        seen.add(name)
    return names


def _without_comments(rows: bytes, layout: _Layout, notes: list[str]) -> bytes:
    """Return the rows without comments and repeated headers, whose lines stay, empty."""
    if not re.search(rb"\n[ \t]*#", rows) and not rows.startswith(b"#") and layout.header not in rows:
        return rows
    found = b"|".join([rb"[ \t]*#.*", re.escape(layout.header)])
    if 2 * rows.count(b"\n#") > rows.count(b"\n"):  # the first column's way to write
        return rows
    rows, count = re.subn(rb"(?m)^(?:%s)$" % found, b"", rows)
    if count:
        notes.append(f"{count} lines among the rows are comments or repeated headers and were left out")
    return rows


def _parse(rows: bytes, layout: _Layout, encoding: str, decimal: str = ".") -> pandas.DataFrame:
    with warnings.catch_warnings():
        # A row too long is an error, not the first column turned into an index.
        warnings.simplefilter("error", pandas.errors.ParserWarning)
        return pandas.read_csv(
            io.BytesIO(rows),
            sep=r"\s+" if layout.separator == " " else layout.separator,
            names=layout.names,
            index_col=False,
            skipinitialspace=True,
            encoding=encoding,
            low_memory=False,
            decimal=decimal,
        )


def _has_decimal_commas(table: pandas.DataFrame) -> bool:
    """Return whether a table that was read with decimal points has decimal commas, and no points."""
    numbers, text = table.select_dtypes("number"), table.select_dtypes(exclude="number")
    commas = any(_matches(column.astype("string"), _DECIMAL_COMMA).any() for _, column in text.items())
    return commas and not any((column % 1.0 > 0.0).any() for _, column in numbers.items())


def _matches(text: pandas.Series, pattern: str) -> np.ndarray:
    """Return which cells (m,) are what the pattern describes."""
    whole = re.compile(pattern).fullmatch
    return text.isin([cell for cell in text.dropna().unique() if whole(cell)]).to_numpy(bool)


def _line(data: bytes, layout: _Layout, row: int) -> int:
    """Return the line in the file of a row of the data, counted from 0."""
    filled = (k for k, (line, end) in enumerate(_lines(data), 1) if end > layout.start and line.strip())
    return next(itertools.islice(filled, row, None), layout.lines + row + 1)


def _parts(path: Path, column: pandas.Series) -> dict[str, pandas.Series]:
    """Return a column by its name; one of lists, as `[0.1, 0.2]`, as NAME.0, NAME.1 and so on."""
    name = str(column.name)
    if pandas.api.types.is_numeric_dtype(column) or not str(column.head(1).squeeze()).startswith("["):
        return {name: column}
    plain = column.astype("string").str.replace(r"[\[\]]", " ", regex=True).str.strip()
    parts = plain.str.replace(r"\s*,\s*|\s+", ",", regex=True).str.split(",", expand=True)
    if parts.shape[1] > MOST_COLUMNS or parts.isna().to_numpy().any():
        raise UserError(f"{path}: the lists in column {shown(name)} differ in length")
    return {f"{name}.{k}": parts[k].rename(f"{name}.{k}") for k in parts}


def _numbers(
    column: pandas.Series, decimal: str, notes: list[str], cut: bool
) -> tuple[np.ndarray | None, str, tuple[int, str] | None]:
    """Return a column's numbers, their unit if stated, and the first row and cell that is not a number.

    Of text alone the numbers are NaN, of numbers with text among them None. cut: the last line may be cut.
    """
    if pandas.api.types.is_numeric_dtype(column):
        return column.to_numpy(float), "", None
    text = column.astype("string").str.strip()
    first = str(text.dropna().head(1).squeeze())
    if re.fullmatch(_TIME_OF_DAY, first):  # s since midnight
        return pandas.to_timedelta(text, errors="coerce").dt.total_seconds().to_numpy(float), "s", None
    if re.fullmatch(_DATE, first):  # s since 1970
        dates = pandas.to_datetime(text, errors="coerce", format="ISO8601", utc=True)
        seconds = (dates - pandas.Timestamp(0, tz="UTC")).dt.total_seconds()
        return seconds.to_numpy(float), "s", None
    lower = text.str.lower()
    missing = lower.isin(_MISSING).fillna(True).astype(bool)
    if lower[~missing].isin(("true", "false")).all():
        return lower.map({"true": 1.0, "false": 0.0}).to_numpy(float, na_value=np.nan), "", None
    marks = " '\u2019\u00a0\u202f" + ("," if decimal == "." else ".")
    grouped = _matches(text, _GROUPED.format(marks=marks, point=re.escape(decimal)))
    if grouped.any():
        notes.append(f"column {shown(column.name)} has thousands separators")
        text = text.mask(grouped, text.str.replace(f"[{marks}]", "", regex=True))
    if decimal == ",":
        text = text.str.replace(",", ".")
    values = pandas.to_numeric(text, errors="coerce")
    bad = values.isna() & ~missing
    if cut and bad.sum() == 1 and bad.iloc[-1]:
        bad.iloc[-1] = False
    numbers = values.to_numpy(float, na_value=np.nan)
    if not bad.any():
        return numbers, "", None
    row = int(np.argmax(bad.to_numpy()))
    mixed = values.notna().sum() > bad.sum()
    return None if mixed else np.full(len(numbers), np.nan), "", (row, str(text.iloc[row]))


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", ".", 1))
    except ValueError:
        return False
    return True
