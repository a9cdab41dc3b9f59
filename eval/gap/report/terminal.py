"""A diagnosis in the terminal: the first lines of the page and a small table."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table

from inclined_landing.envs.shared.tables import new_table, printer
from inclined_landing.eval.gap.report import words
from inclined_landing.eval.gap.result import Diagnosis, InconsistentFlights


def show(d: Diagnosis, notes: Sequence[str] = ()) -> None:
    """Print verdict, effects, ties, remedies, gap and limits."""
    rows = new_table(None, "effect", "parameter", "value", "95 % interval", "probability", "closes", left=2)
    for effect in d.effects:
        ends = (words.label(effect.name), words.probability(effect.probability), words.share(effect.gain))
        for name, p in effect.parameters.items():
            value = words.rounded(p.value, p.ci95, p.unit)
            rows.add_row(ends[0], name, value, words.interval(p.ci95, p.unit), *ends[1:])
            ends = ("", "", "")
    answer = new_table(None, *words.ANSWER_HEADS, left=4)
    for row in words.answer_rows(d):
        answer.add_row(*row)
    lines = words.sentences(d)
    say(words.headline(d), lines, rows, (*d.notes, *notes), d.inconsistent_flights, answer)


def say(
    headline: str,
    sentences: Sequence[str],
    rows: Table,
    notes: Sequence[str],
    inconsistent_flights: Sequence[InconsistentFlights],
    answer: Table | None = None,
) -> None:
    """Print an answer, inconsistent flights first; repeated notes are removed."""
    console = printer()
    for one in inconsistent_flights:
        who, *more = words.inconsistency(one)
        console.print(who, style="bold")
        for text in more:
            console.print(text)
    console.print(headline, style="bold")
    if answer is not None and answer.row_count:
        console.print(answer)
    for text in sentences:
        console.print(text)
    if rows.row_count:
        console.print(rows)
    for note in dict.fromkeys(notes):
        console.print(f"Note: {words.plain(note)}", style="dim")
