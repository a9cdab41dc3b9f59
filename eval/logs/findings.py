"""A finding: one sentence about a flight, and its consequence."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Finding:
    """The result of one check.

    decision: "refuse" (the flight cannot be used), "limit" (it is used, and this is noted) or "info".
    channel: the column or columns concerned.
    text: a sentence for the user.
    without: the optional channel ("velocity", "voltage") that is therefore omitted.
    rows: the rows that are therefore omitted.
    """

    decision: str
    channel: str
    text: str
    without: str | None = None
    rows: tuple[int, ...] = ()


def refuse(channel: str, text: str) -> Finding:
    """Return a finding that the flight cannot be used."""
    return Finding("refuse", channel, text)


def limit(channel: str, text: str, *, without: str | None = None, rows: tuple[int, ...] = ()) -> Finding:
    """Return a finding that the flight is used with this limitation."""
    return Finding("limit", channel, text, without, rows)


def info(channel: str, text: str) -> Finding:
    """Return a finding that has no consequence."""
    return Finding("info", channel, text)
