"""The named effects: which probable ones matter and predict, their sizes, and the vehicle with them."""

from __future__ import annotations

import dataclasses
import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy import stats

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.answer import rollout
from inclined_landing.eval.gap.infer.contact import ContactPosterior
from inclined_landing.eval.gap.infer.fit import (
    field_half_widths,
    fit_least_squares,
    fit_vehicle,
    leave_one_out_modes,
    vehicles_a_half_width_away,
)
from inclined_landing.eval.gap.infer.gaussian import EffectSet, LinearGaussian
from inclined_landing.eval.gap.infer.sets import SetPosterior, leave_one_out, posterior_mode
from inclined_landing.eval.gap.model.columns import BASE, FittedValues, Values, slab_deviations
from inclined_landing.eval.gap.model.prediction import UNITS_OF, channels_of
from inclined_landing.eval.gap.model.problem import Problem
from inclined_landing.eval.gap.result import Disturbance, Estimate, NamedEffect, ScoredSet
from inclined_landing.eval.logs.values import LEAST_RATE
from inclined_landing.models.effects import Effect
from inclined_landing.models.errors import UserError, first_of
from inclined_landing.models.vehicle import Vehicle


def named_effects(found: SetPosterior, values: Values) -> tuple[NamedEffect, ...]:
    """Return the named effects with estimates, largest gain first."""
    problem = found.problem
    sizes, lost = _estimates(found, values), _squared_error_increase(problem, values)
    before, after = (problem.squares_by_channel(v).sum() for v in ({}, values))
    members = {name: equivalence_class(found, name) for name in values}
    slow = [f.name for f in problem.flights if not f.shows_lags]
    which = f"Flights logged below {LEAST_RATE:g} Hz ({first_of(slow)})" if slow else ""
    too_slow = f"{which} cannot separate lags: log at 50 Hz or more."
    lags = {name: bool(slow) and problem.library[name].is_lag for name in values}
    errors = problem.reference.errors if problem.reference else None
    effects = [
        NamedEffect(
            name=name,
            members=members[name],
            probability=found.probability(*members[name]),
            parameters=sizes[name],
            gain=float(np.clip(lost[name].sum() / max(before - after, 1e-9), 0.0, 1.0)),
            remedy=problem.library[name].remedy,
            note=too_slow if lags[name] else "",
            product=_product(found, values, name) if problem.library[name].product else None,
            doubted=lags[name] or bool(errors and errors.worse),
        )
        for name in values
    ]
    return tuple(sorted(effects, key=lambda e: -e.gain))


def fitted_values(found: SetPosterior, names: EffectSet) -> FittedValues:
    """Return the values of a set of effects."""
    problem = found.problem
    values = posterior_mode(problem, found.local.with_wide_slabs(names), names)
    if problem.identified:
        return values
    # Far from the nominal vehicle, spikes of other effects would take a share.
    return fit_least_squares(problem, values, prior=slab_deviations).values


def refitted(found: SetPosterior, values: FittedValues) -> tuple[SetPosterior, FittedValues]:
    """Return the posterior linearised again at a set's values, and the values fitted there."""
    # Read off a linearisation elsewhere, a pair of effects may keep what is not there of either.
    names, problem = frozenset(values), found.problem
    if not (names and problem.identified):
        return found, values
    columns = problem.columns([*problem.library, BASE]) + problem.form_columns(values)
    linear = problem.linearise(values, columns)
    local = LinearGaussian.of(problem, found.spread, linear, values)
    there = dataclasses.replace(found, local=local, at=values)
    new = fitted_values(there, names)
    return (there, new) if problem.squares(new) <= problem.squares(values) else (found, values)


def relevant_values(found: SetPosterior) -> FittedValues:
    """Return the values of the probable effects that matter: RELEVANT of the squared error in a channel.

    Or USEFUL of the error one second ahead, as few windows may show one. With many flights a change too small
    to matter is certain.
    """
    # Effects of the best set of probability >= NAMED, those confounded with them added.
    names = frozenset(
        n for n in found.names if found.probability(*equivalence_class(found, n)) >= thresholds.NAMED
    )
    while True:
        values = fitted_values(found, names)
        after = found.problem.squares_by_channel(values)
        logged = after > 0.0
        # R^2 = increase without it / (rest + increase), in the channel where it is largest
        shares = {}
        for name, lost in _squared_error_increase(found.problem, values).items():
            shares[name] = float(np.max(lost[logged] / np.maximum(after + lost, 1e-9)[logged], initial=0.0))
        small = sorted((n for n in shares if shares[n] < thresholds.RELEVANT), key=lambda name: shares[name])
        least = next((n for n in small if not _shows_ahead(found, values, n)), "")
        if not least:
            return values
        names -= {least}


def _shows_ahead(found: SetPosterior, values: FittedValues, name: str) -> bool:
    """Return whether an error one second ahead grows by USEFUL without an effect, others fitted again."""
    ahead = _Ahead.of(found, fitted_values)
    by = _judged_by(found.problem.library[name])
    if ahead is None or not by:
        return False
    here, without = (ahead.fitted(names)[0][by] for names in (frozenset(values), frozenset(values) - {name}))
    return bool((without > (1.0 + thresholds.USEFUL) * here).any())


def useful_values(
    found: SetPosterior,
    values: FittedValues,
    fit: Callable[[SetPosterior, EffectSet], FittedValues] = fitted_values,
) -> FittedValues:
    """Return the values of the effects without which flights left out are predicted worse.

    Backward elimination by the open-loop errors one second ahead: of the position, and of tilt and heading
    where an effect acts on the attitude or on yaw. It is dropped if, without it, the first of these does not
    grow (other effects fixed) and none grows by USEFUL (other effects refitted). All of `values` are returned
    if no stretch is long enough. fit: values of a set of effects.
    """
    # No set of effects is exactly true: one may be certain from its windows and mislead all the same.
    ahead = _Ahead.of(found, fit)
    if ahead is None:
        return values
    errors, fitted = ahead.errors, ahead.fitted
    by = {name: _judged_by(found.problem.library[name]) for name in values}
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


@dataclasses.dataclass(frozen=True)
class _Ahead:
    """Errors one second ahead on flights left out, of any set of effects."""

    found: SetPosterior
    fit: Callable[[SetPosterior, EffectSet], FittedValues]
    starts: rollout.RolloutWindows

    @staticmethod
    def of(found: SetPosterior, fit: Callable[[SetPosterior, EffectSet], FittedValues]) -> _Ahead | None:
        """Return them; None where no stretch is so long."""
        try:
            return _Ahead(found, fit, rollout.RolloutWindows.of(found.problem.flights))
        except UserError:
            return None

    def errors(self, left_out: Sequence[Values]) -> np.ndarray:
        """Return the errors (3,) of position, tilt and heading, with values for every flight."""
        return rollout.pose_errors(self.starts, [self.found.problem.corrected(v) for v in left_out])

    def fitted(self, names: EffectSet) -> tuple[np.ndarray, FittedValues, list[FittedValues]]:
        """Return the errors of a set fitted again, its values, and those without each flight."""
        there, local = self.fit(self.found, names), self.found.local.with_wide_slabs(names)
        left_out = leave_one_out(self.found.problem, local, names, there)
        return self.errors(left_out), there, left_out


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


def equivalence_class(found: SetPosterior, name: str) -> tuple[str, ...]:
    """Return an effect of the best set, and those that the flights do not distinguish from it.

    These replace it in probable sets, and alone reproduce a share ALIKE of its contribution to the flights,
    or make a moment too, or are a part of it; or reproduce all but all of it (TIED), whatever their
    probabilities; or are together the same by their definition (`same_as`).
    """
    local, library = found.local, found.problem.library
    effect, others = library[name], {n: e for n, e in library.items() if n not in found.names}
    share = {other: local.reproduced(found.names, name, other) for other in others}

    def replaces(other: str) -> bool:
        moment = "requests" in effect.channels and "requests" in library[other].channels
        return share[other] >= thresholds.ALIKE or moment or name in library[other].same_as

    replacing = [o for o in confounded_with(found, name) if o in others and replaces(o)]
    tied = [o for o in others if share[o] >= thresholds.TIED and others[o].reference is None]
    same = [o for o in effect.same_as if o in library]
    return tuple(dict.fromkeys((name, *replacing, *sorted(tied, key=lambda o: -share[o]), *same)))


def _squared_error_increase(problem: Problem, values: Values) -> dict[str, np.ndarray]:
    """Return effect -> increase of the squared error (C,) of every channel without it."""
    after = problem.squares_by_channel(values)
    rest = {name: {n: v for n, v in values.items() if n != name} for name in values}
    return {name: problem.squares_by_channel(rest[name]) - after for name in values}


def _estimates(found: SetPosterior, values: Values) -> dict[str, dict[str, Estimate]]:
    """Return effect -> parameter -> its estimate, the other effects marginalised."""
    problem = found.problem
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
                at_bound=thresholds.at_bound(value, p.bounds),
                per_flight=tuple(map(float, value + known.deviation)),
                per_flight_error=tuple(map(float, known.alone)),
                spread=known.between,
            )
    return result


def _product(found: SetPosterior, values: Values, name: str) -> tuple[float, tuple[float, float]]:
    """Return the acceleration [m/s2] that an effect makes in hover, and its 95 % interval."""
    # By propagation of the sizes' errors, the others as they are:  C = (a + V^-1)^-1,  var = g' C g
    problem, local = found.problem, found.local.with_wide_slabs(frozenset(values))
    own = [k for k in local.index([name]) if not problem.parameter(local.columns[k]).is_reference]
    columns, unit = [local.columns[k] for k in own], local.unit[own]
    information = local.a.sum(axis=0)[np.ix_(own, own)] + np.linalg.inv(local.slab[np.ix_(own, own)])
    covariance = np.linalg.inv(information) * np.outer(unit, unit)
    at, others = problem.coordinates(values, columns), {n: v for n, v in values.items() if n != name}
    without = problem.hover_acceleration(others)

    def made(coordinates: np.ndarray) -> float:
        sizes = {c.key[1]: problem.parameter(c).value_at(x) for c, x in zip(columns, coordinates)}
        there = problem.hover_acceleration({**others, name: {**values[name], **sizes}})
        return float(np.linalg.norm(there - without))

    here, step = made(at), 0.1 * np.sqrt(covariance.diagonal())
    slope = np.array([(made(at + move) - here) / x for move, x in zip(np.diag(step), step)])
    half = float(stats.t.ppf(0.975, max(1, problem.groups - 1)) * np.sqrt(slope @ covariance @ slope))
    return here, (max(0.0, here - half), here + half)


def disturbances(problem: Problem) -> dict[str, Disturbance]:
    """Return channel -> measurement noise and disturbance level; yaw only where it was logged."""
    noise_model = problem.noise_model
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


def scored_sets(found: SetPosterior) -> tuple[ScoredSet, ...]:
    """Return the sets of a posterior with values and their standard errors."""
    result = []
    for scored in found.sets:
        names = tuple(n for n in found.problem.library if n in scored.names)
        values = {n: dict(scored.values[n]) for n in names}
        sized = found.local.estimates(values)
        standard_errors: dict[str, dict[str, float]] = {n: {} for n in names}
        for (name, parameter), known in sized.items():
            standard_errors[name][parameter] = known.error
        result.append(ScoredSet(names, scored.probability, values, standard_errors))
    return tuple(result)


def unidentifiable_sets(found: SetPosterior) -> tuple[ScoredSet, ...]:
    """Return the most probable set extended by each effect that the flights do not excite.

    Such an effect keeps its prior odds and a plausible size.
    """
    problem, local, best = found.problem, found.local, found.sets[0]
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
    return tuple(result)


@dataclasses.dataclass(frozen=True)
class Correction:
    """Values of the effects that correct the vehicle: the named ones, or all of an identified vehicle.

    All are estimated again where that predicts flights left out better.
    """

    vehicle: Vehicle  # with these
    values: FittedValues
    left_out: Sequence[Values]  # for every flight, fitted to the others
    again: bool = False  # whether the errors of the identified vehicle were estimated again
    half_widths: Mapping[str, float | tuple[float, ...]] = dataclasses.field(default_factory=dict)


def corrected(found: SetPosterior, values: FittedValues) -> Correction:
    """Return the correction by the named effects at `values`."""
    problem, names = found.problem, frozenset(values)
    local = found.local.with_wide_slabs(names)
    named = Correction(problem.corrected(values), values, leave_one_out(problem, local, names, values))
    if not (problem.identified and values):
        return named
    again, local = fit_vehicle(problem, found.spread, values, names)
    vehicle, moved = problem.corrected(again), vehicles_a_half_width_away(problem, local, names, again)
    widths = field_half_widths(problem.vehicle, vehicle, moved)
    whole = Correction(vehicle, again, leave_one_out_modes(problem, local, names), True, widths)
    return min(named, whole, key=lambda one: _error_left_out(problem, one))


def _error_left_out(problem: Problem, correction: Correction) -> float:
    """Return the position error [m] one second ahead on flights left out; infinite if none is so long."""
    try:
        starts = rollout.RolloutWindows.of(problem.flights)
    except UserError:
        return math.inf
    vehicles = [problem.corrected(values) for values in correction.left_out]
    return float(rollout.errors_by_flight(starts, vehicles)[0][-1])
