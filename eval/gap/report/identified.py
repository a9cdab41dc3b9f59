"""The results of an identification: page, terminal table and vehicle file."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.patches import Patch

from inclined_landing.envs.shared.tables import new_table
from inclined_landing.eval.base.page import svg
from inclined_landing.eval.base.style import BLUE, MUTED, panel, styled
from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.answer.identification import PAPER, Identification, Identified
from inclined_landing.eval.gap.model.reference import VehiclePosterior, posterior_path
from inclined_landing.eval.gap.report import numbers, words
from inclined_landing.eval.gap.report.figures import AFTER, BEFORE, name_rows
from inclined_landing.eval.gap.report.files import VEHICLE, disturbance_fields, rounded, rounded_fields
from inclined_landing.eval.gap.report.page import print_answer, render
from inclined_landing.models.base import storage
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import load_vehicle, write_vehicle
from inclined_landing.models.vehicle import Vehicle

_HEADS = ("constant", "nominal", "identified", "95 % interval", "between flights")


def headline(found: Identification) -> str:
    """Return how many constants differ from the nominal model, or in what the nominal one is better."""
    if found.worse:
        grown = [
            f"{axis} ({words.centimetres(after)}, before {words.centimetres(before)})"
            for axis, (before, after) in found.worse.items()
        ]
        return (
            f"One second ahead, the identified vehicle predicts {words.listed(grown)} worse than the nominal "
            "one; gap doubts effects that act there and move the vehicle by less."
        )
    n, changed = len(found.parameters), len(changed_parameters(found))
    return f"{changed or 'None'} of {n} constants differ{'s' * (changed == 1)} from the nominal model."


def sentences(found: Identification) -> list[str]:
    """Return the constants that differ, the errors of both models, and which flights would help."""
    values = [
        f"{words.label(p.name)} {numbers.rounded(p.value, p.ci95, p.unit)} "
        f"(nominal {numbers.exact(p.before, p.unit)})"
        for p in changed_parameters(found)
    ]
    fits = [
        f"{channel} {_percent(fit['after'])} (nominal {_percent(fit['before'])})"
        for channel, fit in found.fit.items()
    ]
    those = "These constants differ" if len(values) > 1 else "This constant differs"
    lines = [f"{those}: {words.listed(values)}."] if values else []
    paper = f"The paper reports {PAPER['fit']:g} % for the attitude."
    lines.append(f"Fit on held-out flights: {', '.join(fits)}. {paper}")
    if found.ahead:
        before, after, floor = (words.centimetres(found.ahead[n]) for n in ("before", "after", "floor"))
        lines.append(
            f"Position error one second ahead on these: {after} (nominal {before}, noise alone {floor})."
        )
    if found.kept:
        kept = words.listed([words.label(name) for name in found.kept])
        lines.append(f"Left unchanged, because fitting them made predictions of other flights worse: {kept}.")
    helpful = missing_flights(found)
    if found.worse and not helpful:
        helpful = ["More and longer flights of all kinds would help."]
    return lines + helpful


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
            better = words.listed([words.label(n) for n in LIBRARY if n in names])
            lines.append(f"{text} to identify {better} better; these flights contain little of it.")
    return lines


def changed_parameters(found: Identification) -> list[Identified]:
    """Return the constants whose 95 % interval excludes the nominal value."""
    return [p for p in found.parameters if not p.ci95[0] <= p.before <= p.ci95[1]]


IDENTIFIABLE = ("effect", "standard error", "confounded with", "excited by")


def identifiable_rows(found: Identification) -> list[tuple[str, str, str, str]]:
    """Return one row of text for each effect: standard error, confounded effects, exciting regimes."""
    rows = []
    for one in found.identifiable:
        confounded = [words.label(name) for name in one.confounded[: words.NAMES]]
        regimes = [words.REGIMES[r] for r in one.regimes]
        share = f"{min(one.share, 1.0):.0%}".replace("%", " %")
        rows.append(
            (words.label(one.effect), share, words.listed(confounded, "or"), words.listed(regimes, "or"))
        )
    return rows


def identifiability(found: Identification) -> Figure:
    """Return the figure of the standard errors of all effects, over their prior standard deviations."""
    n = len(found.identifiable)
    with styled():
        figure = Figure(figsize=(6.2, 0.2 * n + 0.9))
        axis = panel(figure, 2.1, 0.5, 4.0, 0.2 * n)
        for k, one in enumerate(found.identifiable):
            colour = AFTER if one.share <= thresholds.ROUGH else BLUE
            colour = BEFORE if one.share > thresholds.UNIDENTIFIABLE else colour
            axis.barh(k, min(one.share, 1.0), color=colour, height=0.62)
        axis.axvline(thresholds.ROUGH, color=MUTED, linewidth=0.8, linestyle=(0, (2, 2)))
        axis.set(xlim=(0.0, 1.0), xlabel="standard error / prior standard deviation")
        name_rows(axis, [words.label(one.effect) for one in found.identifiable], 8.5)
        axis.grid(axis="x")
        looks = (("well identified", AFTER), ("roughly", BLUE), ("not identifiable", BEFORE))
        handles = [Patch(color=colour, label=text) for text, colour in looks]
        axis.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, borderpad=0.1)
    return figure


def page(
    found: Identification,
    *,
    heldout: Sequence[str],
    seconds: float,
    versions: dict,
    notes: Sequence[str] = (),
) -> str:
    """Return the HTML page; heldout: names of the flights held out for the fit in percent."""
    return render(
        "identify.html.j2",
        found,
        command="identify",
        title=headline(found),
        lead=sentences(found),
        identifiable=identifiable_rows(found),
        identifiable_heads=IDENTIFIABLE,
        identifiability=svg(identifiability(found)),
        percent=_percent,
        paper=PAPER["fit"],
        heads=_HEADS,
        rows=rows(found.parameters),
        changed=rows(changed_parameters(found)),
        heldout=heldout,
        notes=notes,
        seconds=seconds,
        versions=versions,
    )


def rows(parameters: Sequence[Identified]) -> list[tuple[str, ...]]:
    """Return one row of text for each constant."""
    return [
        (
            words.label(p.name) + (f" ({p.note})" if p.note else ""),
            numbers.exact(p.before, p.unit),
            numbers.rounded(p.value, p.ci95, p.unit),
            numbers.interval(p.ci95, p.unit),
            numbers.quantity(p.spread, p.unit) if math.isfinite(p.spread) else "",
        )
        for p in parameters
    ]


def show(found: Identification, notes: Sequence[str] = (), vehicle: Path | None = None) -> None:
    """Print constants, notes and headline; vehicle: the file that was written."""
    constants = new_table(None, *_HEADS)
    for row in rows(found.parameters):
        constants.add_row(*row)
    answer = headline(found)
    if vehicle is not None:
        answer += f" The vehicle file is {vehicle}."
    print_answer(answer, sentences(found), constants, notes, found)


def write(found: Identification, folder: Path, *, base: Path | None = None) -> None:
    """Write vehicle.toml and its posterior into `folder`; base: the vehicle file that it started from."""
    heading = "Identified by landing-eval identify.\nEvery command accepts it with --vehicle."
    write_vehicle(folder / VEHICLE, *described(found), base=base, heading=heading)
    write_posterior(folder / VEHICLE, found.reference)


def write_posterior(vehicle: Path, reference: VehiclePosterior) -> None:
    """Write the posterior of an identified vehicle next to its file."""
    text = json.dumps(reference.to_json(load_vehicle(vehicle)), allow_nan=False, separators=(",", ":"))
    storage.write_text(posterior_path(vehicle), text + "\n")


def described(found: Identification) -> tuple[Vehicle, dict[str, str], dict[str, Any]]:
    """Return the vehicle with its flights' disturbance; sources and uncertainties of what was fitted."""
    by_field: dict[str, list[Identified]] = {}
    for p in found.parameters:
        by_field.setdefault(p.field, []).append(p)
    sources = {
        field: f"identified by landing-eval identify from {len(found.flights)} flights"
        + "".join(
            f"; {p.name} {numbers.interval(p.ci95, p.unit)}, 95 % interval" for p in by_field.get(field, [])
        )
        for field in found.fields
    }
    disturbance, widths = disturbance_fields(found.disturbance)
    lines = f"estimated by landing-eval identify from {len(found.flights)} flights"
    return (
        dataclasses.replace(rounded_fields(found.vehicle, found.fields), **disturbance),
        sources | dict.fromkeys(disturbance, lines),
        {field: rounded(width) for field, width in found.fields.items()} | widths,
    )


def _percent(fit: float) -> str:
    return (f"{fit:.1f} %" if abs(fit) < 100 else f"{fit:.0f} %") if math.isfinite(fit) else "not known"
