"""`diagnose`, from flights to a diagnosis: every step takes records and returns records."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from msgspec import structs
from threadpoolctl import threadpool_limits

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.answer import selection, sizes
from inclined_landing.eval.gap.infer.contact import contact_answer
from inclined_landing.eval.gap.infer.fit import estimate_noise
from inclined_landing.eval.gap.infer.heterogeneity import inconsistent_flights, summary_line
from inclined_landing.eval.gap.infer.residual import analyse_residual
from inclined_landing.eval.gap.infer.sets import SetPosterior, equivalence_class, search
from inclined_landing.eval.gap.measured.usable import check_unused, usable_flights
from inclined_landing.eval.gap.measured.windows import MeasuredFlight
from inclined_landing.eval.gap.model.columns import Candidates, Values
from inclined_landing.eval.gap.model.problem import Problem, identifiable_effects
from inclined_landing.eval.gap.model.reference import VehiclePosterior
from inclined_landing.eval.gap.result import Diagnosis, NamedEffect, Remaining, ScoredSet
from inclined_landing.eval.logs import FlightLog
from inclined_landing.eval.logs.limits import LEAST_RATE
from inclined_landing.models.base.errors import first_of
from inclined_landing.models.effects import LIBRARY, Effect
from inclined_landing.models.parameters import as_vehicle
from inclined_landing.models.vehicle import Vehicle

LOOP = "attitude_time_constant"  # whose remedy stands for all lags of the attitude loops


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
) -> Diagnosis:
    """Return the missing effects that explain `flights` best, and the errors with and without them.

    reference: posterior of the vehicle's constants, from flights (`identify`) or from its file
    (`read_reference`); None: they are exact, its formulas nearly.
    heldout: flights that are not fitted, but whose errors decide the verdict and which names are sure;
    without them these are the errors of each flight, left out of the fit in turn.
    platform: the slab of the vehicle file stands in the arena (None: where a log has contacts).
    plants: measure the gap in these.

    Raises UserError when no flight can be used.
    """
    vehicle = as_vehicle(vehicle)

    # Which flights can be used, and which effects can they show?
    usable = usable_flights(flights, heldout, vehicle, platform)
    if reference is not None:
        check_unused(usable.heldout, reference.flights, "by which the vehicle was identified")
    candidates, unidentifiable = identifiable_effects(library, usable.fitted)

    # How probable is every set of effects?
    searched = probable_sets(usable.fitted, vehicle, candidates, reference)
    notes = [*usable.notes, *_data_notes(searched.problem), *unidentifiable]
    if in_strong_wind(searched):  # search again without attitude loops and lags, which cannot be judged
        notes.append(_IN_WIND)
        usable = usable.without_angle_commands(vehicle)
        candidates = {name: effect for name, effect in candidates.items() if not effect.is_lag}
        searched = probable_sets(usable.fitted, vehicle, candidates, reference)
    inconsistent = inconsistent_flights(searched.problem, searched.linear)

    # Which effects are named? An effect has to matter, to predict flights left out, and to have a firm size
    # or to show one second ahead. From here on the posterior is the one linearised at their values.
    useful = selection.useful_values(searched, selection.probable_names(searched))
    found, values = selection.distinct_values(searched, useful)

    # How wrong is the vehicle before and after its correction by them, and does anything else repeat?
    correction = selection.corrected(found, values)
    with ThreadPoolExecutor(1) as beside:  # whose thread analyses the residual while MuJoCo flies
        analysis = beside.submit(analyse_residual, found, correction.vehicle)
        ahead = selection.open_loop_errors(found, correction, usable.judged, values, plants)
    reference_errors = reference.errors if reference else None
    remaining = Remaining(analysis.result(), ahead.gap.get("analytic"), reference_errors)
    effects = named_effects(found, values, ahead.costs, remaining)
    landings = reference.landings if reference else None
    contact = contact_answer(usable, correction.vehicle, candidates, landings)

    return Diagnosis(
        set_aside=usable.set_aside,
        inconsistent_flights=inconsistent,
        effects=(*effects, *contact.effects),
        estimated={} if correction.half_widths is None else correction.values,
        half_widths=correction.half_widths or {},
        corrected=contact.vehicle,
        sets=contact.sets(scored_sets(found)),
        touchdowns=contact.posterior.touchdowns if contact.posterior else None,
        disturbance=sizes.disturbances(found.problem),
        residual=remaining.residual,
        gap=ahead.gap,
        platform=usable.platform,
        flights=tuple(f.name for f in usable.fitted),
        heldout=tuple(f.name for f in usable.judged or usable.fitted),
        notes=(*map(summary_line, inconsistent), *notes, *contact.notes, *ahead.notes),
        reference=reference_errors,
        displacements=ahead.displacements,
        growth=ahead.growth,
        thrust_over_weight=sizes.thrust_over_weight(found, values),
    )


def probable_sets(
    flights: Sequence[MeasuredFlight],
    vehicle: Vehicle,
    candidates: Mapping[str, Effect],
    reference: VehiclePosterior | None,
) -> SetPosterior:
    """Return the posterior over sets of candidate effects, with the noise of the flights estimated."""
    problem, joint_fit = estimate_noise(Problem.of(flights, vehicle, candidates, reference))
    return search(problem, joint_fit)


def named_effects(
    found: SetPosterior, values: Values, costs: Mapping[str, float], remaining: Remaining
) -> tuple[NamedEffect, ...]:
    """Return the named effects with estimates, in the order of `values`.

    costs [m]: the error one second ahead that each accounts for; NaN: not known.
    """
    problem, library = found.problem, found.problem.library
    gains = selection.squared_error_shares(problem, values)
    estimates = sizes.estimates(found, values)
    # Several lags of the attitude loops have one name, that of the first, and one size.
    lags = sizes.loop_pieces(problem, values)
    result: list[NamedEffect] = []
    for name in (n for n in values if n not in lags[1:]):
        is_loop = name in lags
        names = lags if is_loop else (name,)
        parameters = {"response": sizes.response(found, values, lags)} if is_loop else estimates[name]
        classes = ((*equivalence_class(found, n), *_predicting_as_well(found, values, n)) for n in names)
        members = tuple(dict.fromkeys(itertools.chain(*classes)))
        result.append(
            NamedEffect(
                name=name,
                members=members,
                probability=found.probability(*members),
                parameters=parameters,
                gain=max(gains[n] for n in names),
                remedy=library[LOOP if is_loop else name].remedy,
                cost=costs[name],
                doubt=_doubt(problem, name, remaining.doubts(costs[name])),
                parts={n: dict(values[n]) for n in lags} if is_loop else {},
            )
        )
    return tuple(result)


def _predicting_as_well(found: SetPosterior, values: Values, name: str) -> list[str]:
    """Return the effects that predict flights left out as well as a nonlinear one does.

    A load on a string is a mass where no swing shows. Otherwise a load of 1 g would be sure, and wrong,
    next to upgraded motors (crazyswarm2-tools).
    """
    effect = found.problem.library[name]
    judged_by = selection.judged_by(effect)
    if not judged_by or all(p.linear for p in effect.parameters):
        return []
    result, here = [], selection.fitted_to_others(found, frozenset(values)).pose_errors[judged_by]
    for other in effect.confused_with:
        if other in found.problem.library and other not in values:
            instead = selection.fitted_to_others(found, frozenset(values) - {name} | {other})
            if (instead.pose_errors[judged_by] <= here).all():
                result.append(other)
    return result


def _doubt(problem: Problem, name: str, too_small: bool) -> str:
    """Return a sentence on why an effect is not sure, whatever its probability; empty where it may be.

    too_small: its cost, compared with what all names leave.
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
    if too_small:
        return "In doubt, because the named effects leave more than noise and disturbances would."
    return ""


# Flapping rotors, and the rear ones in the wake of the front ones, turn the vehicle by moments that no
# formula of the library has: they would be named as changes of the loops. How a stream damps the vehicle's
# motion is not in the library either, and would be named as a lag.
_IN_WIND = (
    "a strong steady force, such as wind, also acts on the attitude loops, and its damping looks like a lag: "
    "neither was judged, and translation is predicted along the measured attitude"
)


def in_strong_wind(found: SetPosterior) -> bool:
    """Return whether flights with attitude commands show a strong steady force."""
    force = steady_force(found.problem, found.best.values)
    return bool(found.problem.logged[:, 3:5].any()) and force > thresholds.STRONG_WIND


def steady_force(candidates: Candidates, values: Values) -> float:
    """Return the largest steady sideways force of `values` on a hovering vehicle, over its weight.

    It is the drag of a wind, or the force that a tilt of the measured attitude, which may stand for a wind,
    amounts to.
    """
    tilts = [np.hypot(*values[n].values()) for n in ("mocap_tilt", "level_calibration") if n in values]
    tilt = float(max(tilts, default=0.0))
    if "wind" not in values:
        return tilt
    calm = {name: of for name, of in values.items() if name != "wind"}
    push = candidates.hover_acceleration(values) - candidates.hover_acceleration(calm)
    return max(tilt, float(np.hypot(*push[:2])) / candidates.vehicle.environment_gravity)


def _data_notes(problem: Problem) -> list[str]:
    """Return notes on too few or too short flights."""
    n, notes = len(problem.flights), []
    if n < thresholds.FEW_FLIGHTS:
        parts = "cross-validation leaves out parts of flights instead of whole flights"
        how = parts if n > 1 else "errors are measured on the flight that was fitted"
        notes.append(f"only {n} flight{'s' * (n > 1)}: {how}, and the spread between flights is a guess")
    seconds = sum(len(f.starts) * f.rows * f.dt for f in problem.flights)
    if seconds < thresholds.SHORT_FLIGHT:
        notes.append(f"only {seconds:.0f} s of usable flight, so small effects cannot be detected")
    if not problem.logged[:, :2].any():
        notes.append("roll or pitch is not logged, so only vertical motion can be diagnosed")
    if not problem.logged[:, 3:5].any():
        notes.append(
            "attitude commands are not logged: the attitude loops cannot be diagnosed, and translation is "
            "predicted along the measured attitude"
        )
    if not problem.logged[:, 5].any():
        notes.append("yaw or its command is not logged, so the yaw channel was not used")
    if problem.flights[0].thrust_is_measured:
        notes.append(
            "thrust is computed from the measured rotor speeds, so the motors' response cannot be diagnosed"
        )
    return notes


def scored_sets(found: SetPosterior) -> tuple[ScoredSet, ...]:
    """Return the sets of a posterior with the standard errors of their values."""
    result = []
    for scored in found.sets:
        standard_errors: dict[str, dict[str, float]] = {n: {} for n in scored.effects}
        for (name, parameter), known in found.local.parameter_errors(scored.values).items():
            standard_errors[name][parameter] = known.error
        result.append(structs.replace(scored, standard_errors=standard_errors))
    return tuple(result)
