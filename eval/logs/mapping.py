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
from typing import Annotated, ClassVar, Literal

import numpy as np
from msgspec import Meta, field, structs

from inclined_landing.eval.logs import clock as clocks
from inclined_landing.eval.logs import limits, units
from inclined_landing.eval.logs.record import Record
from inclined_landing.models import schema, storage
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.schema import Table

FULL_COMMAND = 65535.0  # PWM
# A share of rows beyond the full command that is saturation, and how far they may be; more is another unit.
MOST_OVER, MOST_COMMAND = 0.1, 2.0
# s, over which derived angles and the gyro are compared, and the least correlation of what may be used.
GYRO_SPAN, LEAST_AGREEMENT = 0.1, 0.7
DEEPEST = 20  # mapping files that inherit one another
# Columns of a table in long form, and how many it has at most.
_KINDS = (
    *("variable", "name", "key", "signal", "channel", "field", "topic", "quantity", "parameter"),
    *("column", "series"),
)
_VALUES = ("value", "values", "val", "data")
_LONG_FORM = 6
# What a flight cannot be used without, and what is left out where it cannot be read.
_NEEDED = ("t", "x", "y", "z", "cmd_thrust_pwm")
_OPTIONAL = (
    *("vx", "vy", "vz", "cmd_yaw", "cmd_yaw_rate", "vbat", "contact"),
    *units.REQUESTS,
    *units.ROTOR_SPEEDS,
)


class Source(Table, frozen=True):
    """Where one canonical column comes from: value = sign * factor(unit) * column + add, at t - late.

    With `full`, a thrust command or request: value = 65535 column/full, and of rotor speeds
    65535 mean(column^2)/full^2.
    """

    column: str | None = None  # or, of several:
    mean: tuple[str, ...] | None = None
    sum: tuple[str, ...] | None = None
    mean_square: tuple[str, ...] | None = None  # of measured rotor speeds
    measured: bool = False  # of a thrust command: that of measured rotor speeds
    full: Annotated[float, Meta(gt=0.0, le=limits.LARGEST_VALUE)] | None = None  # in the file's own unit
    unit: str | None = None
    sign: float = 1.0
    add: Annotated[float, Meta(ge=-limits.LARGEST_VALUE, le=limits.LARGEST_VALUE)] = 0.0
    late: Annotated[float, Meta(ge=-limits.LATEST, le=limits.LATEST)] = 0.0  # s too late in the file

    @property
    def columns(self) -> tuple[str, ...]:
        """Return the names of the columns that the value is made of."""
        return self.mean or self.sum or self.mean_square or (self.column or "",)


class AttitudePid(Table, frozen=True):
    """Gains of an onboard attitude controller from whose set-points and output the attitude follows."""

    kp: Annotated[float, Meta(gt=0.0, le=1000.0)]  # 1/s
    ki: Annotated[float, Meta(ge=0.0, le=1000.0)]  # 1/s2
    roll: tuple[Source, Source]  # set-point [angle] and commanded rate [angular rate]
    pitch: tuple[Source, Source]
    gyro: tuple[Source, Source] | None = None  # rates of roll and pitch, against which the angles are checked


class Mixer(Table, frozen=True):
    """Outputs of the rate controllers, which the firmware adds up to the requests of the motors."""

    thrust: str
    roll: str
    pitch: str
    yaw: str

    # Requests of M1 to M4:  thrust + signs (roll, pitch, yaw), in the frame of the firmware.
    SIGNS: ClassVar = ((-0.5, 0.5, 1.0), (-0.5, -0.5, -1.0), (0.5, -0.5, 1.0), (0.5, 0.5, -1.0))

    def requests(self, record: Record, names: Sequence[str]) -> dict[str, Channel]:
        """Return the requests of a record; none where a column is missing."""
        found = [find(names, name, record.path) for name in (self.thrust, self.roll, self.pitch, self.yaw)]
        if None in found:
            return {}
        thrust, *torques = (record.columns[str(name)] for name in found)
        time = record.times[str(found[0])]
        return {
            key: Channel(time, thrust + sum(s * x for s, x in zip(signs, torques)), "+".join(map(str, found)))
            for key, signs in zip(units.REQUESTS, self.SIGNS)
        }


class ColumnMap(Table, frozen=True):
    """A mapping file, read."""

    description: str = ""
    detect: tuple[str, ...] = ()
    inherit: str = ""  # a mapping whose columns are taken too
    euler: Literal["ZXY", "ZYX"] = "ZXY"
    notes: tuple[str, ...] = ()
    attitude_pid: AttitudePid | None = None  # where roll and pitch were not logged
    mixer: Mixer | None = None  # where the requests of the motors were not logged
    refuse: str | None = None
    columns: dict[str, str | Source | tuple[str | Source, ...]] = field(
        default_factory=dict
    )  # by canonical name

    def sources(self, canonical: str) -> tuple[Source, ...]:
        """Return the sources of a canonical column, of which the first that is present is taken."""
        entry = self.columns.get(canonical, "t" if canonical == "t" else ())
        entries = entry if isinstance(entry, tuple) else (entry,)
        return tuple(Source(column=one) if isinstance(one, str) else one for one in entries)


@dataclasses.dataclass(frozen=True)
class Channel:
    """One canonical column: time (k,) in s and value (k,) in the canonical unit, NaN where absent."""

    t: np.ndarray
    value: np.ndarray
    column: str  # its name in the file, for messages
    measured: bool = False  # of a thrust command: whether it is that of measured rotor speeds


@cache
def shipped() -> Mapping[str, ColumnMap]:
    """Return the mappings that come with this package, by name."""
    folder = resources.files("inclined_landing.eval.logs") / "mappings"
    files = sorted((f for f in folder.iterdir() if f.name.endswith(".toml")), key=lambda f: f.name)
    return {f.name[:-5]: _parse(f.name, tomllib.loads(f.read_text("utf-8")), ()) for f in files}


def load(name: str | Path) -> ColumnMap:
    """Return a shipped mapping by its name, or a mapping file (TOML) by its path.

    Raises UserError when there is no such mapping or it cannot be understood.
    """
    if str(name) in shipped():
        return shipped()[str(name)]
    return _load(storage.as_path(name, "mapping"), ())


def _load(path: Path, heirs: tuple[Path, ...]) -> ColumnMap:
    """Return the mapping file, or the shipped mapping of that name, which `heirs` inherit."""
    if str(path) in shipped():
        return shipped()[str(path)]
    if not os.path.lexists(path):
        whose = f"{heirs[-1]}: inherit: " if heirs else ""
        files = f"neither a file nor one of {', '.join(shipped())}"
        raise UserError(f"{whose}no mapping {shown(path, 120)}: {files}")
    real = Path(os.path.realpath(path))
    if real in heirs:
        raise UserError(f"{heirs[0]}: inherit leads back to {path}")
    if len(heirs) > DEEPEST:
        raise UserError(f"{heirs[0]}: inherit goes through more than {DEEPEST} files")
    return _parse(str(path), storage.read_toml(path, "mapping"), (*heirs, real))


def detect(names: Sequence[str], where: str) -> ColumnMap:
    """Return the shipped mapping that asks for most of the column names at hand.

    Raises UserError, listing the columns, when none fits.
    """
    for spelled in (list(names), _plain_names(names)):
        fitting = [m for m in shipped().values() if m.detect and all(_any(spelled, d) for d in m.detect)]
        if fitting:
            return max(fitting, key=lambda m: len(m.detect))
    _check_form(names, where)
    found = f"{where}: its columns ({shown(', '.join(names), 90)})"
    if all(_any([*_plain_names(names), "t"], name) for name in ("x", "y", "z")):
        raise UserError(
            f'{found} have no time: a mapping file with inherit = "documented" and, under [columns], '
            't = "NAME" says which it is'
        )
    raise UserError(
        f"{found} are those of no known kind of log; expected t, x, y, z, roll, pitch, yaw, cmd_thrust_pwm, "
        "cmd_roll, cmd_pitch, or a mapping file"
    )


def _plain_names(names: Sequence[str]) -> list[str]:
    """Return names as they are, and without case and units; t for what time is called."""
    plain = [*names, *(units.split(name)[0] for name in names), *(name.lower() for name in names)]
    return [*plain, "t"] if clocks.named(names) else plain


def _check_form(names: Sequence[str], where: str) -> None:
    """Raise UserError, with what to do, for a table of one value per row."""
    kinds = [name for name in names if units.split(name)[0] in _KINDS]
    values = [name for name in names if units.split(name)[0] in _VALUES]
    time = clocks.named(names)
    if kinds and values and time and len(names) <= _LONG_FORM:
        pivot = f"pivot_table(index={time!r}, columns={kinds[0]!r}, values={values[0]!r})"
        raise UserError(
            f"{where}: one value per row; pandas.read_csv(FILE).{pivot}.to_csv('wide.csv') makes a column of "
            "each variable"
        )


def _any(names: Sequence[str], pattern: str) -> bool:
    return any(fnmatch.fnmatchcase(name, pattern) for name in names)


def find(names: Sequence[str], pattern: str, where: str) -> str | None:
    """Return the one name that is `pattern` or, if it has a `*`, matches it; None without.

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
    """Return every column name that a mapping asks for; those of all shipped mappings for None."""
    asked = shipped().values() if column_map is None else [column_map]
    sources = [source for m in asked for canonical in m.columns for source in m.sources(canonical)]
    return [column for source in sources for column in source.columns]


def apply(
    column_map: ColumnMap, record: Record, given: Mapping[str, str]
) -> tuple[dict[str, Channel], list[str]]:
    """Return the channels of one record in canonical names and units, and notes in words.

    given: unit per canonical column, as the user says; it goes before the file's units row and the
        mapping's unit.
    Raises UserError when the record cannot be used, or a unit is wrong.
    """
    if column_map.refuse:
        raise UserError(f"{record.path}: {column_map.refuse}")
    where = record.path
    clock = None
    is_table = bool(record.columns) and not record.times
    if is_table:
        wanted = {source.columns[0]: source.unit for source in column_map.sources("t")}
        record = clocks.with_clock(_as_named(column_map, record), wanted, given.get("t"))
    names = list(record.columns)
    notes: list[str] = []
    if is_table:
        clock = _channel("t", column_map, record, names, given, np.array(0.0), notes)
        if clock is None:
            called = ", ".join(wanted) or "t"
            raise UserError(
                f'{where}: no time column ({called}); in a mapping file, t = "NAME" says which it is'
            )
        asked = {name for column in patterns(column_map) if (name := find(names, column, where)) is not None}
        record, t = clocks.sorted_rows(record, clock.value, asked - {clock.column})
        clock = dataclasses.replace(clock, value=t)
        clocks.check(where, t, f"column {clock.column}")
        if clock.value[0] == clock.value[-1]:
            rows = f"{len(clock.value)} row{'s' if len(clock.value) > 1 else ''}"
            raise UserError(f"{where}: {rows}, all at {clock.value[0]:g} s ({clock.column}): not a flight")
    notes = [*record.notes, *column_map.notes, *notes]
    channels = {}
    for canonical in column_map.columns:
        if canonical == "t":
            continue
        time = np.array(0.0) if clock is None else clock.value
        channel = _channel(canonical, column_map, record, names, given, time, notes)
        if channel is not None:
            channels[canonical] = channel
    if clock is not None:
        record = dataclasses.replace(record, times=dict.fromkeys(names, clock.value))
    if column_map.attitude_pid is not None:
        channels |= _attitude(column_map.attitude_pid, record, names, notes)
    if column_map.mixer is not None:
        channels |= column_map.mixer.requests(record, names)
    return channels, notes


def _as_named(column_map: ColumnMap, record: Record) -> Record:
    """Return a table with columns that are wanted under names that differ by case or have a unit; noted."""
    columns, stated, notes = dict(record.columns), dict(record.units), []
    for canonical in column_map.columns:
        sources = column_map.sources(canonical)
        wanted = [column for source in sources for column in source.columns if "*" not in column]
        if any(column in columns or column in record.unreadable for column in wanted):
            continue
        for column in wanted:
            plain = column.lstrip("# %").lower()
            like = [name for name in record.columns if plain in (name.lower(), units.split(name)[0])]
            if len(like) == 1:
                columns[column] = columns[like[0]]
                unit = record.units.get(like[0])
                if unit is None and like[0].lower() != plain:
                    unit = units.split(like[0])[1]
                if unit is not None:
                    stated[column] = unit
                notes.append(f"{column} = {shown(like[0])}")
    if notes:
        notes = [f"columns taken by names that differ by case or a unit: {', '.join(notes)}"]
    return dataclasses.replace(record, columns=columns, units=stated, notes=(*record.notes, *notes))


def _attitude(pid: AttitudePid, record: Record, names: list[str], notes: list[str]) -> dict[str, Channel]:
    """Return roll and pitch from what an attitude controller was given and what it commanded.

    An angle that the gyro contradicts is left out. Raises UserError where what it takes is not in the record,
    or both angles are left out.
    """
    result = {}
    for k, (angle, sources) in enumerate((("roll", pid.roll), ("pitch", pid.pitch))):
        time, wanted = _values(record, names, sources[0], angle)
        _, commanded = _values(record, names, sources[1], "cmd_yaw_rate")
        # r = kp e + ki I,  dI/dt = e:  the error is e = (r - ki I)/kp, the angle set-point - e
        error, integral = np.zeros(len(time)), 0.0
        step = np.diff(time, append=time[-1])
        for i in range(len(time)):
            error[i] = (commanded[i] - pid.ki * integral) / pid.kp
            integral += error[i] * step[i]
        derived = wanted - error
        notes.append(f"{angle} is derived: from set-point and output of the attitude controller")
        if pid.gyro is not None:
            correlation, off = _gyro_agreement(
                time, derived, _values(record, names, pid.gyro[k], "cmd_yaw_rate")[1]
            )
            notes[-1] += (
                f"; its turning within {GYRO_SPAN:g} s agrees with the gyro to {np.degrees(off):.2f} deg "
                f"(correlation {correlation:.2f})"
            )
            if correlation < LEAST_AGREEMENT:
                notes[-1] += ": left out"
                continue
        result[angle] = Channel(time, derived, sources[0].columns[0])
    if not result:
        raise UserError(f"{record.path}: roll and pitch cannot be derived: {notes[-2]}, {notes[-1]}")
    return result


def _values(
    record: Record, names: list[str], source: Source, canonical: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return times and SI values of a source that the mapping needs. Raises UserError where it is missing."""
    name = find(names, source.columns[0], record.path)
    if name is None:
        raise UserError(f"{record.path}: no column {source.columns[0]}")
    unit = source.unit or next(iter(units.UNITS[units.COLUMNS[canonical]]))
    return record.times[name], source.sign * units.factor(canonical, unit, record.path) * record.columns[name]


def _gyro_agreement(time: np.ndarray, angle: np.ndarray, rate: np.ndarray) -> tuple[float, float]:
    """Return correlation and root mean square difference [rad] of the turning by angles and rates (m,)."""
    rows = max(1, round(GYRO_SPAN / float(np.median(np.diff(time)))))
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(time))])
    by_angle, by_gyro = (x[rows:] - x[:-rows] for x in (angle, turned))
    if min(np.ptp(by_angle), np.ptp(by_gyro)) == 0.0:
        return 0.0, float(np.sqrt(np.mean((by_angle - by_gyro) ** 2)))
    return float(np.corrcoef(by_angle, by_gyro)[0, 1]), float(np.sqrt(np.mean((by_angle - by_gyro) ** 2)))


def _channel(
    canonical: str,
    column_map: ColumnMap,
    record: Record,
    names: list[str],
    given: Mapping[str, str],
    clock: np.ndarray,
    notes: list[str],
) -> Channel | None:
    problems = []
    for source in column_map.sources(canonical):
        for column in source.columns:
            if (name := find(list(record.unreadable), column, record.path)) is not None:
                problems.append((record.unreadable[name], name in record.columns))
        found = [name for column in source.columns if (name := find(names, column, record.path)) is not None]
        if len(found) < len(source.columns):
            continue
        if source.full is not None:
            scale = FULL_COMMAND / source.full ** (2 if source.mean_square else 1)
        else:
            unit = given.get(canonical) or record.units.get(found[0]) or source.unit
            scale = 1.0 if unit is None else units.factor(canonical, unit, record.path)
        value = record.columns[found[0]]
        if source.column is None:
            power = 2 if source.mean_square else 1
            value = np.sum([record.columns[name] ** power for name in found], axis=0)
            value = value if source.sum else value / len(found)
            kind = "sum" if source.sum else "mean" if source.mean else "mean square"
            notes.append(f"{canonical} is derived: the {kind} of {', '.join(found)}")
        if np.isnan(value).all():
            continue  # a column of empty cells was not logged
        time = record.times[found[0]] if record.times else clock
        if record.times:
            if (rows := clocks.order(time, [value])) is not None:
                time, value = time[rows], value[rows]
                notes.append(f"values of {found[0]} came out of order: sorted by their time")
            clocks.check(record.path, time, f"the time of {found[0]}")
        if source.late:
            notes.append(f"{canonical} is dated {1e3 * source.late:.0f} ms earlier than in the file")
        value = source.sign * scale * value + source.add
        if source.full is not None:
            # Controllers ask for more than there is; the motors give no more than the full command.
            over = value > FULL_COMMAND
            if 0.0 < over.mean() <= MOST_OVER and value[over].max() <= MOST_COMMAND * FULL_COMMAND:
                value = np.where(over, FULL_COMMAND, value)
                notes.append(f"{canonical} is beyond the full command in {over.sum()} rows: taken as full")
        if canonical != "t" and not (np.abs(value) < limits.LARGEST_VALUE).any():
            problems.append((f"column {'+'.join(found)} ({canonical}) holds no number of a flight", False))
            continue
        measured = source.measured or source.mean_square is not None
        return Channel(time - source.late, value, "+".join(found), measured)
    if problems:
        problem, is_text = problems[0]
        if canonical in _NEEDED or not (is_text or canonical in _OPTIONAL):
            raise UserError(f"{record.path}: {problem}")
        notes.append(f"{canonical} is left out: {problem}")
    return None


def _parse(where: str, data: dict, heirs: tuple[Path, ...]) -> ColumnMap:
    given = schema.parse(data, ColumnMap, f"{where}: ")
    columns = (_load(Path(given.inherit), heirs).columns if given.inherit else {}) | given.columns
    for canonical in given.columns:
        if canonical not in units.COLUMNS:
            raise UserError(f"{where}: [columns] {shown(canonical)} is not one of {', '.join(units.COLUMNS)}")
        if not given.sources(canonical):
            raise UserError(f"{where}: [columns] {canonical} names no column")
        for source in given.sources(canonical):
            _check_source(source, canonical, f"{where}: [columns] {canonical}")
    if not columns and given.refuse is None:
        raise UserError(f"{where}: no [columns]")
    return structs.replace(given, columns=columns)


def _check_source(source: Source, canonical: str, where: str) -> None:
    if [source.column, source.mean, source.sum, source.mean_square].count(None) != 3:
        raise UserError(f"{where} needs exactly one of column, mean, sum, mean_square")
    if not all(source.columns):
        raise UserError(f"{where}: column, mean, sum and mean_square must name columns")
    if source.full is not None and (units.COLUMNS[canonical] != "pwm" or source.unit is not None):
        raise UserError(f"{where}: full is for a thrust command or a request, in place of a unit")
    if source.mean_square is not None and source.full is None:
        raise UserError(f"{where}: mean_square needs full, the rotor speed at the full command")
    if source.unit is not None:
        units.factor(canonical, source.unit, where)
    if source.sign not in (1, -1):
        raise UserError(f"{where}: sign must be 1 or -1, not {source.sign:g}")
