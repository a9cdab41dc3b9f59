"""Nonlinear least squares (Levenberg-Marquardt) of effects through the simulator, within bounds."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np

from inclined_landing.eval.gap.model.columns import BASE, Column, FittedValues, Values
from inclined_landing.eval.gap.model.problem import Linearisation, Problem, solve


@dataclasses.dataclass
class LeastSquaresFit:
    """A least-squares fit and its linearisation."""

    values: FittedValues
    linear: Linearisation  # columns of the effects in `values`

    @property
    def squares(self) -> float:
        """Return the weighted squared white error over all windows (least-squares cost)."""
        return float(self.linear.c.sum())


def fit_least_squares(
    problem: Problem,
    values: Values,
    inflation: np.ndarray,
    iterations: int = 8,
    tolerance: float = 0.05,
    prior: Callable[[Problem, Sequence[Column]], np.ndarray] | None = None,
) -> LeastSquaresFit:
    """Return the Levenberg-Marquardt fit of all parameters of the effects in `values`, within bounds.

    tolerance: decrease of the cost that ends the iteration. prior: gives the standard deviations (P,) of the
    columns about neutral; None: flat.
    """
    names = list(values)
    start = {name: problem.neutral(name) | dict(v) for name, v in values.items()}
    damping = 1e-3
    columns = [
        Column(name, p.name) for name in names if name != BASE for p in problem.library[name].parameters
    ]
    columns += problem.columns([BASE] if BASE in names else ())
    fit = _linearised_fit(problem, start, columns, inflation)
    width = prior(problem, columns) if prior else np.full(len(columns), np.inf)
    # Damping lambda as by Marquardt: a tenth after a step that decreases the cost, else ten times as much.
    for _ in range(iterations if names else 0):
        improved = False
        while damping < 1e4:
            trial = _damped_step(problem, fit, damping, width)
            gain = fit.squares - problem.squares(trial, inflation)
            gain += _prior_penalty(problem, columns, fit.values, width) - _prior_penalty(
                problem, columns, trial, width
            )
            if gain > 0.0:
                fit, improved = _linearised_fit(problem, trial, columns, inflation), True
                damping = max(1e-9, damping / 10.0)
                break
            if fit.squares - _predicted_squares(problem, fit, trial) < tolerance:
                break
            damping *= 10.0
        if not improved or gain < tolerance:
            break
    return fit


def _linearised_fit(
    problem: Problem, values: FittedValues, columns: Sequence[Column], inflation: np.ndarray
) -> LeastSquaresFit:
    """Return the linearisation at `values`."""
    return LeastSquaresFit(values, problem.linearise(values, columns, inflation))


def _prior_penalty(problem: Problem, columns: Sequence[Column], values: Values, width: np.ndarray) -> float:
    """Return the prior penalty sum_k (x_k / width_k)^2 (ridge)."""
    return float(((problem.coordinates(values, columns) / width) ** 2).sum())


def _damped_step(problem: Problem, fit: LeastSquaresFit, damping: float, width: np.ndarray) -> FittedValues:
    """Return the values after a damped Gauss-Newton step within bounds (active set)."""
    # (a + lambda diag a) d = b,  with the prior W = width^-2:  a = J'J + W,  b = J'e - W x
    a, b = fit.linear.a.sum(axis=0), fit.linear.b.sum(axis=0)
    a, b = a + np.diag(width**-2.0), b - problem.coordinates(fit.values, fit.linear.columns) * width**-2.0
    at, bounds = at_and_bounds(problem, fit)
    step = active_set_step(a + damping * np.diag(np.diag(a)), a, b, at, bounds, np.ones(len(at), bool))
    return _values_after(problem, fit, step)


def at_and_bounds(problem: Problem, fit: LeastSquaresFit) -> tuple[np.ndarray, np.ndarray]:
    """Return coordinates (k,) and bounds (2, k) of all columns of a fit."""
    parameters = [problem.parameter(c) for c in fit.linear.columns]
    bounds = [[p.coordinate(x) for x in p.possible] for p in parameters]
    return problem.coordinates(fit.values, fit.linear.columns), np.array(bounds).reshape(-1, 2).T


def active_set_step(damped, a, b, at, bounds, free) -> np.ndarray:
    """Return the step of the `free` columns by the active-set method.

    Columns that would leave their bounds are fixed there, and the others solved for again.
    """
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


def _predicted_squares(problem: Problem, fit: LeastSquaresFit, trial: Values) -> float:
    """Return the squared error that the linearisation predicts at trial values."""
    there, here = (problem.coordinates(v, fit.linear.columns) for v in (trial, fit.values))
    return fit.linear.predicted_squares(there - here)


def dersimonian_laird(value: np.ndarray, error: np.ndarray) -> float:
    """Return the between-flight standard deviation by moments (DerSimonian and Laird 1986)."""
    # tau^2 = [Q - (k - 1)] / (S1 - S2 / S1),  Q = sum w (x - mean)^2,  w = 1 / se^2,
    # S1 = sum w,  S2 = sum w^2
    good = np.isfinite(value) & np.isfinite(error) & (error > 0)
    if good.sum() < 3:
        return 0.0
    w = 1.0 / error[good] ** 2
    mean = (w * value[good]).sum() / w.sum()
    q = (w * (value[good] - mean) ** 2).sum()
    excess = (q - (good.sum() - 1)) / (w.sum() - (w**2).sum() / w.sum())
    return math.sqrt(max(0.0, float(excess)))


def _values_after(problem: Problem, fit: LeastSquaresFit, step: np.ndarray) -> FittedValues:
    """Return the values of a fit after a step of its columns, clipped to their bounds."""
    values = {name: dict(v) for name, v in fit.values.items()}
    for column, change in zip(fit.linear.columns, step):
        p = problem.parameter(column)
        at = p.value_at(p.coordinate(values[column.effect][column.parameter]) + change)
        values[column.effect][column.parameter] = float(np.clip(at, *p.possible))
    return values
