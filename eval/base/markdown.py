"""Text of others in Markdown: names of files, metadata, recipes."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence

from inclined_landing.models.errors import shown

LONGEST = 2000  # characters of a value
# What Markdown or HTML would read as its own within a line; `_` not within a word, `]` where a link goes on,
# `[` where it may begin the definition of one.
_SPECIAL = re.compile(r"[\\`*<>|~$&#]|(?<![^\W_])_|_(?![^\W_])|\](?=[(\[])|\A\[")


def escaped(value: object) -> str:
    """Return any value as one printable line of Markdown, without formatting, link or HTML of its own."""
    return literal(shown(value, LONGEST))


def literal(text: str) -> str:
    """Return one printable line of text as Markdown that shows it letter by letter."""
    return _SPECIAL.sub(lambda mark: f"&#{ord(mark[0])};", text)  # backslashes differ between dialects


def table(
    heads: Sequence[str], rows: Iterable[Sequence[str]], cell: Callable[[str], str] = escaped
) -> list[str]:
    """Return the lines of a table; cell: what makes Markdown of a text in it."""
    ruled = [(*map(cell, heads),), ("---",) * len(heads), *(map(cell, row) for row in rows)]
    return [f"| {' | '.join(row)} |" for row in ruled]
