"""The report page: one self-contained HTML file."""

from __future__ import annotations

import re
from collections.abc import Sequence

from matplotlib.figure import Figure

from inclined_landing.eval.base import page as base_page
from inclined_landing.eval.base.style import styled
from inclined_landing.eval.gap.answer.identification import Identification
from inclined_landing.eval.gap.report import figures, words
from inclined_landing.eval.gap.report.files import MJCF, VEHICLE
from inclined_landing.eval.gap.report.numbers import exact, interval
from inclined_landing.eval.gap.report.tracks import EVERY, Track
from inclined_landing.eval.gap.result import Diagnosis
from inclined_landing.models.effects import LIBRARY


def page(
    d: Diagnosis, track: Track | None, *, versions: dict, notes: Sequence[str] = (), flight: str = ""
) -> str:
    """Return the HTML page of a diagnosis.

    track: one flight with predictions along it. notes: sentences on the logs. flight: on the most informative
    flight.
    """
    with styled():
        drawn: dict[str, Sequence[Figure]] = {
            "before_after": figures.before_after(track) if track else (),
            "estimates": figures.estimates(d.effects, d.flights),
            "horizon": [figures.horizon(d.horizon, d.gap)] if d.horizon else (),
            "residual": figures.residual(d.residual),
        }
    rows = []
    for effect in d.effects:
        first, last = words.label(effect.name), LIBRARY[effect.name].formula
        for name, p in effect.parameters.items():
            ends = interval(p.ci95, p.unit) if words.is_identifiable(p) else "not identifiable"
            row = (name, words.value(p), ends, exact(p.neutral, p.unit))
            rows.append((first, *row, last))
            first = last = ""
    caption = track and (
        f"{track.flight}, {'left out of' if track.held_out else 'part of'} the fit. Every {EVERY:g} s a "
        "prediction starts from the measured state, driven by the commands alone."
    )
    return render(
        "gap.html.j2",
        d,
        command="gap",
        title=words.headline(d),
        lead=[text for text in (words.how_much(d),) if text],
        caption=caption,
        answers=words.answers(d),
        flight=flight or words.possible_sentence(d),
        rows=rows,
        where=figures.where_tables(d.where),
        figures={name: [base_page.svg(one) for one in some] for name, some in drawn.items()},
        mjcf=MJCF,
        heldout=[name for name in d.heldout if name not in d.flights],
        notes=notes,
        seconds=sum(d.seconds.values()),
        versions=versions,
    )


def render(template: str, found: Diagnosis | Identification, *, notes: Sequence[str], **content) -> str:
    """Return a template of this package filled in; notes: sentences, in addition to those of `found`."""
    text = base_page.render(
        __package__,
        template,
        found=found,
        notes=words.notes(found.notes, notes),
        words=words,
        colours=(figures.BEFORE, figures.AFTER),
        vehicle=VEHICLE,
        **content,
    )
    # No line ends between a number and its unit.
    return re.sub(r" (?=%)|(?<=\d) (?=(?:cm|mm|ms|deg)\b)", "\u00a0", text)
