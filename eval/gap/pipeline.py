"""`diagnose`: prediction errors by regime, the missing effects, and the error of the corrected model."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Mapping, Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.answer import rollout
from inclined_landing.eval.gap.answer.before_after import (
    landing_gap,
    open_loop_errors,
    regime_errors,
    touchdown_errors,
)
from inclined_landing.eval.gap.answer.named import (
    contact_effects,
    disturbances,
    joint_sets,
    named_effects,
    relevant_values,
    scored_sets,
    unidentifiable_sets,
    useful_values,
)
from inclined_landing.eval.gap.flights.landings import Landing, landings_of
from inclined_landing.eval.gap.flights.sensors import without_failed_sensors
from inclined_landing.eval.gap.flights.windows import MeasuredFlight, prepare_all
from inclined_landing.eval.gap.infer import contact, heterogeneity, residual, sets
from inclined_landing.eval.gap.infer.fit import fit_least_squares
from inclined_landing.eval.gap.infer.gaussian import EffectSet
from inclined_landing.eval.gap.infer.vehicle_fit import (
    field_half_widths,
    fit_vehicle,
    leave_one_out_modes,
    vehicles_a_half_width_away,
)
from inclined_landing.eval.gap.model.columns import Candidates, Values, slab_deviations
from inclined_landing.eval.gap.model.problem import Problem, identifiable_effects
from inclined_landing.eval.gap.model.reference import VehiclePosterior
from inclined_landing.eval.gap.plan.words import discriminating_manoeuvre
from inclined_landing.eval.gap.result import (
    Diagnosis,
    InconsistentFlights,
    NamedEffect,
    RegimeError,
    ResidualAnalysis,
    ScoredSet,
    Touchdowns,
)
from inclined_landing.eval.logs import FlightLog
from inclined_landing.eval.logs.log import as_logs
from inclined_landing.models.attitude import LAG, STATE_SIZE
from inclined_landing.models.effects import LIBRARY, Effect
from inclined_landing.models.equations import derivative
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import as_vehicle
from inclined_landing.models.vehicle import Vehicle


@threadpool_limits.wrap(limits=1, user_api="blas")  # flights are shared among threads already
def diagnose(
    flights: Sequence[FlightLog],
    vehicle: Vehicle,
    library: Mapping[str, Effect] = LIBRARY,
    *,
    reference: VehiclePosterior | None = None,
    heldout: Sequence[FlightLog] = (),
    platform: bool | None = None,
    plants: Sequence[str] = ("analytic",),
    curves: bool = True,
) -> Diagnosis:
    """Return the missing effects that explain `flights` best, and the errors with and without them.

    reference: posterior of the vehicle's identification; None: its constants are exact, its formulas nearly.
    heldout: flights for evaluation only; without them every flight is evaluated with the effects fitted to
    the others (leave-one-out). platform: the slab of the vehicle file stands in the arena (None: where a log
    has contacts). plants: measure the gap in these. curves: also error against horizon and single windows.

    Raises UserError when no flight can be used.
    """
    clock = _Stopwatch()
    notes: list[str] = []
    flights, heldout, vehicle = as_logs(flights), as_logs(heldout), as_vehicle(vehicle)
    if platform is None:
        platform = any(log.contact is not None and log.contact.any() for log in flights)
    flights, failed = without_failed_sensors(flights)
    heldout, failed_heldout = without_failed_sensors(heldout)
    searched = _search(flights, heldout, vehicle, library, reference, platform, notes, clock)
    problem, found, library = searched.problem, searched.found, searched.library
    inconsistent = _inconsistent_flights(problem, found, [*failed, *failed_heldout], notes)

    effects, correction = _named(problem, found)
    corrected = problem.corrected(correction.values)
    remaining = _residual(problem, found, corrected)
    clock("remainder")
    test, after = _evaluation(searched, correction, corrected)
    where = regime_errors(test, test.white_errors([vehicle] * len(after)), test.white_errors(after))
    clock("where")
    tied = any(len(e.members) > 1 for e in effects)
    manoeuvre = discriminating_manoeuvre(problem, found, platform) if tied else ""
    clock("manoeuvre")
    contact_result = _contact_result(flights, heldout, vehicle, corrected, library, notes)
    if contact_result.landings:
        clock("touchdown")
    predicted = open_loop_errors(
        problem, test, after, effects, corrected, correction.again, plants, curves, notes, clock
    )
    gap, effects = predicted.gap, predicted.effects
    if math.isfinite(predicted.error):
        remaining = dataclasses.replace(remaining, error=predicted.error)
    if not gap and contact_result.landings and "mujoco" in plants:
        gap["mujoco"] = landing_gap(contact_result.landings, vehicle, contact_result.vehicle)
        clock("gap mujoco")
    effects += contact_result.effects
    touchdowns = contact_result.remaining
    unknown = remaining.unexplained or (touchdowns is not None and touchdowns.unexplained)
    return Diagnosis(
        verdict="unknown" if unknown else "effects" if effects else "nothing",
        inconsistent_flights=inconsistent,
        effects=effects,
        estimated=correction.values if correction.again else {},
        half_widths=correction.half_widths,
        corrected=contact_result.vehicle,
        separating_manoeuvre=manoeuvre or None,
        where=where + contact_result.where,
        sets=contact_result.sets(tuple(scored_sets(problem, found))),
        unidentifiable_sets=tuple(unidentifiable_sets(problem, found)),
        touchdowns=touchdowns,
        disturbance=disturbances(problem, found.noise_model),
        horizon=predicted.horizon,
        windows=predicted.windows,
        residual=remaining,
        gap=gap,
        platform=platform,
        flights=tuple(f.name for f in problem.flights),
        heldout=tuple(f.name for f in test.flights),
        seconds=clock.spent,
        notes=tuple(notes),
    )


@dataclasses.dataclass(frozen=True)
class _Searched:
    """The flights as windows, and the posterior of the sets of effects."""

    problem: Problem
    found: sets.SetPosterior
    judged: list[MeasuredFlight]  # flights for evaluation only
    library: dict[str, Effect]  # identifiable on the flights


def _search(
    flights: list[FlightLog],
    heldout: list[FlightLog],
    vehicle: Vehicle,
    library: Mapping[str, Effect],
    reference: VehiclePosterior | None,
    platform: bool,
    notes: list[str],
    clock: _Stopwatch,
) -> _Searched:
    """Return the posterior of the sets of effects; in a strong wind the attitude loops are not judged."""
    fitted = prepare_all(flights, vehicle, platform, notes)
    judged = prepare_all(heldout, vehicle, platform, notes) if heldout else []
    usable, unidentifiable = identifiable_effects(library, fitted)
    problem = Problem(fitted, vehicle, usable, reference)
    notes += [*_data_notes(problem), *unidentifiable]
    clock("prepare")
    found = sets.search(problem)
    if problem.logged[:, 3:5].any() and _steady_force(problem, found.values) > thresholds.STRONG_WIND:
        # Flapping rotors, and the rear ones in the wake of the front ones, turn the vehicle by moments that
        # no formula of the library has: they would be named as changes of the loops.
        notes.append(
            "a strong steady force, as of wind, turns a vehicle against its attitude loops too: these were "
            "not judged, and translation is predicted along the measured attitude"
        )
        fitted = prepare_all([_without_angle_commands(log) for log in flights], vehicle, platform, [])
        if heldout:
            judged = prepare_all([_without_angle_commands(log) for log in heldout], vehicle, platform, [])
        problem = Problem(fitted, vehicle, usable, reference)
        found = sets.search(problem)
    clock("name")
    return _Searched(problem, found, judged, usable)


def _inconsistent_flights(
    problem: Problem, found: sets.SetPosterior, failed: list[InconsistentFlights], notes: list[str]
) -> tuple[InconsistentFlights, ...]:
    """Return the flights left out for a failed sensor, then those that contradict the others."""
    inconsistent = heterogeneity.inconsistent_flights(problem, found.linear, found.joint)
    notes[:0] = map(heterogeneity.summary_line, inconsistent)
    notes[:0] = [f"{one.flights[0]} is left out: {one.sensor}" for one in failed]
    return (*failed, *inconsistent)


def _evaluation(
    searched: _Searched, correction: _Correction, corrected: Vehicle
) -> tuple[Problem, list[Vehicle]]:
    """Return the flights that errors are measured on, and the corrected vehicle of each."""
    problem, judged = searched.problem, searched.judged
    if not judged:  # leave-one-out
        return problem, [problem.corrected(values) for values in correction.left_out]
    test = Problem(judged, problem.vehicle, searched.library)
    test.rewhiten(searched.found.noise_model, corrected)
    return test, [corrected] * len(judged)


def _residual(problem: Problem, found: sets.SetPosterior, corrected: Vehicle) -> ResidualAnalysis:
    """Return what the corrected vehicle leaves unexplained."""
    residuals = residual.Residual.by(
        problem, found.local, found.names, found.at, found.noise_model.size, found.inflation
    )
    return residual.analyse_residual(problem, residuals, corrected)


def _named(problem: Problem, found: sets.SetPosterior) -> tuple[tuple[NamedEffect, ...], _Correction]:
    """Return the effects that the flights and their prediction need, and the correction of the vehicle."""

    def fitted_values(names: EffectSet) -> Values:
        values = sets.posterior_mode(problem, found.local.with_wide_slabs(names), names)
        if problem.identified:
            return values
        # Far from the nominal vehicle, spikes of other effects would take a share.
        return fit_least_squares(problem, values, found.inflation, prior=slab_deviations).values

    values = relevant_values(problem, found, fitted_values)
    values = useful_values(problem, found, values, fitted_values)
    return named_effects(problem, found, values), _Correction.of(problem, found, values)


@dataclasses.dataclass(frozen=True)
class _Correction:
    """Values of the effects that correct the vehicle: the named ones, or all of an identified vehicle.

    All are estimated again where that predicts flights left out better.
    """

    values: Values
    left_out: Sequence[Values]  # for every flight, fitted to the others
    again: bool = False  # whether the errors of the identified vehicle were estimated again
    half_widths: dict[str, float | tuple[float, ...]] = dataclasses.field(default_factory=dict)

    @staticmethod
    def of(problem: Problem, found: sets.SetPosterior, values: Values) -> _Correction:
        """Return the correction by the named effects at `values`."""
        names = frozenset(values)
        local = found.local.with_wide_slabs(names)
        named = _Correction(values, sets.leave_one_out(problem, local, names, values))
        if not (problem.identified and values):
            return named
        again, local = fit_vehicle(problem, values, names, found.inflation)
        moved = vehicles_a_half_width_away(problem, local, names, again)
        widths = field_half_widths(problem.vehicle, problem.corrected(again), moved)
        whole = _Correction(again, leave_one_out_modes(problem, local, names), True, widths)
        return min(named, whole, key=lambda one: one.error(problem))

    def error(self, problem: Problem) -> float:
        """Return the position error [m] one second ahead on flights left out; infinite if none is so long."""
        try:
            starts = rollout.RolloutWindows.of(problem.flights)
        except UserError:
            return math.inf
        vehicles = [problem.corrected(values) for values in self.left_out]
        return float(rollout.errors_by_flight(starts, vehicles)[0][-1])


def _steady_force(problem: Candidates, values: Values) -> float:
    """Return the largest steady sideways force of `values` on a hovering vehicle, over its weight.

    The drag of a wind, or what a tilt of the measured attitude, which may stand for it, amounts to.
    """
    tilts = [np.hypot(*values[n].values()) for n in ("mocap_tilt", "level_calibration") if n in values]
    tilt = float(max(tilts, default=0.0))
    if "wind" not in values:
        return tilt
    rest = {name: of for name, of in values.items() if name != "wind"}
    state, command = np.zeros(STATE_SIZE), np.array([problem.vehicle.hover_pwm, 0.0, 0.0, 0.0])
    state[LAG] = problem.vehicle.hover_lag
    windy, calm = (derivative(state, command, problem.corrected(v))["acceleration"] for v in (values, rest))
    return max(tilt, float(np.hypot(*(windy - calm)[:2])) / problem.vehicle.environment_gravity)


def _without_angle_commands(log: FlightLog) -> FlightLog:
    """Return a flight whose attitude commands are not known."""
    command = log.command.copy()
    command[:, 1:3] = np.nan
    return dataclasses.replace(log, command=command)


@dataclasses.dataclass(frozen=True)
class _ContactResult:
    """Posterior of contact effects; `landings` is empty where there are too few."""

    vehicle: Vehicle  # corrected for contact too
    landings: list[Landing] = dataclasses.field(default_factory=list)  # those judged on
    effects: tuple[NamedEffect, ...] = ()
    where: tuple[RegimeError, ...] = ()
    named: contact.ContactPosterior | None = None
    remaining: Touchdowns | None = None

    def sets(self, flown: tuple[ScoredSet, ...]) -> tuple[ScoredSet, ...]:
        """Return the joint sets of free flight and contact."""
        return joint_sets(flown, self.named) if self.named else flown


def _contact_result(
    flights, heldout, vehicle: Vehicle, corrected: Vehicle, library, notes: list[str]
) -> _ContactResult:
    """Return the contact effects found from the landings of the flights."""
    landings = landings_of(flights, corrected)
    if len(landings) < thresholds.LEAST_LANDINGS or not any(e.contact for e in library.values()):
        if landings:
            few = f"{len(landings)} touchdown{'s' * (len(landings) > 1)} only"
            notes.append(f"{few}: contact effects need {thresholds.LEAST_LANDINGS}")
        return _ContactResult(corrected)
    problem, named = contact.contact_posterior(landings, corrected, library)
    effects = contact_effects(problem, named)
    after = problem.corrected({e.name: e.values() for e in effects})
    if named.unexplained:
        notes.append(
            f"something in the motion after the touch repeats that no effect explains (p {named.p_value:.2g})"
        )
    test = landings_of(heldout, corrected) or landings
    where = touchdown_errors(test, vehicle, after)
    remaining = Touchdowns(len(landings), named.unexplained, named.p_value)
    return _ContactResult(after, test, effects, where, named, remaining)


class _Stopwatch:
    """Wall time by stage."""

    def __init__(self):
        self.spent: dict[str, float] = {}
        self._last = time.perf_counter()

    def __call__(self, stage: str) -> None:
        now = time.perf_counter()
        self.spent[stage] = self.spent.get(stage, 0.0) + now - self._last
        self._last = now


def _data_notes(problem: Problem) -> list[str]:
    """Return notes on too few or too short flights."""
    n, notes = len(problem.flights), []
    if n < thresholds.FEW_FLIGHTS:
        notes.append(
            f"{n} flight{'s' * (n > 1)} only: parts of a flight take the place of flights left out, and "
            "how far flights differ is a guess"
        )
    seconds = sum(len(f.starts) * f.rows * f.dt for f in problem.flights)
    if seconds < thresholds.SHORT_FLIGHT:
        notes.append(f"{seconds:.0f} s of usable flight only: small effects cannot be seen")
    if not problem.logged[:, :2].any():
        notes.append("roll or pitch not logged: only the motion up and down can be judged")
    if not problem.logged[:, 3:5].any():
        notes.append(
            "attitude commands not logged: the attitude loops cannot be judged, and translation is predicted "
            "along the measured attitude"
        )
    if not problem.logged[:, 5].any():
        notes.append("yaw or its command not logged: the yaw channel was left out")
    if problem.flights[0].thrust_is_measured:
        notes.append(
            "the thrust is that of the measured rotor speeds: how the motors answer cannot be judged"
        )
    return notes
