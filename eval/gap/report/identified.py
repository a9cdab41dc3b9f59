"""The answer of `identify` in sentences, as a page and as a table in the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from inclined_landing.eval.base.claims import Section, Table
from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.answer.identification import Identification, Identified
from inclined_landing.eval.gap.report import words
from inclined_landing.eval.gap.report.page import build_page, limits, print_answer
from inclined_landing.models.effects import LIBRARY


def headline(found: Identification) -> str:
    """Return how many constants differ from the nominal model."""
    n, changed = len(found.parameters), len(changed_parameters(found))
    return f"{changed or 'None'} of {n} constants differ{'s' * (changed == 1)} from the nominal model."


def sentences(found: Identification) -> list[str]:
    """Return the constants that differ, the errors of both models, and which flights would help."""
    values = [
        f"{words.label(p.name)} {words.rounded(p.value, p.ci95, p.unit)} "
        f"(nominal {words.exact(p.before, p.unit)})"
        for p in changed_parameters(found)
    ]
    those = "These constants differ" if len(values) > 1 else "This constant differs"
    lines = [f"{those}: {words.listed(values)}."] if values else []
    if found.ahead:
        before, after, floor = (words.centimetres(found.ahead[n]) for n in ("before", "after", "floor"))
        lines.append(
            f"Position error one second ahead on flights not fitted: {after} (nominal {before}, noise alone "
            f"{floor})."
        )
    if found.kept:
        kept = words.labels(found.kept)
        lines.append(f"Left unchanged, because fitting them made predictions of other flights worse: {kept}.")
    return lines + missing_flights(found)


# What excites the effects of a regime.
_FLIGHTS = {
    "hover": "Hover at several headings",
    "climb": "Climb and descend fast",
    "lateral": "Fly sideways both slowly and fast",
    "attitude_step": "Command steps of roll and pitch",
    "near_surface": "Hover at several heights above the floor",
    "low_battery": "Fly with a full and with a half-empty battery",
}


def missing_flights(found: Identification) -> list[str]:
    """Return a sentence on every regime that the flights lack: which effects it would identify better."""
    rough = [o.effect for o in found.identifiable if o.share > thresholds.ROUGH]
    rough, lines = [n for n in rough if not LIBRARY[n].told_by], []
    for regime, text in _FLIGHTS.items():
        names = {n for n in rough if regime in LIBRARY[n].regimes}
        if names and found.regimes[regime] < thresholds.FLOWN:
            if len(names) > 1:  # what is confounded with them is told from them as well
                names |= {n for n in rough if not names.isdisjoint(LIBRARY[n].confused_with)}
            better = words.labels(n for n in LIBRARY if n in names)
            lines.append(f"{text} to identify {better} better; these flights contain little of it.")
    return lines


def changed_parameters(found: Identification) -> list[Identified]:
    """Return the constants whose 95 % interval excludes the nominal value."""
    return [p for p in found.parameters if not p.ci95[0] <= p.before <= p.ci95[1]]


def identifiable_rows(found: Identification) -> list[tuple[str, str, str, str]]:
    """Return one row of text for each effect: standard error, confounded effects, exciting regimes."""
    rows = []
    for one in found.identifiable:
        confounded = words.labels(one.confounded[: words.NAMES], "or")
        regimes = words.listed([words.REGIME_LABELS[r] for r in one.regimes], "or")
        share = f"{min(one.share, 1.0):.0%}".replace("%", " %")
        rows.append((words.label(one.effect), share, confounded, regimes))
    return rows


def page(found: Identification, *, heldout: Sequence[str], versions: dict, notes: Sequence[str] = ()) -> str:
    """Return the HTML page; heldout: names of the flights held out."""
    identifiable = (
        "Standard error of each effect, fitted jointly with all others, over its prior standard deviation: "
        "at 100 % the flights do not excite it at all. Flights of the last column would identify it better."
    )
    heads = ("effect", "standard error", "confounded with", "excited by")
    shown = Table("", heads, identifiable_rows(found))
    sections = [
        Section("differ", "Constants that differ", tables=[_table(changed_parameters(found))]),
        *limits(found, notes, heldout),
        Section("constants", "All constants", tables=[_table(found.parameters)]),
        Section("identifiable", "What these flights identify", identifiable, tables=[shown]),
    ]
    return build_page(sections, found, "identify", headline(found), " ".join(sentences(found)), versions)


def _table(parameters: Sequence[Identified]) -> Table:
    """Return the table of constants; between flights: the standard deviation beyond what noise explains."""
    heads = ("constant", "nominal", "identified", "95 % interval", "between flights")
    rows = [
        (
            words.label(p.name) + (f" ({p.note})" if p.note else ""),
            words.exact(p.before, p.unit),
            words.rounded(p.value, p.ci95, p.unit),
            words.interval(p.ci95, p.unit),
            words.quantity(p.spread, p.unit) if math.isfinite(p.spread) else "",
        )
        for p in parameters
    ]
    return Table("", heads, rows, 1)


def show(found: Identification, notes: Sequence[str] = (), vehicle: Path | None = None) -> None:
    """Print constants, notes and headline; vehicle: the file that was written."""
    answer = headline(found) + (f" The vehicle file is {vehicle}." if vehicle else "")
    print_answer(answer, sentences(found), _table(found.parameters), notes, found)
