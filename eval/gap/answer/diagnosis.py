"""`diagnose`: where the model is wrong, what is missing, and what the correction brings."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping, Sequence

import numpy as np
from scipy import stats

from inclined_landing.eval.gap.answer import manoeuvres
from inclined_landing.eval.gap.flights.windows import REGIMES, prepare_all
from inclined_landing.eval.gap.result import (
    Diagnosis,
    Estimate,
    HorizonCurve,
    NamedEffect,
    PlantGap,
    WhereRow,
    WindowCurves,
)
from inclined_landing.eval.gap.search import remainder, rollout, touchdown
from inclined_landing.eval.gap.search.evidence import Problem, tellable
from inclined_landing.eval.gap.search.fit import left_out_vehicles, refit, spread_between
from inclined_landing.eval.gap.search.naming import Search, search
from inclined_landing.eval.gap.search.prediction import CHANNELS
from inclined_landing.eval.gap.search.touchdown import landings_of
from inclined_landing.eval.gap.search.trial import Thresholds
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.effects import LIBRARY, Effect
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import Vehicle

FEW_FLIGHTS = 3


def diagnose(
    flights: Sequence[FlightLog],
    vehicle: Vehicle,
    library: Mapping[str, Effect] = LIBRARY,
    *,
    heldout: Sequence[FlightLog] = (),
    platform: bool | None = None,
    limits: Thresholds | None = None,
    plants: Sequence[str] = ("analytic",),
    curves: bool = True,
) -> Diagnosis:
    """Name the effects that `vehicle` lacks to explain `flights`.

    heldout: flights only judged on; without them every flight is judged with the effects fitted to the
    others. platform: the slab of the vehicle file stands in the arena (None: where a log has contacts).
    plants: measure the gap in these. curves: also error against horizon and single windows.

    Raises UserError when no flight can be used.
    """
    clock = _Clock()
    notes: list[str] = []
    if platform is None:
        platform = any(log.contact is not None and log.contact.any() for log in flights)
    fitted = prepare_all(flights, vehicle, platform, notes)
    judged = prepare_all(heldout, vehicle, platform, notes) if heldout else []
    library, untold = tellable(library, fitted)
    problem = Problem(fitted, vehicle, library)
    notes += [*_limits_in_words(problem), *untold]
    clock("prepare")

    contact_unknown = False
    found = united(problem, search(problem, limits))
    clock("name")

    effects = _named(problem, found)
    own = left_out_vehicles(problem, found.fit)  # one for each fitted flight
    if judged:
        test = Problem(judged, vehicle, library)
        after_vehicles = [problem.corrected(found.fit.values)] * len(judged)
    else:
        test, after_vehicles = problem, own
    white_before = test.white([vehicle] * len(test.flights))
    white_after = test.white(after_vehicles)
    where = _where(test, white_before, white_after)
    left = remainder.assess(test, white_after, remainder.floors_with(test, found.fit.values))
    clock("where")

    ties = manoeuvres.separating(problem, [e.members for e in effects], found.fit.values)
    clock("manoeuvres")

    corrected = problem.corrected(found.fit.values)
    steps = list(found.steps)
    landed = landings_of(flights, corrected)
    after_contact = corrected
    if len(landed) >= touchdown.FEWEST and any(e.contact for e in library.values()):
        contact, named = touchdown.name_contact(landed, corrected, library)
        after_contact = contact.corrected(named.fit.values)
        effects += _named(contact, named)
        steps += named.steps
        contact_unknown = named.unexplained
        if contact_unknown:
            notes.append(
                "the motion after the touch differs from the simulated one in a way no effect explains"
            )
        test_landed = landings_of(heldout, corrected) or landed
        where += _where_touching(test_landed, vehicle, after_contact)
        clock("touchdown")
    elif landed:
        notes.append(
            f"{len(landed)} touchdown{'s' * (len(landed) > 1)} only: contact effects need {touchdown.FEWEST}"
        )
    gap: dict[str, PlantGap] = {}
    horizon, windows = (), ()
    starts = _starts(test, notes)
    if starts is not None and (curves or plants):
        floor = rollout.noise_floor(starts, corrected)
        if curves:
            horizon = _horizon(problem, test, starts, found, after_vehicles, floor)
            windows = _window_curves(starts, vehicle, corrected, test)
        clock("show")
        for plant in plants:
            gap[plant] = rollout.plant_gap(
                starts, vehicle, corrected if judged else after_vehicles, plant, floor
            )
            clock(f"gap {plant}")
    elif len(landed) >= touchdown.FEWEST and "mujoco" in plants:
        gap["mujoco"] = _landing_gap(landings_of(heldout, corrected) or landed, vehicle, after_contact)
        clock("gap mujoco")
    corrected = after_contact

    unknown = left.unexplained or found.unstable or contact_unknown
    verdict = "unknown" if unknown else "effects" if effects else "nothing"
    if found.unstable:
        names = ", ".join(dict.fromkeys(found.unstable))
        notes.append(f"{names} would explain part of the error, but not the same way in every flight")
    return Diagnosis(
        verdict=verdict,
        effects=effects,
        corrected=corrected,
        separating_manoeuvre=" ".join(t["text"] for t in ties) or None,
        manoeuvres=tuple(ties),
        where=where,
        steps=tuple(steps),
        horizon=horizon,
        windows=windows,
        remainder=left,
        gap=gap,
        flights=tuple(f.name for f in fitted),
        heldout=tuple(f.name for f in test.flights),
        seconds=clock.spent,
        notes=tuple(notes),
    )


class _Clock:
    def __init__(self):
        self.spent: dict[str, float] = {}
        self._last = time.perf_counter()

    def __call__(self, stage: str) -> None:
        now = time.perf_counter()
        self.spent[stage] = self.spent.get(stage, 0.0) + now - self._last
        self._last = now


def _limits_in_words(problem: Problem) -> list[str]:
    """What the flights are too few or too short for."""
    n, notes = len(problem.flights), []
    if n < FEW_FLIGHTS:
        notes.append(
            f"{n} flight{'s' * (n > 1)} only: parts of a flight take the place of flights left out, and "
            "whether an effect is the same in every flight cannot be checked"
        )
    seconds = sum(len(f.starts) * f.rows * f.dt for f in problem.flights)
    if seconds < 20.0:
        notes.append(f"{seconds:.0f} s of usable flight only: small effects cannot be seen")
    if not problem.logged[:, 5].any():
        notes.append("yaw or its command not logged: the yaw channel was left out")
    return notes


def united(problem: Problem, found: Search) -> Search:
    """Effects found that are equal are the one that unites them, where that explains as much."""
    for name, effect in problem.library.items():
        if effect.unites and set(effect.unites) <= set(found.fit.values):
            found = _united(problem, found, name)
    return found


def _united(problem: Problem, found: Search, name: str) -> Search:
    parts, values = problem.library[name].unites, found.fit.values
    parameters = [problem.library[n].parameters[0] for n in parts]
    sizes = [values[n][p.name] for n, p in zip(parts, parameters)]
    variance = np.diag(found.fit.weighted.covariance(found.fit.index))[found.fit.weighted.index(parts)]
    least = max(p.negligible for p in parameters)
    if max(sizes) - min(sizes) > max(least, 2.5 * np.sqrt(variance.sum())):
        return found
    own = {problem.library[name].parameters[0].name: sum(sizes) / len(sizes)}

    def merged(table: dict, value) -> dict:
        return {n: x for n, x in table.items() if n not in parts} | {name: value}

    return dataclasses.replace(
        found,
        fit=refit(problem, merged(values, own), found.inflation),
        gains=merged(found.gains, sum(found.gains[n] for n in parts)),
        evidence=merged(found.evidence, max(found.evidence[n] for n in parts)),
        classes=merged(found.classes, (name,)),
    )


def _named(problem: Problem, found: Search) -> tuple[NamedEffect, ...]:
    fit = found.fit
    covariance = fit.weighted.covariance(fit.index) if len(fit.index) else np.zeros((0, 0))
    change, error = fit.weighted.per_flight(fit.index)
    clusters = problem.groups
    quantile = stats.t.ppf(0.975, max(1, clusters - 1))
    effects = []
    for name in fit.values:
        effect = problem.library[name]
        parameters = {}
        for k, column in enumerate(fit.weighted.columns):
            if column.effect != name:
                continue
            p = next(p for p in effect.parameters if p.name == column.parameter)
            value = fit.values[name][p.name]
            half = quantile * float(np.sqrt(max(0.0, covariance[k, k])))
            own = np.where(
                error[:, k] < 10 * max(abs(value - p.neutral), p.negligible), value + change[:, k], np.nan
            )
            lo, hi = p.bounds
            parameters[p.name] = Estimate(
                value,
                p.unit,
                (float(max(lo, value - half)), float(min(hi, value + half))),
                p.neutral,
                p.bounds,
                bool(min(value - lo, hi - value) <= 1e-6 * (hi - lo)),
                tuple(map(float, own)),
                tuple(map(float, error[:, k])),
                spread_between(change[:, k], error[:, k]),
            )
        effects.append(
            NamedEffect(
                name,
                found.classes.get(name, (name,)),
                parameters,
                found.gains.get(name, 0.0),
                found.evidence.get(name, 0.0),
                effect.remedy,
                found.follows.get(name, ""),
                f"follows from {cause} physically"
                if (cause := found.follows.get(name))
                else effect.unites_because,
            )
        )
    return tuple(sorted(effects, key=lambda e: -e.gain))


def _where(problem: Problem, before, after) -> tuple[WhereRow, ...]:
    first, variance = remainder.sizes(problem, before)
    second, _ = remainder.sizes(problem, after)
    regimes = np.concatenate([f.regimes for f in problem.flights])
    rows = []
    for name, member in [("all", np.ones(len(regimes), bool)), *zip(REGIMES, regimes.T)]:
        for k, channel in enumerate(CHANNELS):
            w = member & (problem.logged[:, k] > 0.0)
            if w.any():
                rms = [float(np.sqrt((x[w, k] ** 2).mean())) for x in (first, second)]
                floor = float(np.sqrt(variance[w, k].mean()))
                rows.append(WhereRow(name, channel, *rms, floor, remainder.UNITS[channel], int(w.sum())))
    return tuple(rows)


def _where_touching(landed, before: Vehicle, after: Vehicle) -> tuple[WhereRow, ...]:
    """Position error over the motion that follows the touch."""
    rms = [float(np.sqrt((touchdown.position_errors(landed, v) ** 2).mean())) for v in (before, after)]
    floor = float(np.sqrt(np.mean([(x.deviation[:, :3] ** 2).sum(axis=1).mean() for x in landed])))
    return (WhereRow("touchdown", "touchdown", *rms, floor, "m", len(landed)),)


def _landing_gap(landed, before: Vehicle, after: Vehicle) -> PlantGap:
    """The gap of logs that hold nothing but landings: at the end of the motion after the touch."""
    end = [float(np.sqrt((touchdown.position_errors(landed, v)[:, -1] ** 2).mean())) for v in (before, after)]
    floor = float(np.sqrt(np.mean([(x.deviation[-1, :3] ** 2).sum() for x in landed])))
    nan = float("nan")
    return PlantGap(*end, floor, nan, nan, len(landed), touchdown.BEFORE + touchdown.AFTER)


def _starts(problem: Problem, notes: list[str]) -> rollout.Starts | None:
    """Windows for the gap; flights at the most usual rate."""
    try:
        starts = rollout.Starts.of(problem.flights)
    except UserError as error:
        notes.append(f"the gap after one second was not measured: {error}")
        return None
    if not len(starts):
        notes.append("the gap after one second was not measured: no stretch of free flight is long enough")
        return None
    return starts


def _horizon(problem, test, starts, found: Search, after_vehicles, floor) -> tuple[HorizonCurve, ...]:
    t = np.arange(1, starts.rows + 1) * starts.dt
    measured = starts.measured()
    curves = []
    names = sorted(found.fit.values, key=lambda n: -found.gains.get(n, 0.0))
    for k in range(len(names) + 1):
        chosen = tuple(names[:k])
        vehicle = problem.corrected({n: found.fit.values[n] for n in chosen})
        if k and k == len(names):
            error, _ = rollout.errors_by_flight(starts, after_vehicles)
        else:
            error = rollout.position_error(rollout.simulate(starts, vehicle), measured)
        curves.append(HorizonCurve(f"+ {names[k - 1]}" if k else "nominal", chosen, t, error, floor))
    return tuple(curves)


def _window_curves(starts, vehicle, corrected, problem) -> tuple[WindowCurves, ...]:
    """For every regime, the window whose error is largest before."""
    measured = starts.measured()
    before, after = rollout.simulate(starts, vehicle), rollout.simulate(starts, corrected)
    error = ((before - measured)[:, -1, :3] ** 2).sum(axis=1)
    t = np.arange(starts.rows + 1) * starts.dt
    result = []
    for r, regime in enumerate(REGIMES):
        best = None
        for i in range(len(starts)):
            flight = starts.flights[starts.flight_of[i]]
            k = int(np.searchsorted(flight.starts, starts.first[i], side="right")) - 1
            if k >= 0 and flight.regimes[k, r] and (best is None or error[i] > error[best]):
                best = i
        if best is not None:
            flight = starts.flights[starts.flight_of[best]]
            result.append(
                WindowCurves(
                    flight.name,
                    regime,
                    float(flight.t[starts.first[best]]),
                    t,
                    measured[best],
                    before[best],
                    after[best],
                )
            )
    return tuple(result)
