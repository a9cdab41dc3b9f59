"""The named effects: the vehicle with them, its errors on flights not fitted, and why each is sure or not."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence, Set

import numpy as np
from scipy.special import ndtri

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.answer import rollout
from inclined_landing.eval.gap.answer.selection import (
    LOOPS,
    Refit,
    estimates,
    fitted_to_others,
    half_width,
    jointly,
    judged_by,
    loop_pieces,
    propagated,
    response,
    size_columns,
    squared_error_shares,
)
from inclined_landing.eval.gap.flights.windows import REGIMES, MeasuredFlight
from inclined_landing.eval.gap.infer import residual
from inclined_landing.eval.gap.infer.fit import (
    field_half_widths,
    fit_vehicle,
    leave_one_out_modes,
    vehicles_a_half_width_away,
)
from inclined_landing.eval.gap.infer.sets import SetPosterior, equivalence_class
from inclined_landing.eval.gap.model.columns import Candidates, FittedValues, ParameterColumn, Values
from inclined_landing.eval.gap.model.prediction import UNITS_OF, channels_of
from inclined_landing.eval.gap.model.problem import Problem
from inclined_landing.eval.gap.result import Disturbance, ErrorGrowth, NamedEffect, PlantGap, RegimeError
from inclined_landing.eval.logs.limits import LEAST_RATE
from inclined_landing.models.base.errors import UserError, first_of
from inclined_landing.models.effects import Effect
from inclined_landing.models.vehicle import Vehicle

LOOP = "attitude_time_constant"  # whose remedy stands for all lags of the attitude loops
# Effects of the thrust in hover, or of the weight.
WEIGHT = ("thrust_scale", "thrust_bias", "thrust_curve", "battery_sag", "mass", "slung_load")


def corrected(found: SetPosterior, values: FittedValues) -> Refit:
    """Return the correction by the named effects at `values`.

    All effects of an identified vehicle are estimated again where that predicts flights left out better.
    """
    problem, names, named = found.problem, frozenset(values), Refit.of(found, values)
    if not (problem.identified and values):
        return named
    again, local = fit_vehicle(problem, found.spread, values, names)
    moved = vehicles_a_half_width_away(problem, local, names, again)
    widths = field_half_widths(problem.vehicle, problem.corrected(again), moved)
    whole = Refit(problem, again, leave_one_out_modes(problem, local, names), widths)
    return min(named, whole, key=Refit.error_ahead)


def regime_errors(correction: Refit, heldout: Sequence[MeasuredFlight]) -> tuple[RegimeError, ...]:
    """Return the root mean square errors by regime and channel, before and after, on flights not fitted."""
    problem, (_, after) = correction.problem, correction.judged(heldout)
    if heldout:
        test = Problem.of(heldout, problem.vehicle, {})
        problem = test.whitened(problem.noise_model, correction.vehicle)
    before = problem.white_errors([problem.vehicle] * len(after))
    first, variance = residual.equivalent_sizes(problem, before)
    second, _ = residual.equivalent_sizes(problem, problem.white_errors(after))
    regimes = np.concatenate([f.regimes for f in problem.flights])
    rows = []
    for name, member in [("all", np.ones(len(regimes), bool)), *zip(REGIMES, regimes.T)]:
        for k, channel in enumerate(channels_of(problem)):
            w = member & (problem.logged[:, k] > 0.0)
            if w.any():
                worse, better = (float(np.sqrt((x[w, k] ** 2).mean())) for x in (first, second))
                floor = float(np.sqrt(variance[w, k].mean()))
                unit = residual.UNITS[channel]
                rows.append(RegimeError(name, channel, worse, better, floor, unit, int(w.sum())))
    return tuple(rows)


@dataclasses.dataclass(frozen=True)
class Displacement:
    """The change of the position one second ahead by a named effect."""

    cost: float = math.nan  # m, the error that it accounts for; NaN: not known
    along: Mapping[str, float] = dataclasses.field(default_factory=dict)  # axis -> m, root mean square


@dataclasses.dataclass(frozen=True)
class OpenLoopErrors:
    """Open-loop predictions of the flights, with and without the effects; empty where none can be made."""

    error: float = math.nan  # m, of the position after the longest horizon, corrected
    named: dict[str, Displacement] = dataclasses.field(default_factory=dict)  # what each of these does
    gap: dict[str, PlantGap] = dataclasses.field(default_factory=dict)  # by plant, of the equations first
    displacements: dict[str, float] = dataclasses.field(default_factory=dict)  # see Diagnosis
    growth: ErrorGrowth | None = None
    notes: tuple[str, ...] = ()


def open_loop_errors(
    found: SetPosterior,
    correction: Refit,
    heldout: Sequence[MeasuredFlight],
    values: Values,
    plants: Sequence[str],
) -> OpenLoopErrors:
    """Return the open-loop predictions of flights that were not fitted; values: of the named effects."""
    problem, (flights, after) = found.problem, correction.judged(heldout)
    try:
        starts = rollout.RolloutWindows.of(flights)
    except UserError as why:
        unknown = dict.fromkeys(values, Displacement())
        return OpenLoopErrors(named=unknown, notes=(f"the gap after one second was not measured: {why}",))
    floor = rollout.noise_floor(starts, correction.vehicle)
    error = float(rollout.errors_by_flight(starts, after)[-1])
    pieces = loop_pieces(problem, values)
    named = {n: _displacement(problem, starts, values, pieces if n in pieces else (n,)) for n in values}
    vehicles = correction.vehicle if heldout else after
    gap, notes = {}, []
    for plant in dict.fromkeys(("analytic", *plants)):
        try:
            gap[plant] = rollout.plant_gap(starts, problem.vehicle, vehicles, plant, floor)
        except UserError as why:  # as loops that are too fast for the engine's step
            notes.append(f"the gap was not measured in {plant}: {why}")
    classes = {member for name in values for member in equivalence_class(found, name)}
    moved = _displacements(found, starts, classes)
    growth = _growth(problem, starts, values, vehicles, floor, correction.half_widths is not None)
    return OpenLoopErrors(error, named, gap, moved, growth, tuple(notes))


def _growth(problem: Problem, starts, values: Values, corrected, floor, others: bool) -> ErrorGrowth:
    """Return the errors with the effects of `values` added in turn; the last are of the corrected vehicle.

    others: the constants of the identified vehicle change as well.
    """
    vehicles, names = {"": problem.vehicle}, list(values)
    for k, name in enumerate(names, 1):
        vehicles[name] = problem.corrected({name: values[name] for name in names[:k]})
    if others:
        names.append("all others")
    if names:
        vehicles[names[-1]] = corrected
    errors = {name: rollout.errors_by_flight(starts, vehicle) for name, vehicle in vehicles.items()}
    return ErrorGrowth(np.arange(1, starts.rows + 1) * starts.dt, errors, floor)


def _displacement(problem: Problem, starts, values: Values, names: Sequence[str]) -> Displacement:
    """Return the error after one second that effects account for, and how far they move the vehicle."""
    # cost^2 = e_without^2 - e_with^2
    measured, rest = starts.measured(), {n: v for n, v in values.items() if n not in names}
    without, whole = (rollout.simulate(starts, problem.corrected(v)) for v in (rest, values))
    worse, better = (rollout.position_error(pose, measured)[-1] for pose in (without, whole))
    moved = np.sqrt(((whole - without)[:, -1, :3] ** 2).mean(axis=0))
    return Displacement(float(np.sqrt(max(0.0, worse**2 - better**2))), dict(zip("xyz", map(float, moved))))


def _displacements(found: SetPosterior, starts: rollout.RolloutWindows, named: Set[str]) -> dict[str, float]:
    """Return possible effect -> displacement [m] within a second by its size in the best set with it."""
    problem = found.problem
    plain, result = rollout.simulate(starts, problem.vehicle), {}
    for name in problem.library:
        if name in named or found.probability(name) < thresholds.POSSIBLE:
            continue
        best = max((one for one in found.sets if name in one.names), key=lambda one: one.probability)
        moved = rollout.simulate(starts, problem.corrected({name: best.values[name]}))
        result[name] = float(rollout.position_error(moved, plain)[-1])
    return result


def named_effects(
    found: SetPosterior, values: Values, ahead: Mapping[str, Displacement], least: float
) -> tuple[NamedEffect, ...]:
    """Return the named effects with estimates, in the order of `values`.

    ahead: what each does to the error one second ahead. least: the answer of `least_cost`.
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
    """Return the effects that predict flights left out as well as a nonlinear one does.

    A load on a string is a mass where no swing shows.
    """
    effect = found.problem.library[name]
    by = judged_by(effect, values[name])
    if not by or all(p.linear for p in effect.parameters):
        return []
    others = [n for n in effect.confused_with if n in found.problem.library and n not in values]
    sets = [frozenset(values) - {name} | {n} for n in (name, *others)]
    here, *errors = (fitted_to_others(found, names).pose_errors[by] for names in sets)
    return [n for n, error in zip(others, errors) if (error <= here).all()]


def _doubt(problem: Problem, name: str, along: Mapping[str, float], doubtful: bool, cancelled: bool) -> str:
    """Return a sentence on why an effect is not sure, whatever its probability; empty where it may be.

    doubtful: the named effects leave too much. cancelled: it and others may cancel each other.
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

    No loop is quite of the modelled form: what is confused with a change makes up for the errors of its form.
    """
    loops = {n for n in (name, *larger) if LOOPS.issuperset(library[n].channels)}
    for other in larger:
        if {name, other} <= loops and other in library[name].confused_with:
            return f"In doubt, because it may be a part of the {other.replace('_', ' ')}."
    return ""


def product(found: SetPosterior, values: Values, name: str) -> tuple[float, tuple[float, float]]:
    """Return the acceleration [m/s2] that an effect makes in hover, and its 95 % interval."""
    # The others as they are:  C = (a + V^-1)^-1
    local = found.local.with_wide_slabs(frozenset(values))
    own = size_columns(found.problem, local, [name])
    information = local.a.sum(axis=0)[np.ix_(own, own)] + np.linalg.inv(local.slab[np.ix_(own, own)])
    covariance = np.linalg.inv(information) * np.outer(local.unit[own], local.unit[own])
    without = found.problem.hover_acceleration({n: v for n, v in values.items() if n != name})

    def made(at: Values) -> float:
        return float(np.linalg.norm(found.problem.hover_acceleration(at) - without))

    value, (low, high) = propagated(found.problem, values, [local.columns[k] for k in own], covariance, made)
    return value, (max(0.0, low), high)


def thrust_over_weight(found: SetPosterior, values: Values) -> tuple[float, tuple[float, float]] | None:
    """Return thrust over weight, over the modelled one, at the flights' usual command, and its interval.

    The interval covers the other probable sets too, and what the flights of an identified vehicle left
    uncertain of its own at this command. None where no named effect changes it, or one alone that is this
    ratio.
    """
    named = thrust_of_names(found, values)
    if named is None or not found.problem.identified:
        return named
    value, (low, high) = named
    half = max(0.5 * (high - low), value * _reference_half_width(found.problem))
    return value, (value - half, value + half)


def thrust_of_names(found: SetPosterior, values: Values) -> tuple[float, tuple[float, float]] | None:
    """Return `thrust_over_weight` with the identified vehicle's taken as known."""
    problem, names = found.problem, [name for name in WEIGHT if name in values]
    ratios = [name for name in names if problem.library[name].parameters[0].neutral == 1.0]
    if not names or names == ratios[:1]:
        return None
    value, (low, high) = jointly(found, values, names, lambda at: _thrust_ratio(problem, at))
    # Var = Var within the named set + sum_s p_s (r_s - r)^2 over the sets s
    apart = sum(one.probability * (_thrust_ratio(problem, one.values) - value) ** 2 for one in found.sets)
    half = math.hypot(0.5 * (high - low), ndtri(0.975) * math.sqrt(apart))
    return value, (value - half, value + half)


def _thrust_ratio(problem: Problem, at: Values, vehicle: Vehicle | None = None) -> float:
    """Return thrust over weight at the usual command, over the modelled one, of a vehicle with effects."""
    usual = float(np.median(np.concatenate([f.command[f.usable, 0] for f in problem.flights])))
    changed = Candidates(vehicle or problem.vehicle, problem.library)
    its = {n: at[n] for n in WEIGHT if n in at}
    gravity = problem.vehicle.environment_gravity
    thrust, before = (float(c.hover_acceleration(v, usual)[2]) for c, v in ((changed, its), (problem, {})))
    return (thrust + gravity) / (before + gravity)


def _reference_half_width(problem: Problem) -> float:
    """Return the half-width of the interval of the identified vehicle's own thrust over weight, over it."""
    # Propagation of errors, as `propagated`
    names = [name for name in WEIGHT if name in problem.library]
    columns = [c for c in problem.columns(names) if isinstance(c, ParameterColumn)]
    moved = [problem.one_sided_difference({}, c) for c in columns]
    slope = np.array([(_thrust_ratio(problem, {}, vehicle) - 1.0) / step for vehicle, step in moved])
    variance = slope @ problem.vehicle_prior(columns)[1] @ slope
    return half_width(problem, np.sqrt(variance))


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
