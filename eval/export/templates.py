"""The templates of exports, and escaping for them."""

from __future__ import annotations

import re

from inclined_landing.eval.base.page import environment
from inclined_landing.models.base.errors import shown

LONGEST = 2000  # characters of a value
# What Markdown or HTML would read as its own within a line; `_` not within a word, `]` where a link goes on,
# `[` where it may begin the definition of one.
_SPECIAL = re.compile(r"[\\`*<>|~$&#]|(?<![^\W_])_|_(?![^\W_])|\](?=[(\[])|\A\[")


def render(template: str, **content) -> str:
    """Return a rendered template of this package as plain text; in Markdown values are escaped."""
    finalize = escaped if template.endswith(".md.j2") else None
    plain = environment(__package__, keep_trailing_newline=True, finalize=finalize)
    return plain.get_template(template).render(content)


def escaped(value: object) -> str:
    """Return any value as one printable line of Markdown, with formatting, links and HTML escaped."""
    # Character references instead of backslashes, which differ between dialects.
    return _SPECIAL.sub(lambda mark: f"&#{ord(mark[0])};", shown(value, LONGEST))
