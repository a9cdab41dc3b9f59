"""`diagnose`: prediction errors by regime, the missing effects, and the error of the corrected model."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Mapping, Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from inclined_landing.eval.gap.answer.named import (
    contact_effects,
    disturbances,
    joint_sets,
    named_effects,
    relevant_values,
    useful_values,
)
from inclined_landing.eval.gap.flights.landings import AFTER, BEFORE, Landing, landings_of
from inclined_landing.eval.gap.flights.sensors import without_failed_sensors
from inclined_landing.eval.gap.flights.windows import REGIMES, prepare_all
from inclined_landing.eval.gap.plan.information import set_hypotheses, unidentifiable_sets
from inclined_landing.eval.gap.plan.words import discriminating_manoeuvre
from inclined_landing.eval.gap.result import (
    Diagnosis,
    HorizonCurve,
    NamedEffect,
    PlantGap,
    RegimeError,
    ScoredSet,
    Touchdowns,
    WindowCurves,
)
from inclined_landing.eval.gap.search import (
    contact,
    heterogeneity,
    residual,
    rollout,
    sets,
    touchdown_simulation,
)
from inclined_landing.eval.gap.search.columns import Candidates, Values, slab_deviations
from inclined_landing.eval.gap.search.evidence import Problem, identifiable_effects
from inclined_landing.eval.gap.search.fit import fit_least_squares
from inclined_landing.eval.gap.search.posterior import EffectSet
from inclined_landing.eval.gap.search.prediction import channels_of
from inclined_landing.eval.gap.search.reference import VehiclePosterior
from inclined_landing.eval.gap.search.vehicle_fit import (
    field_half_widths,
    fit_vehicle,
    leave_one_out_modes,
    vehicles_a_half_width_away,
)
from inclined_landing.eval.logs import FlightLog
from inclined_landing.eval.logs.log import as_logs
from inclined_landing.models.attitude import LAG, STATE_SIZE
from inclined_landing.models.effects import LIBRARY, Effect
from inclined_landing.models.equations import derivative
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import as_vehicle
from inclined_landing.models.vehicle import Vehicle

FEW_FLIGHTS = 3
STRONG_WIND = 0.05  # of the weight, drag of a wind in which the attitude loops are not judged


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
    clock = _Clock()
    notes: list[str] = []
    flights, heldout, vehicle = as_logs(flights), as_logs(heldout), as_vehicle(vehicle)
    if platform is None:
        platform = any(log.contact is not None and log.contact.any() for log in flights)
    flights, failed = without_failed_sensors(flights)
    heldout, failed_heldout = without_failed_sensors(heldout)
    fitted = prepare_all(flights, vehicle, platform, notes)
    judged = prepare_all(heldout, vehicle, platform, notes) if heldout else []
    usable, unidentifiable = identifiable_effects(library, fitted)
    problem = Problem(fitted, vehicle, usable, reference)
    notes += [*_data_notes(problem), *unidentifiable]
    clock("prepare")
    found = sets.search(problem)
    if problem.logged[:, 3:5].any() and _steady_force(problem, found.values) > STRONG_WIND:
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
    library = usable
    clock("name")
    inconsistent = heterogeneity.inconsistent_flights(problem, found.linear, found.joint)
    notes[:0] = map(heterogeneity.summary_line, inconsistent)
    failed += failed_heldout
    notes[:0] = [f"{one.flights[0]} is left out: {one.sensor}" for one in failed]
    inconsistent = (*failed, *inconsistent)

    def fitted_values(names: EffectSet) -> Values:
        values = sets.posterior_mode(problem, found.local.with_wide_slabs(names), names)
        if problem.identified:
            return values
        # Far from the nominal vehicle, spikes of other effects would take a share.
        return fit_least_squares(problem, values, found.inflation, prior=slab_deviations).values

    values = relevant_values(problem, found, fitted_values)
    values = useful_values(problem, found, values, fitted_values)
    effects, correction = named_effects(problem, found, values), _Correction.of(problem, found, values)
    corrected = problem.corrected(correction.values)
    residuals = residual.Residual.by(
        problem, found.local, found.names, found.at, found.noise_model.size, found.inflation
    )
    remaining = residual.analyse_residual(problem, residuals, corrected)
    clock("remainder")
    if judged:
        test, after = Problem(judged, vehicle, library), [corrected] * len(judged)
        test.rewhiten(found.noise_model, corrected)
    else:
        test, after = (
            problem,
            [problem.corrected(v) for v in correction.left_out],
        )
    where = _regime_errors(test, test.white_errors([vehicle] * len(after)), test.white_errors(after))
    clock("where")
    tied = any(len(e.members) > 1 for e in effects)
    manoeuvre = discriminating_manoeuvre(problem, found, platform) if tied else ""
    clock("manoeuvre")
    contact_result = _contact_result(flights, heldout, vehicle, corrected, library, notes)
    if contact_result.landings:
        clock("touchdown")
    starts = _starts(test, notes)
    gap: dict[str, PlantGap] = {}
    horizon: tuple[HorizonCurve, ...] = ()
    windows: tuple[WindowCurves, ...] = ()
    if starts is not None:
        floor = rollout.noise_floor(starts, corrected)
        error = float(rollout.errors_by_flight(starts, after)[0][-1])
        remaining = dataclasses.replace(remaining, error=error)
        effects = tuple(_with_cost(problem, starts, effects, e) for e in effects)
        if curves:
            horizon = _horizon(problem, starts, effects, after, floor, correction.again)
            windows = _window_curves(starts, vehicle, corrected)
        clock("show")
        for plant in plants:
            gap[plant] = rollout.plant_gap(starts, vehicle, corrected if judged else after, plant, floor)
            clock(f"gap {plant}")
    elif contact_result.landings and "mujoco" in plants:
        gap["mujoco"] = _landing_gap(contact_result.landings, vehicle, contact_result.vehicle)
        clock("gap mujoco")
    effects += contact_result.effects
    unknown = remaining.unexplained or (
        contact_result.remaining is not None and contact_result.remaining.unexplained
    )
    return Diagnosis(
        verdict="unknown" if unknown else "effects" if effects else "nothing",
        inconsistent_flights=inconsistent,
        effects=effects,
        estimated=correction.values if correction.again else {},
        half_widths=correction.half_widths,
        corrected=contact_result.vehicle,
        separating_manoeuvre=manoeuvre or None,
        where=where + contact_result.where,
        sets=contact_result.sets(tuple(set_hypotheses(problem, found)[0])),
        unidentifiable_sets=tuple(unidentifiable_sets(problem, found)),
        touchdowns=contact_result.remaining,
        disturbance=disturbances(problem, found.noise_model),
        horizon=horizon,
        windows=windows,
        residual=remaining,
        gap=gap,
        platform=platform,
        flights=tuple(f.name for f in fitted),
        heldout=tuple(f.name for f in test.flights),
        seconds=clock.spent,
        notes=tuple(notes),
    )


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
    if len(landings) < contact.LEAST_LANDINGS or not any(e.contact for e in library.values()):
        if landings:
            few = f"{len(landings)} touchdown{'s' * (len(landings) > 1)} only"
            notes.append(f"{few}: contact effects need {contact.LEAST_LANDINGS}")
        return _ContactResult(corrected)
    problem, named = contact.contact_posterior(landings, corrected, library)
    effects = contact_effects(problem, named)
    after = problem.corrected({e.name: e.values() for e in effects})
    if named.unexplained:
        notes.append(
            f"something in the motion after the touch repeats that no effect explains (p {named.p_value:.2g})"
        )
    test = landings_of(heldout, corrected) or landings
    where = _touchdown_errors(test, vehicle, after)
    remaining = Touchdowns(len(landings), named.unexplained, named.p_value)
    return _ContactResult(after, test, effects, where, named, remaining)


class _Clock:
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
    if n < FEW_FLIGHTS:
        notes.append(
            f"{n} flight{'s' * (n > 1)} only: parts of a flight take the place of flights left out, and "
            "how far flights differ is a guess"
        )
    seconds = sum(len(f.starts) * f.rows * f.dt for f in problem.flights)
    if seconds < 20.0:
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


def _regime_errors(problem: Problem, before, after) -> tuple[RegimeError, ...]:
    """Return the root mean square errors by regime and channel, from white errors before and after."""
    first, variance = residual.equivalent_sizes(problem, before)
    second, _ = residual.equivalent_sizes(problem, after)
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


def _touchdown_errors(landings, before: Vehicle, after: Vehicle) -> tuple[RegimeError, ...]:
    """Return the position error after the touch, as a table row."""
    worse, better = (
        float(np.sqrt((touchdown_simulation.position_errors(landings, v) ** 2).mean()))
        for v in (before, after)
    )
    floor = float(np.sqrt(np.mean([(x.deviation[:, :3] ** 2).sum(axis=1).mean() for x in landings])))
    return (RegimeError("touchdown", "touchdown", worse, better, floor, "m", len(landings)),)


def _landing_gap(landings, before: Vehicle, after: Vehicle) -> PlantGap:
    """Return the gap of logs with landings only: error at the end of the motion after the touch."""
    worse, better = (
        float(np.sqrt((touchdown_simulation.position_errors(landings, v)[:, -1] ** 2).mean()))
        for v in (before, after)
    )
    floor = float(np.sqrt(np.mean([(x.deviation[-1, :3] ** 2).sum() for x in landings])))
    nan = float("nan")
    return PlantGap(worse, better, floor, nan, nan, len(landings), BEFORE + AFTER)


def _starts(problem: Problem, notes: list[str]) -> rollout.RolloutWindows | None:
    """Return the windows for open-loop prediction; None, with a note, where there are none."""
    try:
        return rollout.RolloutWindows.of(problem.flights)
    except UserError as error:
        notes.append(f"the gap after one second was not measured: {error}")
        return None


def _horizon(problem, starts, effects, after, floor, again: bool) -> tuple[HorizonCurve, ...]:
    """Return error against horizon with the effects added one by one; `again`: then all others too."""
    t = np.arange(1, starts.rows + 1) * starts.dt
    names = [e.name for e in effects]
    labels = ["nominal", *(f"+ {name}" for name in names), *["+ all others"][: int(again)]]
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


def _window_curves(starts, vehicle: Vehicle, corrected: Vehicle) -> tuple[WindowCurves, ...]:
    """Return, for every regime, the window of the largest error before correction."""
    measured = starts.measured()
    before, after = rollout.simulate(starts, vehicle), rollout.simulate(starts, corrected)
    error = ((before - measured)[:, -1, :3] ** 2).sum(axis=1)
    t = np.arange(starts.rows + 1) * starts.dt
    shown = np.zeros((len(starts), len(REGIMES)), bool)  # the regimes of the window that a start lies in
    for i, (f, first) in enumerate(zip(starts.flight_of, starts.first)):
        k = int(np.searchsorted(starts.flights[f].starts, first, side="right")) - 1
        shown[i] = k >= 0 and starts.flights[f].regimes[k]
    result = []
    for regime, member in zip(REGIMES, shown.T):
        if member.any():
            i = int(np.argmax(np.where(member, error, -1.0)))
            flight = starts.flights[starts.flight_of[i]]
            begins = float(flight.t[starts.first[i]])
            result.append(WindowCurves(flight.name, regime, begins, t, measured[i], before[i], after[i]))
    return tuple(result)
