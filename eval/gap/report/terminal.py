"""A diagnosis in the terminal: the first lines of the page and a small table."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table

from inclined_landing.eval.base.tables import new_table, printer
from inclined_landing.eval.gap.report import words
from inclined_landing.eval.gap.result import Contradiction, Diagnosis


def show(d: Diagnosis, notes: Sequence[str] = ()) -> None:
    """Print verdict, effects, ties, remedies, gap and limits."""
    rows = new_table(None, "effect", "parameter", "value", "95 % interval", "probability", "closes", left=2)
    for effect in d.effects:
        ends = (words.label(effect.name), words.probability(effect.probability), words.share(effect.gain))
        for name, p in effect.parameters.items():
            value = words.rounded(p.value, p.ci95, p.unit)
            rows.add_row(ends[0], name, value, words.span(p.ci95, p.unit), *ends[1:])
            ends = ("", "", "")
    answer = new_table(None, *words.ANSWER, left=4)
    for row in words.answer_rows(d):
        answer.add_row(*row)
    said = words.sentences(d)
    say(words.headline(d), said, rows, (*d.notes, *notes), d.contradictions, answer)


def say(
    headline: str,
    sentences: Sequence[str],
    rows: Table,
    notes: Sequence[str],
    contradictions: Sequence[Contradiction],
    answer: Table | None = None,
) -> None:
    """Print an answer, flights that contradict the others first; notes are said once each."""
    console = printer()
    for one in contradictions:
        who, *more = words.against(one)
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
