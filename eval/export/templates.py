"""The texts that exports are written from."""

from __future__ import annotations

import jinja2

from inclined_landing.eval.base.markdown import escaped


def render(template: str, **content) -> str:
    """Return a template of this package filled in, as plain text; in Markdown values are escaped."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("inclined_landing.eval.export", ""),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
        finalize=escaped if template.endswith(".md.j2") else None,
    )
    return environment.get_template(template).render(content)
