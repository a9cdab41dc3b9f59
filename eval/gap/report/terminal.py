"""A diagnosis in the terminal: the first lines of the page and a small table."""

from __future__ import annotations

from rich.console import Console

from inclined_landing.eval.base.tables import new_table, printer
from inclined_landing.eval.gap.report import words
from inclined_landing.eval.gap.result import Diagnosis


def show(d: Diagnosis, notes: tuple[str, ...] = (), console: Console | None = None) -> None:
    """Print verdict, effects, ties, remedies, gap and limits."""
    console = printer(console)
    console.print(words.headline(d), style="bold")
    for text in words.sentences(d):
        console.print(text)
    if d.effects:
        rows = new_table(None, "effect", "parameter", "value", "95 % interval", "closes", left=2)
        for effect in d.effects:
            for k, (name, p) in enumerate(effect.parameters.items()):
                rows.add_row(
                    words.label(effect.name) if k == 0 else "",
                    name,
                    words.rounded(p.value, p.ci95, p.unit),
                    words.span(p.ci95, p.unit),
                    words.share(effect.gain) if k == 0 else "",
                )
        console.print(rows)
    for note in dict.fromkeys((*d.notes, *notes)):
        console.print(f"Note: {words.plain(note)}", style="dim")
