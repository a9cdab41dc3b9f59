"""The vehicle that the flights show: all its effects fitted together, by Newton's method.

Without a reference this identifies a vehicle: every effect has its slab. With one, the errors of the
identified vehicle are estimated again beside what changed: still air at 1 m/s says little of the drag in a
wind of 10. Model errors are left out, as no vehicle file has them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np

from inclined_landing.eval.gap.infer.gaussian import EffectSet, LinearGaussian
from inclined_landing.eval.gap.model.columns import FittedValues, Values
from inclined_landing.eval.gap.model.problem import Problem
from inclined_landing.models.vehicle import Vehicle

ROUNDS = 8  # of Newton's method
STEP_SHARES = (1.0, 0.5, 0.25, 0.1)  # of a Newton step, the first that decreases the deviance
_NORMAL = 1.96  # half-width of a 95 % interval in standard deviations
DEVIANCE_TOLERANCE = 1.0  # decrease of the deviance that ends the iteration


def fit_vehicle(
    problem: Problem, values: Values, names: EffectSet, inflation: np.ndarray
) -> tuple[FittedValues, LinearGaussian]:
    """Return the posterior mode of the vehicle's effects, and the model linearised there.

    values: where to begin. names: effects that may have changed since the reference's flights; without a
    reference, all. Effects of the place (a wind) are left out unless among these. Random effects of the
    flights stand beside it: pooled, a fresher battery would count as the slope of the thrust over its
    command. Newton's method with step halving.
    """
    fitted = [n for n, e in problem.library.items() if n in names or not e.of_the_place]
    columns = problem.columns(fitted)
    at: FittedValues = {n: problem.neutral(n) | dict(values.get(n, {})) for n in fitted}

    def linearised(here: Values) -> LinearGaussian:
        return LinearGaussian.of(problem, problem.linearise(here, columns, inflation), here)

    local = linearised(at)
    for _ in range(ROUNDS):
        here = problem.coordinates(at, columns)
        change = problem.coordinates(vehicle_mode(problem, local, names), columns) - here
        for share in STEP_SHARES:
            trial = problem.values_at(fitted, columns, here + share * change)
            there = linearised(trial)
            gain = _deviance(local, names) - _deviance(there, names)
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
    at, _ = local.bounds.truncated_mode(local.at + change, covariance, every)
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


def _deviance(local: LinearGaussian, names: EffectSet) -> float:
    """Return -2 log posterior at the linearisation point, random effects marginalised."""
    # c + (x - m)' K^-1 (x - m),  N(m, K) the prior: of the identified vehicle's errors and of what changed
    mean, covariance = local.prior(names)
    return float(local.c.sum() + mean @ np.linalg.solve(covariance, mean))
