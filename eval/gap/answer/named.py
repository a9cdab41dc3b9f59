"""The named effects: estimates, confounded effects, and shares of the decrease in squared error."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Sequence

import numpy as np
from scipy import stats

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.answer import rollout
from inclined_landing.eval.gap.flights.noise_model import NoiseModel
from inclined_landing.eval.gap.infer.contact import ContactPosterior
from inclined_landing.eval.gap.infer.fit import dersimonian_laird
from inclined_landing.eval.gap.infer.gaussian import EffectSet
from inclined_landing.eval.gap.infer.sets import SetPosterior, leave_one_out
from inclined_landing.eval.gap.infer.touchdown_simulation import TouchdownProblem
from inclined_landing.eval.gap.model.columns import FittedValues, Values
from inclined_landing.eval.gap.model.prediction import UNITS_OF, channels_of
from inclined_landing.eval.gap.model.problem import Problem
from inclined_landing.eval.gap.result import (
    Disturbance,
    Estimate,
    NamedEffect,
    ScoredSet,
)
from inclined_landing.eval.logs.values import LEAST_RATE
from inclined_landing.models.effects import Effect
from inclined_landing.models.errors import UserError, first_of


def named_effects(problem: Problem, found: SetPosterior, values: Values) -> tuple[NamedEffect, ...]:
    """Return the named effects with estimates, largest gain first."""
    sizes, lost = _estimates(problem, found, values), squared_error_increase(problem, found, values)
    before, after = (squares_by_channel(problem, found, v).sum() for v in ({}, values))
    members = {name: (name, *confounded_with(found, name)) for name in values}
    slow = [f.name for f in problem.flights if not f.shows_lags]
    unresolved = {name: bool(slow) and problem.library[name].is_lag for name in values}
    effects = [
        NamedEffect(
            name=name,
            members=members[name],
            probability=found.probability(*members[name]),
            parameters=sizes[name],
            gain=float(np.clip(lost[name].sum() / max(before - after, 1e-9), 0.0, 1.0)),
            remedy=problem.library[name].remedy,
            note=_too_slow(slow) if unresolved[name] else "",
            unresolved=unresolved[name],
        )
        for name in values
    ]
    return tuple(sorted(effects, key=lambda e: -e.gain))


def _too_slow(flights: Sequence[str]) -> str:
    """Return a sentence on flights recorded at too low a rate to distinguish lags."""
    which = f"Flights of fewer than {LEAST_RATE:g} rows per second ({first_of(flights)})"
    return f"{which} do not distinguish lags: log 50 or more."


def probable_effects(found: SetPosterior) -> EffectSet:
    """Return the effects of the best set of probability >= NAMED, confounded ones added."""
    return frozenset(
        n for n in found.names if found.probability(n, *confounded_with(found, n)) >= thresholds.NAMED
    )


def relevant_values(problem: Problem, found: SetPosterior, fit: Callable[[EffectSet], Values]) -> Values:
    """Return the values of the probable effects that matter: RELEVANT of the squared error in a channel.

    With many flights a change too small to matter is certain. fit: values of a set of effects.
    """
    names = probable_effects(found)
    while True:
        values = fit(names)
        after = squares_by_channel(problem, found, values)
        logged = after > 0.0
        # R^2 = increase without it / (rest + increase), in the channel where it is largest
        shares = {}
        for name, lost in squared_error_increase(problem, found, values).items():
            shares[name] = float(np.max(lost[logged] / np.maximum(after + lost, 1e-9)[logged], initial=0.0))
        least = min(shares, key=lambda name: shares[name], default="")
        if not least or shares[least] >= thresholds.RELEVANT:
            return values
        names -= {least}


def useful_values(
    problem: Problem, found: SetPosterior, values: Values, fit: Callable[[EffectSet], Values]
) -> Values:
    """Return the values of the effects without which flights left out are predicted worse.

    Backward elimination by the open-loop errors one second ahead: of the position, and of tilt and heading
    where an effect acts on the attitude or on yaw. It is dropped where without it the first of these does not
    grow, the others as they are, and none by USEFUL with the others fitted again. All of `values` where no
    stretch is so long. fit: values of a set of effects.
    """
    # No set of effects is exactly true: one may be certain from its windows and mislead all the same.
    try:
        starts = rollout.RolloutWindows.of(problem.flights)
    except UserError:
        return values
    by = {name: _judged_by(problem.library[name]) for name in values}

    def errors(left_out: Sequence[Values]) -> np.ndarray:
        return rollout.pose_errors(starts, [problem.corrected(v) for v in left_out])

    def fitted(names: EffectSet) -> tuple[np.ndarray, Values, list[FittedValues]]:
        there = fit(names)
        left_out = leave_one_out(problem, found.local.with_wide_slabs(names), names, there)
        return errors(left_out), there, left_out

    here, values, left_out = fitted(frozenset(values))
    while values:
        fewer = []
        for name in (n for n in sorted(values) if by[n]):
            first, rest = by[name][0], frozenset(values) - {name}
            others = [{n: v[n] for n in rest} for v in left_out]
            if errors(others)[first] <= here[first]:
                without = fitted(rest)
                growth = without[0][by[name]] / np.maximum(here[by[name]], 1e-12)
                if growth.max() <= 1.0 + thresholds.USEFUL:
                    fewer.append((growth[0], without))
        if not fewer:
            break
        _, (here, values, left_out) = min(fewer, key=lambda one: one[0])
    return values


def _judged_by(effect: Effect) -> list[int]:
    """Return which of position, tilt and heading (0, 1, 2) an effect acts on; motor requests are none."""
    acts = ({"translation", "attitude"}, {"attitude"}, {"yaw"})
    return [k for k, channels in enumerate(acts) if channels & set(effect.channels)]


def confounded_with(found: SetPosterior | ContactPosterior, name: str) -> tuple[str, ...]:
    """Return the effects that replace `name` in probable sets, most probable first.

    An effect that is more probable together with `name` than without it is not confounded with it.
    """
    alone: dict[str, float] = defaultdict(float)  # probability of sets without `name`
    beside: dict[str, float] = defaultdict(float)  # and of sets with it
    covered = 0.0
    for one in found.sets:
        if covered >= thresholds.CONFOUNDED_WITHIN:
            break
        covered += one.probability
        for other in one.names - found.names:
            (beside if name in one.names else alone)[other] += one.probability
    ranked = sorted(alone.items(), key=lambda item: -item[1])
    return tuple(n for n, share in ranked if share > max(beside[n], thresholds.CONFOUNDED))


def squares_by_channel(problem: Problem, found: SetPosterior, values: Values) -> np.ndarray:
    """Return the weighted sum of squared white errors (6,) of every channel."""
    white = problem.white_errors_at(values)
    squares = np.concatenate([np.einsum("wcq,wcq->wc", x, x) for x in white])
    return (problem.weight / found.inflation * squares).sum(axis=0)


def squared_error_increase(problem: Problem, found: SetPosterior, values: Values) -> dict[str, np.ndarray]:
    """Return effect -> increase of the squared error (6,) of every channel without it."""
    after = squares_by_channel(problem, found, values)
    rest = {name: {n: v for n, v in values.items() if n != name} for name in values}
    return {name: squares_by_channel(problem, found, rest[name]) - after for name in values}


def _estimates(problem: Problem, found: SetPosterior, values: Values) -> dict[str, dict[str, Estimate]]:
    """Return effect -> parameter -> its estimate, the other effects marginalised."""
    sized = found.local.with_wide_slabs(frozenset(values)).estimates(values)
    quantile = stats.t.ppf(0.975, max(1, problem.groups - 1))
    result: dict[str, dict[str, Estimate]] = {name: {} for name in values}
    for name in values:
        for p in problem.library[name].parameters:
            value, (low, high) = values[name][p.name], p.bounds
            known = sized.get((name, p.name))
            if known is None:  # a reference: another one and another size do the same
                nan = (math.nan,) * len(problem.flights)
                result[name][p.name] = Estimate(
                    value, p.unit, p.possible, p.neutral, p.bounds, False, nan, nan, 0.0
                )
                continue
            half = float(quantile * known.error)
            result[name][p.name] = Estimate(
                value=value,
                unit=p.unit,
                ci95=(max(low, value - half), min(high, value + half)),
                neutral=p.neutral,
                bounds=p.bounds,
                at_bound=bool(min(value - low, high - value) <= thresholds.AT_BOUND * (high - low)),
                per_flight=tuple(map(float, value + known.deviation)),
                per_flight_error=tuple(map(float, known.alone)),
                spread=known.between,
            )
    return result


def disturbances(problem: Problem, noise_model: NoiseModel) -> dict[str, Disturbance]:
    """Return channel -> measurement noise and disturbance level; yaw only where it was logged."""
    noise = np.median([f.noise for f in problem.flights], axis=0) * noise_model.noise
    return {
        channel: Disturbance(
            noise=float(noise[k]),
            size=float(noise_model.size[k]),
            size_ci95=(float(noise_model.size_ci95[0, k]), float(noise_model.size_ci95[1, k])),
            time=float(noise_model.time[k]),
            time_ci95=(float(noise_model.time_ci95[0, k]), float(noise_model.time_ci95[1, k])),
            unit=UNITS_OF[channel],
        )
        for k, channel in enumerate(channels_of(problem))
        if problem.logged[:, k].any()
    }


def contact_effects(problem: TouchdownProblem, found: ContactPosterior) -> tuple[NamedEffect, ...]:
    """Return the named contact effects with estimates, largest gain first."""
    effects = []
    for name, sized in found.sizes.items():
        members = (name, *confounded_with(found, name))
        if found.probability(*members) < thresholds.NAMED:
            continue
        (p,), (low, high) = problem.library[name].parameters, problem.library[name].parameters[0].bounds
        estimate = Estimate(
            value=sized.value,
            unit=p.unit,
            ci95=sized.ends,
            neutral=p.neutral,
            bounds=p.bounds,
            at_bound=bool(min(sized.value - low, high - sized.value) <= thresholds.AT_BOUND * (high - low)),
            per_flight=tuple(map(float, sized.each)),
            per_flight_error=tuple(map(float, sized.error)),
            spread=dersimonian_laird(sized.each, sized.error),
        )
        probability, remedy = found.probability(*members), problem.library[name].remedy
        effects.append(NamedEffect(name, members, probability, {p.name: estimate}, found.gains[name], remedy))
    return tuple(sorted(effects, key=lambda e: -e.gain))


def scored_sets(problem: Problem, found: SetPosterior) -> list[ScoredSet]:
    """Return the sets of a posterior with values and their standard errors."""
    result = []
    for scored in found.sets:
        names = tuple(n for n in problem.library if n in scored.names)
        values = {n: dict(scored.values[n]) for n in names}
        sized = found.local.estimates(values)
        standard_errors: dict[str, dict[str, float]] = {n: {} for n in names}
        for (name, parameter), known in sized.items():
            standard_errors[name][parameter] = known.error
        result.append(ScoredSet(names, scored.probability, values, standard_errors))
    return result


def unidentifiable_sets(problem: Problem, found: SetPosterior) -> list[ScoredSet]:
    """Return the most probable set extended by each effect that the flights do not excite.

    Such an effect keeps its prior odds and a plausible size.
    """
    local, best = found.local, found.sets[0]
    share = 1.0 - thresholds.PRIOR_EMPTY ** (1.0 / len(problem.library))
    scored = {one.names for one in found.sets}
    result = []
    for name, effect in problem.library.items():
        names = best.names | {name}
        own = local.index([name])
        if names in scored or effect.told_by or not len(own):
            continue
        prior = np.sqrt(local.slab[own[0], own[0]])
        if local.standard_errors(names)[own[0]] < thresholds.UNIDENTIFIABLE * prior:
            continue
        width = {p.name: abs(p.size(p.plausible)) for p in effect.parameters}
        values = {n: dict(best.values[n]) for n in best.names} | {name: effect.plausible}
        ordered = tuple(n for n in problem.library if n in names)
        odds = best.probability * share / (1.0 - share)
        result.append(ScoredSet(ordered, odds, values, {name: width}))
    return result


def joint_sets(flown: tuple[ScoredSet, ...], found: ContactPosterior) -> tuple[ScoredSet, ...]:
    """Return the product of the posteriors of free-flight and contact sets, most probable first."""
    both = [
        ScoredSet(
            (*one.effects, *other.values),
            one.probability * other.probability,
            {**one.values, **other.values},
            one.standard_errors,
        )
        for one in flown
        for other in found.sets
    ]
    both.sort(key=lambda one: -one.probability)
    return tuple(one for k, one in enumerate(both) if not k or one.probability >= thresholds.REPORTED)
