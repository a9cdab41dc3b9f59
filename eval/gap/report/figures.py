"""The figure of a diagnosis: predictions along a flight, and the error as the effects are added."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from inclined_landing.eval.base.style import BLUE, GREEN, INK, ORANGE, PURPLE, RULE, panel, styled
from inclined_landing.eval.gap.answer import rollout
from inclined_landing.eval.gap.flights.usable import ReadFlights
from inclined_landing.eval.gap.flights.windows import NEAR, prepare
from inclined_landing.eval.gap.report.words import centimetres
from inclined_landing.eval.gap.result import HORIZON, Diagnosis
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.vehicle import Vehicle

BEFORE, AFTER = ORANGE, GREEN
BETWEEN = (PURPLE, BLUE, "#56b4e9", "#8a8f98", "#c9b458")
WIDTH = 7.4  # inches
SMALL = 0.1  # of the motion, error of predictions that are drawn as such


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


def draw_growth(axis: Axes, d: Diagnosis) -> None:
    """Draw the position error against the horizon as effects are added, their names at its right end."""
    assert d.growth is not None
    horizon, errors, floor = d.growth.horizon, d.growth.errors, d.growth.floor
    middle = (BETWEEN[k % len(BETWEEN)] for k in range(len(errors) - 2))
    colours = [BEFORE, *middle, AFTER][: len(errors)]
    ends = []
    for k, ((name, error), colour) in enumerate(zip(errors.items(), colours)):
        axis.plot(horizon, 100 * error, color=colour, linewidth=2.2, zorder=3 + k)
        text = f"+ {name.replace('_', ' ')}" if name else "model before"
        ends.append((100 * error[-1], f"{text}  {centimetres(error[-1])}", colour))
    axis.plot(horizon, 100 * floor, color=INK, linewidth=1.3, linestyle=(0, (1, 1.6)), zorder=3)
    axis.fill_between(horizon, 0, 100 * floor, color=RULE, alpha=0.6, linewidth=0)
    ends.append((100 * floor[-1], f"noise alone  {centimetres(floor[-1])}", INK))
    if engine := d.gap.get("mujoco"):
        look: dict[str, Any] = {"color": "white", "markeredgewidth": 1.6, "markersize": 5.5}
        look |= {"zorder": 20, "clip_on": False}
        text = "the same windows simulated in MuJoCo"
        axis.plot(engine.horizon, 100 * engine.before, "D", markeredgecolor=BEFORE, label=text, **look)
        axis.plot(engine.horizon, 100 * engine.after, "D", markeredgecolor=AFTER, **look)
        axis.legend(loc="upper left", handletextpad=0.2)
    top = 1.06 * max(value for value, *_ in ends)
    axis.set(xlim=(0, horizon[-1]), ylim=(0, top), xlabel="horizon [s]", ylabel="position error [cm, RMS]")
    axis.grid(axis="y")
    _name_ends(axis, ends, top)


def _name_ends(axis: Axes, ends, top: float) -> None:
    """Write names right of the axes at the height of their curves, without overlaps."""
    figure = axis.get_figure(root=True)
    assert figure is not None
    least = 0.17 / (axis.get_position().height * figure.get_figheight()) * top
    ends = sorted(ends, key=lambda end: end[0])
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


def overview(d: Diagnosis, one: Track | None) -> Figure:
    """Return a flight with predictions before and after the correction, above the error by horizon."""
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
    text = "Position error on flights left out of the fit, as the effects are added."
    if one is None:
        return text
    part = "left out of" if one.held_out else "part of"
    return (
        f"Above: {one.flight}, {part} the fit. Every {rollout.EVERY:g} s a prediction starts from the "
        f"measured state, driven by the commands alone. Below: {text[0].lower()}{text[1:]}"
    )
