"""The texts that exports are written from."""

from __future__ import annotations

import re
from importlib import resources

import jinja2

from inclined_landing.models.errors import shown

LONGEST = 2000  # characters of a value
# What Markdown or HTML would read as its own within a line; `_` not within a word, `]` where a link goes on.
_SPECIAL = re.compile(r"[\\`*<>|~$&#]|(?<![^\W_])_|_(?![^\W_])|\](?=[(\[:])")


def render(template: str, **content) -> str:
    """Return a template of this package filled in, as plain text; in Markdown values are escaped by
    `markdown`.
    """
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(text),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
        finalize=markdown if template.endswith(".md.j2") else None,
    )
    return environment.get_template(template).render(content)


def markdown(value: object) -> str:
    """Return a value escaped for Markdown: one line, and no formatting, link or HTML of its own."""
    return _SPECIAL.sub(r"\\\g<0>", shown(value, LONGEST))


def text(name: str) -> str:
    """Return a text file of this package."""
    return resources.files("inclined_landing.eval.export").joinpath(*name.split("/")).read_text("utf-8")
