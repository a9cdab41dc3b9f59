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
    labels: text (m,) of columns of few words, such as the names of vehicles.
    """

    path: str
    columns: Mapping[str, np.ndarray]
    times: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    unreadable: Mapping[str, str] = dataclasses.field(default_factory=dict)
    labels: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    notes: tuple[str, ...] = ()
    is_table: bool = False  # whether all columns have the same times, which are checked

    def rows(self, selection: np.ndarray) -> Record:
        """Return a table with the rows (k,) of an index array or a mask (m,)."""
        columns, labels = ({n: v[selection] for n, v in of.items()} for of in (self.columns, self.labels))
        return dataclasses.replace(self, columns=columns, labels=labels)
