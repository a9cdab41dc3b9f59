"""The contents of a file, before a mapping assigns quantities to its columns."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np


@dataclasses.dataclass(frozen=True)
class Record:
    """Columns of one file by their names in the file.

    columns: values (m,) each; NaN where the file has no value.
    times: seconds (m,) per column if the format stores the time of every value (micro-SD, bags);
        empty for tables, whose time is an ordinary column, until that is found.
    units: unit per column if the file states it.
    unreadable: a sentence per column whose values cannot be read: it is not in `columns`, or NaN there
        if it contains only text.
    """

    path: str
    columns: Mapping[str, np.ndarray]
    times: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    unreadable: Mapping[str, str] = dataclasses.field(default_factory=dict)
    notes: tuple[str, ...] = ()
    is_table: bool = False  # whether all columns have the same times, which are checked
