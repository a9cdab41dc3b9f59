"""Columns of a table as it is, without a mapping."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas

from inclined_landing.eval.logs import csv_file
from inclined_landing.models.errors import UserError

_FEWEST_ROWS = 100  # of a flight


def read_columns(path: Path, names: Sequence[str]) -> pandas.DataFrame:
    """Return the columns `names` of a CSV file; raise UserError for one missing, cut or not finite."""
    record = csv_file.read(path)
    for name in names:
        if name in record.unreadable:
            raise UserError(f"{path}: {record.unreadable[name]}")
        if name not in record.columns:
            raise UserError(f"{path} lacks the column {name}")
    table = pandas.DataFrame({name: record.columns[name] for name in names})
    if len(table) < _FEWEST_ROWS or not np.isfinite(table).all(axis=None):
        raise UserError(f"{path} has {len(table)} rows, or columns that are no numbers throughout")
    return table
