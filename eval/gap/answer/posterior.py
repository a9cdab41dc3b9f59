"""The posterior of an identified vehicle, and the parameters that its flights identify."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.flights.landings import LandingReference
from inclined_landing.eval.gap.infer.fit import deviance
from inclined_landing.eval.gap.infer.gaussian import LinearGaussian, Spread, truncated_mode
from inclined_landing.eval.gap.infer.residual import reference_residual, white_residuals
from inclined_landing.eval.gap.model.columns import BASE, BaseColumn, slab_deviations
from inclined_landing.eval.gap.model.problem import Problem, identifiable_effects
from inclined_landing.eval.gap.model.reference import VehiclePosterior, free_effects
from inclined_landing.eval.gap.result import ReferenceErrors
from inclined_landing.models.effects import LIBRARY, Effect
from inclined_landing.models.vehicle import Vehicle


def problem_about(problem: Problem, vehicle: Vehicle) -> Problem:
    """Return the problem of all effects that free flights can show, about the identified vehicle."""
    free = {name: effect for name, effect in free_effects().items() if effect.identified}
    library, _ = identifiable_effects(free, problem.flights)
    return with_library(dataclasses.replace(problem, vehicle=vehicle), library)


def with_library(problem: Problem, library: Mapping[str, Effect]) -> Problem:
    """Return a problem with other effects and the same noise."""
    return dataclasses.replace(
        Problem.of(problem.flights, problem.vehicle, library, model_errors=1.0),
        noise_model=problem.noise_model,
        weight=problem.weight,
        inflation=problem.inflation,
    )


def identified_reference(
    problem: Problem,
    *,
    errors: ReferenceErrors | None,
    landings: LandingReference | None,
    flights: Mapping[str, tuple[int, ...]],
) -> VehiclePosterior:
    """Return the posterior of the vehicle of `problem`, all effects with their slab priors.

    errors, landings, flights: as of `VehiclePosterior`.
    """
    columns, names = problem.all_columns(), frozenset(problem.library)
    linear = problem.linearise({}, columns)
    spread = Spread.of(problem, linear)
    local = LinearGaussian.of(problem, spread, linear)
    known, mean = _errors_of_the_vehicle(problem, spread, local)
    # The vehicle lacks effects that its flights never met, such as the ground high up. They are no error of
    # its identification: theta = 0, and flights that meet them name them.
    prior = local.slab.diagonal() * local.unit**2
    met = (known.diagonal() < thresholds.UNMET**2 * prior) | [isinstance(c, BaseColumn) for c in columns]
    known, mean = np.where(np.outer(met, met), known, 0.0), np.where(met, mean, 0.0)
    repeating = reference_residual(problem, white_residuals(problem, local, names))
    # But a constant that every vehicle has is as uncertain as before flights that do not show it at all.
    unseen = {n for n, e in free_effects().items() if n not in names and e.is_constant}
    return VehiclePosterior(
        *(tuple(columns), mean, known, repeating, frozenset(free_effects()) - unseen),
        errors=errors,
        landings=landings,
        flights=flights,
    )


def _errors_of_the_vehicle(
    problem: Problem, spread: Spread, local: LinearGaussian
) -> tuple[np.ndarray, np.ndarray]:
    """Return the covariance (P, P) and mean (P,) of the errors of the vehicle of a problem.

    The slopes at the vehicle may lead to where the flights are less probable: there they say nothing of its
    effects, and the mean is that of the model errors without them.
    """
    columns, names, unit = local.columns, frozenset(problem.library), local.unit
    change, covariance = local.posterior(names)
    at = local.at + change
    model = np.array([isinstance(c, BaseColumn) for c in columns])
    # Conditioned on x_E = 0 (Bishop 2.81):  x_B = m_B - C_BE C_EE^-1 m_E
    inner = covariance[np.ix_(~model, ~model)] + 1e-9 * np.eye(np.count_nonzero(~model))
    without = np.where(model, at - covariance[:, ~model] @ np.linalg.solve(inner, at[~model]), 0.0)
    whole, _ = truncated_mode(at, covariance, np.arange(len(at)), local.bounds)

    def less_probable(x: np.ndarray) -> float:
        weights = {c.key[1]: float(w) for c, w in zip(columns, x * unit) if isinstance(c, BaseColumn)}
        values = {**problem.values_at(names, columns, x * unit), BASE: weights}
        return deviance(LinearGaussian.of(problem, spread, problem.linearise(values, columns)), names)

    return covariance * np.outer(unit, unit), min(whole, without, key=less_probable) * unit


@dataclasses.dataclass(frozen=True)
class Identifiable:
    """Identifiability of an effect from the flights."""

    effect: str
    share: float  # posterior over prior standard deviation; 1: not excited at all
    confounded: tuple[str, ...]  # effects that it is confounded with
    regimes: tuple[str, ...]  # that excite it


def identifiability(around: Problem, reference: VehiclePosterior) -> tuple[Identifiable, ...]:
    """Return the identifiability of each effect, best identified first."""
    wide = slab_deviations(around, reference.columns)
    error = np.sqrt(np.diag(reference.covariance))
    scale = np.where(error > 0.0, error, 1.0)
    correlation = np.abs(reference.covariance / np.outer(scale, scale))
    columns = {n: [k for k, c in enumerate(reference.columns) if c.effect == n] for n in around.library}
    result = []
    for name, own in columns.items():
        share = float(max(np.where(error[own] > 0.0, error[own] / wide[own], 1.0)))
        others = [
            n
            for n, its in columns.items()
            if n != name and correlation[np.ix_(own, its)].max() > thresholds.CORRELATED
        ]
        confounded = tuple(others) if share > thresholds.ROUGH else ()
        result.append(Identifiable(name, share, confounded, LIBRARY[name].regimes))
    return tuple(sorted(result, key=lambda one: one.share))
