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
from inclined_landing.eval.gap.search.evidence import Problem
from inclined_landing.eval.gap.search.naming import (
    Search,
    Thresholds,
    left_out_vehicles,
    refit,
    search,
    spread_between,
)
from inclined_landing.eval.gap.search.prediction import CHANNELS
from inclined_landing.eval.gap.search.touchdown import landings_of
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
    problem = Problem(fitted, vehicle, library)
    touches = {n: e for n, e in library.items() if set(e.channels) == {"touchdown"}}
    _limits_in_words(problem, library, notes)
    clock("prepare")

    contact_unknown = False
    found = search(problem, limits)
    found = merge_delays(problem, found)
    clock("name")

    effects = _named(problem, found)
    own = left_out_vehicles(problem, found.fit)  # one for each fitted flight
    if judged:
        test = Problem(judged, vehicle, library)
        after_vehicles = [problem.corrected(found.fit.values)] * len(judged)
    else:
        test, after_vehicles = problem, own
    white_before = [x[0] for x in test.white([vehicle])]
    white_after = [test.white_of(k, v) for k, v in enumerate(after_vehicles)]
    where = _where(test, white_before, white_after)
    left = remainder.assess(test, white_after, remainder.floors_with(test, found.fit.values))
    clock("where")

    ties = manoeuvres.separating(problem, [e.members for e in effects], found.fit.values)
    clock("manoeuvres")

    corrected = problem.corrected(found.fit.values)
    steps = list(found.steps)
    landed = landings_of(flights, corrected)
    after_contact = corrected
    if len(landed) >= touchdown.FEWEST and touches:
        contact, named = touchdown.name_contact(landed, corrected, touches)
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


def _limits_in_words(problem: Problem, library, notes: list[str]) -> None:
    n = len(problem.flights)
    if n < FEW_FLIGHTS:
        notes.append(
            f"{n} flight{'s' * (n > 1)} only: parts of a flight take the place of flights left out, and "
            "whether an effect is the same in every flight cannot be checked"
        )
    seconds = sum(len(f.starts) * f.rows * f.dt for f in problem.flights)
    if seconds < 20.0:
        notes.append(f"{seconds:.0f} s of usable flight only: small effects cannot be seen")
    if "battery_voltage" in library and "battery_voltage" not in problem.library:
        notes.append("battery voltage not logged in every flight: only the sag with the load can be told")
    elif "battery_voltage" in problem.library:
        spans = [np.ptp(f.voltage[f.usable]) for f in problem.flights]
        means = [f.voltage[f.usable].mean() for f in problem.flights]
        if max(spans) < 0.02 and np.ptp(means) < 0.02:
            del problem.library["battery_voltage"]
            notes.append("the battery voltage is constant: its effect on the thrust cannot be told")
    if not problem.logged[:, 5].any():
        notes.append("yaw or its command not logged: the yaw channel was left out")


def merge_delays(problem: Problem, found: Search) -> Search:
    """Equal delays of thrust and attitude are one late measurement, where that explains as much."""
    values = found.fit.values
    if not {"thrust_delay", "attitude_delay"} <= set(values) or "mocap_delay" not in problem.library:
        return found
    a, b = values["thrust_delay"]["delay"], values["attitude_delay"]["delay"]
    covariance = found.fit.weighted.covariance(found.fit.index)
    columns = [c.effect for c in found.fit.weighted.columns]
    error = np.sqrt(
        covariance[columns.index("thrust_delay"), columns.index("thrust_delay")]
        + covariance[columns.index("attitude_delay"), columns.index("attitude_delay")]
    )
    if abs(a - b) > max(0.003, 2.5 * error):
        return found
    merged = {k: v for k, v in values.items() if k not in ("thrust_delay", "attitude_delay")}
    merged["mocap_delay"] = {"delay": 0.5 * (a + b)}
    fit = refit(problem, merged, found.inflation)
    gain = found.gains["thrust_delay"] + found.gains["attitude_delay"]
    evidence = max(found.evidence["thrust_delay"], found.evidence["attitude_delay"])
    drop = ("thrust_delay", "attitude_delay")

    def keep(table: dict) -> dict:
        return {name: value for name, value in table.items() if name not in drop}

    return dataclasses.replace(
        found,
        fit=fit,
        gains=keep(found.gains) | {"mocap_delay": gain},
        evidence=keep(found.evidence) | {"mocap_delay": evidence},
        classes=keep(found.classes) | {"mocap_delay": ("mocap_delay",)},
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
                _note(name, found),
            )
        )
    return tuple(sorted(effects, key=lambda e: -e.gain))


def _note(name: str, found: Search) -> str:
    if name in found.follows:
        return f"follows from {found.follows[name]} physically"
    if name == "mocap_delay":
        return "commands of thrust and attitude that are late by the same time look the same"
    return ""


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
