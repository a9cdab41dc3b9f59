"""Mapping files: the assignment of a file's columns to quantities, with units, signs and conventions."""

from __future__ import annotations

import fnmatch
import os
import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta, field, structs

from inclined_landing.eval.logs import clock as clocks
from inclined_landing.eval.logs import limits, units
from inclined_landing.models.base import schema, storage
from inclined_landing.models.base.errors import UserError, choices, shown
from inclined_landing.models.base.schema import Table


class Source(Table, frozen=True):
    """Source of one canonical column: value = sign * factor(unit) * column + add, at t - late.

    With `full`, a thrust command or request: value = 65535 column/full, and of rotor speeds
    65535 mean(column^2)/full^2.
    """

    column: str | None = None  # or, of several:
    mean: tuple[str, ...] | None = None
    mean_square: tuple[str, ...] | None = None  # of measured rotor speeds
    measured: bool = False  # of a thrust command: that of measured rotor speeds
    full: Annotated[float, Meta(gt=0.0, le=limits.LARGEST_VALUE)] | None = None  # in the file's own unit
    unit: str | None = None
    sign: float = 1.0
    add: Annotated[float, Meta(ge=-limits.LARGEST_VALUE, le=limits.LARGEST_VALUE)] = 0.0
    late: Annotated[float, Meta(ge=-limits.LATEST, le=limits.LATEST)] = 0.0  # s too late in the file

    @property
    def columns(self) -> tuple[str, ...]:
        """Return the names of the columns from which the value is computed."""
        return self.mean or self.mean_square or (self.column or "",)


class AttitudePid(Table, frozen=True):
    """Gains of an onboard attitude controller, to compute the attitude from its set-points and output."""

    kp: Annotated[float, Meta(gt=0.0, le=1000.0)]  # 1/s
    ki: Annotated[float, Meta(ge=0.0, le=1000.0)]  # 1/s2
    roll: tuple[Source, Source]  # set-point [angle] and commanded rate [angular rate]
    pitch: tuple[Source, Source]
    gyro: tuple[Source, Source] | None = None  # rates of roll and pitch, against which the angles are checked


class Mixer(Table, frozen=True):
    """Outputs of the rate controllers, from which the firmware computes the commands of the motors."""

    thrust: str
    roll: str
    pitch: str
    yaw: str


class ColumnMap(Table, frozen=True):
    """The content of a mapping file."""

    description: str = ""
    detect: tuple[str, ...] = ()
    inherit: str = ""  # a shipped mapping whose columns are taken too
    euler: Literal["ZXY", "ZYX"] = "ZXY"
    header: tuple[Annotated[int, Meta(ge=1, le=1000)], ...] = ()  # lines of a table that name its columns
    where: dict[str, str | float] = field(default_factory=dict)  # the rows to take: value by column
    notes: tuple[str, ...] = ()
    attitude_pid: AttitudePid | None = None  # where roll and pitch were not logged
    mixer: Mixer | None = None  # where the requests of the motors were not logged
    refuse: str | None = None
    columns: dict[str, str | Source | tuple[str | Source, ...]] = field(
        default_factory=dict
    )  # by canonical name

    def sources(self, canonical: str) -> tuple[Source, ...]:
        """Return the sources of a canonical column, of which the first that is present is used."""
        entry = self.columns.get(canonical, "t" if canonical == "t" else ())
        entries = entry if isinstance(entry, tuple) else (entry,)
        return tuple(Source(column=one) if isinstance(one, str) else one for one in entries)


@cache
def shipped() -> Mapping[str, ColumnMap]:
    """Return the shipped mappings by name."""
    folder = resources.files("inclined_landing.eval.logs") / "mappings"
    files = sorted((f for f in folder.iterdir() if f.name.endswith(".toml")), key=lambda f: f.name)
    return {f.name[:-5]: _parse(f.name, tomllib.loads(f.read_text("utf-8"))) for f in files}


def load(name: str | Path) -> ColumnMap:
    """Return a shipped mapping by its name, or a mapping file (TOML) by its path.

    Raises UserError if there is no such mapping or it is malformed.
    """
    if str(name) in shipped():
        return shipped()[str(name)]
    path = storage.as_path(name, "mapping")
    if not os.path.lexists(path):
        raise UserError(f"no mapping {shown(path, 120)}: neither a file nor one of {', '.join(shipped())}")
    return _parse(str(path), storage.read_toml(path, "mapping"))


def detect(names: Sequence[str], where: str) -> ColumnMap:
    """Return the shipped mapping that uses most of the given column names.

    The documented CSV is chosen only if no other format fits, and unusable formats only if it does not fit
    either. Raises UserError, listing the columns, if none fits.
    """
    documented = shipped()["documented"]
    for spelled in (list(names), _plain_names(names)):
        fitting = [m for m in shipped().values() if m.detect and all(_any(spelled, d) for d in m.detect)]
        if fitting:
            return max(fitting, key=lambda m: (not m.refuse, m is not documented, len(m.detect)))
    found = f"{where}: its columns ({shown(', '.join(names), 90)})"
    if all(_any([*_plain_names(names), "t"], name) for name in ("x", "y", "z")):
        raise UserError(
            f'{found} do not include time; name it in a mapping file with inherit = "documented" and, under '
            '[columns], t = "NAME"'
        )
    raise UserError(
        f"{found} match no known log format; expected t, x, y, z, roll, pitch, yaw, cmd_thrust_pwm, "
        "cmd_roll, cmd_pitch, or a mapping file"
    )


def _plain_names(names: Sequence[str]) -> list[str]:
    """Return the names, unchanged and without case and units, and t for names of time."""
    plain = [*names, *(units.split(name)[0] for name in names), *(name.lower() for name in names)]
    return [*plain, "t"] if clocks.named(names) else plain


def _any(names: Sequence[str], pattern: str) -> bool:
    return any(fnmatch.fnmatchcase(name, pattern) for name in names)


def find(names: Sequence[str], pattern: str, where: str) -> str | None:
    """Return the only name that equals `pattern` or, if it has a `*`, matches it, or None. Raises UserError
    if several match, for instance two vehicles in one bag.
    """
    if "*" not in pattern:
        return pattern if pattern in names else None
    found = [name for name in names if fnmatch.fnmatchcase(name, pattern)]
    if len(found) > 1:
        fitting = shown(", ".join(found))
        raise UserError(f"{where}: {shown(pattern)} matches {fitting}; a mapping file must name one")
    return found[0] if found else None


def patterns(column_map: ColumnMap | None) -> list[str]:
    """Return every column name that a mapping uses; for None, those of all shipped mappings."""
    asked = shipped().values() if column_map is None else [column_map]
    sources = [source for m in asked for canonical in m.columns for source in m.sources(canonical)]
    return [column for source in sources for column in source.columns]


def is_named(names: Sequence[str], column_map: ColumnMap) -> bool:
    """Return whether a mapping uses any of the given column names."""
    return any(_any(names, pattern) for pattern in patterns(column_map))


def _parse(where: str, data: dict) -> ColumnMap:
    read = schema.parse(data, ColumnMap, f"{where}: ")
    if read.inherit and read.inherit not in shipped():
        raise UserError(f"{where}: inherit {shown(read.inherit, 40)}: {choices(shipped(), read.inherit)}")
    for canonical in read.columns:
        if canonical not in units.COLUMNS:
            raise UserError(f"{where}: [columns] {shown(canonical)} is not one of {', '.join(units.COLUMNS)}")
        if not read.sources(canonical):
            raise UserError(f"{where}: [columns] {canonical} names no column")
        for source in read.sources(canonical):
            _check_source(source, canonical, f"{where}: [columns] {canonical}")
    if list(read.header) != sorted({*read.header}):
        raise UserError(f"{where}: header must list line numbers in their order, each once")
    columns = (shipped()[read.inherit].columns if read.inherit else {}) | read.columns
    if not columns and read.refuse is None:
        raise UserError(f"{where}: no [columns]")
    return structs.replace(read, columns=columns)


def _check_source(source: Source, canonical: str, where: str) -> None:
    if [source.column, source.mean, source.mean_square].count(None) != 2:
        raise UserError(f"{where} needs exactly one of column, mean, mean_square")
    if not all(source.columns):
        raise UserError(f"{where}: column, mean and mean_square must name columns")
    if source.full is not None and (units.COLUMNS[canonical] != "pwm" or source.unit is not None):
        raise UserError(f"{where}: full is only for a thrust command or a request, instead of a unit")
    if source.mean_square is not None and source.full is None:
        raise UserError(f"{where}: mean_square needs full, the rotor speed at the full command")
    if source.unit is not None:
        units.factor(canonical, source.unit, where)
    if source.sign not in (1, -1):
        raise UserError(f"{where}: sign must be 1 or -1, not {source.sign:g}")
