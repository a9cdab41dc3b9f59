"""The answers of `gap` and `identify`: as a page, which is one self-contained HTML file, and in the terminal.

In the terminal stand the limits, the sentences and the table of the page, the headline last.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from inclined_landing.envs.shared.tables import new_table, say, show_table
from inclined_landing.eval.base.claims import Section, Table
from inclined_landing.eval.base.page import of_sections, png
from inclined_landing.eval.gap.answer.identification import Identification
from inclined_landing.eval.gap.report import words
from inclined_landing.eval.gap.report.figures import Track, caption, overview
from inclined_landing.eval.gap.report.files import MJCF, VEHICLE
from inclined_landing.eval.gap.result import Diagnosis, RegimeError

_USE = (
    f"{VEHICLE} is the corrected model for every command of this package; {MJCF} is the same model for "
    f"plain MuJoCo with the plugins. Test a policy on it: landing-eval success landing --vehicle {VEHICLE}. "
    f"Retrain one that fails: landing-train landing --from landing --vehicle {VEHICLE}."
)
_PLANTS = {"analytic": "equations", "mujoco": "MuJoCo"}


def page(d: Diagnosis, track: Track | None, *, versions: dict, notes: Sequence[str] = ()) -> str:
    """Return the HTML page of a diagnosis; track: a flight with predictions, notes: sentences on the logs."""
    change = Section("change", "What to change", words.causes(d), [], [effect_table(d)])
    drawn = {}
    if d.growth:
        change.figures["gap.png"], drawn["gap.png"] = caption(track), overview(d, track)
    if d.effects:
        change.remarks = [_USE]
    sections = [
        change,
        Section("error", "Remaining error", "", [], _error_tables(d)),
        *limits(d, notes, [name for name in d.heldout if name not in d.flights]),
        Section(
            *("probabilities", "Probabilities", "Each is the sum over all sets of effects with it.", []),
            [Table("", ("effect", "probability"), probability_rows(d))],
        ),
    ]
    return fill_in(sections, d, "gap", words.headline(d), words.how_much(d), versions, drawn)


def fill_in(
    sections: Sequence[Section],
    found: Diagnosis | Identification,
    command: str,
    title: str,
    lead: str,
    versions: dict,
    drawn: Mapping[str, Figure] | None = None,
) -> str:
    """Return the page of an answer, without sections and tables that are empty.

    Flights that were set aside or contradict the others come first.
    """
    for one in sections:
        one.tables = [table for table in one.tables if table.rows]
    shown = [one for one in sections if any(one.text) or one.tables or one.figures]
    lead = " ".join([*map(words.set_aside, found.set_aside), *_inconsistencies(found), lead])
    images = {name: png(figure) for name, figure in (drawn or {}).items()}
    return of_sections(
        *(shown, images), title=title, lead=lead, run=f"landing-eval {command}", versions=versions
    )


def _inconsistencies(found: Diagnosis | Identification) -> list[str]:
    return [sentence for one in found.inconsistent_flights for sentence in words.inconsistency(one)]


def effect_table(d: Diagnosis) -> Table:
    """Return the table of what to change; further sizes of an effect are rows of their own."""
    rows = []
    for one in words.answers(d):
        last = (one.how, one.cost)
        for parameter, number, ends in one.sizes:
            rows.append((one.title + f", {parameter}" * bool(parameter), number, ends, *last))
            last = ("", "")
    return Table("", ("effect", "size", "95 % interval", "confidence", "error after 1 s"), rows, 1)


def _error_tables(d: Diagnosis) -> list[Table]:
    """Return the tables of the error one second ahead, and by regime and channel."""
    lengths = []
    for plant, g in d.gap.items():
        known = d.reference.error if d.reference and plant == "analytic" else None
        row = (g.before, g.after, known, g.floor)
        lengths.append((_PLANTS[plant], *("" if x is None else words.centimetres(x) for x in row)))
    heads = ("simulated with", "before", "after", "reference flights", "noise alone")
    ahead = next(iter(d.gap.values())).horizon if d.gap else 1.0
    tables = [Table(f"Position error {ahead:.2g} s ahead", heads, lengths)]
    channels = tuple(dict.fromkeys(row.channel for row in d.where))
    cells = {(row.regime, row.channel): row for row in d.where}
    regimes = [regime for regime in words.REGIMES if any(row.regime == regime for row in d.where)]
    rows = [
        (words.REGIMES[regime], *(_before_after(cells.get((regime, channel))) for channel in channels))
        for regime in regimes
    ]
    caption = (
        "Error within windows of 0.6 s, before → after (noise and disturbances alone); in x, y and z as "
        "acceleration, with the measured attitude"
    )
    return [*tables, Table(caption, ("flights", *channels), rows)]


def _before_after(row: RegimeError | None) -> str:
    """Return the errors of a regime and channel as text."""
    if row is None:
        return ""
    before, after, floor = (words.quantity(x, row.unit) for x in (row.before, row.after, row.floor))
    return f"{before.split()[0]} → {after.split()[0]} ({floor})"


def probability_rows(d: Diagnosis) -> list[tuple]:
    """Return the effects that are named or possible with their probabilities, most probable first."""
    names = dict.fromkeys([*(n for e in d.effects for n in e.members), *d.possible])
    ranked = sorted(names, key=lambda name: -d.probability(name))
    return [(words.label(name), words.probability(d.probability(name))) for name in ranked]


def limits(
    found: Diagnosis | Identification, notes: Sequence[str], heldout: Sequence[str]
) -> tuple[Section, ...]:
    """Return the sections on what limits an answer, and on its flights."""
    evaluated = f"Held out: {', '.join(heldout)}." if heldout else "Each is evaluated by a fit to the others."
    return (
        Section("limits", "Limits", words.notes(found.notes, notes), []),
        Section("flights", "Flights", f"Fitted: {', '.join(found.flights)}. {evaluated}", []),
    )


def show(d: Diagnosis, notes: Sequence[str] = (), report: Path | None = None) -> None:
    """Print limits, sentences, the table of effects and the headline; report: the folder with the page."""
    headline, lines = words.headline(d), [*words.causes(d), words.how_much(d)]
    following = ""
    if report:
        headline += f" The report is {report / 'report.html'}."
        if d.verdict == "undecided" or d.possible or not all(e.sure for e in d.effects):
            following = f"landing-eval plan {report} --out {report.with_name(report.name + '-flight')}"
    print_answer(headline, filter(None, lines), effect_table(d), notes, d, following)


def print_answer(
    headline: str,
    sentences,
    table: Table,
    notes: Sequence[str],
    found: Diagnosis | Identification,
    following: str = "",
) -> None:
    """Print an answer, the notes first and the headline last; repeated notes are removed."""
    say(*(f"Note: {note}" for note in words.notes(found.notes, notes)), style="dim")
    if table.rows:
        printed = new_table(None, *table.heads)
        for row in table.rows:
            printed.add_row(*row)
        show_table(printed)
    say(*sentences)
    say(*map(words.set_aside, found.set_aside), style="bold")
    for one in found.inconsistent_flights:
        who, *more = words.inconsistency(one)
        say(who, style="bold")
        say(*more)
    if following:
        print(f"To plan a more informative flight: {following}")  # whole, to be copied
    say(headline, style="bold")
