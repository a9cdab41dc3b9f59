"""One self-contained HTML page: all templates extend `page.html.j2` and share its parts."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import jinja2

from inclined_landing.eval.base.claims import Section, number

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def environment(package: str, **options) -> jinja2.Environment:
    """Return the environment of a package's templates, which may extend or import those of this package."""

    owners = (package, __package__)
    return jinja2.Environment(
        loader=jinja2.ChoiceLoader([jinja2.PackageLoader(owner, "") for owner in owners]),
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
        **options,
    )


def render(package: str, template: str, **content) -> str:
    """Return a package's rendered HTML template."""
    html = environment(package, autoescape=True)
    html.filters["number"] = number
    html.globals["parts"] = html.get_template("parts.html.j2").module
    return html.get_template(template).render(content)


def of_sections(
    sections: Sequence[Section],
    images: Mapping[str, bytes],
    *,
    title: str,
    run: str,
    versions: Mapping[str, Any],
    lead: str = "",
    facts: Sequence[tuple[Any, ...]] = (),
) -> str:
    """Return the page of sections: claims, or tables of a study.

    images: PNG files by the names used in the captions of sections; run: the command; facts: rows on the
    flown vehicles and policies, each with subject, name, value and unit.
    """
    content = {"sections": sections, "title": title, "run": run, "versions": versions, "lead": lead}
    # Data URLs, so that the page is one file.
    data = {k: "data:image/png;base64," + base64.b64encode(v).decode("ascii") for k, v in images.items()}
    return render(__package__, "sections.html.j2", images=data, facts=facts, **content)


def png(figure: Figure) -> bytes:
    """Return the figure as the bytes of a PNG file."""
    from inclined_landing.eval.base.style import PNG_DPI, styled  # here, as most pages have no figures

    file = io.BytesIO()
    with styled():
        figure.savefig(file, format="png", dpi=PNG_DPI)
    return file.getvalue()
