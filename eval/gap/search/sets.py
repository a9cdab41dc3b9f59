"""Bayesian model selection: a posterior distribution over the sets of effects that may explain the flights.

Greedy search with backward elimination for a start. The marginal likelihood of a neighbouring set - one
effect added, removed or exchanged - is predicted from the linearisation (Gram matrices) of the nearest fitted
set; the most probable ones are fitted through the simulator by Newton's method and linearised again, until no
neighbour is predicted to beat the best.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence

import numpy as np
from scipy.special import ndtr

from inclined_landing.eval.gap.flights.noise_model import NoiseModel, estimate
from inclined_landing.eval.gap.search.evidence import BASE, Linearisation, Problem, Values
from inclined_landing.eval.gap.search.fit import LeastSquaresFit, fit_least_squares
from inclined_landing.eval.gap.search.posterior import (
    EffectSet,
    Evidence,
    LinearGaussian,
    confounding,
    estimate_between_flight_deviations,
    excitation,
    flight_weights,
    slab_deviations,
)

PRIOR_EMPTY = 0.5  # prior probability that nothing is missing
MOST_EFFECTS = 16  # effects of a set
EXCHANGES = 2  # others that are fitted in the place of every effect of the best set
MOST_FITS = 12  # sets that are fitted through the simulator, at most
FIT_WITHIN = 6.0  # log probability behind the best within which a neighbour is worth a fit
NEWTON_STEPS = 3  # of Newton for a set, at most
STEP_TOLERANCE = 0.5  # negligible sizes within which a step is linear
COMPARE_WITHIN = 7.0  # log probability behind the best beyond which a set is not worth telling
ROUGH_BEYOND = 20.0  # beyond which it is not worth fitting well
MODEL_ERRORS = np.array([0.0, *np.geomspace(0.002, 0.5, 30)])  # shares of the motion by which it may be off
ALTERNATIONS = 4  # rounds in which effects and disturbance are fitted in turn, at most
LEAST_PROBABILITY = 1e-3  # probability of a set that is worth telling
LINEARISATIONS = 3  # linearisations in which sets are compared
REFIT_ABOVE = 0.03  # above which it is fitted through the simulator


@dataclasses.dataclass
class FittedSet:
    """A set fitted through the simulator."""

    names: EffectSet
    at: dict[str, dict[str, float]]  # where it was linearised
    values: dict[str, dict[str, float]]  # a step on, beside the small errors of all other effects
    local: LinearGaussian
    screen: Evidence
    score: float  # log probability, up to a constant


@dataclasses.dataclass(frozen=True)
class SetProbability:
    """A set with its probability."""

    names: EffectSet
    probability: float
    values: dict[str, dict[str, float]]


@dataclasses.dataclass
class SetPosterior:
    """The outcome of `search`."""

    names: EffectSet  # the most probable set, what scales the thrust counted as one
    values: dict[str, dict[str, float]]  # of the most probable set
    at: dict[str, dict[str, float]]  # effect values near it
    local: LinearGaussian  # the flights at these
    sets: tuple[SetProbability, ...]  # most probable first
    noise_model: NoiseModel
    joint: dict[str, dict[str, float]]  # fit of all effects
    linear: Linearisation  # the flights linearised there
    inflation: np.ndarray  # (6,)

    def probability(self, *names: str) -> float:
        """That one of some effects is part of what is missing."""
        return sum(s.probability for s in self.sets if s.names & set(names))


def search(problem: Problem) -> SetPosterior:
    """Return the posterior over sets of effects; the noise model of `problem` is estimated on the way."""
    joint, noise_model = fit_jointly(problem, list(problem.library))
    inflation = autocorrelation_inflation(problem, joint.values)
    columns = problem.columns([*problem.library, BASE])
    linear = problem.linearise(joint.values, columns, inflation)
    problem.confounded = confounding(linear)
    problem.between = estimate_between_flight_deviations(problem, linear)
    problem.excitation = excitation(problem, linear)
    eliminated = backward_eliminate(problem, LinearGaussian.of(problem, linear, joint.values).evidence())
    nodes = _greedy_search(problem, inflation, eliminated, joint.values)
    best = max(nodes.values(), key=lambda node: node.score)
    scored = _bagged_posterior(problem, nodes, best, inflation)
    names = _most_probable(problem, scored)
    if names not in nodes:
        nodes[names] = _fit_set(problem, names, _linear_estimate(problem, best, names), inflation)
    chosen = nodes[names]
    return SetPosterior(
        names, chosen.values, chosen.at, chosen.local, scored, noise_model, joint.values, linear, inflation
    )


def _most_probable(problem: Problem, scored: Sequence[SetProbability]) -> EffectSet:
    """Return the most probable set; mass, thrust scale and bias count as one (only their ratio shows)."""
    together: dict[EffectSet, float] = {}

    def merged(names: EffectSet) -> EffectSet:
        return frozenset("thrust over mass" if problem.library[n].scales_thrust else n for n in names)

    for one in scored:
        key = merged(one.names)
        together[key] = together.get(key, 0.0) + one.probability
    most = max(together, key=lambda key: together[key])
    return next(one.names for one in scored if merged(one.names) == most)


def fit_jointly(problem: Problem, names: Sequence[str]) -> tuple[LeastSquaresFit, NoiseModel]:
    """Fit effects jointly, alternating with the noise model: measurement noise and disturbance level."""
    values: dict[str, dict[str, float]] = {name: {} for name in (*names, BASE)}
    no_inflation, noise_model = np.ones(6), NoiseModel.none()
    for _ in range(ALTERNATIONS):
        before, fit = (
            noise_model,
            fit_least_squares(
                problem, values, no_inflation, iterations=3, tolerance=5.0, prior=_joint_fit_prior
            ),
        )
        values, vehicle = fit.values, problem.corrected(fit.values)
        predicted = [problem.predicted(f, values) for f in problem.flights]
        errors = [f.measured - p for f, p in zip(problem.flights, predicted)]
        ends = np.cumsum([len(f.starts) for f in problem.flights])[:-1]
        noise_model = estimate(problem.flights, errors, np.split(problem.weight, ends))
        problem.rewhiten(noise_model, vehicle)
        if not problem.identified:
            problem.compute_form_jacobians(vehicle)
        model_error_weights(problem, predicted, errors)
        if np.allclose(noise_model.size, before.size, rtol=0.15, atol=1e-3):
            break
    return fit, noise_model


def _joint_fit_prior(problem: Problem, columns: Sequence) -> np.ndarray:
    """Prior standard deviation (P,) of the joint fit; model errors are tight without reference flights."""
    width = slab_deviations(problem, columns)
    if problem.identified:
        return width
    known = np.sqrt(problem.known(columns)[1].diagonal())
    return np.where([c.effect == BASE for c in columns], known, width)


def model_error_weights(
    problem: Problem, predicted: Sequence[np.ndarray], errors: Sequence[np.ndarray]
) -> None:
    """Set every window's weight from a multiplicative model error, maximum likelihood per channel.

    Variance of a white error in a window with predicted energy E:  1 + f^2 E,  f one of FORMS.
    predicted, errors: (m, 6) of every flight.
    """

    def energy(values: Sequence[np.ndarray]) -> np.ndarray:
        white = [f.whitening(f.cut(v)) for f, v in zip(problem.flights, values)]
        return np.concatenate([(x**2).mean(axis=2) for x in white])

    moved, left = energy(predicted), energy(errors)  # (w, 6)
    variance = 1.0 + MODEL_ERRORS[:, None, None] ** 2 * moved
    unlikely = (problem.rows[:, None] * problem.logged * (np.log(variance) + left / variance)).sum(axis=1)
    best = np.argmin(unlikely, axis=0)
    problem.weight = problem.logged / np.take_along_axis(variance, best[None, None], axis=0)[0]


def autocorrelation_inflation(problem: Problem, values) -> np.ndarray:
    """Return the variance inflation (6,) of correlated windows: 1 + 2 sum of their autocorrelations."""
    white = problem.white_errors_at(values)
    scale = np.ones(6)
    for channel in range(6):
        total, apart = 0.0, np.zeros(4)
        for flight, errors in zip(problem.flights, white):
            size = flight.whitening.amplitudes(errors)[:, channel]
            size = size * np.sqrt(flight.whitening.power[channel])
            total += float(size @ size)
            apart += [float(size[lag:] @ size[:-lag]) if len(size) > lag else 0.0 for lag in range(1, 5)]
        if total > 0.0:
            scale[channel] = np.clip(1.0 + 2.0 * (apart / total).sum(), 1.0, 10.0)
    return scale


def log_prior(problem: Problem, names: EffectSet) -> float:
    """Return the log prior of a set: independent effects of equal odds, the empty set with NOTHING."""
    share = 1.0 - PRIOR_EMPTY ** (1.0 / max(1, len(problem.library)))
    return len(names) * math.log(share / (1.0 - share))


def _fit_set(
    problem: Problem, names: EffectSet, start, inflation: np.ndarray, rough_below: float = -math.inf
) -> FittedSet:
    """Fit a set from `start` by Newton's method and linearise the simulator there.

    worth: score below which one iteration is enough.
    """
    new = {n: problem.library[n].neutral | start.get(n, {}) for n in problem.library if n in names}
    for _ in range(NEWTON_STEPS):
        values = new
        columns = problem.columns([*problem.library, BASE]) + problem.form_columns(values)
        linear = problem.linearise(values, columns, inflation)
        local = LinearGaussian.of(problem, linear, values)
        new = posterior_mode(problem, local, names)
        step = problem.coordinates(new, columns) - problem.coordinates(values, columns)
        least = np.array([problem.parameter(c).negligible for c in columns])
        screen = local.evidence()
        score = screen(names) + log_prior(problem, names) if _all_nonzero(problem, names, new) else -np.inf
        if np.abs(step / least).max() < STEP_TOLERANCE or score < rough_below:
            break
    return FittedSet(names, values, new, local, screen, score)


def _all_nonzero(problem: Problem, names: EffectSet, values) -> bool:
    """Tell whether every effect of a set is non-zero; with one at zero it is a smaller set."""
    return all(np.any(problem.sizes(name, values)) for name in names)


def posterior_mode(problem: Problem, local: LinearGaussian, names: EffectSet, weights=None) -> dict:
    """Return the posterior mode of a set's effects, within bounds, the others' spikes integrated out."""
    return problem.values_at(names, local.columns, local.within(names, weights) * local.unit)


def leave_one_out(problem: Problem, local: LinearGaussian, names: EffectSet, values: Values) -> list[dict]:
    """Return, for every flight, the effects' values fitted to the other flights only (linearised)."""
    result, full = [], local.within(frozenset(names))
    at = problem.coordinates(values, local.columns)
    for k in range(len(problem.flights)):
        weights = np.ones(problem.groups)
        if len(problem.flights) > 1:
            weights[np.unique(problem.group_of[problem.flight_of == k])] = 0.0
        change = (local.within(frozenset(names), weights) - full) * local.unit
        result.append(problem.values_at(names, local.columns, at + change))
    return result


def _linear_estimate(problem: Problem, node: FittedSet, names: EffectSet) -> dict:
    """Return the linear estimate of a neighbouring set, where its fit starts."""
    start = posterior_mode(problem, node.local, names)
    return start | {n: dict(v) for n, v in node.values.items() if n in names}


def _neighbours(problem: Problem, node: FittedSet) -> list[EffectSet]:
    """Return the sets that differ by one effect added, removed or exchanged, or by two added."""
    names = list(problem.library)
    others = [n for n in names if n not in node.names]
    result = [node.names - {n} for n in node.names]
    if len(node.names) < MOST_EFFECTS:
        more = [node.names | {n} for n in others]
        result += more
    result += [(node.names - {n}) | {m} for n in node.names for m in others]
    if len(node.names) + 2 <= MOST_EFFECTS:
        pairs = list(itertools.combinations(others, 2))
        result += [node.names | set(pair) for pair in pairs]
    return [frozenset(s) for s in result]


def backward_eliminate(problem: Problem, evidence: Evidence) -> EffectSet:
    """Return the set that backward elimination by marginal likelihood ends at."""
    kept = frozenset(problem.library)

    def score(names: EffectSet) -> float:
        return evidence(names) + log_prior(problem, names)

    while kept:
        fewer = max((kept - {n} for n in sorted(kept)), key=score)
        if score(fewer) < score(kept) and len(kept) <= MOST_EFFECTS:
            break
        kept = fewer
    return kept


def _greedy_search(
    problem: Problem, inflation: np.ndarray, eliminated: EffectSet, values: Values
) -> dict[EffectSet, FittedSet]:
    """Search greedily from the empty set and from `eliminated`, started at `values`; return the fitted sets."""
    nodes = {names: _fit_set(problem, names, values, inflation) for names in (frozenset[str](), eliminated)}
    predicted: dict[EffectSet, tuple[float, FittedSet]] = {}
    expanded: set[EffectSet] = set()
    while len(nodes) < MOST_FITS:
        best = max(nodes.values(), key=lambda node: node.score)
        if best.names not in expanded:
            expanded.add(best.names)
            for names in _neighbours(problem, best):
                predicted[names] = (best.screen(names) + log_prior(problem, names), best)
        left = [(score, names) for names, (score, _) in predicted.items() if names not in nodes]
        if not left:
            break
        score, names = max(left, key=lambda item: (item[0], sorted(item[1])))
        if score < best.score - FIT_WITHIN:
            break
        start = _linear_estimate(problem, predicted[names][1], names)
        if _all_nonzero(problem, names, start):
            nodes[names] = _fit_set(problem, names, start, inflation, best.score - ROUGH_BEYOND)
        else:  # it promises something beyond its bounds only
            del predicted[names]
    best = max(nodes.values(), key=lambda node: node.score)
    for names in _exchange_candidates(problem, best, nodes):
        start = _linear_estimate(problem, best, names)
        if _all_nonzero(problem, names, start):
            nodes[names] = _fit_set(problem, names, start, inflation, best.score - ROUGH_BEYOND)
    return nodes


def _exchange_candidates(
    problem: Problem, best: FittedSet, nodes: dict[EffectSet, FittedSet]
) -> list[EffectSet]:
    """Return, for every effect of the best set, the best exchanges by another that are not fitted yet."""
    result = []
    for name in sorted(best.names):
        rest = best.names - {name}
        near = nodes.get(rest, best)  # adding is more nearly linear than exchanging
        swaps = [rest | {n} for n in problem.library if n not in best.names]
        swaps = sorted(swaps, key=lambda names: -near.screen(names))[:EXCHANGES]
        result += [names for names in swaps if names not in nodes]
    return result


def _bagged_posterior(
    problem: Problem, nodes: dict[EffectSet, FittedSet], best: FittedSet, inflation
) -> tuple[SetProbability, ...]:
    """Return bagged posterior probabilities, log evidence averaged over the best POINTS linearisations.

    All sets are compared in the same linearisations: the error of linearising cancels in the difference.
    """
    weights = flight_weights(problem.groups)
    near = {n: best.screen(n) + log_prior(problem, n) for n in _neighbours(problem, best) if n not in nodes}
    near = {n: x for n, x in near.items() if x > best.score - COMPARE_WITHIN}
    starts = {n: _linear_estimate(problem, best, n) for n in near}
    near = {n: x for n, x in near.items() if _all_nonzero(problem, n, starts[n])}
    fitted = {n: node for n, node in nodes.items() if np.isfinite(node.score)}
    names = [*fitted, *near]
    points = sorted(fitted.values(), key=lambda node: -node.score)[:LINEARISATIONS]
    logs = np.tile([log_prior(problem, n) for n in names], (len(weights), 1)).T
    for node in points:
        for d, w in enumerate(weights):
            evidence = node.local.evidence(w)
            logs[:, d] += np.array([evidence(n) for n in names]) / len(points)
    shares = np.exp(logs - logs.max(axis=0))
    probability: dict[EffectSet, float] = {}
    for one, share in zip(names, (shares / shares.sum(axis=0)).mean(axis=1)):
        near_it = nodes.get(one, best).local
        for subset, part in _relevant_subsets(problem, near_it, one).items():
            probability[subset] = probability.get(subset, 0.0) + part * float(share)
    result: list[SetProbability] = []
    for one in sorted(probability, key=lambda n: -probability[n]):
        if probability[one] < LEAST_PROBABILITY and result:
            continue
        if one not in nodes and (probability[one] > REFIT_ABOVE or not result):
            start = starts.get(one) or _linear_estimate(
                problem, best, one
            )  # told by the linearisation alone so far
            nodes[one] = _fit_set(problem, one, start, inflation)
        values = (
            nodes[one].values if one in nodes else starts.get(one) or _linear_estimate(problem, best, one)
        )
        result.append(SetProbability(one, probability[one], values))
    return tuple(result)


def _relevant_subsets(problem: Problem, local: LinearGaussian, names: EffectSet) -> dict[EffectSet, float]:
    """Return, for every subset, the probability that exactly its effects exceed their negligible size."""
    at, spread = local.within(names), local.delta(names)[1]
    errors = np.sqrt(np.maximum(spread.diagonal(), 1e-12))
    result: dict[EffectSet, float] = {frozenset(): 1.0}
    for name in names:
        within = 1.0
        for k in local.index([name]):
            if not local.columns[k].form:
                least = problem.parameter(local.columns[k]).negligible / local.unit[k]
                within *= float(np.diff(ndtr((np.array([-least, least]) - at[k]) / errors[k]))[0])
        parts = result.items()
        result = {s: x * within for s, x in parts} | {s | {name}: x * (1.0 - within) for s, x in parts}
    return result
