"""Contact of the reference vehicle, from its landings: constants, and what they leave unexplained.

Effects of contact are fitted jointly, as those of free flight are, to the maximum of the posterior. Real
contact does not follow MuJoCo's law: the residual that all landings share is expected of later
ones as well, and their scatter about it is the model error of a single landing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.infer.contact import inflation, log_t, weights
from inclined_landing.eval.gap.infer.touchdown_simulation import TouchdownProblem
from inclined_landing.eval.gap.measured.landings import (
    BEFORE,
    REST_ERROR,
    TRANSIENT_ERROR,
    LandingReference,
    contact_model_covariance,
    landings_of,
)
from inclined_landing.eval.gap.model.columns import FittedValues
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.effects import Effect
from inclined_landing.models.vehicle import Vehicle

STEP = 0.3  # of central differences, in plausible sizes: contact is rough
ITERATIONS = 4  # Gauss-Newton
SHARES = (1.0, 0.5, 0.2)  # of a step that are tried
SCALES = np.array([0.25, 0.5, 1.0, 2.0, 4.0, 8.0])  # of the model errors, tried for each axis
PRIOR_LANDINGS = 2.0  # as many landings as the prior of those scales is worth


def landing_reference(
    logs: Sequence[FlightLog], vehicle: Vehicle, library: Mapping[str, Effect]
) -> tuple[Vehicle, LandingReference | None, tuple[Vehicle, ...]]:
    """Return the vehicle with its contact identified, and what its landings leave; None with too few.

    Returns vehicles with each constant a half-width of its 95 % interval away, too.
    """
    landings = landings_of(logs, vehicle)
    if len(landings) < thresholds.LEAST_LANDINGS:
        return vehicle, None, ()
    problem = TouchdownProblem.of(landings, vehicle, library)
    values, *moved = _fitted(problem)
    found = problem.corrected(values)
    return found, _left(problem, found), tuple(map(problem.corrected, moved))


def _fitted(problem: TouchdownProblem) -> list[FittedValues]:
    """Return all effects of contact at the maximum of their posterior, by Gauss-Newton steps.

    After these, with each of them a half-width of its interval away.
    """
    parameters = {n: e.parameters[0] for n, e in problem.library.items()}
    slab = np.array([abs(p.coordinate(p.plausible)) for p in parameters.values()])

    def values(x: np.ndarray) -> FittedValues:
        return {n: {p.name: p.bounded(float(at))} for (n, p), at in zip(parameters.items(), x)}

    def errors(x: np.ndarray) -> np.ndarray:
        return problem.errors(problem.corrected(values(x)))

    def score(e: np.ndarray, x: np.ndarray) -> float:
        return float((log_t(e) / share).sum() - 0.5 * ((x / slab) ** 2).sum())

    x, share = np.zeros(len(slab)), np.ones(6)
    residual = errors(x)
    for _ in range(ITERATIONS):
        steps = STEP * np.diag(slab)
        pairs = [(errors(x - step), errors(x + step)) for step in steps]
        slopes = np.stack([(a - b) / (2.0 * step.sum()) for (a, b), step in zip(pairs, steps)], axis=-1)
        share = inflation(residual, slopes)
        weight = weights(residual) / share
        known = np.einsum("icqp,icqs,ic->ps", slopes, slopes, weight, optimize=True) + np.diag(slab**-2.0)
        down = np.einsum("icqp,icq,ic->p", slopes, residual, weight, optimize=True) - x / slab**2
        step, before = np.linalg.solve(known, down), score(residual, x)
        for size in SHARES:
            after = errors(x + size * step)
            if score(after, x + size * step) > before:
                x, residual = x + size * step, after
                break
        else:
            break
    deviation = np.sqrt(np.diag(np.linalg.inv(known)))
    return [values(x), *(values(x + 1.96 * way) for way in np.diag(deviation))]


def _left(problem: TouchdownProblem, vehicle: Vehicle) -> LandingReference:
    """Return the common residual of the landings at a vehicle, and the size of their model errors."""
    left, landings = problem.deviations(vehicle), problem.landings
    on_platform, q = np.array([x.on_platform for x in landings]), problem.samples
    t = landings[0].compared[:q] * landings[0].dt - BEFORE
    weight = weights(problem.errors(vehicle))[:, None, :]  # (n, 1, 6)
    common, about = np.zeros((2, 6, q)), []
    for surface in (0, 1):
        own = on_platform == bool(surface)
        if own.sum() < 2:
            continue
        mean = (weight[own] * left[own]).sum(axis=0) / weight[own].sum(axis=0)
        common[surface] = mean.T
        about.append((left[own] - mean) / np.sqrt(1.0 - 1.0 / own.sum()))
    scatter = np.concatenate(about)
    noise = np.mean([x.by_noise[:, :q, :q] for x in landings], axis=0)
    transient, rest = np.array(TRANSIENT_ERROR), np.array(REST_ERROR)
    for c in range(6):
        best = -np.inf
        for a in SCALES:
            for b in SCALES:
                model = contact_model_covariance(
                    t, a * np.eye(6)[c] * TRANSIENT_ERROR, b * np.eye(6)[c] * REST_ERROR
                )[c]
                root = np.linalg.cholesky(noise[c] + model)
                white = np.linalg.solve(root, scatter[:, :, c].T)
                log = -0.5 * (white**2).sum() - len(scatter) * np.log(np.diag(root)).sum()
                log -= 0.5 * PRIOR_LANDINGS * (np.log(a) ** 2 + np.log(b) ** 2)
                if log > best:
                    best, transient[c], rest[c] = log, a * TRANSIENT_ERROR[c], b * REST_ERROR[c]
    return LandingReference((int((~on_platform).sum()), int(on_platform.sum())), t, common, transient, rest)
