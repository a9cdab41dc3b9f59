"""The report page: one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Sequence

from inclined_landing.eval.base import page as base_page
from inclined_landing.eval.base.style import styled
from inclined_landing.eval.gap.report import figures, words
from inclined_landing.eval.gap.report.model import MJCF, VEHICLE
from inclined_landing.eval.gap.report.tracks import EVERY, Track
from inclined_landing.eval.gap.result import Diagnosis
from inclined_landing.models.effects import LIBRARY


def page(d: Diagnosis, track: Track | None, *, versions: dict, notes: Sequence[str] = ()) -> str:
    """Return the HTML page of a diagnosis.

    track: one flight with predictions along it. notes: sentences on the logs.
    """
    with styled():
        drawn = {
            "estimates": figures.estimates(d.effects, d.flights),
            "horizon": figures.horizon(d.horizon, d.gap) if d.horizon else None,
            "track": figures.track(track) if track else None,
            "windows": figures.window_curves(d.windows),
            "residual": figures.residual(d.residual),
        }
    rows = []
    for effect in d.effects:
        for k, (name, p) in enumerate(effect.parameters.items()):
            value = words.rounded(p.value, p.ci95, p.unit)
            row = (name, value, words.interval(p.ci95, p.unit), words.exact(p.neutral, p.unit))
            first, last = ("", "") if k else (words.label(effect.name), LIBRARY[effect.name].formula)
            rows.append((first, *row, last))
    return render(
        "gap.html.j2",
        command="gap",
        title=words.headline(d),
        lead=[words.gap("analytic", d.gap["analytic"])] if "analytic" in d.gap else [],
        d=d,
        inconsistent_flights=d.inconsistent_flights,
        set_aside=d.set_aside,
        words=words,
        rows=rows,
        answer=words.answer_rows(d),
        sets=words.set_rows(d),
        noise_rows=words.noise_rows(d.disturbance),
        where=figures.where_tables(d.where),
        figures={
            name: [figures.svg(one) for one in some] if isinstance(some, list) else some and figures.svg(some)
            for name, some in drawn.items()
        },
        colours=(figures.BEFORE, figures.AFTER),
        every=EVERY,
        vehicle=VEHICLE,
        mjcf=MJCF,
        flights=d.flights,
        heldout=[name for name in d.heldout if name not in d.flights],
        notes=(*d.notes, *notes),
        seconds=sum(d.seconds.values()),
        versions=versions,
    )


def render(template: str, *, notes: Sequence[str], **content) -> str:
    """Return a template of this package filled in; notes: sentences, repetitions removed."""
    lines = [words.plain(note) for note in dict.fromkeys(notes)]
    text = base_page.render(__package__, template, notes=lines, **content)
    return text.replace(" %", "\u00a0%")  # no line ends between a number and its percent
