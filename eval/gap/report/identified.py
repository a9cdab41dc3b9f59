"""What identification found: page, terminal table and vehicle file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

from inclined_landing.eval.base.style import INK, panel, styled
from inclined_landing.eval.base.tables import new_table, printer
from inclined_landing.eval.gap.answer.identify import PAPER, Identification, Identified
from inclined_landing.eval.gap.report import words
from inclined_landing.eval.gap.report.figures import AFTER, BEFORE, svg
from inclined_landing.eval.gap.report.model import VEHICLE
from inclined_landing.eval.gap.report.page import render
from inclined_landing.models.parameters import write_vehicle

_HEADS = ("constant", "model as it was", "identified", "95 % interval", "between flights", "the paper")


def headline(found: Identification) -> str:
    """How well the identified vehicle follows the flights, in one sentence."""
    text = ", ".join(f"{channel} {_percent(fit['after'])}" for channel, fit in found.fit.items())
    return f"The identified model follows the flights it was not fitted to by {text}."


def sentences(found: Identification) -> list[str]:
    """What the headline leaves out."""
    before = ", ".join(f"{channel} {_percent(fit['before'])}" for channel, fit in found.fit.items())
    said = [
        f"The model as it was: {before}. The paper reports {PAPER['fit']:g} % for the attitude. Fit is "
        "100 % minus the error as a share of the signal's own variation; x, y and z: velocity changes over "
        "1 s, angles: open loop.",
    ]
    best = min(found.alternatives, key=found.alternatives.get)
    others = [
        f"{name} leaves {found.alternatives[name] / max(found.alternatives[best], 1e-12):.2f} times the error"
        for name in found.alternatives
        if name != best
    ]
    if others:
        said.append(f"The thrust is that of the {best}; the {words.listed(others)}.")
    return said


def page(
    found: Identification,
    *,
    heldout: Sequence[str],
    seconds: float,
    versions: dict,
    notes: Sequence[str] = (),
) -> str:
    """The HTML page; heldout: names of the flights kept for the fit in percent."""
    with styled():
        picture = svg(fit_figure(found))
    return render(
        "identify.html.j2",
        command="identify",
        title=headline(found),
        lead=sentences(found),
        figure=picture,
        heads=_HEADS,
        rows=rows(found),
        vehicle=VEHICLE,
        flights=found.flights,
        heldout=heldout,
        notes=(*found.notes, *notes),
        seconds=seconds,
        versions=versions,
    )


def rows(found: Identification) -> list[tuple[str, ...]]:
    """One row of text for each constant."""
    return [
        (
            p.name + (f" ({p.note})" if p.note else ""),
            words.exact(p.before, p.unit),
            words.rounded(p.value, p.ci95, p.unit),
            words.span(p.ci95, p.unit),
            words.exact(float(f"{p.spread:.2g}"), p.unit) if math.isfinite(p.spread) else "",
            words.exact(PAPER[p.field], p.unit) if p.field in PAPER else "",
        )
        for p in found.parameters
    ]


def fit_figure(found: Identification) -> Figure:
    """Fit in percent, every channel, before and after."""
    channels = list(found.fit)
    figure = Figure(figsize=(10.4, 0.42 * len(channels) + 0.9))
    axis = panel(figure, 0.75, 0.5, 8.6, 0.42 * len(channels))
    for k, (what, colour) in enumerate((("before", BEFORE), ("after", AFTER))):
        value = np.array([found.fit[c][what] for c in channels])
        y = np.arange(len(channels)) + (k - 0.5) * 0.36
        axis.barh(y, np.clip(value, 0, 100), 0.34, color=colour, label=what)
        for at, x in zip(y, value):
            axis.text(max(0.0, min(x, 100.0)) + 0.8, at, _percent(x), va="center", fontsize=8)
    axis.axvline(PAPER["fit"], color=INK, linewidth=1.0, linestyle=(0, (2, 2)))
    axis.set(xlim=(0, 104), ylim=(len(channels) - 0.4, -0.6), xlabel="fit [%]")
    axis.set_yticks(range(len(channels)), channels)
    axis.tick_params(axis="y", length=0)
    axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
    return figure


def show(found: Identification, notes: Sequence[str] = (), console: Console | None = None) -> None:
    """Print headline, constants and notes."""
    console = printer(console)
    console.print(headline(found), style="bold")
    for text in sentences(found):
        console.print(text)
    constants = new_table(None, *_HEADS)
    for row in rows(found):
        constants.add_row(*row)
    console.print(constants)
    for note in dict.fromkeys((*found.notes, *notes)):
        console.print(f"Note: {words.plain(note)}", style="dim")


def write(found: Identification, folder: Path, *, base: Path | None = None) -> None:
    """Write vehicle.toml into `folder`; base: the vehicle file identification started from."""
    by_field: dict[str, list[Identified]] = {}
    for p in found.parameters:
        by_field.setdefault(p.field, []).append(p)
    sources = {
        field: f"identified by landing-eval identify from {len(found.flights)} flights"
        + "".join(f"; {p.name} {words.span(p.ci95, p.unit)}, 95 % interval" for p in by_field.get(field, []))
        for field in found.fields
    }
    write_vehicle(
        folder / VEHICLE,
        found.vehicle,
        sources,
        found.fields,
        base=base,
        heading=f"Identified by landing-eval identify, thrust as the {found.thrust}.\n"
        "Every command takes it with --vehicle.",
    )


def _percent(fit: float) -> str:
    return (f"{fit:.1f} %" if abs(fit) < 100 else f"{fit:.0f} %") if math.isfinite(fit) else "not known"
