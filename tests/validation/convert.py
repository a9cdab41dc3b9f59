"""From the files of a public set, as its authors published them, to the documented CSV.

The TOML file of a set's name maps its columns: source column, unit, sign, decimals.
Nothing is filtered, shifted or filled in: an impossible PWM, and what was not logged, become empty cells.
"""

from __future__ import annotations

import dataclasses
import math
import re
import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np
import pandas

from inclined_landing.eval.logs import csv_file, limits, sd_card
from inclined_landing.eval.logs.read import log_table, read_log
from inclined_landing.eval.logs.record import Record
from inclined_landing.models.base.errors import UserError, shown

_UNITS = {"deg": math.pi / 180.0, "g": 9.80665, "mV": 1e-3}
_MOST_PWM = 65535
_DECIMALS = 6


@dataclasses.dataclass(frozen=True)
class PublicSet:
    """A set of flights that others published."""

    title: str
    repository: str
    commit: str
    files: str  # which files of the repository, as a shell would find them
    licence: str
    cite: str
    path: str  # regular expression of a file's path
    name: str  # of the flight, by the groups of `path`
    columns: Mapping[str, Mapping] = dataclasses.field(default_factory=dict)
    mapping: str = ""  # in place of columns: the shipped mapping that reads its files
    unit_length: tuple[str, ...] = ()  # columns of a quaternion, to be normalised
    zeros_mean_not_logged: tuple[str, ...] = ()
    segments: Mapping[str, tuple[float, float]] | None = None  # by the file's name: from, to [s]


@cache
def public_sets() -> Mapping[str, PublicSet]:
    """Return the known sets by name."""
    files = sorted(Path(__file__).with_name("public_sets").glob("*.toml"))
    return {file.stem: PublicSet(**tomllib.loads(file.read_text("utf-8"))) for file in files}


def convert(name: str, path: Path) -> tuple[str, pandas.DataFrame, list[str]]:
    """Convert one file of the set `name`: the flight's name, its table in documented columns, notes.

    Raises UserError when the file is none of that set.
    """
    known = public_sets()[name]
    match = re.fullmatch(known.path, path.as_posix())
    if not match:
        raise UserError(f"{shown(path, 250)}: files of {name} have paths that end like {known.files}")
    if limits.check_file(path):
        raise UserError(f"{path}: a folder, not a file")
    flight = match.expand(known.name)
    if known.mapping:
        log = read_log(path, mapping=known.mapping, name=flight, check=False)
        return flight, log_table(log).round(_DECIMALS), list(log.notes)
    record = sd_card.read(path) if sd_card.is_sd_card_log(path) else csv_file.read(path)
    notes = list(record.notes)
    table = pandas.DataFrame({c: _column(name, of, path, record) for c, of in known.columns.items()})
    if known.segments:
        if path.name not in known.segments:
            chosen = ", ".join(known.segments)
            raise UserError(f"{path}: the flights of {name} are parts of {chosen} only")
        start, stop = known.segments[path.name]
        table = table[(table["t"] >= start) & (table["t"] <= stop)]
    if len(table) < 2:
        raise UserError(f"{path}: {len(table)} rows; not a flight")
    table = table.reset_index(drop=True)
    table["t"] -= table["t"].iloc[0]
    quaternion = list(known.unit_length)
    if quaternion:
        length = np.linalg.norm(table[quaternion].to_numpy(), axis=1)
        table[quaternion] /= np.where(length > 0.0, length, np.nan)[:, None]
    for column in table:
        if not (column.endswith("_pwm") and (table[column].abs() > 0.0).any()):
            continue
        wrong = (table[column] < 0) | (table[column] > _MOST_PWM)
        if wrong.any():
            notes.append(
                f"{column} is not a PWM value in {wrong.sum()} rows ({table[column].max():.0f}): left empty"
            )
            table.loc[wrong, column] = np.nan
    idle = [column for column in known.zeros_mean_not_logged if (table[column] == 0.0).all()]
    if idle:
        notes.append(f"always zero: {', '.join(idle)}; treated as not logged")
        table[idle] = np.nan
    decimals = {c: of["decimals"] for c, of in known.columns.items() if "decimals" in of}
    return flight, table.round(decimals), notes


def _column(name: str, of: Mapping, path: Path, record: Record) -> np.ndarray | pandas.Series | float:
    """Return one column of the record in SI units; text as it stands."""
    if "from" not in of:  # the time of logs that date every value
        if not record.times:
            raise UserError(f"{path}: not a file of {name}, whose files are micro-SD logs")
        return record.times[next(iter(record.columns))]
    source = of["from"]
    if source not in record.columns:
        if of.get("optional"):
            return np.nan
        raise UserError(f"{path}: not a file of {name}: it lacks the column {source}")
    if of.get("text"):
        return pandas.read_csv(path, usecols=[source], dtype=str)[source].fillna("")
    return of.get("sign", 1) * _UNITS.get(of.get("unit", ""), 1.0) * record.columns[source]
