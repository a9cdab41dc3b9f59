"""The named effects: which probable ones matter and predict, their sizes, and the vehicle with them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import structs

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.answer.evaluation import Displacement, Refit
from inclined_landing.eval.gap.answer.rollout import RolloutWindows, pose_errors
from inclined_landing.eval.gap.answer.sizes import (
    WEIGHT,
    estimates,
    loop_pieces,
    product,
    response,
    thrust_of_names,
)
from inclined_landing.eval.gap.infer.fit import fit_least_squares
from inclined_landing.eval.gap.infer.gaussian import EffectSet, LinearGaussian
from inclined_landing.eval.gap.infer.sets import (
    SetPosterior,
    equivalence_class,
    leave_one_out,
    posterior_mode,
)
from inclined_landing.eval.gap.model.columns import (
    FittedValues,
    Values,
    slab_deviations,
)
from inclined_landing.eval.gap.model.prediction import UNITS_OF, channels_of
from inclined_landing.eval.gap.model.problem import Problem
from inclined_landing.eval.gap.result import HORIZON, Disturbance, NamedEffect, ScoredSet
from inclined_landing.eval.logs.limits import LEAST_RATE
from inclined_landing.models.base.errors import UserError, first_of
from inclined_landing.models.effects import Effect

LOOPS = frozenset(("attitude", "yaw"))  # channels of effects on the loops alone
LOOP = "attitude_time_constant"  # whose remedy stands for all lags of the attitude loops


def named_effects(
    found: SetPosterior, values: Values, ahead: Mapping[str, Displacement], least: float
) -> tuple[NamedEffect, ...]:
    """Return the named effects with estimates, in the order of `values`.

    ahead: what each does. least: see `least_cost`.
    """
    problem, pieces = found.problem, loop_pieces(found.problem, values)
    doubtful = {name for name in values if least > 0.0 and not ahead[name].cost > least}
    sizes, gains = estimates(found, values), squared_error_shares(problem, values)
    total = thrust_of_names(found, values)
    cancel = total is not None and total[1][0] <= 1.0 <= total[1][1]
    result: list[NamedEffect] = []
    for name in (n for n in values if n not in pieces[1:]):
        names = pieces if name in pieces else (name,)
        classes = ((n, *equivalence_class(found, n), *_predicting_as_well(found, values, n)) for n in names)
        members = tuple(dict.fromkeys(m for of_one in classes for m in of_one))
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
                doubt=_doubt(problem, name, ahead[name].along, name in doubtful, cancel and name in WEIGHT)
                or _doubt_next_to(library, name, [one.name for one in result]),
                parts=parts,
            )
        )
    return tuple(result)


def _predicting_as_well(found: SetPosterior, values: Values, name: str) -> list[str]:
    """Return what predicts flights left out as well as an effect that is more than its size.

    A load on a string is a mass, too, where no swing shows.
    """
    effect, starts = found.problem.library[name], _starts(found.problem)
    by = _judged_by(effect, values[name])
    if starts is None or not by or all(p.linear for p in effect.parameters):
        return []
    others = [n for n in effect.confused_with if n in found.problem.library and n not in values]
    sets = [frozenset(values) - {name} | {n} for n in (name, *others)]
    here, *errors = (pose_errors(starts, _fitted_to_others(found, names).vehicles)[by] for names in sets)
    return [n for n, error in zip(others, errors) if (error <= here).all()]


def _doubt(problem: Problem, name: str, along: Mapping[str, float], doubtful: bool, cancelled: bool) -> str:
    """Return a sentence on why an effect is not sure, whatever its probability; empty where it may be.

    doubtful: the named effects leave too much. cancelled: together, it and others may be none.
    """
    slow = [f.name for f in problem.flights if not f.shows_lags]
    if slow and problem.library[name].is_lag:
        which = f"Flights logged below {LEAST_RATE:g} Hz ({first_of(slow)})"
        return f"{which} cannot separate lags: log at 50 Hz or more."
    if "requests" in problem.library[name].channels and not problem.requested:
        return (
            "In doubt, because without the requests of the motors flights show a moment only while it is "
            "taken over: log them (m1req to m4req)."
        )
    if doubtful:
        return "In doubt, because the named effects leave more than noise and disturbances would."
    if cancelled:
        return "In doubt, because the named effects together may leave thrust over weight as modelled."
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


def _doubt_next_to(library: Mapping[str, Effect], name: str, larger: Sequence[str]) -> str:
    """Return a sentence on why a change of the loops is not sure next to larger names; empty where it may be.

    Where no loop is quite of the modelled form, what is confused with a change makes up for its errors.
    """
    loops = {n for n in (name, *larger) if LOOPS.issuperset(library[n].channels)}
    for other in larger:
        if {name, other} <= loops and other in library[name].confused_with:
            return f"In doubt, because it may be a part of the {other.replace('_', ' ')}."
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
        columns = problem.all_columns() + problem.form_columns(values)
        local = LinearGaussian.of(problem, found.spread, problem.linearise(values, columns))
        there = dataclasses.replace(found, local=local)
        new = fitted_values(there, names)
        if problem.squares(new) <= problem.squares(values):
            found, values = there, new
    return found, _largest_first(problem, values)


def _largest_first(problem: Problem, values: FittedValues) -> FittedValues:
    """Return the same values, the effects without which most squared error is lost first."""
    gains = squared_error_shares(problem, values)
    return {name: values[name] for name in sorted(gains, key=lambda n: -gains[n])}


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


def _starts(problem: Problem) -> RolloutWindows | None:
    """Return the windows of a second in which errors ahead are measured; None where no stretch is so long."""
    try:
        return RolloutWindows.of(problem.flights)
    except UserError:
        return None


def _fitted_to_others(found: SetPosterior, names: EffectSet) -> Refit:
    """Return a set of effects fitted again, and without each flight."""
    values = fitted_values(found, names)
    local = found.local.with_wide_slabs(names)
    return Refit(found.problem, values, leave_one_out(found.problem, local, names, values))


def _shows_ahead(found: SetPosterior, values: FittedValues, name: str) -> bool:
    """Return whether an error one second ahead grows by USEFUL without an effect, others fitted again."""
    starts = _starts(found.problem)
    by = _judged_by(found.problem.library[name], values[name])
    if starts is None or not by:
        return False
    sets = (frozenset(values), frozenset(values) - {name})
    here, without = (pose_errors(starts, _fitted_to_others(found, names).vehicles)[by] for names in sets)
    return bool((without > (1.0 + thresholds.USEFUL) * here).any())


def useful_values(found: SetPosterior, values: FittedValues) -> FittedValues:
    """Return the values of the effects without which flights left out are predicted worse.

    Backward elimination by the open-loop errors one second ahead: of the position, and of tilt and heading
    where an effect acts on the attitude or on yaw. It is dropped if, without it, the first of these does not
    grow (other effects fixed) and none grows by USEFUL (other effects refitted). All of `values` are returned
    if no stretch is long enough.
    """
    # No set of effects is exactly true: one may be certain from its windows and mislead all the same.
    starts = _starts(found.problem)
    if starts is None:
        return values
    by = {name: _judged_by(found.problem.library[name], values[name]) for name in values}
    fit = _fitted_to_others(found, frozenset(values))
    here = pose_errors(starts, fit.vehicles)
    while fit.values:
        fewer = []
        for name in (n for n in sorted(fit.values) if by[n]):
            rest = frozenset(fit.values) - {name}
            fixed = dataclasses.replace(fit, left_out=[{n: v[n] for n in rest} for v in fit.left_out])
            if pose_errors(starts, fixed.vehicles)[by[name][0]] <= here[by[name][0]]:
                without = _fitted_to_others(found, rest)
                errors = pose_errors(starts, without.vehicles)
                growth = errors[by[name]] / np.maximum(here[by[name]], 1e-12)
                if growth.max() <= 1.0 + thresholds.USEFUL:
                    fewer.append((growth[0], errors, without))
        if not fewer:
            break
        _, here, fit = min(fewer, key=lambda one: one[0])
    return fit.values


def distinct_values(found: SetPosterior, values: FittedValues) -> tuple[SetPosterior, FittedValues]:
    """Return the values of the effects whose sizes differ from neutral, or that predict better by USEFUL.

    An effect each of whose sizes may be neutral, or ends at a bound, is not named: others explain it. No loop
    is quite of the modelled form, and the vehicle's constants are estimated again: next to a larger effect, a
    change of the loops alone must be firm and predict better. Without the motors' requests a moment must be
    firm. The posterior is linearised where the effects are named.
    """
    found, values = refitted(found, values)
    distinct = values
    while least := _least_distinct(found, distinct):
        distinct = _largest_first(found.problem, fitted_values(found, frozenset(distinct) - {least}))
    return refitted(found, distinct) if len(distinct) < len(values) else (found, values)


def _least_distinct(found: SetPosterior, values: FittedValues) -> str:
    """Return the smallest of the effects that are not to be named, see `distinct_values`; "" for none."""
    firm, pieces = firm_names(found, values), loop_pieces(found.problem, values)
    for k, name in reversed([*enumerate(values)]):
        channels = found.problem.library[name].channels
        smaller_loop = k > 0 and LOOPS.issuperset(channels)
        if name in firm and (name in pieces or not smaller_loop):
            continue
        unseen = "requests" in channels and not found.problem.requested
        if (name not in firm and (unseen or (smaller_loop and firm))) or not _shows_ahead(
            found, values, name
        ):
            return name
    return ""


def firm_names(found: SetPosterior, values: Values) -> set[str]:
    """Return the effects with a firm size; for pieces of the attitude loops, the time of their answer."""
    problem, pieces, sizes = found.problem, loop_pieces(found.problem, values), estimates(found, values)
    firm = set(pieces) if pieces and response(found, values, pieces).differs else set()
    for name in (n for n in values if n not in pieces):
        own = (p.name for p in problem.library[name].parameters if not p.is_reference)
        if any(sizes[name][p].firm for p in own):
            firm.add(name)
    return firm


def _judged_by(effect: Effect, values: Mapping[str, float]) -> list[int]:
    """Return which of position, tilt and heading (0, 1, 2) an effect acts on; motor requests are none.

    Nor is there one for a moment that the loops take over within the second ahead: it takes from the range of
    control, and from the motion little.
    """
    hold = [values.get(p.name, 0.0) for p in effect.parameters if p.adds_to == "effects_attitude_hold"]
    if hold and hold[0] * HORIZON > 1.0:
        return []
    acts = ({"translation", "attitude"}, {"attitude"}, {"yaw"})
    return [k for k, channels in enumerate(acts) if channels & set(effect.channels)]


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
    """Return the sets of a posterior with the standard errors of their values."""
    result = []
    for scored in found.sets:
        standard_errors: dict[str, dict[str, float]] = {n: {} for n in scored.effects}
        for (name, parameter), known in found.local.estimates(scored.values).items():
            standard_errors[name][parameter] = known.error
        result.append(structs.replace(scored, standard_errors=standard_errors))
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
        odds = best.probability * share / (1.0 - share)
        result.append(ScoredSet(problem.ordered(names), odds, values, {name: width}))
    return tuple(result)
