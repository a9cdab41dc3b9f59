"""One sentence about a flight, and what follows from it."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Finding:
    """What a check has to say.

    decision: "refuse" (the flight cannot be used), "limit" (it is used, and this is noted) or "info".
    channel: the column, or columns, it is about.
    text: a sentence for a person.
    without: the optional channel ("velocity", "voltage") that is therefore left out.
    rows: the rows that are therefore left out.
    """

    decision: str
    channel: str
    text: str
    without: str | None = None
    rows: tuple[int, ...] = ()


def refuse(channel: str, text: str) -> Finding:
    """The flight cannot be used."""
    return Finding("refuse", channel, text)


def limit(channel: str, text: str, *, without: str | None = None, rows: tuple[int, ...] = ()) -> Finding:
    """The flight is used with this limit."""
    return Finding("limit", channel, text, without, rows)


def info(channel: str, text: str) -> Finding:
    """Nothing follows from it."""
    return Finding("info", channel, text)
