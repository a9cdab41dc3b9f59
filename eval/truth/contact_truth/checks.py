"""A claim about contact: what was measured, what is asked for, and whether it is met."""

from __future__ import annotations

import dataclasses
import math


@dataclasses.dataclass(frozen=True)
class Check:
    """`measured` should lie between `low` and `high`; `note` says how it was measured."""

    name: str
    measured: float
    unit: str
    high: float
    note: str
    low: float = -math.inf

    @property
    def met(self) -> bool:
        """Is the measured value a number within the bounds?"""
        return bool(self.low <= self.measured <= self.high)

    @property
    def asked(self) -> str:
        """The bounds as text."""
        if math.isinf(self.low):
            return f"at most {self.high:g}"
        if math.isinf(self.high):
            return f"at least {self.low:g}"
        return f"{self.low:g} to {self.high:g}"

    def record(self) -> dict:
        """Plain values for the JSON file."""
        return dataclasses.asdict(self) | {"met": self.met}


@dataclasses.dataclass
class Finding:
    """One section of the page: checks, a paragraph, the data of the figure."""

    key: str
    title: str
    text: str
    checks: list[Check]
    data: dict
