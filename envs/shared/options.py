"""Types of single options, and the check of their numbers."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import tyro

from inclined_landing.models.errors import UserError, shown


@dataclasses.dataclass(frozen=True)
class Range:
    """Which numbers an option takes: from `low` to `high`, without the two where it is `open`."""

    low: float
    high: float
    open: bool = False

    def __contains__(self, value: float) -> bool:
        return self.low < value < self.high if self.open else self.low <= value <= self.high

    def __str__(self) -> str:
        low, high = (f"{end:.15g}" for end in (self.low, self.high))
        return f"above {low} and below {high}" if self.open else f"from {low} to {high}"


@dataclasses.dataclass(frozen=True)
class AtMost:
    """How many values an option takes."""

    count: int


Seed = Annotated[int, Range(0, 2**32 - 1)]
Flag = tyro.conf.FlagCreatePairsOff[bool]
NewFolder = Annotated[Path | None, tyro.conf.arg(metavar="DIR")]


def check_ranges(group: object, hints: Mapping[str, Any] | None = None) -> None:
    """Raise UserError unless numbers are finite, in their `Range`, and no more than `AtMost` allows.

    group: options by name, or a dataclass of them; groups within are checked too. hints: the annotations,
    where `group` does not have its own.
    """
    values = group if isinstance(group, Mapping) else vars(group)
    hints = get_type_hints(type(group), include_extras=True) if hints is None else hints
    for name, value in values.items():
        if dataclasses.is_dataclass(value):
            check_ranges(value)
        option = "from" if name == "start_from" else name.replace("_", "-")
        for number in _numbers(value):
            if not math.isfinite(number):
                raise UserError(f"--{option} takes finite numbers, not {number}")
        for limits in getattr(hints.get(name), "__metadata__", ()):
            if isinstance(limits, Range) and value is not None and value not in limits:
                raise UserError(f"--{option} must lie {limits}, not {shown(value, 40)}")
            if isinstance(limits, AtMost) and len(value) > limits.count:
                raise UserError(f"{option}: at most {limits.count} stand side by side, not {len(value)}")


def _numbers(value: object) -> Iterator[float]:
    """Yield the floats of an option, which may be a list, or a list of lists of them."""
    if isinstance(value, float):
        yield value
    elif isinstance(value, tuple):
        for item in value:
            yield from _numbers(item)
