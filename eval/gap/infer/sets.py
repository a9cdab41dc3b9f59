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
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from msgspec import structs
from scipy.special import ndtr

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.infer.gaussian import (
    EffectSet,
    Evidence,
    LinearGaussian,
    Spread,
    flight_weights,
    prior_share,
)
from inclined_landing.eval.gap.model.columns import (
    FITTING,
    Column,
    FittedValues,
    ParameterColumn,
    Values,
    fitting,
)
from inclined_landing.eval.gap.model.problem import Linearisation, Problem
from inclined_landing.eval.gap.result import ScoredSet, marginal

REDUNDANT = (  # of these one is a combination of the others
    frozenset(("mass", "thrust_scale")),  # free flight shows the ratio of thrust to mass alone
    # Such as late poses, which are late commands of the thrust and of the attitude.
    *(frozenset((name, *of.same_as)) for name, of in FITTING.items() if of.same_as),
    frozenset(("attitude_trim", "mocap_tilt", "level_calibration")),  # a tilted estimate is trim and tilt
    # The lost torque of a rotor belongs to that rotor alone.
    *(frozenset((f"weak_rotor_{k}", "yaw_imbalance")) for k in range(1, 5)),
)
LEFT_OUT = 30.0  # nat, for each of a redundant set: odds of 1e-13
# nat, by hand, as of four numbers known to 0.6 of their prior deviations, 4 log 1/0.6: without it slung loads
# are possible in flights that carry none (CrazyPAD).
SWING_START = 2.0
MOST_EFFECTS = 16  # of a set
# Fits with another effect in the place of each one of the best set: without these a recorded load has a wrong
# sure name.
EXCHANGES = 2
MOST_FITS = 12  # sets fitted through the simulator
# Differences of log posterior odds from the best set:
FIT_WITHIN = 6.0  # a neighbour predicted to be this close is fitted through the simulator
COMPARE_WITHIN = 7.0  # one this close is given a probability
ROUGH_BEYOND = 20.0  # one further off gets a single Newton step
NEWTON_STEPS = 3
STEP_TOLERANCE = 0.5  # negligible sizes: a smaller Newton step ends the iteration
LINEARISATIONS = 3  # points whose log evidences are averaged
SIMULATED = 1.25  # simulated squared error of a probable set over the least of all, above: it is dropped
SUBSET = 0.02  # the same over that of a subset: without it two RotorPy cases are undecided
REFIT_ABOVE = 0.03  # probability of a neighbour above which it is fitted through the simulator


@dataclasses.dataclass(frozen=True)
class FittedSet:
    """A set of effects fitted through the simulator, and its linearisation."""

    names: EffectSet
    values: FittedValues  # posterior mode: one Newton step beyond the linearisation
    local: LinearGaussian  # the linearisation
    evidence: Evidence  # log marginal likelihood of any set, by this linearisation
    score: float  # log posterior probability, up to a constant


@dataclasses.dataclass(frozen=True)
class SetPosterior:
    """Posterior distribution over sets of effects, with the most probable one."""

    problem: Problem  # with its noise estimated
    linear: Linearisation  # at the fit of all effects together
    spread: Spread  # of the flights, by that
    best: FittedSet  # the most probable set, all that scales the thrust counted as one
    sets: tuple[ScoredSet, ...]  # most probable first

    @property
    def names(self) -> EffectSet:
        """Return the most probable set."""
        return self.best.names

    @property
    def local(self) -> LinearGaussian:
        """Return the model linearised where sizes are read off."""
        return self.best.local

    def probability(self, *names: str) -> float:
        """Return the marginal probability that at least one of some effects is missing."""
        return marginal(self.sets, names)


def search(problem: Problem, joint: FittedValues) -> SetPosterior:
    """Return the posterior over sets of effects; joint: the fit of `estimate_noise`."""
    linear = problem.linearise(joint, problem.all_columns())
    spread = Spread.of(problem, linear)
    eliminated = backward_eliminate(problem, LinearGaussian.of(problem, spread, linear).evidence())
    fits = _Fits(problem, spread)
    fits.search_greedily((frozenset(), eliminated), joint)
    fits.drop_worse_than_subsets()
    fits.exchange_effects_of_best()
    best = fits.best
    scored = fits.bagged_posterior(best)
    names = _most_probable(problem, scored)
    chosen = fits.by_set.get(names) or fits.fit(names, fits.linear_estimate(best, names))
    return SetPosterior(problem, linear, spread, chosen, scored)


class _Prediction(NamedTuple):
    """A set that is not fitted yet, as the linearisation of a fitted one predicts it."""

    score: float  # log posterior probability, up to a constant
    near: FittedSet  # the fitted set
    far_start: FittedValues  # of an effect of the set whose slopes at neutral mislead, if there is one


class _Fits:
    """Sets of effects fitted through the simulator, and the search for the most probable ones."""

    def __init__(self, problem: Problem, spread: Spread):
        self.problem, self.spread = problem, spread
        self.by_set: dict[EffectSet, FittedSet] = {}

    @property
    def best(self) -> FittedSet:
        """Return the fit of the most probable set."""
        return max(self.by_set.values(), key=lambda fit: fit.score)

    def fit(self, names: EffectSet, start: Values, rough_below: float = -math.inf) -> FittedSet:
        """Return the most probable of the fits of a set by Newton's method from `start`.

        Each step linearises the flights and leads to the posterior mode. If that is less probable than the
        best, the step before is halved. rough_below: log posterior probability below which a single step is
        enough.
        """
        problem, library = self.problem, self.problem.library
        values = {n: {**library[n].neutral, **start.get(n, {})} for n in library if n in names}
        # Effects that are not in the set but show in the motors' requests are linearised at their most
        # probable values (`_requested`), from the second step on.
        outside: FittedValues = {}
        best = None
        for _ in range(NEWTON_STEPS):
            columns = problem.all_columns() + problem.form_columns(values)
            local = self._linearised({**outside, **values}, columns)
            mode, evidence = posterior_mode(problem, local, names), local.evidence()
            outside = _requested(problem, local, names)
            nonzero = _all_nonzero(problem, names, mode)
            score = evidence(names) + log_prior(problem, names) if nonzero else -np.inf
            at = problem.coordinates(values, columns)
            next_values, distance = mode, problem.coordinates(mode, columns) - at  # a full Newton step
            if best is None or score > best.score:
                best = FittedSet(names, mode, local, evidence, score)
            elif np.isfinite(best.score):  # back to the middle between the best and here
                best_at = problem.coordinates(best.local.values, columns)
                next_values = problem.values_at(names, columns, 0.5 * (best_at + at))
                distance = at - best_at
            in_negligible = distance / [problem.parameter(c).negligible for c in columns]
            if score < rough_below or np.abs(in_negligible).max() < STEP_TOLERANCE:
                break
            values = next_values
        assert best is not None
        return best

    def _linearised(self, values: Values, columns: Sequence[Column]) -> LinearGaussian:
        return LinearGaussian.of(self.problem, self.spread, self.problem.linearise(values, columns))

    def linear_estimate(self, near: FittedSet, names: EffectSet) -> FittedValues:
        """Return the linear estimate of a set near a fitted one, the initial guess of its fit."""
        start = posterior_mode(self.problem, near.local, names)
        return start | {n: dict(v) for n, v in near.values.items() if n in names}

    def search_greedily(self, starts: Sequence[EffectSet], joint: Values) -> None:
        """Fit the sets `starts`, and the neighbours that are predicted to be nearly as probable as the best.

        These are neighbours of the best set, and of the empty one. joint: values that first fits begin at.
        """
        problem, fitted = self.problem, self.by_set
        fitted |= {names: self.fit(names, joint) for names in starts}
        predictions: dict[EffectSet, _Prediction] = {}
        expanded: set[EffectSet] = set()
        while len(fitted) < MOST_FITS:
            best = self.best
            for names in sorted({frozenset(), best.names} - expanded, key=len):
                expanded.add(names)
                predictions |= self._predicted_neighbours(fitted[names], predictions)
            unfitted = [names for names in predictions if names not in fitted]
            if not unfitted:
                break
            names = max(unfitted, key=lambda n: (predictions[n].score, sorted(n)))
            prediction = predictions[names]
            if prediction.score < best.score - FIT_WITHIN:
                break
            start = self.linear_estimate(prediction.near, names) | prediction.far_start
            if _all_nonzero(problem, names, start):
                fitted[names] = self.fit(names, start, best.score - ROUGH_BEYOND)
            else:  # its predicted probability comes from values beyond the bounds
                predictions[names] = prediction._replace(score=-math.inf)

    def _predicted_neighbours(
        self, fit: FittedSet, known: Mapping[EffectSet, _Prediction]
    ) -> dict[EffectSet, _Prediction]:
        """Return the neighbours of a fitted set as its linearisation predicts them.

        An effect that fits better from a distant start, added or instead of what it is confused with, is
        predicted to gain as much as there. known: predictions of other fits, which keep their distant starts.
        """
        result: dict[EffectSet, _Prediction] = {}
        for names in _neighbours(self.problem, fit):
            score = fit.evidence(names) + log_prior(self.problem, names)
            result[names] = _Prediction(score, fit, known[names].far_start if names in known else {})
        for name, far in self._far_starts(fit).items():
            confused = [n for n in self.problem.library[name].confused_with if n in fit.names]
            for names in (fit.names | {name}, *(fit.names - {n} | {name} for n in confused)):
                here = result.get(names) or known.get(names)  # neither: the set would be too large
                if here is not None and names not in self.by_set:
                    result[names] = far._replace(score=max(here.score, far.score))
        return result

    def _far_starts(self, fit: FittedSet) -> dict[str, _Prediction]:
        """Return the predictions with effects outside a fit that fit better from a distant start.

        If an effect is not linear in its size, the slopes at neutral may show nothing.
        """
        # Squared white errors are a deviance, -2 log p + constant: log p gains half of what they decrease by.
        here, result = self.problem.squares(fit.values), {}
        for name, effect in self.problem.library.items():
            if name in fit.values:
                continue
            tried = [{**effect.neutral, **start} for start in fitting(name).starts]
            gains = [0.5 * (here - self.problem.squares({**fit.values, name: start})) for start in tried]
            if gains and max(gains) > FIT_WITHIN:
                best = int(np.argmax(gains))
                result[name] = _Prediction(fit.score + gains[best], fit, {name: tried[best]})
        return result

    def drop_worse_than_subsets(self) -> None:
        """Drop the sets whose simulation is worse than that of a subset: Newton's method led these astray.

        First they are fitted again from the subset's values.
        """
        kept: dict[EffectSet, FittedSet] = {}
        squares: dict[EffectSet, float] = {}
        for names, fit in sorted(self.by_set.items(), key=lambda item: len(item[0])):
            subset = min((n for n in kept if n < names), key=lambda n: squares[n], default=names)
            most = (1.0 + SUBSET) * squares.get(subset, math.inf)
            own = self.problem.squares(fit.values)
            if own > most:
                fit = self.fit(names, kept[subset].values)
                own = self.problem.squares(fit.values)
            if own <= most:
                kept[names], squares[names] = fit, own
        self.by_set = kept

    def exchange_effects_of_best(self) -> None:
        """Fit the most probable sets with one effect of the best set exchanged."""
        best, candidates = self.best, []
        for name in sorted(best.names):
            rest = best.names - {name}
            near = self.by_set.get(rest, best)  # adding is more nearly linear than exchanging
            swaps = [rest | {n} for n in self.problem.library if n not in best.names]
            swaps = sorted(swaps, key=lambda names: -near.evidence(names))[:EXCHANGES]
            candidates += [names for names in swaps if names not in self.by_set]
        for names in candidates:
            start = self.linear_estimate(best, names)
            if _all_nonzero(self.problem, names, start):
                self.by_set[names] = self.fit(names, start, best.score - ROUGH_BEYOND)

    def bagged_posterior(self, best: FittedSet) -> tuple[ScoredSet, ...]:
        """Return the bagged posterior (Huggins and Miller 2023) of fitted sets and neighbours of the best.

        Probable neighbours are fitted, for their values.
        """
        problem, fitted = self.problem, self.by_set
        others = [n for n in _neighbours(problem, best) if n not in fitted]
        near = [n for n in others if best.evidence(n) + log_prior(problem, n) > best.score - COMPARE_WITHIN]
        starts = {n: self.linear_estimate(best, n) for n in near}
        names = [n for n, fit in fitted.items() if np.isfinite(fit.score)]
        names += [n for n, start in starts.items() if _all_nonzero(problem, n, start)]
        probability: dict[EffectSet, float] = defaultdict(float)
        for one, share in zip(names, self._bagged_probabilities(names)):
            for subset, part in _relevant_subsets(problem, fitted.get(one, best).local, one).items():
                probability[subset] += part * float(share)
        result: list[ScoredSet] = []
        for one in sorted(probability, key=lambda n: -probability[n]):
            if probability[one] < thresholds.REPORTED and result:
                continue
            if one not in fitted:
                values = starts.get(one) or self.linear_estimate(best, one)
                if probability[one] > REFIT_ABOVE or not result:  # so far from the linearisation alone
                    fitted[one] = self.fit(one, values)
            if one in fitted:
                values = fitted[one].values
            result.append(ScoredSet(problem.ordered(one), probability[one], values))
        return _simulated(problem, result)

    def _bagged_probabilities(self, names: Sequence[EffectSet]) -> np.ndarray:
        """Return the probabilities (k,) of sets, by the linearisations of the most probable fits.

        All sets are compared in the same linearisations: their error cancels in the differences.
        """
        # p(S | data) = mean_b softmax_S [log p(S) + mean_k log p_k(data_b | S)], over bootstrap samples b of
        # the flights and linearisations k.
        fits = [fit for fit in self.by_set.values() if np.isfinite(fit.score)]
        points = sorted(fits, key=lambda fit: -fit.score)[:LINEARISATIONS]
        weights = flight_weights(self.problem.groups)
        logs = np.tile([log_prior(self.problem, n) for n in names], (len(weights), 1)).T
        for point in points:
            for d, w in enumerate(weights):
                evidence = point.local.evidence(w)
                logs[:, d] += np.array([evidence(n) for n in names]) / len(points)
        shares = np.exp(logs - logs.max(axis=0))
        return (shares / shares.sum(axis=0)).mean(axis=1)


def _most_probable(problem: Problem, scored: Sequence[ScoredSet]) -> EffectSet:
    """Return the most probable set; mass, thrust scale and bias are confounded and count as one."""
    together: dict[EffectSet, float] = {}

    def merged(names: EffectSet) -> EffectSet:
        return frozenset("thrust over mass" if problem.library[n].scales_thrust else n for n in names)

    for one in scored:
        key = merged(one.names)
        together[key] = together.get(key, 0.0) + one.probability
    most = max(together, key=lambda key: together[key])
    return next(one.names for one in scored if merged(one.names) == most)


def log_prior(problem: Problem, names: EffectSet) -> float:
    """Return the log prior of a set, up to a constant: independent Bernoulli effects of equal odds.

    Sets with all of one of REDUNDANT are left out.
    """
    share = prior_share(len(problem.library))  # p(S) = s^|S| (1 - s)^(n - |S|)
    all_of = sum(len(of) for of in REDUNDANT if names >= of)
    # In addition to a load's mass and string, its swing at the start of every stretch is fitted: 4 numbers.
    begun = problem.swing_starts if "slung_load" in names else 0
    return len(names) * math.log(share / (1.0 - share)) - all_of * LEFT_OUT - begun * SWING_START


def _requested(problem: Problem, local: LinearGaussian, names: EffectSet) -> FittedValues:
    """Return the most probable values of the effects outside a set that the requests of the motors show.

    Small differences between rotors are large in the requests, and so are their products.
    """
    others = [n for n, e in problem.library.items() if "requests" in e.channels and n not in names]
    if not (problem.requested and others):
        return {}
    return problem.values_at(others, local.columns, (local.at + local.posterior(names)[0]) * local.unit)


def _all_nonzero(problem: Problem, names: EffectSet, values: Values) -> bool:
    """Return whether every effect of a set is non-zero; with one at zero it is a smaller set."""
    return all(np.any(problem.sizes(name, values)) for name in names)


def posterior_mode(problem: Problem, local: LinearGaussian, names: EffectSet) -> FittedValues:
    """Return the posterior mode of a set's effects within bounds, the others' spikes marginalised."""
    return problem.values_at(names, local.columns, local.bounded_mode(names) * local.unit)


def leave_one_out(
    problem: Problem, local: LinearGaussian, names: EffectSet, values: Values
) -> list[FittedValues]:
    """Return the leave-one-out estimates: for every flight, the values fitted to the others (linearised)."""
    result, full = [], local.bounded_mode(frozenset(names))
    at = problem.coordinates(values, local.columns)
    for weights in problem.weights_without_each_flight():
        change = (local.bounded_mode(frozenset(names), weights) - full) * local.unit
        result.append(problem.values_at(names, local.columns, at + change))
    return result


def _neighbours(problem: Problem, fit: FittedSet) -> list[EffectSet]:
    """Return the sets that differ by one effect added, removed or exchanged, or by two added."""
    # Both lists have the library's order, because that of sets differs from process to process.
    held = [n for n in problem.library if n in fit.names]
    others = [n for n in problem.library if n not in fit.names]
    result = [fit.names - {n} for n in held]
    if len(fit.names) < MOST_EFFECTS:
        result += [fit.names | {n} for n in others]
    result += [(fit.names - {n}) | {m} for n in held for m in others]
    if len(fit.names) + 2 <= MOST_EFFECTS:
        result += [fit.names | set(pair) for pair in itertools.combinations(others, 2)]
    return result


def backward_eliminate(problem: Problem, evidence: Evidence) -> EffectSet:
    """Return the set at which backward elimination by posterior probability stops."""
    kept = frozenset(problem.library)

    def score(names: EffectSet) -> float:
        return evidence(names) + log_prior(problem, names)

    while kept:
        fewer = max((kept - {n} for n in sorted(kept)), key=score)
        if score(fewer) < score(kept) and len(kept) <= MOST_EFFECTS:
            break
        kept = fewer
    return kept


def _simulated(problem: Problem, sets: Sequence[ScoredSet]) -> tuple[ScoredSet, ...]:
    """Return the sets, at probabilities of 1 in all, whose simulation bears out their linearised score."""
    probable = [one for one in sets if one.probability > REFIT_ABOVE]
    squares = {one.effects: problem.squares(one.values) for one in probable}
    most = SIMULATED * min(squares.values(), default=math.inf)
    kept = [one for one in sets if squares.get(one.effects, 0.0) <= most]
    total = sum(one.probability for one in kept)
    return tuple(structs.replace(one, probability=one.probability / total) for one in kept)


def _relevant_subsets(problem: Problem, local: LinearGaussian, names: EffectSet) -> dict[EffectSet, float]:
    """Return, for every subset, the probability that exactly its effects are of practical relevance."""
    # Region of practical equivalence (Kruschke 2018): an effect counts where a size exceeds `negligible` = r;
    # P(|x| < r) = Phi((r - m) / s) - Phi((-r - m) / s), effects taken as independent.
    at, covariance = local.bounded_mode(names), local.change(names)[1]
    errors = np.sqrt(np.maximum(covariance.diagonal(), 1e-12))
    result: dict[EffectSet, float] = {frozenset(): 1.0}
    for name in sorted(names):  # the order of sets differs from process to process
        within = 1.0
        for k in local.index([name]):
            column = local.columns[k]
            # A reference (the length of a string) matters by the size that acts about it alone.
            if isinstance(column, ParameterColumn) and not problem.parameter(column).is_reference:
                least = problem.parameter(column).negligible / local.unit[k]
                within *= float(np.diff(ndtr((np.array([-least, least]) - at[k]) / errors[k]))[0])
        parts = result.items()
        result = {s: x * within for s, x in parts} | {s | {name}: x * (1.0 - within) for s, x in parts}
    return result


def confounded_with(sets: Sequence[ScoredSet], best: EffectSet, name: str) -> tuple[str, ...]:
    """Return the effects that replace `name` of the best set in probable ones, most probable first.

    An effect that is more probable together with `name` than without it is not confounded with it.
    """
    alone: dict[str, float] = defaultdict(float)  # probability of sets without `name`
    beside: dict[str, float] = defaultdict(float)  # and of sets with it
    covered = 0.0
    for one in sets:
        if covered >= thresholds.CONFOUNDED_WITHIN:
            break
        covered += one.probability
        for other in one.names - best:
            (beside if name in one.names else alone)[other] += one.probability
    ranked = sorted(alone.items(), key=lambda item: -item[1])
    return tuple(n for n, share in ranked if share > max(beside[n], thresholds.CONFOUNDED))


def equivalence_class(found: SetPosterior, name: str) -> tuple[str, ...]:
    """Return an effect of the best set, and those that the flights do not distinguish from it.

    An effect belongs to the class for any of these reasons:
    - It replaces `name` in probable sets, and reproduces a share ALIKE of its contribution to the flights, or
      makes a moment as well, or has `name` in its `same_as`.
    - It reproduces nearly all of that contribution (TIED), whatever its probability.
    - It is in the `same_as` of `name`.
    """
    local, library = found.local, found.problem.library
    effect, others = library[name], {n: e for n, e in library.items() if n not in found.names}
    share = {other: local.reproduced(found.names, name, other) for other in others}

    def replaces(other: str) -> bool:
        moment = "requests" in effect.channels and "requests" in library[other].channels
        return share[other] >= thresholds.ALIKE or moment or name in fitting(other).same_as

    replacing = [o for o in confounded_with(found.sets, found.names, name) if o in others and replaces(o)]
    tied = [o for o in others if share[o] >= thresholds.TIED and others[o].reference is None]
    same = [o for o in fitting(name).same_as if o in library]
    tied.sort(key=lambda o: -share[o])
    return tuple(dict.fromkeys((name, *replacing, *tied, *same)))
