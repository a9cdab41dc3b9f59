"""The selection of the named effects among the probable ones, by what they explain and predict."""

from __future__ import annotations

import dataclasses
import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

import numpy as np
from scipy.special import ndtri, stdtrit

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.answer.rollout import RolloutWindows, errors_by_flight, pose_errors
from inclined_landing.eval.gap.flights.windows import MeasuredFlight
from inclined_landing.eval.gap.infer.fit import fit_least_squares
from inclined_landing.eval.gap.infer.gaussian import EffectSet, LinearGaussian
from inclined_landing.eval.gap.infer.sets import (
    SetPosterior,
    equivalence_class,
    leave_one_out,
    posterior_mode,
)
from inclined_landing.eval.gap.model.columns import (
    Column,
    FittedValues,
    ParameterColumn,
    Values,
    at_an_end,
    slab_deviations,
)
from inclined_landing.eval.gap.model.fitting import fitting
from inclined_landing.eval.gap.model.problem import Problem
from inclined_landing.eval.gap.result import HORIZON, Estimate
from inclined_landing.models import forces
from inclined_landing.models.attitude_loops import angle_steps
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.effects import Effect
from inclined_landing.models.vehicle import Vehicle

LOOPS = frozenset(("attitude", "yaw"))  # channels of effects on the loops alone
STEP_RESPONSE, STEP = 2.0, 0.001  # s, length and step of the simulated answer of an attitude loop


@dataclasses.dataclass(frozen=True)
class Refit:
    """Values of effects fitted to the flights of a problem, and those fitted without each flight."""

    problem: Problem
    values: FittedValues
    left_out: Sequence[FittedValues]  # for every flight, fitted to the others
    # Where the constants of an identified vehicle were estimated again: half-widths of their 95 % intervals.
    half_widths: Mapping[str, float | tuple[float, ...]] | None = None

    @staticmethod
    def of(found: SetPosterior, values: FittedValues) -> Refit:
        """Return values of a set of effects, and those fitted without each flight (linearised)."""
        names = frozenset(values)
        local = found.local.with_wide_slabs(names)
        return Refit(found.problem, values, leave_one_out(found.problem, local, names, values))

    @cached_property
    def vehicle(self) -> Vehicle:
        """Return the vehicle with the effects."""
        return self.problem.corrected(self.values)

    @cached_property
    def vehicles(self) -> list[Vehicle]:
        """Return for every flight the vehicle fitted to the others."""
        return [self.problem.corrected(values) for values in self.left_out]

    def judged(self, heldout: Sequence[MeasuredFlight]) -> tuple[Sequence[MeasuredFlight], list[Vehicle]]:
        """Return the flights that errors are measured on, each with a vehicle that was not fitted to it.

        They are those held out; without any, the flights fitted.
        """
        if heldout:
            return heldout, [self.vehicle] * len(heldout)
        return self.problem.flights, self.vehicles

    def error_ahead(self) -> float:
        """Return the position error [m] one second ahead on flights left out; infinite if none is so long."""
        starts = self._windows_ahead()
        return float(errors_by_flight(starts, self.vehicles)[-1]) if starts else math.inf

    @cached_property
    def pose_errors(self) -> np.ndarray:
        """Return the errors (3,) of position [m], tilt and heading [rad] ahead, as above; NaN if none is."""
        starts = self._windows_ahead()
        return pose_errors(starts, self.vehicles) if starts else np.full(3, math.nan)

    def _windows_ahead(self) -> RolloutWindows | None:
        """Return the windows of a second in which errors are measured; None where no stretch is so long."""
        try:
            return RolloutWindows.of(self.problem.flights)
        except UserError:
            return None


def relevant_values(found: SetPosterior) -> FittedValues:
    """Return the values of the probable effects that are large enough to matter.

    Each explains a share RELEVANT of the squared error in a channel, or the error one second ahead grows by
    USEFUL without it, as few windows may show it. With many flights even a change too small to matter is
    certain.
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


def useful_values(found: SetPosterior, values: FittedValues) -> FittedValues:
    """Return the values of the effects without which flights left out are predicted worse.

    This is a backward elimination by the open-loop errors one second ahead: of the position, and of tilt and
    heading where an effect acts on the attitude or on yaw. An effect is dropped if, without it, the first of
    these does not grow (other effects fixed) and none grows by USEFUL (other effects refitted). None is
    dropped if no stretch is long enough.
    """
    # No set of effects is exactly true: one may be certain from its windows and mislead all the same.
    by = {name: judged_by(found.problem.library[name], values[name]) for name in values}
    fit = fitted_to_others(found, frozenset(values))
    while fit.values:
        fewer = []
        for name in (n for n in sorted(fit.values) if by[n]):
            rest, own = frozenset(fit.values) - {name}, by[name]
            fixed = dataclasses.replace(fit, left_out=[{n: v[n] for n in rest} for v in fit.left_out])
            if fixed.pose_errors[own[0]] <= fit.pose_errors[own[0]]:
                without = fitted_to_others(found, rest)
                growth = without.pose_errors[own] / np.maximum(fit.pose_errors[own], 1e-12)
                if growth.max() <= 1.0 + thresholds.USEFUL:
                    fewer.append((growth[0], without))
        if not fewer:
            break
        _, fit = min(fewer, key=lambda one: one[0])
    return fit.values


def distinct_values(found: SetPosterior, values: FittedValues) -> tuple[SetPosterior, FittedValues]:
    """Return the values of the effects whose sizes differ from neutral, or that predict better by USEFUL.

    An effect each of whose sizes may be neutral, or ends at a bound, is not named: others explain it. A
    change of the loops alone, next to a larger effect, must be firm and predict better too, because no loop
    is quite of the modelled form and the vehicle's constants are estimated again. Without the motors'
    requests a moment must be firm. The posterior is linearised where the effects are named.
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


def judged_by(effect: Effect, values: Mapping[str, float]) -> list[int]:
    """Return which of position, tilt and heading (0, 1, 2) an effect acts on, the first being the main one.

    There is none for an effect that acts on the motors' requests alone, and for a moment that the loops take
    over within the second ahead: it takes up some of the range of control, and changes the motion little.
    """
    hold = [values.get(p.name, 0.0) for p in effect.parameters if p.adds_to == "effects_attitude_hold"]
    if hold and hold[0] * HORIZON > 1.0:
        return []
    acts = ({"translation", "attitude"}, {"attitude"}, {"yaw"})
    return [k for k, channels in enumerate(acts) if channels & set(effect.channels)]


def _shows_ahead(found: SetPosterior, values: FittedValues, name: str) -> bool:
    """Return whether an error one second ahead grows by USEFUL without an effect, others fitted again."""
    by = judged_by(found.problem.library[name], values[name])
    if not by:
        return False
    sets = (frozenset(values), frozenset(values) - {name})
    here, without = (fitted_to_others(found, names).pose_errors[by] for names in sets)
    return bool((without > (1.0 + thresholds.USEFUL) * here).any())


def fitted_to_others(found: SetPosterior, names: EffectSet) -> Refit:
    """Return a set of effects fitted again, and without each flight."""
    return Refit.of(found, fitted_values(found, names))


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
        there = dataclasses.replace(found, best=dataclasses.replace(found.best, local=local))
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


def _squared_error_increase(problem: Problem, values: Values) -> dict[str, np.ndarray]:
    """Return effect -> increase of the squared error (C,) of every channel without it."""
    after = problem.squares_by_channel(values)
    rest = {name: {n: v for n, v in values.items() if n != name} for name in values}
    return {name: problem.squares_by_channel(rest[name]) - after for name in values}


def estimates(found: SetPosterior, values: Values) -> dict[str, dict[str, Estimate]]:
    """Return effect -> parameter -> its estimate, the other effects marginalised."""
    problem = found.problem
    sized = found.local.with_wide_slabs(frozenset(values)).estimates(values)
    result: dict[str, dict[str, Estimate]] = {name: {} for name in values}
    for name in values:
        for p in problem.library[name].parameters:
            value, (low, high) = values[name][p.name], p.bounds
            known = sized.get((name, p.name))
            if known is None:  # a reference: another one and another size do the same
                nan = (math.nan,) * len(problem.flights)
                result[name][p.name] = Estimate(
                    value, p.unit, p.possible, p.neutral, p.bounds, False, nan, 0.0
                )
                continue
            half = half_width(problem, known.error)
            below, above = _extrapolated(value - p.neutral, half, fitting(name).extrapolated)
            result[name][p.name] = Estimate(
                value=value,
                unit=p.unit,
                ci95=(max(low, p.neutral + below), min(high, p.neutral + above)),
                neutral=p.neutral,
                bounds=p.bounds,
                at_bound=thresholds.at_bound(value, p.bounds),
                per_flight=tuple(map(float, value + known.deviation)),
                spread=known.between,
            )
    return result


def half_width(problem: Problem, error: float) -> float:
    """Return the half-width of the 95 % interval of a quantity with this standard error (Student t)."""
    return float(stdtrit(max(1, problem.groups - 1), 0.975) * error)


def _extrapolated(size: float, half: float, share: float) -> tuple[float, float]:
    """Return the interval of a size with a half-width, where the constant it acts by is uncertain by a share.

    That constant is above zero, so that an interval that excludes zero still does.
    """
    ends = size - half, size + half
    if not (share and size):
        return ends
    # log |x| ~ N(log |size|, s^2 + share^2), s from each end in turn
    result = []
    for end in ends:
        ratio = end / size
        if ratio > 0.0:
            distance = math.hypot(math.log(ratio), ndtri(0.975) * share)
            end = size * math.exp(math.copysign(distance, ratio - 1.0))
        result.append(end)
    return result[0], result[1]


def loop_pieces(problem: Problem, values: Values) -> tuple[str, ...]:
    """Return the named lags of the attitude loops if there are several, first the largest in plausible sizes.

    They are pieces of one change: no loop quite follows the formula of one of them, so that the flights show
    how quickly the loops answer, but not which piece makes them do so.
    """

    def size(name: str) -> float:
        of = problem.library[name].parameters
        return max(abs(p.coordinate(values[name][p.name]) / p.coordinate(p.plausible)) for p in of)

    lags = [n for n in values if problem.library[n].is_lag]
    own = [n for n in lags if {"attitude", "translation"} & set(problem.library[n].channels) == {"attitude"}]
    return tuple(sorted(own, key=size, reverse=True)) if len(own) > 1 else ()


def response(found: SetPosterior, values: Values, pieces: Sequence[str]) -> Estimate:
    """Return when the attitude loops with these pieces answer to a step of their command."""
    vehicle = found.problem.vehicle

    def response(at: Values) -> float:
        return step_response_time(found.problem.corrected({n: at[n] for n in pieces}))

    value, (low, high) = jointly(found, values, pieces, response)
    ends, bounds = (max(0.0, low), high), (0.0, STEP_RESPONSE)
    return Estimate(value, "s", ends, step_response_time(vehicle), bounds, False, (), 0.0)


def step_response_time(vehicle: Vehicle) -> float:
    """Return when [s] roll is at 63 % of its steady angle after a step of its command, delay included."""
    packed, command = forces.pack(vehicle), np.full(round(STEP_RESPONSE / STEP), 0.1)
    angle = angle_steps(0, command, np.zeros(len(command)), 0.0, STEP, packed)
    steady = vehicle.attitude_gain * (command[0] + vehicle.effects_attitude_trim[0])
    reached = np.maximum.accumulate(angle / steady) >= 1.0 - math.exp(-1.0)
    k = int(np.argmax(reached)) if reached.any() else len(command)
    before = max(k - 1, 0)
    share = ((1.0 - math.exp(-1.0)) * steady - angle[before]) / max(angle[k] - angle[before], 1e-12)
    return vehicle.effects_attitude_delay + STEP * (before + float(share))


def jointly(
    found: SetPosterior, values: Values, names: Sequence[str], of: Callable[[Values], float]
) -> tuple[float, tuple[float, float]]:
    """Return a quantity of some of the effects in `values`, the others marginalised, and its interval."""
    local = found.local.with_wide_slabs(frozenset(values))
    own = size_columns(found.problem, local, names)
    covariance = local.change(frozenset(values))[1] * np.outer(local.unit, local.unit)
    columns = [local.columns[k] for k in own]
    return propagated(found.problem, values, columns, covariance[np.ix_(own, own)], of)


def size_columns(problem: Problem, local: LinearGaussian, names: Sequence[str]) -> list[int]:
    """Return the indices of the columns of effects' parameters, without those that these are relative to."""
    own = ((k, local.columns[k]) for k in local.index(names))
    return [k for k, c in own if isinstance(c, ParameterColumn) and not problem.parameter(c).is_reference]


def propagated(
    problem: Problem,
    values: Values,
    columns: Sequence[Column],
    covariance: np.ndarray,
    of: Callable[[Values], float],
) -> tuple[float, tuple[float, float]]:
    """Return a quantity of `values` and its 95 % interval, from the covariance along some columns."""
    # Propagation of errors: var = g' C g, slopes g over a tenth of a standard error
    at, step = problem.coordinates(values, columns), 0.1 * np.sqrt(covariance.diagonal())

    def moved(coordinates: np.ndarray) -> float:
        there, ends = {n: dict(v) for n, v in values.items()}, defaultdict(list)
        for c, x in zip(columns, coordinates):
            if at_an_end(c):
                ends[c.effect].append(x)
            else:
                there[c.effect][c.key[1]] = problem.parameter(c).value_at(x)
        for name, sizes in ends.items():
            effect = problem.library[name]
            first, (size, about) = effect.parameters[0], effect.from_ends(*sizes)
            there[name] |= {first.name: first.neutral + size}
            there[name] |= {p.name: about for p in effect.parameters if p is effect.reference}
        return of(there)

    here = of(values)
    slope = np.array([(moved(at + one) - here) / x for one, x in zip(np.diag(step), step)])
    half = half_width(problem, np.sqrt(slope @ covariance @ slope))
    return here, (here - half, here + half)
