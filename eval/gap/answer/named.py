"""The named effects: which probable ones matter and predict, their sizes, and the vehicle with them."""

from __future__ import annotations

import dataclasses
import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.answer import rollout
from inclined_landing.eval.gap.answer.sizes import estimates, loop_pieces, product, response
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
from inclined_landing.eval.gap.model.columns import (
    BASE,
    FittedValues,
    Values,
    slab_deviations,
)
from inclined_landing.eval.gap.model.prediction import UNITS_OF, channels_of
from inclined_landing.eval.gap.model.problem import Problem
from inclined_landing.eval.gap.result import Disturbance, NamedEffect, ScoredSet
from inclined_landing.eval.logs.limits import LEAST_RATE
from inclined_landing.models.base.errors import UserError, first_of
from inclined_landing.models.effects import Effect
from inclined_landing.models.vehicle import Vehicle

LOOP = "attitude_time_constant"  # whose remedy stands for all lags of the attitude loops

DIAGONAL = 0.5  # offset along one axis over the larger along the other, from which it may be a rotor's moment


@dataclasses.dataclass(frozen=True)
class Displacement:
    """What a named effect does to the position one second ahead."""

    cost: float = math.nan  # m, the error that it accounts for; NaN: not known
    along: Mapping[str, float] = dataclasses.field(default_factory=dict)  # axis -> m, root mean square


def named_effects(
    found: SetPosterior, values: Values, ahead: Mapping[str, Displacement], doubtful: bool
) -> tuple[NamedEffect, ...]:
    """Return the named effects with estimates, in the order of `values`.

    ahead: what each does. doubtful: these leave too much.
    """
    problem, pieces = found.problem, loop_pieces(found.problem, values)
    sizes, gains = estimates(found, values), squared_error_shares(problem, values)
    result = []
    for name in (n for n in values if n not in pieces[1:]):
        names = pieces if name in pieces else (name,)
        members = tuple(dict.fromkeys(m for n in names for m in (n, *equivalence_class(found, n))))
        library, parts = problem.library, {}
        if name in pieces:
            parts = {n: dict(values[n]) for n in pieces}
            sizes[name] = {"response": response(found, values, pieces)}
        result.append(
            NamedEffect(
                name=name,
                members=members,
                probability=found.probability(*members),
                parameters=sizes[name],
                gain=max(gains[n] for n in names),
                remedy=library[LOOP if parts else name].remedy,
                cost=ahead[name].cost,
                product=product(found, values, name) if library[name].product else None,
                doubt=_doubt(problem, name, ahead[name].along, doubtful),
                parts=parts,
            )
        )
    return tuple(result)


def _doubt(problem: Problem, name: str, along: Mapping[str, float], doubtful: bool) -> str:
    """Return a sentence on why an effect is not sure, whatever its probability; empty where it may be."""
    slow = [f.name for f in problem.flights if not f.shows_lags]
    if slow and problem.library[name].is_lag:
        which = f"Flights logged below {LEAST_RATE:g} Hz ({first_of(slow)})"
        return f"{which} cannot separate lags: log at 50 Hz or more."
    if doubtful:
        return "In doubt, because the named effects leave more than noise and disturbances would."
    # Does it move the vehicle by less than the reference is wrong where it was right before?
    worse = problem.reference.errors.worse if problem.reference and problem.reference.errors else {}
    most = max(along, key=lambda axis: along[axis], default="")
    for where, (before, after) in worse.items():
        moved = math.hypot(*along.values()) if where == "position" else along.get(where, math.nan)
        if where in ("position", most) and moved < after:
            return (
                f"In doubt, because the identified vehicle predicts {where} of its own flights worse than "
                f"the vehicle before did ({100 * after:.1f} cm for {100 * before:.1f} cm one second ahead): "
                "identify it again, from more flights that move there."
            )
    return ""


def fitted_values(found: SetPosterior, names: EffectSet) -> FittedValues:
    """Return the values of a set of effects."""
    problem = found.problem
    values = posterior_mode(problem, found.local.with_wide_slabs(names), names)
    if problem.identified:
        return values
    # Far from the nominal vehicle, spikes of other effects would take a share.
    return fit_least_squares(problem, values, prior=slab_deviations).values


def refitted(found: SetPosterior, values: FittedValues) -> tuple[SetPosterior, FittedValues]:
    """Return the posterior linearised again at a set's values, and the values there, largest gain first."""
    # Read off a linearisation elsewhere, a pair of effects may keep what is not there of either.
    names, problem = frozenset(values), found.problem
    if names and problem.identified:
        columns = problem.columns([*problem.library, BASE]) + problem.form_columns(values)
        linear = problem.linearise(values, columns)
        local = LinearGaussian.of(problem, found.spread, linear, values)
        there = dataclasses.replace(found, local=local, at=values)
        new = fitted_values(there, names)
        if problem.squares(new) <= problem.squares(values):
            found, values = there, new
    gains = squared_error_shares(problem, values)
    return found, {name: values[name] for name in sorted(gains, key=lambda n: -gains[n])}


def squared_error_shares(problem: Problem, values: Values) -> dict[str, float]:
    """Return effect -> share of the closable squared error that is lost without it."""
    lost = _squared_error_increase(problem, values)
    before, after = (problem.squares_by_channel(v).sum() for v in ({}, values))
    return {n: float(np.clip(x.sum() / max(before - after, 1e-9), 0.0, 1.0)) for n, x in lost.items()}


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
    by = _judged_by(found.problem.library[name], values[name])
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
    by = {name: _judged_by(found.problem.library[name], values[name]) for name in values}
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


def distinct_values(found: SetPosterior, values: FittedValues) -> FittedValues:
    """Return the values of the effects whose sizes differ from neutral, or that predict better by USEFUL.

    An effect each of whose sizes may be neutral, or ends at a bound, is not named: others explain it.
    """
    pieces = loop_pieces(found.problem, values)
    while True:
        sizes = estimates(found, values)
        vague = [n for n in values if n not in pieces and not any(p.firm for p in sizes[n].values())]
        least = next((n for n in vague if not _shows_ahead(found, values, n)), "")
        if not least:
            return values
        values = fitted_values(found, frozenset(values) - {least})


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


def _judged_by(effect: Effect, values: Mapping[str, float]) -> list[int]:
    """Return which of position, tilt and heading (0, 1, 2) an effect acts on; motor requests are none.

    Nor is there one for a moment that the loops take over within the second ahead: it takes from the range of
    control, and from the motion little.
    """
    hold = [values.get(p.name, 0.0) for p in effect.parameters if p.adds_to == "effects_attitude_hold"]
    if hold and hold[0] * rollout.HORIZON > 1.0:
        return []
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
    probabilities; or are together the same by their definition (`same_as`). Without requests of the motors a
    centre of mass towards a corner may be a weak rotor.
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
    if name == "com_offset" and not found.problem.requested and name in found.values:
        same += _rotor_of_moment(found.values[name]["x"], found.values[name]["y"])
    return tuple(dict.fromkeys((name, *replacing, *sorted(tied, key=lambda o: -share[o]), *same)))


def _rotor_of_moment(x: float, y: float) -> list[str]:
    """Return the rotor that, giving less thrust, makes the moment of a centre of mass at (x, y), if one does.

    It is the one towards which the centre of mass lies.
    """
    if min(abs(x), abs(y)) < DIAGONAL * max(abs(x), abs(y)):
        return []
    corners = {(True, False): 1, (False, False): 2, (False, True): 3, (True, True): 4}  # x forward, y left
    return [f"weak_rotor_{corners[x > 0.0, y > 0.0]}"]


def _squared_error_increase(problem: Problem, values: Values) -> dict[str, np.ndarray]:
    """Return effect -> increase of the squared error (C,) of every channel without it."""
    after = problem.squares_by_channel(values)
    rest = {name: {n: v for n, v in values.items() if n != name} for name in values}
    return {name: problem.squares_by_channel(rest[name]) - after for name in values}


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
