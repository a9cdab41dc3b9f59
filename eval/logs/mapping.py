"""Mapping files: which column of a file is which quantity, in which unit, sign and convention."""

from __future__ import annotations

import dataclasses
import fnmatch
import os
import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np

from inclined_landing.eval.logs import limits, units
from inclined_landing.eval.logs.record import Record
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown

_SOURCE_KEYS = {"column", "unit", "sign", "add", "late", "mean", "sum"}
DEEPEST = 20  # mapping files that inherit one another
_FILE_KEYS = {"description", "detect", "inherit", "euler", "notes", "refuse", "columns"}


@dataclasses.dataclass(frozen=True)
class Source:
    """Where one canonical column comes from: value = sign * factor(unit) * column + add, at t - late."""

    columns: tuple[str, ...]
    derived: str | None = None  # "mean" or "sum" of several columns, else None
    unit: str | None = None
    sign: float = 1.0
    add: float = 0.0
    late: float = 0.0  # s by which the file dates the value too late


@dataclasses.dataclass(frozen=True)
class ColumnMap:
    """A mapping file, read."""

    description: str
    columns: Mapping[str, tuple[Source, ...]]  # canonical name -> sources, the first present is taken
    detect: tuple[str, ...] = ()
    euler: str = "ZXY"
    notes: tuple[str, ...] = ()
    refuse: str | None = None


@dataclasses.dataclass(frozen=True)
class Channel:
    """One canonical column: time (k,) in s and value (k,) in the canonical unit, NaN where absent."""

    t: np.ndarray
    value: np.ndarray
    column: str  # its name in the file, for messages


@cache
def shipped() -> Mapping[str, ColumnMap]:
    """The mappings that come with this package, by name."""
    folder = resources.files("inclined_landing.eval.logs") / "mappings"
    files = sorted((f for f in folder.iterdir() if f.name.endswith(".toml")), key=lambda f: f.name)
    return {f.name[:-5]: _parse(f.name, tomllib.loads(f.read_text("utf-8")), ()) for f in files}


def load(name: str | Path) -> ColumnMap:
    """A shipped mapping by its name, or a mapping file (TOML) by its path.

    Raises UserError when there is no such mapping or it cannot be understood.
    """
    if str(name) in shipped():
        return shipped()[str(name)]
    return _load(Path(name), ())


def _load(path: Path, heirs: tuple[Path, ...]) -> ColumnMap:
    """The mapping file, or the shipped mapping of that name, which `heirs` inherit."""
    if str(path) in shipped():
        return shipped()[str(path)]
    if not os.path.lexists(path):
        whose = f"{heirs[-1]}: inherit: " if heirs else ""
        files = f"neither a file nor one of {', '.join(shipped())}"
        raise UserError(f"{whose}no mapping {shown(path, 240)}: {files}")
    real = Path(os.path.realpath(path))
    if real in heirs:
        raise UserError(f"{heirs[0]}: inherit leads back to {path}")
    if len(heirs) > DEEPEST:
        raise UserError(f"{heirs[0]}: inherit goes through more than {DEEPEST} files")
    return _parse(str(path), storage.read_toml(path, "mapping"), (*heirs, real))


def detect(names: Sequence[str], where: str) -> ColumnMap:
    """The shipped mapping that asks for most of the column names at hand.

    Raises UserError, listing the columns, when none fits.
    """
    fitting = [m for m in shipped().values() if m.detect and all(_any(names, d) for d in m.detect)]
    if not fitting:
        raise UserError(
            f"{where}: its columns ({shown(', '.join(names), 90)}) are those of no known kind of log; "
            "expected t, x, y, z, roll, pitch, yaw, cmd_thrust_pwm, cmd_roll, cmd_pitch, or a mapping file"
        )
    return max(fitting, key=lambda m: len(m.detect))


def _any(names: Sequence[str], pattern: str) -> bool:
    return any(fnmatch.fnmatchcase(name, pattern) for name in names)


def find(names: Sequence[str], pattern: str, where: str) -> str | None:
    """The one name that is `pattern` or, if it has a `*`, matches it; None without.

    Raises UserError when several match: two vehicles in one bag, say.
    """
    if "*" not in pattern:
        return pattern if pattern in names else None
    found = [name for name in names if fnmatch.fnmatchcase(name, pattern)]
    if len(found) > 1:
        fitting = shown(", ".join(found))
        raise UserError(f"{where}: {shown(pattern)} fits {fitting}; a mapping file must say which is meant")
    return found[0] if found else None


def patterns(column_map: ColumnMap | None) -> list[str]:
    """Every column name a mapping asks for; those of all shipped mappings for None."""
    asked = shipped().values() if column_map is None else [column_map]
    sources = [s for m in asked for entries in m.columns.values() for s in entries]
    return [column for source in sources for column in source.columns]


def apply(
    column_map: ColumnMap, record: Record, given: Mapping[str, str]
) -> tuple[dict[str, Channel], list[str]]:
    """Channels of one record in canonical names and units, and notes in words.

    given: unit per canonical column, as the user says; it goes before the file's units row and the
        mapping's unit.
    Raises UserError when the record cannot be used, or a unit is wrong.
    """
    if column_map.refuse:
        raise UserError(f"{record.path}: {column_map.refuse}")
    names = list(record.columns)
    where = record.path
    notes = [*record.notes, *column_map.notes]
    clock = None
    if not record.times:
        clock = _channel("t", column_map, record, names, given, np.array(0.0), notes)
        if clock is None:
            wanted = ", ".join(s.columns[0] for s in column_map.columns.get("t", ()))
            raise UserError(f"{where}: no time column ({wanted or 't'})")
        _check_clock(where, clock.value, f"column {clock.column}")
        if clock.value[0] == clock.value[-1]:
            rows = f"{len(clock.value)} row{'s' if len(clock.value) > 1 else ''}"
            raise UserError(f"{where}: {rows}, all at {clock.value[0]:g} s ({clock.column}): not a flight")
    channels = {}
    for canonical in column_map.columns:
        if canonical == "t":
            continue
        time = None if clock is None else clock.value
        channel = _channel(canonical, column_map, record, names, given, time, notes)
        if channel is not None:
            channels[canonical] = channel
    return channels, notes


def _channel(canonical, column_map, record, names, given, clock, notes) -> Channel | None:
    for source in column_map.columns.get(canonical, ()):
        found = [find(names, column, record.path) for column in source.columns]
        if None in found:
            continue
        unit = given.get(canonical) or record.units.get(found[0]) or source.unit
        scale = 1.0 if unit is None else units.factor(canonical, unit, record.path)
        value = record.columns[found[0]]
        if source.derived:
            value = np.sum([record.columns[name] for name in found], axis=0)
            value = value / len(found) if source.derived == "mean" else value
            notes.append(f"{canonical} is derived: the {source.derived} of {', '.join(found)}")
        if np.isnan(value).all():
            continue  # a column of empty cells was not logged
        time = record.times[found[0]] if record.times else clock
        if record.times:
            _check_clock(record.path, time, f"the time of {found[0]}")
        if source.late:
            notes.append(f"{canonical} is dated {1e3 * source.late:.0f} ms earlier than in the file")
        value = source.sign * scale * value + source.add
        if canonical != "t" and not (np.abs(value) < limits.LARGEST_VALUE).any():
            raise UserError(
                f"{record.path}: column {'+'.join(found)} ({canonical}) holds no number of a flight"
            )
        return Channel(time - source.late, value, "+".join(found))
    return None


def _check_clock(where: str, t: np.ndarray, column: str) -> None:
    bad = np.flatnonzero(~np.isfinite(t))
    if bad.size:
        raise UserError(f"{where}: {column} has no number in row {bad[0] + 1} of the data")
    back = np.flatnonzero(t[1:] < t[:-1])
    if back.size:
        k = back[0] + 1
        for lone in (k - 1, k):  # without this row, the clock goes on
            if 0 < lone < len(t) - 1 and t[lone - 1] <= t[lone + 1]:
                raise UserError(
                    f"{where}: {column} holds {t[lone]:g} s in row {lone + 1} of the data, between "
                    f"{t[lone - 1]:g} and {t[lone + 1]:g} s: correct or remove that row"
                )
        raise UserError(
            f"{where}: {column} goes back from {t[k - 1]:g} to {t[k]:g} s "
            f"in row {k + 1} of the data; are two flights in one file?"
        )
    if t[-1] - t[0] > limits.LONGEST:
        row = int(np.argmax(np.diff(t)))
        raise UserError(
            f"{where}: {column} runs over {t[-1] - t[0]:.3g} s, in one step from {t[row]:.6g} to "
            f"{t[row + 1]:.6g} s; a flight lasts at most {limits.LONGEST:g} s: state the unit of time, "
            "or cut the flight out"
        )


def _parse(where: str, data: dict, heirs: tuple[Path, ...]) -> ColumnMap:
    _only(where, data, _FILE_KEYS)
    for key in ("description", "inherit", "refuse"):
        if not isinstance(data.get(key, ""), str):
            raise UserError(f"{where}: {key} must be text, not {shown(data[key])}")
    given = data.get("columns", {})
    if not isinstance(given, dict):
        raise UserError(f"{where}: columns must be a table, not {shown(given)}")
    columns = {}
    if data.get("inherit"):
        columns |= _load(Path(data["inherit"]), heirs).columns
    for canonical, entry in given.items():
        if canonical not in units.COLUMNS:
            raise UserError(f"{where}: [columns] {shown(canonical)} is not one of {', '.join(units.COLUMNS)}")
        entries = entry if isinstance(entry, list) else [entry]
        if not entries:
            raise UserError(f"{where}: [columns] {canonical} names no column")
        columns[canonical] = tuple(_source(where, canonical, item) for item in entries)
    euler = data.get("euler", "ZXY")
    if euler not in ("ZXY", "ZYX"):
        raise UserError(f"{where}: euler = {shown(euler)!r}; expected ZXY or ZYX")
    if not columns and "refuse" not in data:
        raise UserError(f"{where}: no [columns]")
    return ColumnMap(
        description=data.get("description", ""),
        columns=columns,
        detect=_texts(where, "detect", data.get("detect", [])),
        euler=euler,
        notes=_texts(where, "notes", data.get("notes", [])),
        refuse=data.get("refuse"),
    )


def _source(where: str, canonical: str, entry) -> Source:
    entry = {"column": entry} if isinstance(entry, str) else entry
    where = f"{where}: [columns] {canonical}"
    if not isinstance(entry, dict):
        raise UserError(f"{where} must be a column name or a table with one, not {shown(entry)}")
    _only(where, entry, _SOURCE_KEYS)
    kinds = [key for key in ("column", "mean", "sum") if key in entry]
    if len(kinds) != 1:
        raise UserError(f"{where} needs exactly one of column, mean, sum")
    kind = kinds[0]
    columns = _texts(where, kind, [entry[kind]] if kind == "column" else entry[kind])
    if not all(columns) or not columns:
        raise UserError(f"{where}: {kind} must name columns")
    if "unit" in entry:
        (unit,) = _texts(where, "unit", [entry["unit"]])
        units.factor(canonical, unit, where)
    sign = entry.get("sign", 1)
    if type(sign) not in (int, float) or sign not in (1, -1):
        raise UserError(f"{where}: sign must be 1 or -1, not {shown(sign)}")
    return Source(
        columns,
        derived=None if kind == "column" else kind,
        unit=entry.get("unit"),
        sign=float(sign),
        add=_number(where, "add", entry, 0.0, limits.LARGEST_VALUE),
        late=_number(where, "late", entry, 0.0, limits.LATEST),
    )


def _texts(where: str, key: str, given) -> tuple[str, ...]:
    if not isinstance(given, list) or not all(isinstance(text, str) for text in given):
        raise UserError(f"{where}: {key} must be text (where several are meant, a list), not {shown(given)}")
    return tuple(given)


def _number(where: str, key: str, entry: Mapping, default: float, most: float) -> float:
    value = entry.get(key, default)
    if type(value) not in (int, float) or not abs(value) <= most:
        raise UserError(f"{where}: {key} must be a number from {-most:g} to {most:g}, not {shown(value)}")
    return float(value)


def _only(where: str, given: Mapping, known: set[str]) -> None:
    unknown = [key for key in given if key not in known]
    if unknown:
        raise UserError(f"{where}: {shown(unknown[0])} is not one of {', '.join(sorted(known))}")
