"""Claims with tolerance, measured value and verdict; sections of the report."""

from __future__ import annotations

import dataclasses
import math
import numbers
from collections.abc import Callable
from typing import TYPE_CHECKING

from inclined_landing.envs.shared.statistics import number

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True)
class Claim:
    """A claim that `measured` is between `low` and `high`; `why` states the origin of the bounds."""

    name: str
    measured: float
    high: float
    unit: str
    why: str
    low: float = -math.inf

    @property
    def passed(self) -> bool:
        """Return whether the measured value is a number within the bounds."""
        return bool(self.low <= self.measured <= self.high)

    @property
    def shown(self) -> float:
        """Return the measured value, or 0 if it is a rounding error compared with its bounds."""
        scale = max((abs(bound) for bound in (self.low, self.high) if math.isfinite(bound)), default=0.0)
        return 0.0 if abs(self.measured) < 1e-12 * scale else self.measured

    @property
    def tolerance(self) -> str:
        """Return the bounds as text."""
        if math.isinf(self.low):
            return f"at most {number(self.high)}"
        if math.isinf(self.high):
            return f"at least {number(self.low)}"
        return f"{number(self.low)} to {number(self.high)}"

    def record(self) -> dict:
        """Return plain numbers for the JSON report; a bound that does not exist is null."""
        return {
            "claim": self.name,
            "measured": float(self.measured),
            "low": float(self.low),
            "high": float(self.high),
            "unit": self.unit,
            "passed": self.passed,
            "derivation": self.why,
        }


@dataclasses.dataclass
class Table:
    """A table: one heading for each column, rows of text or numbers; numbers are rounded for display."""

    caption: str
    heads: tuple[str, ...]
    rows: list[tuple]
    labels: int = 2  # columns in front that name the row

    @property
    def numbers(self) -> tuple[str, ...]:
        """Return the headings of the columns that contain numbers."""
        first = self.rows[0] if self.rows else ()
        return tuple(head for head, cell in zip(self.heads, first) if isinstance(cell, numbers.Number))


@dataclasses.dataclass
class Section:
    """One section of a page; `figures` maps file names to captions, `data` goes to the JSON.

    text: paragraphs, or the only one. draw: returns its figure, if it has one.
    """

    key: str
    title: str
    text: list[str] | str = ""
    claims: list[Claim] = dataclasses.field(default_factory=list)
    tables: list[Table] = dataclasses.field(default_factory=list)
    figures: dict[str, str] = dataclasses.field(default_factory=dict)
    remarks: list[str] = dataclasses.field(default_factory=list)
    data: dict = dataclasses.field(default_factory=dict)
    draw: Callable[[], Figure] | None = None

    def __post_init__(self):
        if isinstance(self.text, str):
            self.text = [self.text]

    @property
    def passed(self) -> bool:
        """Return whether all claims hold."""
        return all(claim.passed for claim in self.claims)

    def record(self) -> dict:
        """Return the entry of a JSON report, without the text."""
        return {
            "title": self.title,
            "claims": [claim.record() for claim in self.claims],
            "tables": [dataclasses.asdict(table) for table in self.tables],
            "remarks": self.remarks,
            "data": self.data,
        }
