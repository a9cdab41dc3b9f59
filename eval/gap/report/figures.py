"""The figures of a diagnosis. Each `draw_*` draws on given axes; the others return a whole figure."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, to_hex
from matplotlib.figure import Figure

from inclined_landing.eval.base.style import (
    BLUE,
    GREEN,
    INK,
    MUTED,
    ORANGE,
    PURPLE,
    RULE,
    literal,
    panel,
)
from inclined_landing.eval.gap.answer import rollout
from inclined_landing.eval.gap.flights.windows import NEAR, prepare
from inclined_landing.eval.gap.report.numbers import shown
from inclined_landing.eval.gap.report.words import REGIMES, centimetres, label
from inclined_landing.eval.gap.report.words import axis as axis_of
from inclined_landing.eval.gap.result import (
    Diagnosis,
    HorizonCurve,
    NamedEffect,
    PlantGap,
    RegimeError,
    ResidualAnalysis,
)
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.vehicle import Vehicle

BEFORE, AFTER = ORANGE, GREEN
CHANNELS = ("x", "y", "z", "roll", "pitch", "yaw", "touchdown")
WIDTH = 7.4  # inches, of a page
SIDE = 4.6  # inches, of two figures side by side, below each other on a phone
PANEL = 3.6  # of three
EVERY = 1.0  # s between two predictions
SMALL = 0.1  # of the motion, error of predictions that are drawn as such
_HEAT = LinearSegmentedColormap.from_list(
    "heat", ["#f4f8fb", "#fde3c8", "#f9b071", "#e66f22", "#a63c06", "#5e1f04"]
)
_STEPS = (PURPLE, BLUE, "#56b4e9", "#8a8f98", "#c9b458")  # between before and after


# ---- a flight that is shown


@dataclasses.dataclass(frozen=True)
class Track:
    """Measured positions of one flight and open-loop predictions along it."""

    flight: str
    held_out: bool  # of the fit
    seconds: float  # how far each prediction goes
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


def track_of(
    log: FlightLog, before: Vehicle, after: Vehicle, *, held_out: bool, platform: bool = False
) -> Track | None:
    """Return predictions along a flight; None when no stretch of it is long enough.

    Raises UserError when the flight cannot be used at all.
    """
    flight = prepare(log, before, platform=platform)
    try:
        starts = rollout.RolloutWindows.of([flight], every=EVERY)
    except UserError:
        return None
    poses = [rollout.simulate(starts, vehicle)[..., :3] for vehicle in (before, after)]
    part = slice(starts.first[0], starts.first[-1] + starts.rows + 1)
    return Track(
        flight=log.name,
        held_out=held_out,
        seconds=round(starts.rows * starts.dt, 3),
        t=flight.t[part],
        position=flight.position[part],
        times=tuple(flight.t[a : a + starts.rows + 1] for a in starts.first),
        before=tuple(poses[0]),
        after=tuple(poses[1]),
    )


def most_varied_flight(logs: Sequence[FlightLog]) -> FlightLog:
    """Return the flight with the largest range of heights, of those near the floor if there are any."""

    def key(log: FlightLog) -> tuple[bool, float]:
        height = log.position[:, 2]
        return bool(np.nanmin(height) < NEAR), float(np.ptp(height))

    return max(logs, key=key)


# ---- where


def where_tables(rows: Sequence[RegimeError]) -> dict[str, Any]:
    """Return tables of the error by regime and channel, before and after.

    Cells are (text, background, ink); `scale` has the same for multiples of the noise level.
    """
    cells = {(row.regime, row.channel): row for row in rows}
    channels = [c for c in CHANNELS if any(row.channel == c for row in rows)]
    lines: dict[str, list] = {"before": [], "after": []}
    for regime in (r for r in REGIMES if any(row.regime == r for row in rows)):
        name = f"{REGIMES[regime]} ({max(row.windows for row in rows if row.regime == regime)})"
        for what in lines:
            lines[what].append((name, [_cell(cells.get((regime, c)), what) for c in channels]))
    units: dict[str, list[str]] = {}
    for channel in channels:
        unit = next(row.unit for row in rows if row.channel == channel)
        units.setdefault(shown(unit)[1], []).append(channel)
    return {
        "channels": ["touch" if c == "touchdown" else c for c in channels],
        "maps": list(lines.items()),
        "scale": [(f"{times} ×", *_heat(times)) for times in (1, 3, 10, 30, 100, 300)],
        "units": "; ".join(f"{', '.join(names)} in {unit}" for unit, names in units.items()),
    }


def _heat(times: float) -> tuple[str, str]:
    """Return background and ink of a cell whose error is so many times the noise level."""
    share = float(np.clip(np.log(max(times, 1.0)) / np.log(300.0), 0.0, 1.0))
    return to_hex(_HEAT(share)), "#ffffff" if share > 0.62 else INK


def _cell(row: RegimeError | None, what: str) -> tuple[str, str, str]:
    if row is None or not math.isfinite(error := getattr(row, what)):
        return "–", "none", INK
    text = _number(shown(row.unit)[0] * error)
    return (text, *_heat(error / row.floor)) if row.floor > 0 else (text, "none", INK)


def _number(value: float) -> str:
    for limit, digits in ((0.0995, 3), (9.95, 2), (99.5, 1)):
        if abs(value) < limit:
            return f"{value:.{digits}f}"
    return f"{value:.0f}"


# ---- show


def horizon(curves: Sequence[HorizonCurve], gap: dict[str, PlantGap]) -> Figure:
    """Return the position error against the horizon as the effects are added, with the noise floor."""
    figure = Figure(figsize=(5.6, 3.5))
    draw_horizon(panel(figure, 0.6, 0.55, 2.9, 2.8), curves, gap)
    return figure


def draw_horizon(axis: Axes, curves: Sequence[HorizonCurve], gap: dict[str, PlantGap]) -> None:
    """Draw the curves with their names at the right end."""
    ends = []
    for k, curve in enumerate(curves):
        colour = BEFORE if k == 0 else AFTER if k == len(curves) - 1 else _STEPS[(k - 1) % len(_STEPS)]
        axis.plot(curve.horizon, 100 * curve.error, color=colour, linewidth=2.2, zorder=3 + k)
        name = "nominal model" if k == 0 else curve.label.replace("_", " ")
        ends.append((100 * curve.error[-1], f"{name}  {centimetres(curve.error[-1])}", colour))
    if curves:
        last = curves[-1]
        axis.plot(last.horizon, 100 * last.floor, color=INK, linewidth=1.3, linestyle=(0, (1, 1.6)), zorder=3)
        axis.fill_between(last.horizon, 0, 100 * last.floor, color=RULE, alpha=0.6, linewidth=0)
        ends.append((100 * last.floor[-1], f"noise alone  {centimetres(last.floor[-1])}", INK))
    if "mujoco" in gap:
        g = gap["mujoco"]
        look: dict[str, Any] = {"color": "white", "markeredgewidth": 1.6, "markersize": 5.5}
        look |= {"zorder": 20, "clip_on": False}
        for value, colour, text in (
            (g.before, BEFORE, "the same windows simulated in MuJoCo"),
            (g.after, AFTER, None),
        ):
            axis.plot(g.horizon, 100 * value, "D", markeredgecolor=colour, label=text, **look)
        axis.legend(loc="upper left", handletextpad=0.2)
    top = max([value for value, *_ in ends] + [1e-3]) * 1.06
    end = max((curve.horizon[-1] for curve in curves), default=1.0)
    axis.set(xlim=(0, end), ylim=(0, top), xlabel="horizon [s]", ylabel="position error [cm, RMS]")
    axis.grid(axis="y")
    _name_ends(axis, ends, top)


def _name_ends(axis: Axes, ends, top: float) -> None:
    """Write names right of the axes at the height of their curves, without overlaps."""
    figure = axis.get_figure(root=True)
    assert figure is not None
    inches = axis.get_position().height * figure.get_figheight()
    least = 0.17 / inches * top
    ends = sorted(ends, key=lambda e: e[0])
    heights = [value for value, *_ in ends]
    for k in range(1, len(heights)):
        heights[k] = max(heights[k], heights[k - 1] + least)
    beside = axis.get_yaxis_transform()
    for height, (value, text, colour) in zip(heights, ends):
        arrow = {"arrowstyle": "-", "color": colour, "linewidth": 0.7, "shrinkA": 1, "shrinkB": 0}
        axis.annotate(
            *(text, (1.0, value), (1.035, height), beside, beside, arrow | {"relpos": (0, 0.5)}),
            **{"fontsize": 8.5, "color": colour, "va": "center"},
        )


def before_after(one: Track) -> list[Figure]:
    """Return the predictions along a flight, before and after the correction, in two figures."""
    figures = []
    for after in (False, True):
        figure = Figure(figsize=(SIDE, 3.3))
        draw_predictions(panel(figure, 0.62, 0.5, SIDE - 0.75, 2.1), one, after)
        figures.append(figure)
    return figures


def draw_predictions(axis: Axes, one: Track, after: bool) -> None:
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
        label = None if j else f"predicted {one.seconds:g} s ahead"
        axis.plot(t, factor * p, color=colour, linewidth=1.5, label=label)
        axis.plot(t[-1], factor * p[-1], "o", color=colour, markersize=3)
    # All of the measurement, and of the predictions what lies within its range once more.
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


def estimates(effects: Sequence[NamedEffect], flights: Sequence[str]) -> list[Figure]:
    """Return each parameter's estimates in single flights with 95 % intervals, over that of all flights."""
    line = max(1.1, 0.17 * len(flights))
    figures = []
    parts = [(e, name, p) for e in effects for name, p in e.parameters.items()]
    for effect, name, p in parts if flights else []:
        if not any(map(math.isfinite, p.per_flight)):
            continue
        figure = Figure(figsize=(PANEL, line + 1.05))
        axis = panel(figure, 1.05, 0.55, PANEL - 1.2, line)
        factor, unit = shown(p.unit)
        y = np.arange(len(p.per_flight))
        value, error = factor * np.array(p.per_flight), 1.96 * factor * np.array(p.per_flight_error)
        axis.axvspan(*(factor * np.array(p.ci95)), color=BLUE, alpha=0.18, linewidth=0)
        axis.axvline(factor * p.value, color=BLUE, linewidth=1.4)
        axis.errorbar(value, y, xerr=error, fmt="o", color=INK, markersize=3.2, linewidth=1.0)
        low, high = axis.get_xlim()
        if 2 * low - high < factor * p.neutral < 2 * high - low:  # else the table has it
            axis.axvline(factor * p.neutral, color=MUTED, linewidth=1.0, linestyle=(0, (2, 2)))
        names = [literal(f) for f in flights[: len(y)]]
        name_rows(axis, [n if len(n) <= 12 else f"{n[:5]}…{n[-6:]}" for n in names], 8.5)
        axis.locator_params(axis="x", nbins=5)
        axis.grid(axis="y")
        what = label(effect.name) + (f": {label(name)}" if len(effect.parameters) > 1 else "")
        axis.set_title(what + (" (at its bound)" if p.at_bound else ""), loc="left")
        axis.set_xlabel(label(name) + (f" [{unit}]" if unit else ""), labelpad=1)
        figures.append(figure)
    return figures


def name_rows(axis: Axes, names: Sequence[str], size: float = 9.0) -> None:
    """Label one row for each name, the first at the top."""
    axis.set_ylim(len(names) - 0.4, -0.6)
    axis.set_yticks(range(len(names)), names, fontsize=size)
    axis.tick_params(axis="y", length=0)


def residual(left: ResidualAnalysis) -> list[Figure]:
    """Return the functions of the residual over the input that explains most of each."""
    figures = []
    for d in [d for d in left.depends_on if len(d.x) and left.material(d)][:4]:
        figure = Figure(figsize=(PANEL, 2.6))
        plot = panel(figure, 0.75, 0.55, PANEL - 0.9, 1.7)
        factor, unit = shown(d.unit)
        plot.axhline(0, color=RULE, linewidth=1)
        plot.plot(d.x, factor * np.asarray(d.y), "o-", color=ORANGE, markersize=3, linewidth=1.4)
        plot.set_xlabel(d.against)
        plot.set_ylabel(f"{d.channel} [{unit}]", labelpad=1)
        plot.set_title(f"residual {axis_of(d)}: {_number(factor * d.size)} {unit}", loc="left")
        plot.grid()
        figures.append(figure)
    return figures


# ---- all in one


def overview(d: Diagnosis, one: Track | None) -> Figure:
    """Return a flight with predictions before and after the correction, above the error by horizon."""
    below = 3.2
    figure = Figure(figsize=(WIDTH, below + (2.9 if one is not None else 0.0)))
    draw_horizon(panel(figure, 0.75, 0.55, WIDTH - 3.0, 2.4), d.horizon, d.gap)
    if one is not None:
        for k in range(2):
            left = 0.75 + 0.5 * WIDTH * k
            draw_predictions(panel(figure, left, below + 0.5, 0.5 * WIDTH - 0.9, 1.8), one, bool(k))
    return figure
