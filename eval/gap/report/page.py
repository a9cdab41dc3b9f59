"""The page: one HTML file with everything inside."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from inclined_landing.eval.base import page as base_page
from inclined_landing.eval.base.style import styled
from inclined_landing.eval.gap.report import figures, words
from inclined_landing.eval.gap.report.model import MJCF, VEHICLE
from inclined_landing.eval.gap.report.tracks import Track
from inclined_landing.eval.gap.result import Diagnosis, NamedEffect, PlantGap
from inclined_landing.models.effects import LIBRARY


def page(
    d: Diagnosis, track: Track | None, *, versions: dict, notes: Sequence[str] = (), library=LIBRARY
) -> str:
    """The HTML page of a diagnosis.

    track: one flight with predictions along it. notes: sentences on the logs.
    """
    with styled():
        sections = {
            "Where the model is wrong": _where(d),
            "Which effect it is": _name(d),
            "What is added to the model": _add(d, library),
            "What it is worth": _show(d, track),
            "What is left": _left(d),
        }
    return render(
        sections,
        command="gap",
        headline=words.headline(d),
        lead=[words.gap("analytic", d.gap["analytic"])] if "analytic" in d.gap else [],
        cards=[_card(effect) for effect in d.effects],
        manoeuvre=words.manoeuvre(d),
        bars=[_bars(plant, g) for plant, g in d.gap.items()],
        remainder=words.plain(d.remainder.text),
        flights=d.flights,
        heldout=[name for name in d.heldout if name not in d.flights],
        notes=[words.plain(note) for note in dict.fromkeys((*d.notes, *notes))],
        seconds=sum(d.seconds.values()),
        versions=versions,
    )


def render(sections: dict[str, list[dict]], *, headline: str, seconds: float, **head) -> str:
    """The template filled in: {heading: blocks} and what stands above and below them."""
    empty = {"cards": [], "manoeuvre": "", "bars": [], "remainder": ""}
    shown = [{"title": title, "blocks": blocks} for title, blocks in sections.items() if blocks]
    content = empty | head | {"title": headline, "sections": shown, "seconds": f"{seconds:.1f}"}
    return base_page.render(__package__, "report.html.j2", **content)


# ---- the parts of a section


def text_block(text: str) -> dict:
    return {"kind": "text", "text": text}


def figure_block(figure: Figure | None, caption: str) -> list[dict]:
    return [] if figure is None else [{"kind": "figure", "data": figures.svg(figure), "caption": caption}]


def table_block(heads: Sequence[str], numbers: Sequence[str], rows: Sequence[Sequence]) -> dict:
    return {"kind": "table", "heads": heads, "numbers": numbers, "rows": rows}


# ---- the head


def _card(effect: NamedEffect) -> dict:
    says = words.says(effect)
    lines = []
    for name, p in effect.parameters.items():
        of = "" if len(effect.parameters) == 1 else f" of {words.label(name)}"
        lines.append(f"95 % interval{of}: {words.interval(p)}.")
    lines.append(f"Closes {words.share(effect.gain)} of the error that can be closed, on flights left out.")
    return {
        "title": words.label(effect.name),
        "says": says[0].upper() + says[1:] + ".",
        "lines": lines + ([words.plain(effect.note)] if effect.note else []),
        "tie": words.tie(effect),
        "remedy": words.plain(effect.remedy),
    }


def _bars(plant: str, g: PlantGap) -> dict:
    top = max(g.before, g.after, g.floor, 1e-9)
    rows = (
        ("before", g.before, figures.BEFORE),
        ("after", g.after, figures.AFTER),
        ("noise alone", g.floor, "#9aa5b1"),
    )
    return {
        "name": words.PLANTS.get(plant, plant),
        "horizon": f"{g.horizon:g} s",
        "bars": [
            {
                "name": name,
                "width": f"{80 * metres / top:.2f}",
                "colour": colour,
                "text": words.centimetres(metres),
            }
            for name, metres, colour in rows
        ],
    }


# ---- the sections


def _where(d: Diagnosis) -> list[dict]:
    if not d.where:
        return []
    return [
        text_block(
            "What the model missed in windows of 0.6 s, by what the vehicle was doing and by channel. Pale "
            "is the measurement noise, dark is many times the noise."
        ),
        *figure_block(
            figures.where_map(d.where),
            "Root mean square over windows (their number in brackets) of flights left out. x, y, z: the "
            "constant acceleration that the error looks like, attitude as measured. Angles: at the end of a "
            "window, simulated from the commands.",
        ),
    ]


def _name(d: Diagnosis) -> list[dict]:
    return [
        text_block(
            "Each known effect is tried in the simulator and judged by the error it closes on flights it was "
            "not fitted to. The best that passes every check is added, and the search goes on with what is "
            "left."
        ),
        *figure_block(
            figures.ranking(d.steps),
            "Dark blue: added. Light blue: cannot be told apart from it on these flights. Grey: not added, "
            "and why.",
        ),
    ]


def _add(d: Diagnosis, library) -> list[dict]:
    if not d.effects:
        return []
    rows = []
    for effect in d.effects:
        for k, (name, p) in enumerate(effect.parameters.items()):
            value = words.rounded(p.value, p.ci95, p.unit)
            row = (name, value, words.interval(p), words.exact(p.neutral, p.unit))
            first, last = ("", "") if k else (words.label(effect.name), library[effect.name].formula)
            rows.append((first, *row, last))
    heads = ("effect", "parameter", "value", "95 % interval", "model as it was", "formula")
    return [
        table_block(heads, ("value", "95 % interval", "model as it was"), rows),
        *figure_block(
            figures.estimates(d.effects, d.flights),
            "Each flight fitted alone (points with 95 % intervals), all flights together (blue line and "
            "band), and the model as it was (dashed). An effect that is real has one value in all flights.",
        ),
        text_block(
            f"{VEHICLE} is the corrected model for every command of this package, {MJCF} the same for plain "
            "MuJoCo, with its plugins."
        ),
        {"kind": "code", "text": f"landing-eval success landing --vehicle {VEHICLE}"},
    ]


def _show(d: Diagnosis, track: Track | None) -> list[dict]:
    blocks = []
    if d.horizon:
        blocks += figure_block(
            figures.horizon(d.horizon, d.gap),
            "Error of a simulation that gets the measured start state and then only the commands, against "
            "how far it looks ahead, as the effects are added. Shaded: what the measurement noise makes.",
        )
    if track is not None:
        blocks += figure_block(
            figures.track(track),
            f"Every {track.every:g} s a simulation starts from the measured state with the commands only.",
        )
    return blocks + figure_block(
        figures.window_curves(d.windows),
        "For four regimes the window that the model missed most: the coordinate and the angle with the "
        "largest error.",
    )


def _left(d: Diagnosis) -> list[dict]:
    return figure_block(
        figures.remainder(d.remainder),
        "Left: error beyond the noise, beside the size that counts as nothing (dashed). Right: what it "
        "depends on, if on anything that was logged.",
    )
