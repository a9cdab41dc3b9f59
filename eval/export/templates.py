"""The texts that exports are written from."""

from __future__ import annotations

from importlib import resources

import jinja2


def render(template: str, **content) -> str:
    """A template of this room filled in, as plain text."""
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(text),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
    )
    return environment.get_template(template).render(content)


def text(name: str) -> str:
    """A file of this room."""
    return resources.files("inclined_landing.eval.export").joinpath(*name.split("/")).read_text("utf-8")
