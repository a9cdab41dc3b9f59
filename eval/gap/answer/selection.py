"""Which of the probable effects are named, and how well the vehicle with them predicts flights not fitted."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence, Set
from functools import cached_property
from typing import NamedTuple

import numpy as np

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.answer import rollout
from inclined_landing.eval.gap.answer.sizes import estimates, loop_pieces, response
from inclined_landing.eval.gap.infer.fit import (
    field_half_widths,
    fit_least_squares,
    fit_vehicle,
    leave_one_out_modes,
    vehicles_a_half_width_away,
)
from inclined_landing.eval.gap.infer.gaussian import EffectSet, LinearGaussian
from inclined_landing.eval.gap.infer.sets import (
    SetPosterior,
    equivalence_class,
    leave_one_out,
    posterior_mode,
)
from inclined_landing.eval.gap.measured.windows import MeasuredFlight
from inclined_landing.eval.gap.model.columns import FittedValues, Values, slab_deviations, without
from inclined_landing.eval.gap.model.problem import Problem
from inclined_landing.eval.gap.result import ErrorGrowth, PlantGap
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.effects import Effect
from inclined_landing.models.vehicle import Vehicle

LOOPS = frozenset(("attitude", "yaw"))  # channels of effects on the loops alone


class JudgedFlights(NamedTuple):
    """Flights that errors are measured on, each with a vehicle that was not fitted to it."""

    flights: Sequence[MeasuredFlight]
    vehicles: list[Vehicle]


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
        local = found.local.for_sizes_of(names)
        return Refit(found.problem, values, leave_one_out(found.problem, local, names, values))

    @cached_property
    def vehicle(self) -> Vehicle:
        """Return the vehicle with the effects."""
        return self.problem.corrected(self.values)

    @cached_property
    def vehicles(self) -> list[Vehicle]:
        """Return for every flight the vehicle fitted to the others."""
        return [self.problem.corrected(values) for values in self.left_out]

    def judged(self, heldout: Sequence[MeasuredFlight]) -> JudgedFlights:
        """Return the flights that errors are measured on: those held out, or else each left out in turn."""
        if heldout:
            return JudgedFlights(heldout, [self.vehicle] * len(heldout))
        return JudgedFlights(self.problem.flights, self.vehicles)

    @cached_property
    def pose_errors(self) -> np.ndarray:
        """Return the errors (3,) one second ahead on flights left out: position [m], tilt, heading [rad].

        They are those of a simulation from the measured states, driven by the commands alone; NaN if no
        stretch of the flights is a second long.
        """
        try:
            return rollout.pose_errors(rollout.RolloutWindows.of(self.problem.flights), self.vehicles)
        except UserError:
            return np.full(3, math.nan)

    def growth_of(self, errors: Sequence[int], other: Refit) -> np.ndarray:
        """Return some of its `pose_errors` over those of another fit."""
        return self.pose_errors[errors] / np.maximum(other.pose_errors[errors], 1e-12)


def probable_names(found: SetPosterior) -> EffectSet:
    """Return the effects of the most probable set whose equivalence class has the probability NAMED."""
    return frozenset(
        n for n in found.names if found.probability(*equivalence_class(found, n)) >= thresholds.NAMED
    )


def _explained_shares(problem: Problem, values: Values) -> dict[str, float]:
    """Return effect -> share of the squared error that it explains, in the channel where that is largest."""
    # R^2 = increase without it / (rest + increase)
    rest, shares = problem.squares_by_channel(values), {}
    logged = rest > 0.0
    for name, lost in _squared_error_increase(problem, values).items():
        shares[name] = float(np.max(lost[logged] / np.maximum(rest + lost, 1e-9)[logged], initial=0.0))
    return shares


def useful_values(found: SetPosterior, names: EffectSet) -> FittedValues:
    """Return the values of the effects that matter, and without which flights left out are predicted worse.

    This is a backward elimination by the open-loop errors one second ahead: of the effects that flights left
    out do not need (`_fit_if_unneeded`), the one without which its main error grows least is dropped, one at
    a time.
    """
    # No set of effects is exactly true: one may be certain from its windows and mislead all the same. With
    # many flights, even one that is too small to matter is certain.
    fit = fitted_to_others(found, names)
    while True:
        shares = _explained_shares(found.problem, fit.values)
        unneeded: list[tuple[float, Refit]] = []
        for name in sorted(fit.values):
            errors = judged_by(found.problem.library[name])
            if rest := _fit_if_unneeded(found, fit, name, errors, shares[name] < thresholds.RELEVANT):
                growth = rest.growth_of(errors, fit)
                unneeded.append((float(np.nan_to_num(growth[0])) if errors else 0.0, rest))
        if not unneeded:
            return fit.values
        _, fit = min(unneeded, key=lambda one: one[0])


def _fit_if_unneeded(
    found: SetPosterior, fit: Refit, name: str, errors: list[int], small: bool
) -> Refit | None:
    """Return the fit without an effect that the flights do not need; None for one that they need.

    They need it if one of its `errors` (see `judged_by`) grows by USEFUL without it, the other effects fitted
    again; or, unless it is too small to matter, if the first of these grows with the others fixed. Of an
    effect that is not small, errors that were not measured, for want of a second of flight, count as grown.
    """
    rest = frozenset(fit.values) - {name}
    if not small:
        fixed = dataclasses.replace(fit, left_out=[{n: v[n] for n in rest} for v in fit.left_out])
        if not (errors and fixed.pose_errors[errors[0]] <= fit.pose_errors[errors[0]]):
            return None
    again = fitted_to_others(found, rest)
    return None if (again.growth_of(errors, fit) > 1.0 + thresholds.USEFUL).any() else again


def distinct_values(found: SetPosterior, values: FittedValues) -> tuple[SetPosterior, FittedValues]:
    """Return the values of the effects that are to be named, and the posterior linearised there.

    The smallest effect that is not distinct (see `_is_distinct`) is dropped, one at a time.
    """
    found, values = refitted(found, values)
    named = values
    while True:  # `named` has the largest first
        firm = firm_names(found, named)
        least = next((n for n in reversed(named) if not _is_distinct(found, named, n, firm)), None)
        if least is None:
            return refitted(found, named) if len(named) < len(values) else (found, values)
        named = _largest_first(found.problem, fitted_values(found, frozenset(named) - {least}))


def _is_distinct(found: SetPosterior, values: FittedValues, name: str, firm: Set[str]) -> bool:
    """Return whether an effect is to be named: it must have a firm size, or show one second ahead.

    Without either, other effects explain it: three of 127 cases would get an attitude effect that is not
    there. For two kinds of effects one of these is not enough:
    - A change of the loops alone, next to a larger effect, must have both, because no loop is quite of the
      modelled form and the vehicle's constants are estimated again. If no effect is firm, it is enough that
      it shows. Pieces of the attitude loops have one size together, and need not show each.
    - A moment must have a firm size, unless the motors' requests were logged.
    """
    channels = found.problem.library[name].channels
    next_to_larger = name != next(iter(values))
    is_piece = name in loop_pieces(found.problem, values)
    must_have_both = next_to_larger and LOOPS.issuperset(channels)
    must_be_firm = "requests" in channels and not found.problem.requested
    if name in firm:
        return is_piece or not must_have_both or _shows_ahead(found, values, name)
    if must_be_firm or (must_have_both and firm):
        return False
    return _shows_ahead(found, values, name)


def firm_names(found: SetPosterior, values: Values) -> set[str]:
    """Return the effects with a firm size; for pieces of the attitude loops, the time of their answer."""
    problem, pieces, sizes = found.problem, loop_pieces(found.problem, values), estimates(found, values)
    firm = set(pieces) if pieces and response(found, values, pieces).differs else set()
    for name in (n for n in values if n not in pieces):
        own = (p.name for p in problem.library[name].parameters if not p.is_reference)
        if any(sizes[name][p].firm for p in own):
            firm.add(name)
    return firm


def judged_by(effect: Effect) -> list[int]:
    """Return which of POSITION, TILT and HEADING (`rollout`) an effect acts on, the main one first.

    There is none for an effect that acts on the motors' requests alone.
    """
    by_channel = {
        rollout.POSITION: {"translation", "attitude"},
        rollout.TILT: {"attitude"},
        rollout.HEADING: {"yaw"},
    }
    return [error for error, channels in by_channel.items() if channels & set(effect.channels)]


def _shows_ahead(found: SetPosterior, values: FittedValues, name: str) -> bool:
    """Return whether an error one second ahead grows by USEFUL without an effect, others fitted again."""
    errors, names = judged_by(found.problem.library[name]), frozenset(values)
    if not errors:
        return False
    here, rest = (fitted_to_others(found, n).pose_errors[errors] for n in (names, names - {name}))
    return bool((rest > (1.0 + thresholds.USEFUL) * here).any())


def fitted_to_others(found: SetPosterior, names: EffectSet) -> Refit:
    """Return a set of effects fitted again, and without each flight."""
    return Refit.of(found, fitted_values(found, names))


def fitted_values(found: SetPosterior, names: EffectSet) -> FittedValues:
    """Return the values of a set of effects."""
    problem = found.problem
    values = posterior_mode(problem, found.local.for_sizes_of(names), names)
    if problem.identified:
        return values
    # Far from the nominal vehicle, spikes of other effects would take a share.
    return fit_least_squares(problem, values, prior=slab_deviations).values


def refitted(found: SetPosterior, values: FittedValues) -> tuple[SetPosterior, FittedValues]:
    """Return the posterior linearised again at a set's values, and the values there, largest gain first.

    A linearisation about other values may give two effects sizes that cancel, though neither is there. Values
    of a vehicle that was not identified come from the simulator itself (`fitted_values`), and stay.
    """
    problem = found.problem
    if not (values and problem.identified):
        return found, _largest_first(problem, values)
    columns = problem.all_columns() + problem.form_columns(values)
    local = LinearGaussian.of(problem, found.spread, problem.linearise(values, columns))
    there = dataclasses.replace(found, best=dataclasses.replace(found.best, local=local))
    new = fitted_values(there, frozenset(values))
    if problem.squares(new) <= problem.squares(values):
        return there, _largest_first(problem, new)
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
    return {name: problem.squares_by_channel(without(values, name)) - after for name in values}


def corrected(found: SetPosterior, values: FittedValues) -> Refit:
    """Return the correction by the named effects at `values`.

    All effects of an identified vehicle are estimated again where that predicts flights left out better.
    Without this, recorded winds, a load and a centre of mass leave so much error that no name is sure.
    """
    problem, names, named_alone = found.problem, frozenset(values), Refit.of(found, values)
    if not (problem.identified and values):
        return named_alone
    again, local = fit_vehicle(problem, found.spread, values, names)
    moved = vehicles_a_half_width_away(problem, local, names, again)
    all_again = Refit(
        problem=problem,
        values=again,
        left_out=leave_one_out_modes(problem, local, names),
        half_widths=field_half_widths(problem.vehicle, problem.corrected(again), moved),
    )
    return min(named_alone, all_again, key=lambda fit: fit.pose_errors[rollout.POSITION])


@dataclasses.dataclass(frozen=True)
class OpenLoopErrors:
    """Open-loop predictions of the flights, with and without the effects; empty where none can be made."""

    # m, the error one second ahead that each named effect accounts for; NaN: not known
    costs: dict[str, float] = dataclasses.field(default_factory=dict)
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
    problem, judged = found.problem, correction.judged(heldout)
    try:
        windows = rollout.RolloutWindows.of(judged.flights)
    except UserError as why:
        unknown = dict.fromkeys(values, math.nan)
        return OpenLoopErrors(costs=unknown, notes=(f"the gap after one second was not measured: {why}",))
    floor = rollout.noise_floor(windows, correction.vehicle)
    gap, notes = {}, []
    for plant in dict.fromkeys(("analytic", *plants)):
        try:
            gap[plant] = PlantGap(
                before=float(rollout.errors_by_flight(windows, problem.vehicle, plant)[-1]),
                after=float(rollout.errors_by_flight(windows, judged.vehicles, plant)[-1]),
                floor=float(floor[-1]),
                windows=len(windows),
            )
        except UserError as why:  # as loops that are too fast for the engine's step
            notes.append(f"the gap was not measured in {plant}: {why}")
    pieces = loop_pieces(problem, values)
    classes = {member for name in values for member in equivalence_class(found, name)}
    return OpenLoopErrors(
        costs={n: _cost(problem, windows, values, pieces if n in pieces else (n,)) for n in values},
        gap=gap,
        displacements=_displacements(found, windows, classes),
        growth=ErrorGrowth(
            horizon=np.arange(1, windows.rows + 1) * windows.dt,
            errors=_errors_in_turn(windows, correction, values, judged.vehicles),
            floor=floor,
        ),
        notes=tuple(notes),
    )


def _errors_in_turn(
    windows: rollout.RolloutWindows, correction: Refit, values: Values, corrected: Sequence[Vehicle]
) -> dict[str, np.ndarray]:
    """Return the errors of the nominal vehicle (""), and with the effects of `values` added in turn.

    The last are of the corrected vehicles. They stand under the last effect, or under "all others" if other
    constants of an identified vehicle change as well.
    """
    problem, names = correction.problem, list(values)
    vehicles: dict[str, Vehicle | Sequence[Vehicle]] = {"": problem.vehicle}
    for k, name in enumerate(names, 1):
        vehicles[name] = problem.corrected({n: values[n] for n in names[:k]})
    if correction.half_widths is not None:
        vehicles["all others"] = corrected
    elif names:
        vehicles[names[-1]] = corrected
    return {name: rollout.errors_by_flight(windows, vehicle) for name, vehicle in vehicles.items()}


def _cost(problem: Problem, windows: rollout.RolloutWindows, values: Values, names: Sequence[str]) -> float:
    """Return the position error [m] after one second that effects account for."""
    # cost^2 = e_without^2 - e_with^2
    rest, whole = (problem.corrected(v) for v in (without(values, *names), values))
    worse, better = (float(rollout.errors_by_flight(windows, v)[-1]) for v in (rest, whole))
    return math.sqrt(max(0.0, worse**2 - better**2))


def _displacements(found: SetPosterior, windows: rollout.RolloutWindows, named: Set[str]) -> dict[str, float]:
    """Return possible effect -> displacement [m] within a second by its size in the best set with it."""
    problem = found.problem
    plain, result = rollout.simulate(windows, problem.vehicle), {}
    for name in problem.library:
        if name in named or found.probability(name) < thresholds.POSSIBLE:
            continue
        best = max((one for one in found.sets if name in one.names), key=lambda one: one.probability)
        moved = rollout.simulate(windows, problem.corrected({name: best.values[name]}))
        result[name] = float(rollout.position_error(moved, plain)[-1])
    return result
