"""A diagnosis in the terminal: the numbers, then the first lines of the page, the answer last."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from inclined_landing.envs.shared.tables import new_table, say, show_table
from inclined_landing.eval.gap.answer.identify import Identification
from inclined_landing.eval.gap.report import words
from inclined_landing.eval.gap.result import Diagnosis


def show(d: Diagnosis, notes: Sequence[str] = (), report: Path | None = None) -> None:
    """Print effects, limits, ties, remedies, gap and verdict; report: the folder with the page."""
    rows = new_table(None, "effect", "parameter", "value", "95 % interval", "probability", "closes", labels=2)
    for effect in d.effects:
        ends = (words.label(effect.name), words.probability(effect.probability), words.share(effect.gain))
        for name, p in effect.parameters.items():
            value = words.rounded(p.value, p.ci95, p.unit)
            rows.add_row(ends[0], name, value, words.interval(p.ci95, p.unit), *ends[1:])
            ends = ("", "", "")
    answer = new_table(None, *words.ANSWER_HEADS, labels=4)
    for row in words.answer_rows(d):
        answer.add_row(*row)
    lines = words.sentences(d)
    headline, following = words.headline(d), ""
    if report is not None:
        headline += f" The report is {report / 'report.html'}."
        following = words.plan_command(d, report)
    notes = (*d.notes, *notes)
    print_answer(headline, lines, rows, notes, d, answer, following)


def print_answer(
    headline: str,
    sentences: Sequence[str],
    rows: Table,
    notes: Sequence[str],
    found: Diagnosis | Identification,
    answer: Table | None = None,
    following: str = "",
) -> None:
    """Print an answer, the numbers first and the headline last; repeated notes are removed."""
    if rows.row_count:
        show_table(rows)
    say(*(f"Note: {words.plain(note)}" for note in dict.fromkeys(notes)), style="dim")
    say(*sentences)
    if answer is not None and answer.row_count:
        show_table(answer)
    for aside in found.set_aside:
        say(f"{aside.flight} is set aside, and nothing is computed with it: {aside.reason}", style="bold")
    for one in found.inconsistent_flights:
        who, *more = words.inconsistency(one)
        say(who, style="bold")
        say(*more)
    if following:
        print(f"To plan a more informative flight: {following}")  # whole, to be copied
    say(headline, style="bold")
