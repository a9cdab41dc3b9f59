"""Sizes with their 95 % intervals: of effects, of what several make together, and of disturbances."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Sequence

import numpy as np
from scipy.special import ndtri, stdtrit

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.infer.gaussian import LinearGaussian
from inclined_landing.eval.gap.infer.sets import SetPosterior
from inclined_landing.eval.gap.model.columns import (
    Candidates,
    Column,
    ParameterColumn,
    Values,
    at_an_end,
    fitting,
)
from inclined_landing.eval.gap.model.prediction import UNITS_OF, channels_of
from inclined_landing.eval.gap.model.problem import Problem
from inclined_landing.eval.gap.result import Disturbance, Estimate, Quantity
from inclined_landing.models import forces
from inclined_landing.models.attitude_loops import angle_steps
from inclined_landing.models.vehicle import Vehicle

STEP_RESPONSE, STEP = 2.0, 0.001  # s, length and step of the simulated answer of an attitude loop


def estimates(found: SetPosterior, values: Values) -> dict[str, dict[str, Estimate]]:
    """Return effect -> parameter -> its estimate, the other effects marginalised."""
    problem = found.problem
    sized = found.local.for_sizes_of(frozenset(values)).parameter_errors(values)
    result: dict[str, dict[str, Estimate]] = {name: {} for name in values}
    for name in values:
        for p in problem.library[name].parameters:
            value, known = values[name][p.name], sized.get((name, p.name))
            ends = p.possible
            if known is not None:  # else a reference: another one and another size do the same
                half = half_width(problem, known.error)
                below, above = _extrapolated(value - p.neutral, half, fitting(name).extrapolated)
                ends = max(p.bounds[0], p.neutral + below), min(p.bounds[1], p.neutral + above)
            result[name][p.name] = Estimate(
                value=value,
                unit=p.unit,
                ci95=ends,
                neutral=p.neutral,
                bounds=p.bounds,
                at_bound=known is not None and thresholds.at_bound(value, p.bounds),
                is_shown=known is not None,
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
    low, high = (_extrapolated_end(size, end, share) for end in ends)
    return low, high


def _extrapolated_end(size: float, end: float, share: float) -> float:
    """Return the end of a size's interval, where that is also uncertain by a share."""
    # The logarithm of the size is normal, with the variances of both:
    #   log |x| ~ N(log |size|, s^2 + share^2),   1.96 s = |log(end / size)|
    ratio = end / size
    if ratio <= 0.0:
        return end
    distance = math.hypot(math.log(ratio), ndtri(0.975) * share)
    return size * math.exp(math.copysign(distance, ratio - 1.0))


def loop_pieces(problem: Problem, values: Values) -> tuple[str, ...]:
    """Return the named lags of the attitude loops if there are several, first the largest in plausible sizes.

    They are pieces of one change: no loop quite follows the formula of one of them, so that the flights show
    how quickly the loops answer, but not which piece makes them do so. Named apart, a second lag is named
    next to the right one in four measured cases.
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

    time, (low, high) = jointly(found, values, pieces, response)
    return Estimate(
        value=time,
        unit="s",
        ci95=(max(0.0, low), high),
        neutral=step_response_time(vehicle),
        bounds=(0.0, STEP_RESPONSE),
        at_bound=False,
    )


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
) -> Quantity:
    """Return a quantity of some of the effects in `values`, the others marginalised."""
    local = found.local.for_sizes_of(frozenset(values))
    own = size_columns(found.problem, local, names)
    covariance = local.change(frozenset(values))[1] * np.outer(local.unit, local.unit)
    columns = [local.columns[k] for k in own]
    return propagated(found.problem, values, columns, covariance[np.ix_(own, own)], of)


def size_columns(problem: Problem, local: LinearGaussian, names: Sequence[str]) -> list[int]:
    """Return the indices of the columns of effects' parameters, without reference parameters."""
    own = ((k, local.columns[k]) for k in local.index(names))
    return [k for k, c in own if isinstance(c, ParameterColumn) and not problem.parameter(c).is_reference]


def propagated(
    problem: Problem,
    values: Values,
    columns: Sequence[Column],
    covariance: np.ndarray,
    of: Callable[[Values], float],
) -> Quantity:
    """Return a quantity of `values`, its interval from the covariance along some columns."""
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
            there[name] |= problem.library[name].values_from_ends(*sizes)
        return of(there)

    here = of(values)
    slope = np.array([(moved(at + one) - here) / x for one, x in zip(np.diag(step), step)])
    half = half_width(problem, np.sqrt(slope @ covariance @ slope))
    return Quantity(here, (here - half, here + half))


def thrust_over_weight(found: SetPosterior, values: Values) -> Quantity | None:
    """Return thrust over weight, over the modelled one, at the flights' usual command.

    The interval covers the other probable sets too, and what the flights of an identified vehicle left
    uncertain of its own at this command, without which fewer recorded sizes are in their intervals. None
    where no named effect changes it, or one alone that is this ratio.
    """
    named = thrust_of_names(found, values)
    if named is None or not found.problem.identified:
        return named
    value, (low, high) = named
    half = max(0.5 * (high - low), value * _reference_half_width(found.problem))
    return Quantity(value, (value - half, value + half))


def thrust_of_names(found: SetPosterior, values: Values) -> Quantity | None:
    """Return `thrust_over_weight` with the identified vehicle's taken as known."""
    problem = found.problem
    names = [name for name, effect in problem.library.items() if effect.changes_hover and name in values]
    is_the_ratio = len(names) == 1 and problem.library[names[0]].parameters[0].is_factor
    if not names or is_the_ratio:
        return None
    value, (low, high) = jointly(found, values, names, lambda at: _thrust_ratio(problem, at))
    # Var = Var within the named set + sum_s p_s (r_s - r)^2 over the sets s
    apart = sum(one.probability * (_thrust_ratio(problem, one.values) - value) ** 2 for one in found.sets)
    half = math.hypot(0.5 * (high - low), ndtri(0.975) * math.sqrt(apart))
    return Quantity(value, (value - half, value + half))


def _thrust_ratio(problem: Problem, at: Values, vehicle: Vehicle | None = None) -> float:
    """Return thrust over weight at the usual command, over the modelled one, of a vehicle with effects."""
    usual = float(np.median(np.concatenate([f.command[f.usable, 0] for f in problem.flights])))
    changed = Candidates(vehicle or problem.vehicle, problem.library)
    its = {n: at[n] for n, effect in problem.library.items() if effect.changes_hover and n in at}
    # The vertical acceleration of the level vehicle:  a = thrust / mass - g
    gravity = problem.vehicle.environment_gravity
    after = float(changed.hover_acceleration(its, usual)[2])
    before = float(problem.hover_acceleration({}, usual)[2])
    return (after + gravity) / (before + gravity)


def _reference_half_width(problem: Problem) -> float:
    """Return the half-width of the interval of the identified vehicle's own thrust over weight, over it."""
    # Propagation of errors, as in `propagated`:  var = g' C g,  from the ratio 1 of the vehicle itself
    names = [name for name, effect in problem.library.items() if effect.changes_hover]
    columns = [c for c in problem.columns(names) if isinstance(c, ParameterColumn)]
    moved = [problem.one_sided_difference({}, c) for c in columns]
    slope = np.array([(_thrust_ratio(problem, {}, one.vehicle) - 1.0) / one.step for one in moved])
    variance = slope @ problem.vehicle_prior(columns)[1] @ slope
    return half_width(problem, np.sqrt(variance))


def disturbances(problem: Problem) -> dict[str, Disturbance]:
    """Return channel -> measurement noise and disturbance level; yaw only where it was logged."""
    noise = np.median([f.noise for f in problem.flights], axis=0)
    return {
        channel: Disturbance(
            noise=float(noise[k]) * one.noise_ratio,
            size=one.size,
            size_ci95=one.size_ci95,
            time=one.time,
            time_ci95=one.time_ci95,
            unit=UNITS_OF[channel],
        )
        for k, (channel, one) in enumerate(zip(channels_of(problem), problem.noise_model))
        if problem.logged[:, k].any()
    }
