"""An answer on a page, which is one self-contained HTML file, and in the terminal.

In the terminal stand the limits, the sentences and the table of the page, the headline last.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure
from rich.table import Table

from inclined_landing.envs.shared.tables import new_table, say, show_table
from inclined_landing.eval.base import page as base_page
from inclined_landing.eval.base.style import styled
from inclined_landing.eval.gap.answer.identification import Identification
from inclined_landing.eval.gap.report import figures, words
from inclined_landing.eval.gap.report.files import MJCF, VEHICLE
from inclined_landing.eval.gap.report.numbers import exact, interval
from inclined_landing.eval.gap.result import Diagnosis
from inclined_landing.models.effects import LIBRARY

_HEADS = ("effect", "size", "95 % interval", "confidence", "error after 1 s")


def page(
    d: Diagnosis, track: figures.Track | None, *, versions: dict, notes: Sequence[str] = (), flight: str = ""
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
        f"{track.flight}, {'left out of' if track.held_out else 'part of'} the fit. Every "
        f"{figures.EVERY:g} s a prediction starts from the measured state, driven by the commands alone."
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


def show(
    d: Diagnosis,
    notes: Sequence[str] = (),
    report: Path | None = None,
    flight: str = "",
    following: str = "",
) -> None:
    """Print limits, sentences, the table of effects and the headline.

    report: the folder with the page. flight: on the most informative flight; following: the command for it.
    """
    answer = new_table(None, *_HEADS)
    for one in words.answers(d):
        last = (one.how, one.cost)
        for parameter, number, ends in one.sizes:
            answer.add_row(one.title + f", {parameter}" * bool(parameter), number, ends, *last)
            last = ("", "")
    headline = words.headline(d) + (f" The report is {report / 'report.html'}." if report else "")
    print_answer(headline, words.sentences(d, flight), answer, notes, d, following)


def print_answer(
    headline: str,
    sentences: Sequence[str],
    rows: Table,
    notes: Sequence[str],
    found: Diagnosis | Identification,
    following: str = "",
) -> None:
    """Print an answer, the notes first and the headline last; repeated notes are removed."""
    say(*(f"Note: {note}" for note in words.notes(found.notes, notes)), style="dim")
    if rows.row_count:
        show_table(rows)
    say(*sentences)
    for aside in found.set_aside:
        say(f"{aside.flight} was set aside and not used: {aside.reason}", style="bold")
    for one in found.inconsistent_flights:
        who, *more = words.inconsistency(one)
        say(who, style="bold")
        say(*more)
    if following:
        print(f"To plan a more informative flight: {following}")  # whole, to be copied
    say(headline, style="bold")
