"""Grey-box identification of what the model already has, from flights.

All effects that free flight excites are fitted jointly, with those of the place as nuisance parameters. No
model selection: uncertainties and correlations are in the posterior that `gap` takes together with the
vehicle.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property

import numpy as np
from threadpoolctl import threadpool_limits

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.answer import rollout
from inclined_landing.eval.gap.answer.selection import Refit
from inclined_landing.eval.gap.answer.sizes import disturbances, half_width
from inclined_landing.eval.gap.infer.fit import (
    deviance,
    estimate_noise,
    field_half_widths,
    fit_least_squares,
    fit_vehicle,
)
from inclined_landing.eval.gap.infer.gaussian import LinearGaussian, ParameterErrors, Spread, truncated_mode
from inclined_landing.eval.gap.infer.heterogeneity import inconsistent_flights, summary_line
from inclined_landing.eval.gap.infer.landing_reference import landing_reference
from inclined_landing.eval.gap.infer.residual import reference_residual, white_residuals
from inclined_landing.eval.gap.infer.sets import leave_one_out
from inclined_landing.eval.gap.measured.landings import LandingReference
from inclined_landing.eval.gap.measured.usable import UsableFlights, fingerprint, usable_flights
from inclined_landing.eval.gap.measured.windows import WINDOW_REGIMES
from inclined_landing.eval.gap.model.columns import (
    BASE,
    BaseColumn,
    FittedValues,
    Values,
    slab_deviations,
    without,
)
from inclined_landing.eval.gap.model.problem import Problem, identifiable_effects
from inclined_landing.eval.gap.model.reference import VehiclePosterior, free_effects
from inclined_landing.eval.gap.result import (
    VERSION,
    Disturbance,
    InconsistentFlights,
    ReferenceErrors,
    SetAside,
    plain,
)
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.effects import LIBRARY, Effect
from inclined_landing.models.parameters import as_vehicle
from inclined_landing.models.vehicle import Vehicle

IDLE = 0.01  # growth of the squared error up to which a reference is put back to neutral


@dataclasses.dataclass(frozen=True)
class Identified:
    """An identified constant, with its cluster-robust (by flight) 95 % interval."""

    name: str  # lag, attitude gain, ...
    field: str  # of Vehicle
    unit: str
    before: float
    value: float
    ci95: tuple[float, float]
    spread: float  # standard deviation between flights beyond their errors, in the unit
    note: str = ""


@dataclasses.dataclass(frozen=True)
class Identifiable:
    """Identifiability of an effect from the flights."""

    effect: str
    share: float  # posterior over prior standard deviation; 1: not excited at all
    confounded: tuple[str, ...]  # effects that it is confounded with
    regimes: tuple[str, ...]  # that excite it


@dataclasses.dataclass(frozen=True)
class Identification:
    """The answer of `identify`."""

    vehicle: Vehicle
    reference: VehiclePosterior  # its posterior
    parameters: tuple[Identified, ...]
    identifiable: tuple[Identifiable, ...]  # best identified first
    # Open-loop position error [m] one second ahead on flights left out: before, after, floor; empty where no
    # stretch is so long.
    ahead: dict[str, float]
    regimes: dict[str, float]  # share of the windows in each
    kept: tuple[str, ...]  # effects left as they were: fitted, flights left out are predicted worse
    disturbance: dict[str, Disturbance]  # channel -> noise and disturbance
    fields: dict[str, tuple[float, ...] | float]  # changed Vehicle field -> half-width of its interval
    flights: tuple[str, ...]
    notes: tuple[str, ...]
    inconsistent_flights: tuple[InconsistentFlights, ...] = ()
    set_aside: tuple[SetAside, ...] = ()

    def to_json(self) -> dict:
        """Return the contents of report.json: plain dicts, lists, strings and numbers."""
        record = {name: value for name, value in vars(self).items() if name != "reference"}
        vehicle = {f: getattr(self.vehicle, f) for f in self.fields}
        return plain(record | {"version": VERSION, "vehicle": vehicle})


@threadpool_limits.wrap(limits=1, user_api="blas")  # flights are shared among threads already
def identify(
    flights: Sequence[FlightLog],
    vehicle: Vehicle,
    *,
    heldout: Sequence[FlightLog] = (),
    platform: bool = False,
) -> Identification:
    """Return the vehicle's constants fitted to flights, with their posterior and identifiability.

    heldout: flights that are not fitted, but on which errors are measured; without them these are the errors
    of each flight, left out of the fit in turn.
    Raises UserError when no flight can be used.
    """
    vehicle = as_vehicle(vehicle)
    use = usable_flights(flights, heldout, vehicle, platform)
    library, unidentifiable = identifiable_effects(
        {n: e for n, e in LIBRARY.items() if not (e.contact or e.told_by) and e.identified}, use.fitted
    )
    fitted, kept = _Fit.of(use, vehicle, library), frozenset[str]()
    # Slopes at neutral may have led to a worse minimum: without this, flights of a vehicle in which nothing
    # has changed are `unknown`.
    if large := fitted.large_beyond_slopes():
        other = _Fit.of(use, vehicle, without(library, *large))
        if other.ahead.get("after", math.inf) < fitted.ahead.get("after", math.inf):
            fitted, kept = other, large
    linear = fitted.problem.linearise(fitted.joint, fitted.problem.all_columns())
    inconsistent = inconsistent_flights(fitted.problem, linear)
    result, landings, moved = landing_reference(use.logs, fitted.vehicle, LIBRARY)
    disturbance, errors = disturbances(fitted.problem), None
    if fitted.ahead and (use.judged or len(use.fitted) > 1):
        errors = ReferenceErrors(fitted.ahead["after"], fitted.ahead["floor"], disturbance)
    around = problem_about(fitted.problem, result)
    reference = identified_reference(
        around, errors=errors, landings=landings, flights={log.name: fingerprint(log) for log in use.logs}
    )
    notes = [*map(summary_line, inconsistent), *use.notes, *unidentifiable]
    if landings:
        count = sum(landings.count)
        notes.append(f"contact was identified from {count} landings, with their common residual")
    if not use.judged and len(use.fitted) < 2:
        notes.append(
            "only one flight: all errors are on the fitted flight, and it is unknown whether others are "
            "predicted better"
        )
    fields = field_half_widths(vehicle, fitted.vehicle, fitted.vehicles_a_half_width_away())
    fields |= field_half_widths(fitted.vehicle, result, moved)
    return Identification(
        vehicle=result,
        reference=reference.with_new_effects(result),
        parameters=fitted.constants(vehicle),
        identifiable=identifiability(around, reference),
        ahead=fitted.ahead,
        regimes=dict(
            zip(WINDOW_REGIMES, np.concatenate([f.regimes for f in use.fitted]).mean(axis=0).tolist())
        ),
        kept=tuple(n for n in library if n in kept),
        disturbance=disturbance,
        fields=fields,
        flights=tuple(f.name for f in use.fitted),
        notes=tuple(notes),
        inconsistent_flights=inconsistent,
        set_aside=use.set_aside,
    )


@dataclasses.dataclass(frozen=True)
class _Fit:
    """The vehicle fitted to flights, and the errors of it and of the one before."""

    problem: Problem
    joint: FittedValues  # fit of all effects together at which it began
    values: FittedValues
    local: LinearGaussian
    vehicle: Vehicle  # with these, but those of the place
    # These are fields of `Identification`, on the flights judged on (`Refit.judged`).
    ahead: dict[str, float]

    @staticmethod
    def of(use: UsableFlights, vehicle: Vehicle, library: Mapping[str, Effect]) -> _Fit:
        """Return the posterior mode of all effects of a library, with the noise of the flights estimated."""
        problem, joint = estimate_noise(Problem.of(use.fitted, vehicle, library, model_errors=1.0))
        # The vehicle is the best fit without model errors, which a vehicle file cannot represent.
        joint = {n: joint[n] for n in problem.library}
        joint = fit_least_squares(problem, joint, prior=slab_deviations).values
        names, columns = frozenset(problem.library), problem.all_columns()
        spread = Spread.of(problem, problem.linearise(joint, columns))
        values = _idle_references(problem, fit_vehicle(problem, spread, joint, names)[0])
        local = LinearGaussian.of(problem, spread, problem.linearise(values, columns))
        every = (values, *leave_one_out(problem, local, names, values))
        own, *left_out = map(_without_place, every)
        refit, ahead = Refit(problem, own, left_out), {}
        judged, vehicles = refit.judged(use.judged)
        with contextlib.suppress(UserError):  # no stretch of a second
            ahead = _errors_ahead(rollout.RolloutWindows.of(judged), vehicle, vehicles)
        return _Fit(problem, joint, values, local, refit.vehicle, ahead)

    def large_beyond_slopes(self) -> frozenset[str]:
        """Return the effects of more than a plausible size that are not linear in all of their numbers.

        Where the requests of the motors were logged there are none: these show a moment whatever the loops
        do with it.
        """
        effects = () if self.problem.requested else self.problem.library.values()
        bent = [e for e in effects if not all(p.linear for p in e.parameters)]
        at = self.values
        return frozenset(
            e.name
            for e in bent
            if any(abs(p.size(at[e.name][p.name])) > abs(p.size(p.plausible)) for p in e.parameters)
        )

    @cached_property
    def parameter_errors(self) -> dict[tuple[str, str], ParameterErrors]:
        """Return the errors of all parameters, by effect and parameter."""
        return self.local.parameter_errors(self.values)

    def half_width(self, effect: str, parameter: str) -> float:
        """Return the half-width of the 95 % interval of a parameter."""
        return half_width(self.problem, self.parameter_errors[effect, parameter].error)

    def constants(self, before: Vehicle) -> tuple[Identified, ...]:
        """Return the identified constants, without those of the place and references of effects not seen."""
        result = []
        for (effect, parameter), known in self.parameter_errors.items():
            p, value = self.problem.library[effect].parameter(parameter), self.values[effect][parameter]
            if LIBRARY[effect].of_the_place or (p.is_reference and not self._is_seen(effect)):
                continue
            label = effect if effect.endswith(p.name) else f"{effect} {p.name}"
            half = self.half_width(effect, parameter)
            low, high = sorted(p.number(before, float(np.clip(value + x, *p.bounds))) for x in (-half, half))
            note = "at its bound" if thresholds.at_bound(value, p.bounds) else ""
            if LIBRARY[effect].is_lag and not all(f.shows_lags for f in self.problem.flights):
                note = "confounded with other lags at this sampling rate"
            result.append(
                Identified(
                    name=p.reported or label.replace("_", " "),
                    field=p.fields[0].partition(".")[0] if p.reported else "",
                    unit=p.reported_unit,
                    before=p.number(before, p.neutral),
                    value=p.number(before, value),
                    ci95=(low, high),
                    spread=known.between * abs(p.number(before, 2.0) - p.number(before, 1.0)),
                    note=note,
                )
            )
        return tuple(result)

    def _is_seen(self, effect: str) -> bool:
        """Return whether the interval of one of an effect's sizes excludes its neutral value."""
        sizes = [p for p in self.problem.library[effect].parameters if not p.is_reference]
        return any(
            abs(self.values[effect][p.name] - p.neutral) > self.half_width(effect, p.name)
            for p in sizes
            if (effect, p.name) in self.parameter_errors
        )

    def vehicles_a_half_width_away(self) -> Iterator[Vehicle]:
        """Yield the vehicle with each parameter moved by the half-width of its interval."""
        for effect, parameter in self.parameter_errors:
            bounds = self.problem.library[effect].parameter(parameter).bounds
            end = self.values[effect][parameter] + self.half_width(effect, parameter)
            moved = {**self.values[effect], parameter: float(np.clip(end, *bounds))}
            yield self.problem.corrected(_without_place({**self.values, effect: moved}))


def _without_place(values: Values) -> FittedValues:
    """Return the values of the effects that are the vehicle's, not of the place where it flew."""
    return {n: dict(v) for n, v in values.items() if not LIBRARY[n].of_the_place}


def _idle_references(problem: Problem, values: FittedValues) -> FittedValues:
    """Return values in which effects of negligible size have neutral references if the flights allow it.

    A reference at an end of its range would restrict what later flights can show.
    """
    most = (1.0 + IDLE) * problem.squares(values)
    for name, at in values.items():
        of = problem.library[name].parameters
        about = {p.name: p.neutral for p in of if p.is_reference and not p.linear}
        if about and _is_idle(problem, name, values):
            idle = {**values, name: at | about}
            values = idle if problem.squares(idle) <= most else values
    return values


def _is_idle(problem: Problem, name: str, values: Values) -> bool:
    """Return whether all sizes of an effect are negligible, so that its reference is unidentifiable."""
    sizes = zip(problem.library[name].parameters, problem.sizes(name, values))
    return all(abs(size) < p.negligible for p, size in sizes)


def _errors_ahead(
    starts: rollout.RolloutWindows, before: Vehicle, after: Sequence[Vehicle]
) -> dict[str, float]:
    """Return the open-loop position errors [m] one second ahead, as `Identification.ahead`."""
    each = {"before": [before] * len(after), "after": after}
    errors = {n: float(rollout.errors_by_flight(starts, v)[-1]) for n, v in each.items()}
    return errors | {"floor": float(rollout.noise_floor(starts, after[0])[-1])}


def problem_about(problem: Problem, vehicle: Vehicle) -> Problem:
    """Return the problem of all effects that free flights can show, about the identified vehicle."""
    free = {name: effect for name, effect in free_effects().items() if effect.identified}
    library, _ = identifiable_effects(free, problem.flights)
    return dataclasses.replace(
        Problem.of(problem.flights, vehicle, library, model_errors=1.0),
        noise_model=problem.noise_model,
        weight=problem.weight,
        inflation=problem.inflation,
    )


def identified_reference(
    problem: Problem,
    *,
    errors: ReferenceErrors | None,
    landings: LandingReference | None,
    flights: Mapping[str, tuple[int, ...]],
) -> VehiclePosterior:
    """Return the posterior of the vehicle of `problem`, all effects with their slab priors.

    errors, landings, flights: as of `VehiclePosterior`.
    """
    columns, names = problem.all_columns(), frozenset(problem.library)
    linear = problem.linearise({}, columns)
    spread = Spread.of(problem, linear)
    local = LinearGaussian.of(problem, spread, linear)
    known, mean = _errors_of_the_vehicle(problem, spread, local)
    # The vehicle lacks effects that its flights never met, such as the ground high up. They are no error of
    # its identification: theta = 0, and flights that meet them name them.
    prior = local.slab.diagonal() * local.unit**2
    met = (known.diagonal() < thresholds.UNMET**2 * prior) | [isinstance(c, BaseColumn) for c in columns]
    known, mean = np.where(np.outer(met, met), known, 0.0), np.where(met, mean, 0.0)
    repeating = reference_residual(problem, white_residuals(problem, local, names))
    # But a constant that every vehicle has is as uncertain as before flights that do not show it at all.
    unseen = {n for n, e in free_effects().items() if n not in names and e.is_constant}
    return VehiclePosterior(
        columns=tuple(columns),
        mean=mean,
        covariance=known,
        repeating=repeating,
        library=frozenset(free_effects()) - unseen,
        errors=errors,
        landings=landings,
        flights=flights,
    )


def _errors_of_the_vehicle(
    problem: Problem, spread: Spread, local: LinearGaussian
) -> tuple[np.ndarray, np.ndarray]:
    """Return the covariance (P, P) and mean (P,) of the errors of the vehicle of a problem.

    The slopes at the vehicle may lead to where the flights are less probable: there they say nothing of its
    effects, and the mean is that of the model errors without them.
    """
    columns, names, unit = local.columns, frozenset(problem.library), local.unit
    change, covariance = local.posterior(names)
    at = local.at + change
    model = np.array([isinstance(c, BaseColumn) for c in columns])
    # Conditioned on x_E = 0 (Bishop 2.81):  x_B = m_B - C_BE C_EE^-1 m_E
    inner = covariance[np.ix_(~model, ~model)] + 1e-9 * np.eye(np.count_nonzero(~model))
    model_alone = np.where(model, at - covariance[:, ~model] @ np.linalg.solve(inner, at[~model]), 0.0)
    whole, _ = truncated_mode(at, covariance, np.arange(len(at)), local.bounds)

    def less_probable(x: np.ndarray) -> float:
        weights = {c.key[1]: float(w) for c, w in zip(columns, x * unit) if isinstance(c, BaseColumn)}
        values = {**problem.values_at(names, columns, x * unit), BASE: weights}
        return deviance(LinearGaussian.of(problem, spread, problem.linearise(values, columns)), names)

    return covariance * np.outer(unit, unit), min(whole, model_alone, key=less_probable) * unit


def identifiability(around: Problem, reference: VehiclePosterior) -> tuple[Identifiable, ...]:
    """Return the identifiability of each effect, best identified first."""
    wide = slab_deviations(around, reference.columns)
    error = np.sqrt(np.diag(reference.covariance))
    scale = np.where(error > 0.0, error, 1.0)
    correlation = np.abs(reference.covariance / np.outer(scale, scale))
    columns = {n: [k for k, c in enumerate(reference.columns) if c.effect == n] for n in around.library}
    result = []
    for name, own in columns.items():
        share = float(max(np.where(error[own] > 0.0, error[own] / wide[own], 1.0)))
        others = [
            n
            for n, its in columns.items()
            if n != name and correlation[np.ix_(own, its)].max() > thresholds.CORRELATED
        ]
        confounded = tuple(others) if share > thresholds.ROUGH else ()
        result.append(Identifiable(name, share, confounded, LIBRARY[name].regimes))
    return tuple(sorted(result, key=lambda one: one.share))
