"""Errors with and without the effects on flights not fitted: by regime, open loop, in the plants.

Effects are fitted again to all flights, and to all but each one, whose errors then judge the fit.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence, Set
from functools import cached_property

import numpy as np

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.answer import rollout
from inclined_landing.eval.gap.answer.sizes import loop_pieces
from inclined_landing.eval.gap.flights.windows import REGIMES, MeasuredFlight
from inclined_landing.eval.gap.infer import residual
from inclined_landing.eval.gap.infer.fit import (
    field_half_widths,
    fit_vehicle,
    leave_one_out_modes,
    vehicles_a_half_width_away,
)
from inclined_landing.eval.gap.infer.sets import SetPosterior, equivalence_class, leave_one_out
from inclined_landing.eval.gap.model.columns import FittedValues, Values
from inclined_landing.eval.gap.model.prediction import channels_of
from inclined_landing.eval.gap.model.problem import Problem
from inclined_landing.eval.gap.result import HorizonCurve, PlantGap, RegimeError
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.vehicle import Vehicle


@dataclasses.dataclass(frozen=True)
class Refit:
    """Values of effects fitted to the flights of a problem, and those fitted without each flight."""

    problem: Problem
    values: FittedValues
    left_out: Sequence[FittedValues]  # for every flight, fitted to the others

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
        try:
            starts = rollout.RolloutWindows.of(self.problem.flights)
        except UserError:
            return math.inf
        return float(rollout.errors_by_flight(starts, self.vehicles)[0][-1])


@dataclasses.dataclass(frozen=True)
class Correction(Refit):
    """Values of the effects that correct the vehicle: the named ones, or all of an identified vehicle."""

    again: bool = False  # whether the errors of the identified vehicle were estimated again
    # Fields of the vehicle that change with these, and half-widths of their 95 % intervals.
    half_widths: Mapping[str, float | tuple[float, ...]] = dataclasses.field(default_factory=dict)


def corrected(found: SetPosterior, values: FittedValues) -> Correction:
    """Return the correction by the named effects at `values`.

    All effects of an identified vehicle are estimated again where that predicts flights left out better.
    """
    problem, names = found.problem, frozenset(values)
    local = found.local.with_wide_slabs(names)
    named = Correction(problem, values, leave_one_out(problem, local, names, values))
    if not (problem.identified and values):
        return named
    again, local = fit_vehicle(problem, found.spread, values, names)
    moved = vehicles_a_half_width_away(problem, local, names, again)
    widths = field_half_widths(problem.vehicle, problem.corrected(again), moved)
    whole = Correction(problem, again, leave_one_out_modes(problem, local, names), True, widths)
    return min(named, whole, key=Correction.error_ahead)


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """Flights that errors are measured on, each with a corrected vehicle that was not fitted to it."""

    problem: Problem
    vehicles: list[Vehicle]

    @staticmethod
    def of(found: SetPosterior, correction: Correction, heldout: Sequence[MeasuredFlight]) -> Evaluation:
        """Return the evaluation on held-out flights; without any, on those fitted."""
        problem, (_, vehicles) = found.problem, correction.judged(heldout)
        if heldout:
            test = Problem.of(heldout, problem.vehicle, {})
            problem = test.whitened(problem.noise_model, correction.vehicle)
        return Evaluation(problem, vehicles)


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
    horizon: tuple[HorizonCurve, ...] = ()
    gap: dict[str, PlantGap] = dataclasses.field(default_factory=dict)  # by plant, of the equations first
    displacements: dict[str, float] = dataclasses.field(default_factory=dict)  # see Diagnosis
    notes: tuple[str, ...] = ()


def open_loop_errors(
    found: SetPosterior,
    correction: Correction,
    evaluation: Evaluation,
    values: Values,
    plants: Sequence[str],
    curves: bool,
) -> OpenLoopErrors:
    """Return the open-loop predictions of the flights evaluated, each with its vehicle; values: named."""
    problem, after = found.problem, evaluation.vehicles
    try:
        starts = rollout.RolloutWindows.of(evaluation.problem.flights)
    except UserError as why:
        unknown = dict.fromkeys(values, Displacement())
        return OpenLoopErrors(named=unknown, notes=(f"the gap after one second was not measured: {why}",))
    floor = rollout.noise_floor(starts, correction.vehicle)
    error = float(rollout.errors_by_flight(starts, after)[0][-1])
    pieces = loop_pieces(problem, values)
    named = {n: _displacement(problem, starts, values, pieces if n in pieces else (n,)) for n in values}
    horizon: tuple[HorizonCurve, ...] = ()
    if curves:
        horizon = _horizon(problem, starts, values, after, floor, correction.again)
    vehicles = after if evaluation.problem is problem else correction.vehicle
    gap, notes = {}, []
    for plant in dict.fromkeys(("analytic", *plants)):
        try:
            gap[plant] = rollout.plant_gap(starts, problem.vehicle, vehicles, plant, floor)
        except UserError as why:  # as loops that are too fast for the engine's step
            notes.append(f"the gap was not measured in {plant}: {why}")
    classes = {member for name in values for member in equivalence_class(found, name)}
    moved = _displacements(found, starts, classes)
    return OpenLoopErrors(error, named, horizon, gap, moved, tuple(notes))


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


def regime_errors(evaluation: Evaluation) -> tuple[RegimeError, ...]:
    """Return the root mean square errors by regime and channel, before and after."""
    problem, after = evaluation.problem, evaluation.vehicles
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


def _horizon(problem, starts, values: Values, after, floor, has_new_constants: bool):
    """Return error against horizon with the effects added one by one, then with all constants."""
    t, names = np.arange(1, starts.rows + 1) * starts.dt, list(values)
    labels = ["nominal", *(f"+ {name}" for name in names), *["+ all others"][: int(has_new_constants)]]
    curves = []
    for k, label in enumerate(labels):
        if k and k == len(labels) - 1:
            error, _ = rollout.errors_by_flight(starts, after)
        else:
            vehicle = problem.corrected({name: values[name] for name in names[:k]})
            error = rollout.position_error(rollout.simulate(starts, vehicle), starts.measured())
        curves.append(HorizonCurve(label, tuple(names[:k]), t, error, floor))
    return tuple(curves)


def _displacement(problem: Problem, starts, values: Values, names: Sequence[str]) -> Displacement:
    """Return the error after one second that effects account for, and how far they move the vehicle."""
    # cost^2 = e_without^2 - e_with^2
    measured, rest = starts.measured(), {n: v for n, v in values.items() if n not in names}
    without, whole = (rollout.simulate(starts, problem.corrected(v)) for v in (rest, values))
    worse, better = (rollout.position_error(pose, measured)[-1] for pose in (without, whole))
    moved = np.sqrt(((whole - without)[:, -1, :3] ** 2).mean(axis=0))
    return Displacement(float(np.sqrt(max(0.0, worse**2 - better**2))), dict(zip("xyz", map(float, moved))))
