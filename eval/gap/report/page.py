"""The answers of `gap` and `identify`: as a page, which is one self-contained HTML file, and in the terminal.

In the terminal stand the limits, the sentences and the table of the page, the headline last. The figure of
gap's page shows predictions along a flight, and the error as the effects are added.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from inclined_landing.envs.shared.tables import new_table, say, show_table
from inclined_landing.eval.base.claims import Section, Table
from inclined_landing.eval.base.colours import BLUE, GREEN, INK, ORANGE, PURPLE, RULE
from inclined_landing.eval.base.options import FlightSource
from inclined_landing.eval.base.page import of_sections, png
from inclined_landing.eval.gap.answer import rollout
from inclined_landing.eval.gap.answer.identification import Identification
from inclined_landing.eval.gap.measured.usable import ReadFlights
from inclined_landing.eval.gap.measured.windows import NEAR, prepare
from inclined_landing.eval.gap.report import words
from inclined_landing.eval.gap.report.files import MJCF, VEHICLE
from inclined_landing.eval.gap.result import HORIZON, Diagnosis
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.vehicle import Vehicle

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_USE = (
    f"{VEHICLE} is the corrected model for every command of this package; {MJCF} is the same model for "
    f"plain MuJoCo with the plugins. Test a policy on it: landing-eval success landing --vehicle {VEHICLE}. "
    f"Retrain one that fails: landing-train landing --from landing --vehicle {VEHICLE}."
)
_PLANTS = {"analytic": "equations", "mujoco": "MuJoCo"}
BEFORE, AFTER = ORANGE, GREEN
BETWEEN = (PURPLE, BLUE, "#56b4e9", "#8a8f98", "#c9b458")
WIDTH = 7.4  # inches
SMALL = 0.1  # of the motion, error of predictions that are drawn as such


def page(
    d: Diagnosis,
    track: Track | None,
    images: Mapping[str, bytes] = MappingProxyType({}),
    *,
    versions: dict,
    notes: Sequence[str] = (),
) -> str:
    """Return the HTML page of a diagnosis.

    track: the flight that its figure shows; images: those of `figures`; notes: sentences on the logs.
    """
    change = Section("change", "What to change", words.causes(d), tables=[effect_table(d)])
    change.figures = dict.fromkeys(images, caption(track))
    change.remarks = [_USE] if d.effects else []
    sections = [
        change,
        Section("error", "Remaining error", tables=[_error_table(d)]),
        *limits(d, notes, [name for name in d.heldout if name not in d.flights]),
    ]
    return build_page(sections, d, "gap", words.headline(d), words.how_much(d), versions, images)


def build_page(
    sections: Sequence[Section],
    found: Diagnosis | Identification,
    command: str,
    title: str,
    lead: str,
    versions: dict,
    images: Mapping[str, bytes] = MappingProxyType({}),
) -> str:
    """Return the page of an answer, without sections and tables that are empty.

    Flights that were set aside or contradict the others come first. images: PNG files by name.
    """
    for one in sections:
        one.tables = [table for table in one.tables if table.rows]
    shown = [one for one in sections if any(one.text) or one.tables or one.figures]
    contradictions = [line for one in found.inconsistent_flights for line in words.inconsistency(one)]
    lead = " ".join([*map(words.set_aside, found.set_aside), *contradictions, lead])
    run = f"landing-eval {command}"
    return of_sections(shown, images, title=title, lead=lead, run=run, versions=versions)


def effect_table(d: Diagnosis) -> Table:
    """Return the table of what to change; further sizes of an effect are rows of their own."""
    rows = []
    for one in words.answers(d):
        for k, size in enumerate(one.sizes):
            named = one.title + f", {size.parameter}" * bool(size.parameter)
            of_effect = (one.how, one.cost) if k == 0 else ("", "")
            rows.append((named, size.value, size.interval, *of_effect))
    return Table("", ("effect", "size", "95 % interval", "confidence", "error after 1 s"), rows, labels=1)


def _error_table(d: Diagnosis) -> Table:
    """Return the table of the error one second ahead in each plant."""
    rows = []
    for plant, g in d.gap.items():
        known = d.reference.error if d.reference and plant == "analytic" else None
        lengths = (g.before, g.after, known, g.floor)
        rows.append((_PLANTS[plant], *("" if x is None else words.centimetres(x) for x in lengths)))
    heads = ("simulated with", "before", "after", "reference flights", "noise alone")
    return Table("Position error one second ahead", heads, rows)


def limits(
    found: Diagnosis | Identification, notes: Sequence[str], heldout: Sequence[str]
) -> tuple[Section, ...]:
    """Return the sections on what limits an answer, and on its flights."""
    evaluated = f"Held out: {', '.join(heldout)}." if heldout else "Each is evaluated by a fit to the others."
    return (
        Section("limits", "Limits", words.notes(found.notes, notes)),
        Section("flights", "Flights", f"Fitted: {', '.join(found.flights)}. {evaluated}"),
    )


def write_report(
    folder: Path,
    command: str,
    html: str,
    answer: dict,
    source: FlightSource,
    began: float,
    versions: dict,
    images: Mapping[str, bytes] = MappingProxyType({}),
) -> None:
    """Write report.html with its figures, report.json and run.json: the command, options, time, versions."""
    for name, image in images.items():
        storage.write_bytes(folder / name, image)
    storage.write_text(folder / "report.html", html)
    storage.write_json(folder / "report.json", answer)
    statistics = {"seconds": round(time.monotonic() - began, 1), "versions": versions}
    storage.write_json(folder / "run.json", {"command": command, **dataclasses.asdict(source), **statistics})


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


@dataclasses.dataclass(frozen=True)
class Track:
    """Measured positions of one flight and open-loop predictions along it."""

    flight: str
    held_out: bool  # of the fit
    t: np.ndarray  # (m,) s
    position: np.ndarray  # (m, 3) m, measured
    times: tuple[np.ndarray, ...]  # of every prediction, (k,) s
    before: tuple[np.ndarray, ...]  # (k, 3) m, nominal vehicle
    after: tuple[np.ndarray, ...]  # (k, 3) m, corrected vehicle

    @property
    def worst_axis(self) -> int:
        """Return the coordinate (0, 1, 2) of the largest errors of the nominal vehicle."""
        missed = np.zeros(3)
        for t, p in zip(self.times, self.before):
            end = [np.interp(t[-1], self.t, self.position[:, k]) for k in range(3)]
            missed += (p[-1] - end) ** 2
        return int(np.argmax(missed))


def shown_flight(d: Diagnosis, before: Vehicle, flights: ReadFlights) -> Track | None:
    """Return predictions along one of the flights judged on; None where no stretch of it is long enough.

    before: the vehicle diagnosed. The flight has the largest range of heights, of those near the floor if
    there are any.
    """

    def key(log: FlightLog) -> tuple[bool, float]:
        height = log.position[:, 2]
        return bool(np.nanmin(height) < NEAR), float(np.ptp(height))

    log = max((x for x in flights.heldout or flights.logs if x.name in d.heldout), key=key)
    flight = prepare(log, before, platform=d.platform)
    try:
        starts = rollout.RolloutWindows.of([flight])
    except UserError:
        return None
    poses = [rollout.simulate(starts, vehicle)[..., :3] for vehicle in (before, d.corrected)]
    part = slice(starts.first[0], starts.first[-1] + starts.rows + 1)
    return Track(
        flight=log.name,
        held_out=bool(flights.heldout),
        t=flight.t[part],
        position=flight.position[part],
        times=tuple(flight.t[a : a + starts.rows + 1] for a in starts.first),
        before=tuple(poses[0]),
        after=tuple(poses[1]),
    )


def _draw_predictions(axis: Axes, one: Track, after: bool) -> None:
    """Draw the coordinate of the largest error before the correction, and predictions before or after it.

    Where these errors are small compared with the motion, they are drawn themselves.
    """
    k = one.worst_axis
    measured = [np.interp(t, one.t, one.position[:, k]) for t in one.times]
    errors = np.concatenate([p[:, k] - x for x, p in zip(measured, one.before)])
    span = max(np.ptp(one.position[:, k]), 0.1)
    small = bool(np.abs(errors).max(initial=0.0) < SMALL * span)
    position = np.zeros(len(one.t)) if small else one.position[:, k]
    factor, colour = 100.0 if small else 1.0, AFTER if after else BEFORE
    predicted = [
        [p[:, k] - x if small else p[:, k] for x, p in zip(measured, which)]
        for which in (one.before, one.after)
    ]
    axis.plot(one.t, factor * position, color=INK, linewidth=3.0, label="measured")
    for j, (t, p) in enumerate(zip(one.times, predicted[after])):
        label = None if j else f"predicted {HORIZON:g} s ahead"
        axis.plot(t, factor * p, color=colour, linewidth=1.5, label=label)
        axis.plot(t[-1], factor * p[-1], "o", color=colour, markersize=3)
    # The axis shows the whole measurement, and predictions up to 0.8 times its range beyond.
    reach = np.concatenate([p for which in predicted for p in which])
    low, high, far = position.min(), position.max(), math.inf if small else 0.8 * span
    ends = max(low - far, min(low, reach.min())), min(high + far, max(high, reach.max()))
    margin = 0.04 * (ends[1] - ends[0])
    axis.set(xlim=(one.t[0], one.t[-1]), ylim=(factor * (ends[0] - margin), factor * (ends[1] + margin)))
    axis.set_xlabel("time [s]")
    axis.set_ylabel(f"error in {'xyz'[k]} [cm]" if small else f"{'xyz'[k]} [m]", labelpad=2)
    axis.grid()
    axis.set_title("corrected model" if after else "model before", loc="left", pad=22, fontweight="bold")
    axis.legend(loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=2, borderpad=0.1, columnspacing=1.2)


def draw_growth(axis: Axes, d: Diagnosis) -> None:
    """Draw the position error against the horizon as effects are added, their names at its right end."""
    assert d.growth is not None
    horizon, errors, floor = d.growth.horizon, d.growth.errors, d.growth.floor
    middle = (BETWEEN[k % len(BETWEEN)] for k in range(len(errors) - 2))
    colours = [BEFORE, *middle, AFTER][: len(errors)]
    ends = []
    for k, (name, colour) in enumerate(zip(errors, colours)):
        error = errors[name]
        axis.plot(horizon, 100 * error, color=colour, linewidth=2.2, zorder=3 + k)
        text = f"+ {name.replace('_', ' ')}" if name else "model before"
        ends.append(_CurveEnd(100 * error[-1], f"{text}  {words.centimetres(error[-1])}", colour))
    axis.plot(horizon, 100 * floor, color=INK, linewidth=1.3, linestyle=(0, (1, 1.6)), zorder=3)
    axis.fill_between(horizon, 0, 100 * floor, color=RULE, alpha=0.6, linewidth=0)
    ends.append(_CurveEnd(100 * floor[-1], f"noise alone  {words.centimetres(floor[-1])}", INK))
    if engine := d.gap.get("mujoco"):
        look: dict[str, Any] = {"color": "white", "markeredgewidth": 1.6, "markersize": 5.5}
        look |= {"zorder": 20, "clip_on": False}
        text = "the same windows simulated in MuJoCo"
        axis.plot(horizon[-1], 100 * engine.before, "D", markeredgecolor=BEFORE, label=text, **look)
        axis.plot(horizon[-1], 100 * engine.after, "D", markeredgecolor=AFTER, **look)
        axis.legend(loc="upper left", handletextpad=0.2)
    top = 1.06 * max(end.height for end in ends)
    axis.set(xlim=(0, horizon[-1]), ylim=(0, top), xlabel="horizon [s]", ylabel="position error [cm, RMS]")
    axis.grid(axis="y")
    _name_ends(axis, ends, top)


class _CurveEnd(NamedTuple):
    """The right end of a curve, and its name."""

    height: float
    text: str
    colour: str


def _name_ends(axis: Axes, ends: Sequence[_CurveEnd], top: float) -> None:
    """Write names right of the axes at the height of their curves, without overlaps."""
    figure = axis.get_figure(root=True)
    assert figure is not None
    least = 0.17 / (axis.get_position().height * figure.get_figheight()) * top  # a line of text is 0.17 in
    ends = sorted(ends, key=lambda end: end.height)
    heights = [end.height for end in ends]
    for k in range(1, len(heights)):
        heights[k] = max(heights[k], heights[k - 1] + least)
    beside = axis.get_yaxis_transform()
    for height, end in zip(heights, ends):
        arrow = {"arrowstyle": "-", "color": end.colour, "linewidth": 0.7, "shrinkA": 1, "shrinkB": 0}
        axis.annotate(
            end.text,
            xy=(1.0, end.height),
            xytext=(1.035, height),
            xycoords=beside,
            textcoords=beside,
            arrowprops=arrow | {"relpos": (0, 0.5)},
            fontsize=8.5,
            color=end.colour,
            va="center",
        )


def figures(d: Diagnosis, track: Track | None) -> dict[str, bytes]:
    """Return the figures of the page as PNG files by name; none where no flight has a usable second."""
    return {"gap.png": png(overview(d, track))} if d.growth else {}


def overview(d: Diagnosis, one: Track | None) -> Figure:
    """Return a flight with predictions before and after the correction, above the error by horizon."""
    from matplotlib.figure import Figure  # here, as the page of `identify` has no figure

    from inclined_landing.eval.base.style import panel, styled

    below = 3.2
    with styled():
        figure = Figure(figsize=(WIDTH, below + (2.9 if one else 0.0)))
        draw_growth(panel(figure, 0.75, 0.55, WIDTH - 3.0, 2.4), d)
        if one:
            for k in range(2):
                left = 0.75 + 0.5 * WIDTH * k
                _draw_predictions(panel(figure, left, below + 0.5, 0.5 * WIDTH - 0.9, 1.8), one, bool(k))
    return figure


def caption(one: Track | None) -> str:
    """Return the caption of `overview`."""
    text = "Position error on flights not fitted, as the effects are added."
    if one is None:
        return text
    part = "held out" if one.held_out else "part of the fit"
    return (
        f"Above: {one.flight}, {part}. Every {rollout.EVERY:g} s a prediction starts from the "
        f"measured state, driven by the commands alone. Below: {text[0].lower()}{text[1:]}"
    )
