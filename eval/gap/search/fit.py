"""Effects fitted together through the simulator, within their bounds."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np

from inclined_landing.eval.gap.search.evidence import Column, Linear, Problem, Values, solve
from inclined_landing.models.parameters import Vehicle


@dataclasses.dataclass
class Fitted:
    """Effects fitted together, with the linearisation at the fit."""

    values: dict[str, dict[str, float]]
    linear: Linear  # columns of the effects in `values`
    inflation: np.ndarray  # (6,) that the weights were divided by

    @property
    def squares(self) -> float:
        """White squared error over all windows."""
        return float(self.linear.c.sum())


def refit(
    problem: Problem,
    values: Values,
    inflation: np.ndarray,
    iterations: int = 8,
    tolerance: float = 0.05,
    prior: Callable[[Problem, Sequence[Column]], np.ndarray] | None = None,
) -> Fitted:
    """Levenberg-Marquardt fit, within bounds, of all parameters of the effects in `values`.

    prior: gives the standard deviation (P,) of columns about neutral; None: as the flights say.
    """
    names = list(values)
    values = {name: dict(problem.library[name].neutral) | dict(v) for name, v in values.items()}
    damping = 1e-3
    columns = [Column(name, p.name) for name in names for p in problem.library[name].parameters]
    fit = fit_at(problem, values, columns, inflation)
    width = prior(problem, columns) if prior else np.full(len(columns), np.inf)
    for _ in range(iterations if names else 0):
        improved = False
        while damping < 1e4:
            trial = _moved(problem, fit, damping, width)
            gain = fit.squares - problem.squares(trial, inflation)
            gain += _unlikely(problem, columns, fit.values, width) - _unlikely(problem, columns, trial, width)
            if gain > 0.0:
                fit, improved = fit_at(problem, trial, columns, inflation), True
                damping = max(1e-9, damping / 10.0)
                break
            if fit.squares - _predicted(fit, trial) < tolerance:
                break
            damping *= 10.0
        if not improved or gain < tolerance:
            break
    return fit


def fit_at(problem: Problem, values, columns, inflation) -> Fitted:
    """The linearisation at `values`, nothing fitted."""
    return Fitted(values, problem.linearise(values, columns, inflation), inflation)


def _unlikely(problem: Problem, columns: Sequence[Column], values: Values, width: np.ndarray) -> float:
    """Squared sizes of the parameters, each over its `width`."""
    return float(((from_neutral(problem, columns, values) / width) ** 2).sum())


def from_neutral(problem: Problem, columns: Sequence[Column], values: Values) -> np.ndarray:
    """(k,) values of all columns less their neutral ones."""
    return np.array([values[c.effect][c.parameter] - problem.parameter(c).neutral for c in columns])


def _moved(problem: Problem, fit: Fitted, damping: float, width: np.ndarray) -> dict[str, dict[str, float]]:
    """Values after a damped step; parameters that would leave their bounds stay there, the others refit."""
    a, b = fit.linear.a.sum(axis=0), fit.linear.b.sum(axis=0)
    a, b = a + np.diag(width**-2.0), b - from_neutral(problem, fit.linear.columns, fit.values) * width**-2.0
    at, bounds = at_and_bounds(problem, fit)
    step = bounded_step(a + damping * np.diag(np.diag(a)), a, b, at, bounds, np.ones(len(at), bool))
    return _stepped(problem, fit, step)


def at_and_bounds(problem: Problem, fit: Fitted) -> tuple[np.ndarray, np.ndarray]:
    """Fitted values (k,) and bounds (2, k) of all columns of a fit."""
    columns = fit.linear.columns
    at = np.array([fit.values[c.effect][c.parameter] for c in columns])
    return at, np.array([problem.parameter(c).possible for c in columns]).reshape(-1, 2).T


def bounded_step(damped, a, b, at, bounds, free) -> np.ndarray:
    """Step of the `free` columns; what would leave its bounds is held there and the others solved again."""
    free, step = free.copy(), np.zeros(len(at))
    for _ in range(len(at) + 1):
        k = np.flatnonzero(free)
        step[k] = solve(damped[np.ix_(k, k)], b[k] - a[np.ix_(k, ~free)] @ step[~free])
        outside = free & ((at + step < bounds[0]) | (at + step > bounds[1]))
        if not outside.any():
            break
        step[outside] = np.clip(at + step, *bounds)[outside] - at[outside]
        free &= ~outside
    return step


def _predicted(fit: Fitted, trial: Values) -> float:
    step = np.array(
        [trial[c.effect][c.parameter] - fit.values[c.effect][c.parameter] for c in fit.linear.columns]
    )
    return fit.linear.left(step)


def spread_between(value: np.ndarray, error: np.ndarray) -> float:
    """Standard deviation between flights beyond their standard errors (DerSimonian and Laird 1986)."""
    good = np.isfinite(value) & np.isfinite(error) & (error > 0)
    if good.sum() < 3:
        return 0.0
    w = 1.0 / error[good] ** 2
    mean = (w * value[good]).sum() / w.sum()
    q = (w * (value[good] - mean) ** 2).sum()
    excess = (q - (good.sum() - 1)) / (w.sum() - (w**2).sum() / w.sum())
    return math.sqrt(max(0.0, float(excess)))


def left_out_vehicles(problem: Problem, fit: Fitted) -> list[Vehicle]:
    """For every flight, the vehicle with the effects fitted to the other flights.

    One Newton step from the fit to all, shortened where it does not fit the other flights as foreseen:
    parameters that only some flights tell apart may ask for steps beyond what is linear.
    """
    if not fit.values or len(problem.flights) < 2:
        return [problem.corrected(fit.values)] * len(problem.flights)
    own_a, own_b = fit.linear.by_flight()
    a, b = own_a.sum(axis=0), own_b.sum(axis=0)
    weight = problem.weight / fit.inflation
    at, bounds = at_and_bounds(problem, fit)
    # What the fit left at a bound stays there: alone it would move along what it cannot be told from.
    free = np.minimum(at - bounds[0], bounds[1] - at) > 1e-6 * (bounds[1] - bounds[0])
    vehicles = []
    for k in range(len(problem.flights)):
        own = problem.flight_of == k
        step = bounded_step(a - own_a[k], a - own_a[k], b - own_b[k], at, bounds, free)
        others = float(fit.linear.c[np.unique(problem.group_of[~own])].sum())
        for _ in range(6):
            vehicle = problem.corrected(_stepped(problem, fit, step))
            white = [problem.white_of(i, vehicle) for i in range(len(problem.flights)) if i != k]
            squares = (np.concatenate([(x**2).sum(axis=2) for x in white]) * weight[~own]).sum()
            if squares <= others * 1.001:
                break
            step = 0.3 * step
        vehicles.append(vehicle)
    return vehicles


def _stepped(problem: Problem, fit: Fitted, step: np.ndarray) -> dict[str, dict[str, float]]:
    """Values of a fit after a step of its columns, within bounds."""
    values = {name: dict(v) for name, v in fit.values.items()}
    for column, change in zip(fit.linear.columns, step):
        at = values[column.effect][column.parameter] + change
        values[column.effect][column.parameter] = float(np.clip(at, *problem.parameter(column).possible))
    return values
