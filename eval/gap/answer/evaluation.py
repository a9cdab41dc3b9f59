"""Errors with and without the effects, on flights not fitted: by regime, open loop, in the plants."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.answer import rollout
from inclined_landing.eval.gap.answer.named import Correction
from inclined_landing.eval.gap.flights.windows import REGIMES, MeasuredFlight
from inclined_landing.eval.gap.infer import residual
from inclined_landing.eval.gap.infer.sets import SetPosterior
from inclined_landing.eval.gap.model.prediction import channels_of
from inclined_landing.eval.gap.model.problem import Problem
from inclined_landing.eval.gap.result import HorizonCurve, NamedEffect, PlantGap, RegimeError
from inclined_landing.models.errors import UserError
from inclined_landing.models.vehicle import Vehicle


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """Flights that errors are measured on, each with a corrected vehicle that was not fitted to it."""

    problem: Problem
    vehicles: list[Vehicle]
    left_out: bool  # the flights fitted, each left out in turn

    @staticmethod
    def of(found: SetPosterior, correction: Correction, heldout: Sequence[MeasuredFlight]) -> Evaluation:
        """Return the evaluation on held-out flights; without any, on those fitted."""
        problem = found.problem
        if not heldout:
            return Evaluation(problem, [problem.corrected(v) for v in correction.left_out], True)
        test = Problem.of(heldout, problem.vehicle, {})
        test = test.whitened(problem.noise_model, correction.vehicle)
        return Evaluation(test, [correction.vehicle] * len(heldout), False)


@dataclasses.dataclass(frozen=True)
class OpenLoopErrors:
    """Open-loop predictions of the flights, with and without the effects; empty where none can be made."""

    effects: tuple[NamedEffect, ...]  # with what each costs
    error: float = math.nan  # m, of the position after the longest horizon, corrected
    horizon: tuple[HorizonCurve, ...] = ()
    gap: dict[str, PlantGap] = dataclasses.field(default_factory=dict)  # by plant, of the equations first
    displacements: dict[str, float] = dataclasses.field(default_factory=dict)  # see Diagnosis
    notes: tuple[str, ...] = ()


def open_loop_errors(
    found: SetPosterior,
    correction: Correction,
    evaluation: Evaluation,
    effects: tuple[NamedEffect, ...],
    plants: Sequence[str],
    curves: bool,
) -> OpenLoopErrors:
    """Return the open-loop predictions of the flights evaluated, each with its vehicle."""
    problem, after = found.problem, evaluation.vehicles
    try:
        starts = rollout.RolloutWindows.of(evaluation.problem.flights)
    except UserError as why:
        return OpenLoopErrors(effects, notes=(f"the gap after one second was not measured: {why}",))
    floor = rollout.noise_floor(starts, correction.vehicle)
    error = float(rollout.errors_by_flight(starts, after)[0][-1])
    effects = tuple(_with_cost(problem, starts, effects, e) for e in effects)
    horizon: tuple[HorizonCurve, ...] = ()
    if curves:
        horizon = _horizon(problem, starts, effects, after, floor, correction.again)
    vehicles = after if evaluation.left_out else correction.vehicle
    gap, notes = {}, []
    for plant in dict.fromkeys(("analytic", *plants)):
        try:
            gap[plant] = rollout.plant_gap(starts, problem.vehicle, vehicles, plant, floor)
        except UserError as why:  # as loops that are too fast for the engine's step
            notes.append(f"the gap was not measured in {plant}: {why}")
    moved = _displacements(found, starts, effects)
    return OpenLoopErrors(effects, error, horizon, gap, moved, tuple(notes))


def _displacements(
    found: SetPosterior, starts: rollout.RolloutWindows, effects: Sequence[NamedEffect]
) -> dict[str, float]:
    """Return possible effect -> displacement [m] within a second by its size in the best set with it."""
    problem, named = found.problem, {n for e in effects for n in e.members}
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


def _horizon(problem, starts, effects, after, floor, has_new_constants: bool) -> tuple[HorizonCurve, ...]:
    """Return error against horizon with the effects added one by one, then with all constants."""
    t = np.arange(1, starts.rows + 1) * starts.dt
    names = [e.name for e in effects]
    labels = ["nominal", *(f"+ {name}" for name in names), *["+ all others"][: int(has_new_constants)]]
    curves = []
    for k, label in enumerate(labels):
        if k and k == len(labels) - 1:
            error, _ = rollout.errors_by_flight(starts, after)
        else:
            vehicle = problem.corrected({e.name: e.values() for e in effects[:k]})
            error = rollout.position_error(rollout.simulate(starts, vehicle), starts.measured())
        curves.append(HorizonCurve(label, tuple(names[:k]), t, error, floor))
    return tuple(curves)


def _with_cost(problem, starts, effects: Sequence[NamedEffect], one: NamedEffect) -> NamedEffect:
    """Return the effect with its cost: the error after one second that it accounts for."""
    # cost^2 = e_without^2 - e_with^2
    measured, vehicles = starts.measured(), []
    for kept in ([e for e in effects if e is not one], effects):
        vehicles.append(problem.corrected({e.name: e.values() for e in kept}))
    without, whole = (rollout.position_error(rollout.simulate(starts, v), measured)[-1] for v in vehicles)
    return dataclasses.replace(one, cost=float(np.sqrt(max(0.0, without**2 - whole**2))))
