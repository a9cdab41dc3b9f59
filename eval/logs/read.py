"""Reading flight logs of any known format."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas

from inclined_landing.eval.logs import (
    assemble,
    checks,
    copies,
    csv_file,
    limits,
    sd_card,
    unsupported,
    vehicles,
)
from inclined_landing.eval.logs import mapping as mappings
from inclined_landing.eval.logs.channels import Channel, channels_of
from inclined_landing.eval.logs.log import FlightLog, as_logs
from inclined_landing.eval.logs.mapping import ColumnMap
from inclined_landing.eval.logs.record import Record
from inclined_landing.eval.logs.units import COLUMNS, factor
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError, choices, shown

BAGS = (".bag", ".mcap", ".db3")


def read_log(
    path: str | Path | Sequence[str | Path],
    *,
    mapping: str | Path | None = None,
    units: Mapping[str, str] | None = None,
    where: Mapping[str, str | float] | None = None,
    name: str | None = None,
    check: bool = True,
) -> FlightLog:
    """Return one flight from its file, or from several files of the same flight with the same clock.

    Args:
        path: CSV (compressed or not), micro-SD binary or ROS bag. Several files: a sequence, or one string
            with the names joined by `+`, as for the client's one file per log block.
        mapping: name of a shipped mapping or path of a mapping file; detected from the columns if None.
        units: unit per canonical column if neither file nor mapping states it, {"roll": "deg"}.
        where: the rows to read from a table of several vehicles, {"name": "cf1"}.
        check: refuse flights that `check_log` refuses, and add its limits to the notes.

    Raises:
        UserError: naming file and column, if the flight cannot be used.
    """
    paths = _paths(path)
    stated = _dictionary("units", units, "units by column")
    chosen = _dictionary("where", where, "values by column")
    files = "+".join(map(str, paths))
    for column, unit in stated.items():
        if column not in COLUMNS:
            raise UserError(f"unit given for the column {shown(column)}; {choices(COLUMNS, column)}")
        factor(column, unit, files)
    column_map = None if mapping is None else mappings.load(mapping)
    records = vehicles.choose(
        [_record(path, column_map) for path in paths], (column_map.where if column_map else {}) | chosen
    )
    if column_map is None:
        names = dict.fromkeys(
            column for record in records for column in (*record.columns, *record.unreadable)
        )
        column_map = mappings.detect(list(names), files)
    channels: dict[str, Channel] = {}
    notes: list[str] = []
    for record in records:
        found, new_notes = channels_of(column_map, record, stated)
        copies.check_columns(record, found)
        notes += new_notes
        notes += [f"{key} is in several files; the first is used" for key in found if key in channels]
        channels = found | channels
    name = name or shown(paths[0].name).removesuffix(".gz").removesuffix(".csv")
    log = assemble.assemble(name, files, channels, column_map.euler, notes)
    return checks.enforce(log, files) if check else log


def _dictionary(name: str, given: Any, what: str) -> dict:
    try:
        return dict(given or {})
    except (TypeError, ValueError) as error:
        raise UserError(f"{name} must be a dictionary of {what}, not {shown(repr(given), 40)}") from error


def write_log(path: str | Path, log: FlightLog) -> None:
    """Write the documented CSV (gzipped if the name ends in .gz), atomically."""
    with storage.atomic(path) as part:
        log_table(log).to_csv(part, index=False)


def log_table(log: FlightLog) -> pandas.DataFrame:
    """Return a flight in the documented columns, without those that were not logged."""
    (log,) = as_logs([log])
    table = pandas.DataFrame({key: x for key, x in log.columns().items() if not np.isnan(x).all()})
    if log.contact is not None:
        table["contact"] = log.contact.astype(int)
    return table.rename(columns={"cmd_thrust_pwm": "measured_thrust_pwm"} if log.thrust_is_measured else {})


def _record(path: Path, column_map: ColumnMap | None) -> Record:
    folder = limits.check_file(path)
    if folder or path.suffix in BAGS:
        try:
            from inclined_landing.eval.logs import bag
        except ImportError as error:
            raise UserError(f"{path}: ROS bags need rosbags; pip install 'inclined-landing[eval]'") from error
        return bag.read(path, mappings.patterns(column_map))
    if sd_card.is_sd_card_log(path):
        return sd_card.read(path)
    unsupported.check(path)
    return csv_file.read(path, column_map)


def _paths(path: Any) -> list[Path]:
    single = isinstance(path, (str, os.PathLike)) or not isinstance(path, Iterable)
    parts = [path] if single else list(path)
    for part in parts:
        storage.as_path(part, "flight log")
    names = _split(os.fspath(path)) if single else list(map(os.fspath, parts))
    if not names or not all(name.strip() for name in names):
        raise UserError("no flight log given, or an empty name among several")
    return [Path(name) for name in names]


def _split(names: str) -> list[str]:
    """Return the file names joined by `+`, split after existing files, because names may contain `+`."""
    found = []
    while not os.path.exists(names):
        ends = [plus.start() for plus in re.finditer(r"\+", names)]
        end = next((end for end in reversed(ends) if os.path.exists(names[:end])), None)
        if end is None:
            break
        found.append(names[:end])
        names = names[end + 1 :]
    return [*found, names]
