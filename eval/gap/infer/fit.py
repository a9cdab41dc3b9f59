"""Fits of effects through the simulator, within bounds: jointly with the noise, and of a vehicle."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property

import numpy as np

from inclined_landing.eval.gap.infer.gaussian import EffectSet, LinearGaussian, Spread, truncated_mode
from inclined_landing.eval.gap.measured.noise import estimate, winsorised
from inclined_landing.eval.gap.model.columns import (
    BASE,
    BaseColumn,
    Column,
    FittedValues,
    ParameterColumn,
    Values,
    slab_deviations,
)
from inclined_landing.eval.gap.model.prediction import YAW_REQUEST_CHANNEL
from inclined_landing.eval.gap.model.problem import Linearisation, Problem, solve
from inclined_landing.models.vehicle import Vehicle

MODEL_ERRORS = np.array([0.0, *np.geomspace(0.002, 0.5, 30)])  # f, multiplicative model errors that are tried
ALTERNATIONS = 4  # rounds, at most, of fitting effects and noise model in turn
SETTLED, SMALL_SIZE = 0.15, 1e-3  # relative and absolute change of the disturbance's size that ends these
ROUGH_ITERATIONS, ROUGH_TOLERANCE = 3, 5.0  # of a round's fit: the next one begins where it ends
# Marquardt's damping: where the largest is exceeded, no step decreases the error.
FIRST_DAMPING, MOST_DAMPING, LEAST_DAMPING = 1e-3, 1e4, 1e-9
LAGS = 4  # windows over which autocorrelations are summed
ROUNDS = 8  # of Newton's method
STEP_SHARES = (1.0, 0.5, 0.25, 0.1)  # of a Newton step, the first that decreases the deviance
_NORMAL = 1.96  # half-width of a 95 % interval in standard deviations
DEVIANCE_TOLERANCE = 1.0  # decrease of the deviance that ends the iteration


@dataclasses.dataclass(frozen=True)
class LeastSquaresFit:
    """A least-squares fit, with its linearisation where that is asked for."""

    problem: Problem
    values: FittedValues
    columns: Sequence[Column]  # of the effects in `values`
    squares: float  # weighted squared white error over all windows (least-squares objective)

    @cached_property
    def linear(self) -> Linearisation:
        """Return the linearisation at the fit."""
        return self.problem.linearise(self.values, self.columns)


def fit_least_squares(
    problem: Problem,
    values: Values,
    iterations: int = 8,
    tolerance: float = 0.05,
    prior: Callable[[Problem, Sequence[Column]], np.ndarray] | None = None,
) -> LeastSquaresFit:
    """Return the Levenberg-Marquardt fit of all parameters of the effects in `values`, within bounds.

    tolerance: decrease of the objective that ends the iteration. prior: gives the standard deviations (P,) of
    the columns about neutral; None: flat.
    """
    start = {name: problem.neutral(name) | dict(v) for name, v in values.items()}
    columns: list[Column] = [
        ParameterColumn(name, p.name)
        for name in start
        if name != BASE
        for p in problem.library[name].parameters
    ]
    columns += problem.columns([BASE] if BASE in start else ())
    fit = LeastSquaresFit(problem, start, columns, problem.squares(start))
    width = prior(problem, columns) if prior else np.full(len(columns), np.inf)
    damping = FIRST_DAMPING
    for _ in range(iterations if start else 0):
        fit, decrease, damping = _damped_fit(problem, fit, damping, width, tolerance)
        if decrease < tolerance:
            break
    return fit


def _damped_fit(
    problem: Problem, fit: LeastSquaresFit, damping: float, width: np.ndarray, tolerance: float
) -> tuple[LeastSquaresFit, float, float]:
    """Return the fit after a step that decreases the objective, this decrease, and the next step's damping.

    The fit is unchanged, with a decrease of 0, if no damping leads to such a step.
    """

    def penalty(at: Values) -> float:  # sum_k (x_k / width_k)^2
        return float(((problem.coordinates(at, fit.columns) / width) ** 2).sum())

    # Damping lambda as by Marquardt: a tenth after a step that decreases the objective, else ten times it.
    while damping < MOST_DAMPING:
        trial = _damped_step(problem, fit, damping, width)
        squares = problem.squares(trial)
        gain = fit.squares - squares + penalty(fit.values) - penalty(trial)
        if gain > 0.0:
            better = LeastSquaresFit(problem, trial, fit.columns, squares)
            return better, gain, max(LEAST_DAMPING, damping / 10.0)
        step = problem.coordinates(trial, fit.columns) - problem.coordinates(fit.values, fit.columns)
        if fit.squares - fit.linear.predicted_squares(step) < tolerance:  # not worth it anyway
            break
        damping *= 10.0
    return fit, 0.0, damping


def _damped_step(problem: Problem, fit: LeastSquaresFit, damping: float, width: np.ndarray) -> FittedValues:
    """Return the values after a damped Gauss-Newton step within bounds (active set)."""
    # (a + lambda diag a) d = b,  with the prior W = width^-2:  a = J'J + W,  b = J'e - W x
    at, known = problem.coordinates(fit.values, fit.linear.columns), width**-2.0
    a, b = fit.linear.a.sum(axis=0) + np.diag(known), fit.linear.b.sum(axis=0) - at * known
    parameters = [problem.parameter(c) for c in fit.linear.columns]
    bounds = np.array([[p.coordinate(x) for x in p.possible] for p in parameters]).reshape(-1, 2).T
    step = active_set_step(a + damping * np.diag(np.diag(a)), a, b, at, bounds)
    return _values_after(problem, fit, step)


def active_set_step(
    damped: np.ndarray, a: np.ndarray, b: np.ndarray, at: np.ndarray, bounds: np.ndarray
) -> np.ndarray:
    """Return the step by the active-set method: columns that would leave their bounds are fixed there.

    damped, a (P, P): Gram matrix with and without damping, b (P,); at (P,) and bounds (2, P): coordinates.
    """
    free, step = np.ones(len(at), bool), np.zeros(len(at))
    for _ in range(len(at) + 1):
        # The free columns F move, the fixed ones X have their steps:
        #   (a + lambda diag a)_FF d_F = b_F - a_FX d_X
        k = np.flatnonzero(free)
        step[k] = solve(damped[np.ix_(k, k)], b[k] - a[np.ix_(k, ~free)] @ step[~free])
        outside = free & ((at + step < bounds[0]) | (at + step > bounds[1]))
        if not outside.any():
            break
        step[outside] = np.clip(at + step, *bounds)[outside] - at[outside]
        free &= ~outside
    return step


def _values_after(problem: Problem, fit: LeastSquaresFit, step: np.ndarray) -> FittedValues:
    """Return the values of a fit after a step of its columns, clipped to their bounds."""
    values = {name: dict(v) for name, v in fit.values.items()}
    for column, change in zip(fit.linear.columns, step):
        p, (name, parameter) = problem.parameter(column), column.key
        at = p.value_at(p.coordinate(values[name][parameter]) + change)
        values[name][parameter] = float(np.clip(at, *p.possible))
    return values


def estimate_noise(problem: Problem) -> tuple[Problem, FittedValues]:
    """Return the problem with its noise estimated, and the joint fit of all effects, found in alternation.

    The noise: noise model, weights of the windows and their variance inflation.
    """
    values: FittedValues = {name: {} for name in (*problem.library, BASE)}
    for _ in range(ALTERNATIONS):
        before = problem.noise_model
        fit = fit_least_squares(problem, values, ROUGH_ITERATIONS, ROUGH_TOLERANCE, _joint_fit_prior)
        values = fit.values
        predicted = problem.predicted(values)
        errors = [f.measured - p for f, p in zip(problem.flights, predicted)]
        noise_model = estimate(problem.flights, errors, problem.split(problem.weight))
        problem = problem.whitened(noise_model, problem.corrected(values))
        problem = dataclasses.replace(problem, weight=model_error_weights(problem, predicted, errors))
        if np.allclose(*([c.size for c in model] for model in (noise_model, before)), SETTLED, SMALL_SIZE):
            break
    return dataclasses.replace(problem, inflation=variance_inflation(problem, values)), values


def _joint_fit_prior(problem: Problem, columns: Sequence[Column]) -> np.ndarray:
    """Return the prior standard deviations (P,) of the joint fit; without a reference, tight model errors."""
    width = slab_deviations(problem, columns)
    if problem.identified:
        return width
    known = np.sqrt(problem.vehicle_prior(columns)[1].diagonal())
    return np.where([isinstance(c, BaseColumn) for c in columns], known, width)


def model_error_weights(
    problem: Problem, predicted: Sequence[np.ndarray], errors: Sequence[np.ndarray]
) -> np.ndarray:
    """Return the weights (w, C) of all windows: inverse variance by a multiplicative model error.

    That is estimated by maximum likelihood. predicted, errors: (m, C) of every flight.
    """

    def mean_square(values: Sequence[np.ndarray]) -> np.ndarray:
        white = [f.whitening(f.cut(v)) for f, v in zip(problem.flights, values)]
        return np.concatenate([(x**2).mean(axis=2) for x in white])

    # Heteroscedastic normal errors: in a window of q white numbers with predicted mean square E,
    #   var = 1 + f^2 E,   -2 log p = sum_w q [log var + e^2 / var];   f of every channel minimises it.
    signal, error = mean_square(predicted), mean_square(errors)  # (w, C)
    variance = 1.0 + MODEL_ERRORS[:, None, None] ** 2 * signal
    count = problem.white_count[:, None] * problem.logged
    deviance = (count * (np.log(variance) + error / variance)).sum(axis=1)
    best = np.argmin(deviance, axis=0)
    weights = problem.logged / np.take_along_axis(variance, best[None, None], axis=0)[0]
    # A turn asks for a torque about z that is not predicted: such windows say nothing of a steady one, and
    # count for no more than in the noise's estimate. Otherwise recorded flights lose the certainty of a delay
    # and of a yaw loop.
    if problem.requested:
        for k in range(len(problem.flights)):
            own = problem.flight_of == k, YAW_REQUEST_CHANNEL
            weights[own] *= winsorised(error[own] * weights[own])
    return weights


def variance_inflation(problem: Problem, values: Values) -> np.ndarray:
    """Return the variance inflation (C,): the dispersion of the joint fit times the windows' autocorrelation.

    Errors may exceed those of the noise model, whose grid of parameters is bounded. The evidence of a set and
    the errors of its sizes must then allow for errors as large as those that remain. Outlying windows are
    limited as in the estimate of the noise.
    """
    # Effective sample size n_eff = n / (1 + 2 sum_k rho_k) (Gelman et al., BDA3, 11.5), with the
    # autocorrelation rho_k = sum_w x_w x_(w+k) / sum_w x_w^2 of the windows' standardised amplitudes x, and
    # the dispersion phi = chi^2 / n of a quasi-likelihood, at least 1 (McCullagh and Nelder, 9.2.4).
    white = problem.white_errors_at(values)
    squares, count = np.zeros(problem.channels), (problem.white_count[:, None] * problem.logged).sum(axis=0)
    for errors, weight in zip(white, problem.split(problem.weight)):
        of_windows = weight * (errors**2).sum(axis=2)  # (w, C)
        squares += [winsorised(x) @ x for x in of_windows.T]
    dispersion = np.maximum(1.0, squares / np.maximum(count, 1.0))
    correlation = np.ones(problem.channels)
    for channel in range(problem.channels):
        total, lagged = 0.0, np.zeros(LAGS)  # sums over w of x_w^2, and of x_w x_(w+k), within flights
        for flight, errors in zip(problem.flights, white):
            x = flight.whitening.amplitudes(errors)[:, channel] * np.sqrt(flight.whitening.power[channel])
            total += float(x @ x)
            lagged += [float(x[k:] @ x[:-k]) if len(x) > k else 0.0 for k in range(1, LAGS + 1)]
        if total > 0.0:
            correlation[channel] = max(1.0, 1.0 + 2.0 * (lagged / total).sum())
    return dispersion * correlation


def fit_vehicle(
    problem: Problem, spread: Spread, values: Values, names: EffectSet
) -> tuple[FittedValues, LinearGaussian]:
    """Return the posterior mode of the vehicle's effects, and the model linearised there.

    Without a reference this identifies a vehicle: every effect has its slab. With one, the errors of the
    identified vehicle are re-estimated together with what changed: still air at 1 m/s says little of the
    drag in a wind of 10. Model errors are left out, as no vehicle file has them.

    values: where to begin. names: effects that may have changed since the reference's flights; without a
    reference, all. Effects of the place (a wind) are left out unless among these. Flights keep their random
    effects: pooled, a fresher battery would count as the slope of the thrust over its
    command. Newton's method with step halving.
    """
    fitted = [n for n, e in problem.library.items() if n in names or not e.of_the_place]
    columns = problem.columns(fitted)
    at: FittedValues = {n: problem.neutral(n) | dict(values.get(n, {})) for n in fitted}

    local = LinearGaussian.of(problem, spread, problem.linearise(at, columns))
    for _ in range(ROUNDS):
        here = problem.coordinates(at, columns)
        change = problem.coordinates(vehicle_mode(problem, local, names), columns) - here
        for share in STEP_SHARES:
            trial = problem.values_at(fitted, columns, here + share * change)
            there = LinearGaussian.of(problem, spread, problem.linearise(trial, columns))
            gain = deviance(local, names) - deviance(there, names)
            if gain > 0.0:
                at, local = trial, there
                break
        if gain < DEVIANCE_TOLERANCE:
            break
    return at, local


def vehicle_mode(
    problem: Problem, local: LinearGaussian, names: EffectSet, weights: np.ndarray | None = None
) -> FittedValues:
    """Return the posterior mode of the vehicle's effects within bounds, in a linearised model.

    weights (g,): counts of the groups of windows, for flights left out.
    """
    change, covariance = local.posterior(names, weights)
    every = np.arange(len(change))
    at, _ = truncated_mode(local.at + change, covariance, every, local.bounds)
    fitted = {column.effect for column in local.columns}
    return problem.values_at(fitted, local.columns, at * local.unit)


def leave_one_out_modes(problem: Problem, local: LinearGaussian, names: EffectSet) -> list[FittedValues]:
    """Return for every flight the mode by the others (linearised); of a single flight its mode."""
    return [vehicle_mode(problem, local, names, weights) for weights in problem.weights_without_each_flight()]


def vehicles_a_half_width_away(
    problem: Problem, local: LinearGaussian, names: EffectSet, values: Values
) -> list[Vehicle]:
    """Return vehicles at `values`, each with another coordinate moved by the half-width of its interval."""
    _, covariance = local.posterior(names)
    deviation = np.sqrt(np.maximum(covariance.diagonal(), 0.0)) * local.unit
    at = problem.coordinates(values, local.columns)
    return [
        problem.corrected(problem.values_at(values, local.columns, at + step))
        for step in np.diag(_NORMAL * deviation)
    ]


def field_half_widths(
    before: Vehicle, after: Vehicle, moved: Iterable[Vehicle]
) -> dict[str, float | tuple[float, ...]]:
    """Return the fields in which `after` differs, with half-widths of 95 % intervals, in their units.

    moved: vehicles that differ from `after` by the half-width of one independent error each.
    """
    changed = [f.name for f in dataclasses.fields(after) if getattr(after, f.name) != getattr(before, f.name)]
    width = {name: np.zeros(np.shape(getattr(after, name))) for name in changed}
    for one in moved:
        for name in changed:
            width[name] = np.hypot(width[name], np.subtract(getattr(one, name), getattr(after, name)))
    return {n: float(w) if np.ndim(w) == 0 else tuple(map(float, w)) for n, w in width.items()}


def deviance(local: LinearGaussian, names: EffectSet) -> float:
    """Return -2 log posterior at the linearisation point, random effects marginalised."""
    # c + (x - m)' K^-1 (x - m),  N(m, K) the prior: of the identified vehicle's errors and of what changed
    mean, covariance = local.prior(names)
    return float(local.c.sum() + mean @ np.linalg.solve(covariance, mean))
