"""The same effects fitted to the first and to the second halves of flights: are they stable?"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from scipy import stats

from inclined_landing.eval.gap import diagnose
from inclined_landing.eval.gap.answer import rollout
from inclined_landing.eval.gap.flights.windows import prepare_all
from inclined_landing.eval.gap.infer.fit import LeastSquaresFit, fit_least_squares
from inclined_landing.eval.gap.model.columns import slab_deviations
from inclined_landing.eval.gap.model.problem import Problem
from inclined_landing.eval.gap.result import Diagnosis, PlantGap
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.vehicle import Vehicle


def halves(logs: Sequence[FlightLog]) -> tuple[list[FlightLog], list[FlightLog]]:
    """First and second halves in time of every flight."""
    first, second = [], []
    for log in logs:
        middle = log.t[0] + 0.5 * log.duration
        first.append(dataclasses.replace(log.between(log.t[0], middle), name=f"{log.name} first half"))
        second.append(dataclasses.replace(log.between(middle, log.t[-1]), name=f"{log.name} second half"))
    return first, second


@dataclasses.dataclass(frozen=True)
class Stability:
    """One parameter fitted to both halves and to all."""

    effect: str
    parameter: str
    unit: str
    neutral: float
    all: tuple[float, float]  # value, half-width of the 95 % interval
    first: tuple[float, float]
    second: tuple[float, float]

    @property
    def apart(self) -> float:
        """Difference between the halves over the half-width of its 95 % interval: stable below 1."""
        return abs(self.first[0] - self.second[0]) / max(math.hypot(self.first[1], self.second[1]), 1e-12)

    @property
    def change(self) -> float:
        """Difference between the halves as a share of the size of the effect."""
        return abs(self.first[0] - self.second[0]) / max(abs(self.all[0] - self.neutral), 1e-12)


def stability(logs: Sequence[FlightLog], vehicle: Vehicle, values) -> list[Stability]:
    """The effects of `values` refitted to all of `logs` and to both halves, together each time."""
    fits = [_fit(part, vehicle, values) for part in (logs, *halves(logs))]
    rows = []
    for key in fits[0]:
        effect, name = key
        p = LIBRARY[effect].parameter(name)
        rows.append(Stability(effect, name, p.unit, p.neutral, *(fit[key] for fit in fits)))
    return rows


def judged(logs, vehicle: Vehicle, values, heldout: Sequence[FlightLog] = ()) -> tuple[PlantGap, Vehicle]:
    """Gap with the effects of `values`, not searched for, and the vehicle with them, refitted to all flights.

    The gap is that on `heldout`; without, every flight is judged with the others fitted.
    """
    problem = Problem(prepare_all(logs, vehicle, False, []), vehicle, LIBRARY)
    fit, inflation = _refit(problem, values)
    corrected = problem.corrected(fit.values)
    starts = rollout.RolloutWindows.of(
        prepare_all(heldout, vehicle, False, []) if heldout else problem.flights
    )
    floor = rollout.noise_floor(starts, corrected)
    after = corrected if heldout else _left_out(problem, fit, inflation)
    return rollout.plant_gap(starts, vehicle, after, "analytic", floor), corrected


def _refit(problem: Problem, values, prior=None) -> tuple[LeastSquaresFit, np.ndarray]:
    """Return a fit with weights divided by the squared errors (6,) of a first fit, and these errors."""
    first = fit_least_squares(problem, values, np.ones(6), prior=prior)
    squares = np.concatenate([np.einsum("wcq,wcq->wc", x, x) for x in problem.white_errors_at(first.values)])
    freedom = np.maximum(1.0, (problem.weight * problem.rows[:, None]).sum(axis=0))
    inflation = np.maximum(1.0, (problem.weight * squares).sum(axis=0) / freedom)
    return fit_least_squares(problem, first.values, inflation, prior=prior), inflation


def _left_out(problem: Problem, fit: LeastSquaresFit, inflation: np.ndarray) -> list[Vehicle]:
    """For every flight, the vehicle with the effects fitted to the other flights."""
    vehicles = []
    for flight in problem.flights:
        others = [f for f in problem.flights if f is not flight] or problem.flights
        rest = fit_least_squares(Problem(others, problem.vehicle, LIBRARY), fit.values, inflation)
        vehicles.append(problem.corrected(rest.values))
    return vehicles


def _fit(logs, vehicle: Vehicle, values) -> dict[tuple[str, str], tuple[float, float]]:
    problem = Problem(prepare_all(logs, vehicle, False, []), vehicle, LIBRARY)
    # Without a prior, effects that are nearly collinear would not move.
    fit, _ = _refit(problem, values, prior=slab_deviations)
    # A reference is where another parameter acts about: at another one that and others are as good.
    linear = fit.linear
    own = [k for k, c in enumerate(linear.columns) if not problem.parameter(c).is_reference]
    columns = tuple(linear.columns[k] for k in own)
    linear = dataclasses.replace(linear, columns=columns, a=linear.a[:, own][:, :, own], b=linear.b[:, own])
    error = np.sqrt(np.diag(linear.covariance()))
    quantile = stats.t.ppf(0.975, max(1, problem.groups - 1))
    return {
        (c.effect, c.parameter): (fit.values[c.effect][c.parameter], float(quantile * e))
        for c, e in zip(columns, error)
    }


@dataclasses.dataclass(frozen=True)
class Fleet:
    """A fleet diagnosed as a whole (each flight judged with the others fitted) and by halves."""

    title: str
    diagnosis: Diagnosis
    first: Diagnosis  # first halves fitted, second halves judged
    second: Diagnosis
    stability: list[Stability]

    @staticmethod
    def of(title: str, logs: Sequence[FlightLog], vehicle: Vehicle) -> Fleet:
        """Raises UserError when no flight can be used."""
        whole = diagnose(logs, vehicle, plants=("analytic", "mujoco"))
        a, b = halves(logs)
        return Fleet(
            title,
            whole,
            diagnose(a, vehicle, heldout=b, curves=False),
            diagnose(b, vehicle, heldout=a, curves=False),
            stability(logs, vehicle, whole.values()),
        )
