"""An answer in the terminal: the limits, the sentences and the table of the page, the headline last."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from inclined_landing.envs.shared.tables import new_table, say, show_table
from inclined_landing.eval.gap.answer.identification import Identification
from inclined_landing.eval.gap.report import words
from inclined_landing.eval.gap.result import Diagnosis

_HEADS = ("effect", "size", "95 % interval", "confidence", "error after 1 s")


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
