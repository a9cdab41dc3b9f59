"""Conversion of the columns of a file to channels with canonical names and units, each on its clock."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from inclined_landing.eval.logs import clock, limits, units, vehicles
from inclined_landing.eval.logs.mapping import AttitudePid, ColumnMap, Mixer, Source, find, patterns
from inclined_landing.eval.logs.record import Record
from inclined_landing.models.base.errors import UserError, shown

FULL_COMMAND = 65535.0  # PWM
# A share of rows beyond the full command that is saturation, and how far they may be; more is another unit.
MOST_OVER, MOST_COMMAND = 0.1, 2.0
# s, over which derived angles and the gyro are compared, and the least correlation of what may be used.
GYRO_SPAN, LEAST_AGREEMENT = 0.1, 0.7
# Requests of M1 to M4:  thrust + signs (roll, pitch, yaw), in the frame of the firmware.
MIXER_SIGNS = ((-0.5, 0.5, 1.0), (-0.5, -0.5, -1.0), (0.5, -0.5, 1.0), (0.5, 0.5, -1.0))
# What a flight cannot be used without, and what is left out where it cannot be read.
_NEEDED = ("t", "x", "y", "z", "cmd_thrust_pwm")
_OPTIONAL = (
    *("cmd_yaw", "cmd_yaw_rate", "vbat", "contact"),
    *units.REQUESTS,
    *units.ROTOR_SPEEDS,
)


@dataclasses.dataclass(frozen=True)
class Channel:
    """One canonical column: time (k,) in s and value (k,) in the canonical unit, NaN where absent."""

    t: np.ndarray
    value: np.ndarray
    column: str  # its name in the file, for messages
    measured: bool = False  # of a thrust command: whether it is that of measured rotor speeds
    wraps: bool = False  # whether it is an angle that may jump by a turn
    unit: str | None = None  # the unit in the file, if stated


def channels_of(
    column_map: ColumnMap, record: Record, stated: Mapping[str, str]
) -> tuple[dict[str, Channel], list[str]]:
    """Return the channels of one record in canonical names and units, and notes in words.

    stated: unit per canonical column, as given by the user; it overrides the file's units row and the
        mapping's unit.
    Raises UserError if the record cannot be used or a unit is wrong.
    """
    if column_map.refuse:
        raise UserError(f"{record.path}: {column_map.refuse}")
    notes: list[str] = []
    is_table = bool(record.columns) and not record.times
    if is_table:
        record = _on_its_clock(column_map, record, stated, notes)
    notes = [*record.notes, *column_map.notes, *notes]
    channels = {}
    for canonical in column_map.columns:
        if canonical != "t":
            channel = _channel(canonical, column_map, record, stated, notes)
            if channel is not None:
                channels[canonical] = channel
    if column_map.attitude_pid is not None:
        channels |= _attitude(column_map.attitude_pid, record, notes)
    if column_map.mixer is not None:
        channels |= _requests(column_map.mixer, record)
    return channels, notes


def _on_its_clock(
    column_map: ColumnMap, record: Record, stated: Mapping[str, str], notes: list[str]
) -> Record:
    """Return a table sorted by time, in which all columns have the times of its time column."""
    where = record.path
    wanted = {source.columns[0]: source.unit for source in column_map.sources("t")}
    record = clock.with_clock(_as_named(column_map, record), wanted, stated.get("t"))
    time = _channel("t", column_map, record, stated, notes)
    if time is None:
        called = ", ".join(wanted) or "t"
        raise UserError(f'{where}: no time column ({called}); a mapping file can name it with t = "NAME"')
    names = list(record.columns)
    asked = {name for column in patterns(column_map) if (name := find(names, column, where)) is not None}
    dated = int(np.flatnonzero(~np.isnan(time.value))[-1]) + 1
    if dated > 1 and 0 < len(time.value) - dated <= limits.MOST_AT_THE_END:
        note = f"the last {len(time.value) - dated} rows have no time and were cut"
        record = dataclasses.replace(record.rows(np.arange(dated)), notes=(*record.notes, note))
        time = dataclasses.replace(time, value=time.value[:dated])
    axes = [c for key in ("x", "y", "z") for s in column_map.sources(key) for c in s.columns]
    vehicles.check_one(record, time.value, [n for c in axes if (n := find(names, c, where)) is not None])
    t, rows = time.value, clock.order(time.value, [record.columns[name] for name in asked - {time.column}])
    if rows is not None:
        late = int((t < np.maximum.accumulate(t)).sum())
        note = f"{late} rows are out of order; sorted by time"
        columns = {name: values[rows] for name, values in record.columns.items()}
        record, t = dataclasses.replace(record, columns=columns, notes=(*record.notes, note)), t[rows]
    clock.check(where, t, f"column {time.column}")
    if t[0] == t[-1]:
        count = f"{len(t)} row{'s' if len(t) > 1 else ''}"
        raise UserError(f"{where}: {count}, all at {t[0]:g} s ({time.column}): not a flight")
    return dataclasses.replace(record, times=dict.fromkeys(names, t), is_table=True)


def _as_named(column_map: ColumnMap, record: Record) -> Record:
    """Return a table with columns renamed that differ in case or contain a unit, with a note."""
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
        notes = [f"columns matched despite different case or unit in the name: {', '.join(notes)}"]
    return dataclasses.replace(record, columns=columns, units=stated, notes=(*record.notes, *notes))


def _channel(
    canonical: str, column_map: ColumnMap, record: Record, stated: Mapping[str, str], notes: list[str]
) -> Channel | None:
    """Return the channel of the first source in the record; None, with a note, if it cannot be read."""
    problems = []
    names = list(record.columns)
    for source in column_map.sources(canonical):
        for column in source.columns:
            if (name := find(list(record.unreadable), column, record.path)) is not None:
                problems.append((record.unreadable[name], name in record.columns))
        found = [name for column in source.columns if (name := find(names, column, record.path)) is not None]
        if len(found) < len(source.columns):
            continue
        value = _combined(canonical, source, found, record, notes)
        if np.isnan(value).all():
            continue  # a column of empty cells was not logged
        time = record.times.get(found[0], np.array(0.0))  # none yet of the clock itself
        if record.times and not record.is_table:
            if (rows := clock.order(time, [value])) is not None:
                time, value = time[rows], value[rows]
                notes.append(f"values of {found[0]} are out of order; sorted by time")
            clock.check(record.path, time, f"the time of {found[0]}", is_table=False)
        if source.late:
            notes.append(f"{canonical} is dated {1e3 * source.late:.0f} ms earlier than in the file")
        unit = stated.get(canonical) or record.units.get(found[0]) or source.unit
        if source.full is not None:
            scale = FULL_COMMAND / source.full ** (2 if source.mean_square else 1)
        else:
            scale = 1.0 if unit is None else units.factor(canonical, unit, record.path)
        value = source.sign * scale * value + source.add
        if source.full is not None:
            # Controllers ask for more than there is; the motors give no more than the full command.
            over = value > FULL_COMMAND
            if 0.0 < over.mean() <= MOST_OVER and value[over].max() <= MOST_COMMAND * FULL_COMMAND:
                value = np.where(over, FULL_COMMAND, value)
                notes.append(
                    f"{canonical} is beyond the full command in {over.sum()} rows, which counts as full"
                )
        if canonical != "t" and not (np.abs(value) < limits.LARGEST_VALUE).any():
            problems.append((f"column {'+'.join(found)} ({canonical}) contains no usable number", False))
            continue
        measured = source.measured or source.mean_square is not None
        return Channel(time - source.late, value, "+".join(found), measured, unit=unit)
    if problems:
        problem, is_text = problems[0]
        if canonical in _NEEDED or not (is_text or canonical in _OPTIONAL):
            raise UserError(f"{record.path}: {problem}")
        notes.append(f"{canonical} is left out: {problem}")
    return None


def _combined(
    canonical: str, source: Source, found: list[str], record: Record, notes: list[str]
) -> np.ndarray:
    """Return the column of a source (m,), or the mean or mean square of several, with a note."""
    if source.column is not None:
        return record.columns[found[0]]
    value = np.sum([record.columns[name] ** (2 if source.mean_square else 1) for name in found], axis=0)
    kind = "mean" if source.mean else "mean square"
    notes.append(f"{canonical} is derived: the {kind} of {', '.join(found)}")
    return value / len(found)


def _attitude(pid: AttitudePid, record: Record, notes: list[str]) -> dict[str, Channel]:
    """Return roll and pitch computed from the set-point and output of an attitude controller.

    An angle that contradicts the gyro is omitted. Raises UserError if the record lacks the inputs, or if both
    angles are omitted.
    """
    result = {}
    for k, (angle, sources) in enumerate((("roll", pid.roll), ("pitch", pid.pitch))):
        time, wanted = _values(record, sources[0], angle)
        _, commanded = _values(record, sources[1], "cmd_yaw_rate")
        # r = kp e + ki I,  dI/dt = e:  the error is e = (r - ki I)/kp, the angle set-point - e
        error, integral = np.zeros(len(time)), 0.0
        step = np.diff(time, append=time[-1])
        with np.errstate(all="ignore"):  # of gains and units that are wrong, whose angles are refused
            for i in range(len(time)):
                error[i] = (commanded[i] - pid.ki * integral) / pid.kp
                integral += error[i] * step[i]
        derived = wanted - error
        notes.append(f"{angle} is derived: from set-point and output of the attitude controller")
        if pid.gyro is not None:
            rate = _values(record, pid.gyro[k], "cmd_yaw_rate")[1]
            correlation, off = _gyro_agreement(time, derived, rate)
            notes[-1] += (
                f"; its change within {GYRO_SPAN:g} s agrees with the gyro to {np.degrees(off):.2f} deg "
                f"(correlation {correlation:.2f})"
            )
            if correlation < LEAST_AGREEMENT:
                notes[-1] += ": left out"
                continue
        result[angle] = Channel(time, derived, f"{sources[0].columns[0]} by [attitude_pid]")
    if not result:
        raise UserError(f"{record.path}: roll and pitch cannot be derived: {notes[-2]}, {notes[-1]}")
    return result


def _values(record: Record, source: Source, canonical: str) -> tuple[np.ndarray, np.ndarray]:
    """Return times and SI values of a source that the mapping needs. Raises UserError if it is missing."""
    name = find(list(record.columns), source.columns[0], record.path)
    if name is None:
        raise UserError(f"{record.path}: no column {source.columns[0]}")
    unit = source.unit or next(iter(units.UNITS[units.COLUMNS[canonical]]))
    return record.times[name], source.sign * units.factor(canonical, unit, record.path) * record.columns[name]


def _gyro_agreement(time: np.ndarray, angle: np.ndarray, rate: np.ndarray) -> tuple[float, float]:
    """Return correlation and rms difference [rad] of the rotations from angles and from rates (m,)."""
    rows = max(1, round(GYRO_SPAN / float(np.median(np.diff(time)))))
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(time))])
    by_angle, by_gyro = (x[rows:] - x[:-rows] for x in (angle, turned))
    off = float(np.sqrt(np.mean((by_angle - by_gyro) ** 2)))
    if min(np.ptp(by_angle), np.ptp(by_gyro)) == 0.0:
        return 0.0, off
    return float(np.corrcoef(by_angle, by_gyro)[0, 1]), off


def _requests(mixer: Mixer, record: Record) -> dict[str, Channel]:
    """Return the commands of the motors from the outputs of the rate controllers; none if one is missing."""
    outputs = (mixer.thrust, mixer.roll, mixer.pitch, mixer.yaw)
    found = [name for output in outputs if (name := find(list(record.columns), output, record.path))]
    if len(found) < len(outputs):
        return {}
    thrust, *torques = (record.columns[name] for name in found)
    time = record.times[found[0]]
    return {
        key: Channel(time, thrust + sum(s * x for s, x in zip(signs, torques)), "+".join(found))
        for key, signs in zip(units.REQUESTS, MIXER_SIGNS)
    }
