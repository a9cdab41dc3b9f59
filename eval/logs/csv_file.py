"""Tables as text: the documented CSV, that of the Crazyflie client, and anything a mapping describes."""

from __future__ import annotations

import csv
import dataclasses
import io
import itertools
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas

from inclined_landing.eval.logs.limits import MOST_AT_THE_END, MOST_COLUMNS, read_table
from inclined_landing.eval.logs.mapping import ColumnMap, is_named
from inclined_landing.eval.logs.record import Record
from inclined_landing.models.base.errors import UserError, shown

MOST_LABELS = 50  # values of a column that names something
_COMMENT = ("#", "%", "//")
# Cells without a value, in lower case, besides those that pandas knows.
_MISSING = {"", "nan", "-", "--", "---", "?", "*", ".", "nat", "\\n", "missing", "undefined", "invalid"}
_MISSING |= {"nan(ind)", "-nan(ind)", "#num!", "#div/0!", "#value!"}
_COMMAS = re.compile(r"[+-]?[\d.]*(?:,\d+)+(?:\.\d*)?(?:[eE][+-]?\d+)?")  # a number with commas
_GROUPED = re.compile(r"[+-]?[1-9]\d{0,2}(?:,\d{3})+(?:\.\d*)?")  # 37,721.9
_DATE = r"\d{4}-\d\d-\d\d[ T]\d\d:\d\d.*"
_TIME_OF_DAY = r"\d{1,2}:\d\d:\d\d(?:\.\d+)?"


@dataclasses.dataclass(frozen=True)
class _Layout:
    """The lines above the rows of a table."""

    names: list[str]
    separator: str
    start: int  # of the rows, in bytes
    lines: int  # above the rows
    header: bytes
    units: dict[str, str] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class _Column:
    """A column of a table: its numbers, with NaN instead of words."""

    values: np.ndarray
    unit: str = ""
    words: pandas.Series = dataclasses.field(
        default_factory=pandas.Series
    )  # the cells that are words, by row

    @property
    def mixed(self) -> bool:
        """Whether the column has words among a larger number of numbers."""
        return np.isfinite(self.values).sum() > len(self.words) > 0


def read(path: Path, column_map: ColumnMap | None = None) -> Record:
    """Read a table with one header line and, optionally, comments above it and a line of units under it.

    Compressed files are unpacked; the separator is a comma, semicolon, tab, bar or blanks. A column of lists
    becomes one column for each element, and dates and times of day become seconds. Columns of text are NaN.
    Rows of words or sums below the log are removed. column_map: lists the lines that contain the names, if
    these are not the first ones.

    Raises UserError for anything else.
    """
    data, encoding, notes = read_table(path)
    layout = _described(path, data, encoding, column_map)
    if encoding != "utf-8":
        notes.append("the file is not UTF-8 and was read as Latin-1")
    rows = _without_comments(data[layout.start :], layout, notes)
    try:
        table, decimal, thousands = _parse_numbers(rows, layout, encoding, notes)
        parts = {key: part for name in layout.names for key, part in _parts(path, table[name]).items()}
        columns = {key: _numbers(part, decimal, thousands) for key, part in parts.items()}
    except (pandas.errors.ParserError, pandas.errors.ParserWarning) as error:
        reason = str(error).removeprefix("Error tokenizing data. C error: ").strip()
        raise UserError(f"{path}: rows of different length ({reason}) below the header") from error
    except pandas.errors.EmptyDataError as error:
        raise UserError(f"{path}: a header and no rows") from error
    last = len(table) - _at_the_end(columns, notes)
    unreadable, labels = {}, {}
    for name, column in columns.items():
        words = column.words[column.words.index < last]
        if words.empty:
            continue
        row, cell = int(words.index[0]), shown(words.iloc[0], 40)
        unreadable[name] = f"line {_line(data, layout, row)}, column {shown(name)}: {cell!r} is not a number"
        if not column.mixed and words.nunique() <= MOST_LABELS:
            labels[name] = words.reindex(range(last), fill_value="").to_numpy(object)
    return Record(
        str(path),
        {name: c.values[:last] for name, c in columns.items() if name not in unreadable or not c.mixed},
        units=layout.units | {name: column.unit for name, column in columns.items() if column.unit},
        unreadable=unreadable,
        labels=labels,
        notes=tuple(notes),
    )


def _described(path: Path, data: bytes, encoding: str, column_map: ColumnMap | None) -> _Layout:
    """Return the lines above the rows: those listed in the mapping if they name its columns."""
    if column_map is None or not column_map.header:
        return _layout(path, data, encoding)
    try:
        layout = _layout(path, data, encoding, column_map.header)
        if is_named(layout.names, column_map):
            return layout
        names = shown(", ".join(layout.names), 120)
        problem = UserError(
            f"{path}: header = {list(column_map.header)} names no column of the mapping, but {names}"
        )
    except UserError as error:
        problem = error
    try:
        return _layout(path, data, encoding)
    except UserError:
        raise problem from None


def _layout(path: Path, data: bytes, encoding: str, named: Sequence[int] = ()) -> _Layout:
    """Return the lines above the rows: `sep=`, comments and titles, the header, and a line of units.

    named: the lines, counted from 1, whose cells form the names; if empty, the header is detected.
    """
    separator, comment, found = "", None, None
    above, units = list[str](), list[str]()
    for count, (raw, end) in enumerate(_lines(data), 1):
        line = raw.decode(encoding, "replace")
        said = re.fullmatch(r'"?sep=(.)"?', line, re.IGNORECASE)
        marked = line.lstrip().startswith(_COMMENT)
        mark = separator or _separator(line)
        if said:
            separator = said[1]
        elif named and count <= named[-1]:
            above += [line] if count in named else []
            if count == named[-1]:
                found = _Layout(_joined([_cells(path, text, mark) for text in above]), mark, end, count, raw)
        elif not line.strip():
            pass
        elif found is None and marked:
            comment = (line.lstrip(" #%/"), end, count, raw)
        elif found is None:
            cells = _cells(path, line, mark)
            numbers = sum(map(_is_number, cells))
            if not numbers or (mark == " " and 2 * numbers < len(cells)):
                found = _Layout(cells, mark, end, count, raw)
            elif comment is not None:  # the form of numpy.savetxt
                mark = separator or _separator(comment[0])
                found = _Layout(_cells(path, comment[0], mark), mark, *comment[1:])
                break
            else:
                problem = "the first line contains numbers; expected column names"
                raise UserError(f"{path}: {problem}{_where_names_are(data, encoding)}")
        else:
            many = len(found.names)
            cells = _cells(path, line.lstrip(" #%/") if marked else line, found.separator)
            other = _cells(path, line, mark)
            titled = len(other) > max(many, 2) or (found.separator == " " != mark and len(other) > 1)
            if titled and not any(map(_is_number, other)) and not named:
                found = _Layout(other, mark, end, count, raw)  # the lines above are a title
                continue
            if _are_units(cells) and (not marked or len(cells) == many):
                units, found = cells, dataclasses.replace(found, start=end, lines=count)
            break
    if found is None:
        raise UserError(f"{path}: empty; expected a line of column names and rows of numbers")
    names = _names(path, found.names, data, encoding)
    return dataclasses.replace(found, names=names, units=dict(zip(names, units)))


def _joined(lines: Sequence[Sequence[str]]) -> list[str]:
    """Return names joined from several lines; an empty cell of an upper line repeats that to its left."""
    names = [""] * len(lines[-1])
    for upper in lines:
        left = ""
        for k, cell in enumerate(upper[: len(names)]):
            left = cell if cell or upper is lines[-1] else left
            names[k] = ".".join(filter(None, (names[k], left)))
    return names


def _where_names_are(data: bytes, encoding: str) -> str:
    """Return the end of a sentence on the lines above the rows that name the columns; empty if none do."""
    head = [raw.decode(encoding, "replace") for raw, _ in itertools.islice(_lines(data), 100)]
    table = [next(csv.reader([line], delimiter=_separator(line)), []) for line in head]
    numbers = [2 * sum(map(_is_number, cells)) > sum(map(bool, cells)) > 2 for cells in table]
    for row in range(1, len(table) - 1):
        width = len(table[row])
        if not (numbers[row] and numbers[row + 1] and len(table[row + 1]) == width):
            continue
        lines: list[int] = []
        for k in reversed(range(row)):
            if len(table[k]) != width or any(map(_is_number, table[k])):
                break
            lines.insert(0, k)
            names = _joined([table[k] for k in lines])
            if len({*names}) == width and all(names):
                said = ", ".join(str(k + 1) for k in lines)
                line = f"line{'s' * (len(lines) > 1)} {said}"
                return f"; if the names are in {line}, say so in a mapping file: header = [{said}]"
        break
    return ""


def _separator(line: str) -> str:
    """Return the separator of a line's cells: a blank if there is no other, a comma for a single cell."""
    mark = max(",;\t", key=line.count)
    if mark not in line and "|" in line:
        return "|"
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


def _names(path: Path, cells: list[str], data: bytes, encoding: str) -> list[str]:
    """Return the names of the columns; unnamed ones are numbered."""
    if not any(cells):
        raise UserError(f"{path}: empty; expected a line of column names and rows of numbers")
    if len(cells) > MOST_COLUMNS:
        raise UserError(f"{path}: {len(cells)} columns; at most {MOST_COLUMNS} are read")
    names = [name or f"column {k + 1}" for k, name in enumerate(cells)]
    seen: set[str] = set()
    for name in names:
        if name in seen:
            where = _where_names_are(data, encoding)
            raise UserError(f"{path}: column {shown(name)} appears twice{where}")
        seen.add(name)
    return names


def _without_comments(rows: bytes, layout: _Layout, notes: list[str]) -> bytes:
    """Return the rows with comments and repeated headers replaced by empty lines."""
    if not re.search(rb"\n[ \t]*#", rows) and not rows.startswith(b"#") and layout.header not in rows:
        return rows
    found = b"|".join([rb"[ \t]*#.*", re.escape(layout.header)])
    if 2 * rows.count(b"\n#") > rows.count(b"\n"):  # the first column's way to write
        return rows
    rows, count = re.subn(rb"(?m)^(?:%s)$" % found, b"", rows)
    if count:
        notes.append(f"{count} lines among the rows are comments or repeated headers and were left out")
    return rows


def _parse_numbers(
    rows: bytes, layout: _Layout, encoding: str, notes: list[str]
) -> tuple[pandas.DataFrame, str, str]:
    """Return a table, and its decimal and thousands separators, as used in most numbers."""
    table = _parse(rows, layout, encoding)
    text = table.select_dtypes(exclude="number")
    cells = [
        str(c) for _, column in text.items() for c in column.dropna().unique() if _COMMAS.fullmatch(str(c))
    ]
    if not cells:
        return table, ".", ""
    if all(map(_GROUPED.fullmatch, cells)):
        decimal, thousands, note = ".", ",", "commas separate thousands"
    else:
        decimal, thousands, note = (
            ",",
            "." * any("." in cell for cell in cells),
            "the decimal sign is a comma",
        )
    other = _parse(rows, layout, encoding, decimal=decimal, thousands=thousands or None)
    if other.select_dtypes("number").shape[1] <= table.select_dtypes("number").shape[1]:
        return table, ".", ""
    notes.append(note)
    return other, decimal, thousands


def _parse(rows: bytes, layout: _Layout, encoding: str, **options) -> pandas.DataFrame:
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
            **options,
        )


def _line(data: bytes, layout: _Layout, row: int) -> int:
    """Return the line in the file of a row of the data, counted from 0."""
    filled = (k for k, (line, end) in enumerate(_lines(data), 1) if end > layout.start and line.strip())
    return next(itertools.islice(filled, row, None), layout.lines + row + 1)


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


def _numbers(column: pandas.Series, decimal: str, thousands: str) -> _Column:
    """Return a column's numbers; dates as seconds since 1970, times of day as seconds since midnight."""
    if pandas.api.types.is_numeric_dtype(column):
        return _Column(column.to_numpy(float))
    text = column.astype("string").str.strip()
    first = str(text.dropna().head(1).squeeze())
    if re.fullmatch(_TIME_OF_DAY, first):
        spans = pandas.to_timedelta(text, errors="coerce")
        return _Column(spans.dt.total_seconds().to_numpy(float), unit="s")
    if re.fullmatch(_DATE, first):
        dates = pandas.to_datetime(text, errors="coerce", format="ISO8601", utc=True)
        seconds = (dates - pandas.Timestamp(0, tz="UTC")).dt.total_seconds()
        return _Column(seconds.to_numpy(float), unit="s")
    lower = text.str.lower()
    text = text.mask(lower.isin(_MISSING).fillna(False))
    if lower[text.notna()].isin(["true", "false"]).all():
        return _Column(lower.map({"true": 1.0, "false": 0.0}).to_numpy(float, na_value=np.nan))
    plain = text.str.replace(thousands, "", regex=False) if thousands else text
    values = pandas.to_numeric(plain.str.replace(decimal, ".", regex=False), errors="coerce")
    words = text[values.isna() & text.notna()]
    return _Column(values.to_numpy(float, na_value=np.nan), words=words)


def _at_the_end(columns: Mapping[str, _Column], notes: list[str]) -> int:
    """Return the number of rows at the end with words instead of numbers, with a note."""
    words = [column.words for column in columns.values() if column.mixed]
    rows = {row for cells in words for row in cells.index}
    end = max((len(column.values) for column in columns.values()), default=0)
    last = next(row for row in range(end, -1, -1) if row - 1 not in rows)
    if not 0 < end - last <= MOST_AT_THE_END:
        return 0
    cell = next(str(cells[last]) for cells in words if last in cells.index)
    notes.append(f"the last {end - last} rows hold words ({shown(cell, 40)}) and were cut")
    return end - last


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", ".", 1))
    except ValueError:
        return False
    return True
