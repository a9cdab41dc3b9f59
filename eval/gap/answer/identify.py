"""Grey-box identification of what the model already has, from flights.

All effects that free flight excites are fitted jointly, with those of the place as nuisance parameters. No
model selection: uncertainties and correlations are in the posterior that `gap` takes together with the
vehicle.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence

import numpy as np
from scipy import stats
from threadpoolctl import threadpool_limits

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.answer.named import disturbances
from inclined_landing.eval.gap.flights.sensors import without_failed_sensors
from inclined_landing.eval.gap.flights.windows import MeasuredFlight, prepare_all
from inclined_landing.eval.gap.infer import heterogeneity
from inclined_landing.eval.gap.infer.fit import fit_least_squares
from inclined_landing.eval.gap.infer.gaussian import (
    LinearGaussian,
    ParameterEstimate,
    confounding,
    estimate_between_flight_deviations,
    excitation,
)
from inclined_landing.eval.gap.infer.residual import Residual, reference_residual
from inclined_landing.eval.gap.infer.sets import (
    autocorrelation_inflation,
    fit_jointly,
    leave_one_out,
)
from inclined_landing.eval.gap.infer.vehicle_fit import field_half_widths, fit_vehicle
from inclined_landing.eval.gap.model.columns import BASE, Values, slab_deviations
from inclined_landing.eval.gap.model.prediction import predict
from inclined_landing.eval.gap.model.problem import Problem, identifiable_effects
from inclined_landing.eval.gap.model.reference import VehiclePosterior, free_effects
from inclined_landing.eval.gap.result import VERSION, Disturbance, InconsistentFlights
from inclined_landing.eval.logs import FlightLog
from inclined_landing.eval.logs.log import as_logs
from inclined_landing.models.effects import LIBRARY, FittedConstant
from inclined_landing.models.parameters import as_vehicle, load_vehicle
from inclined_landing.models.vehicle import Vehicle

# What the paper reports of the attitude loops: gain, time constant [s] and fit [%].
PAPER = {name: getattr(load_vehicle(), name) for name in ("attitude_gain", "attitude_time_constant")}
PAPER["fit"] = 85.3
FIT_HORIZON = 1.0  # s, of the velocity changes in the fit of x, y and z


@dataclasses.dataclass(frozen=True)
class Identified:
    """An identified constant, with its cluster-robust (by flight) 95 % interval."""

    name: str  # lag, attitude gain, ...
    field: str  # of Vehicle
    unit: str
    before: float
    value: float
    ci95: tuple[float, float]
    per_flight: tuple[float, ...]
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
    fit: dict[str, dict[str, float]]  # channel -> {"before", "after"}: NRMSE fit [%] on flights left out
    disturbance: dict[str, Disturbance]  # channel -> noise and disturbance
    fields: dict[str, tuple[float, ...] | float]  # changed Vehicle field -> half-width of its interval
    flights: tuple[str, ...]
    notes: tuple[str, ...]
    inconsistent_flights: tuple[InconsistentFlights, ...] = ()

    def to_json(self) -> dict:
        """Return the contents of report.json: plain dicts, lists, strings and numbers."""
        return {
            "version": VERSION,
            "vehicle": {f: getattr(self.vehicle, f) for f in self.fields},
            "parameters": [dataclasses.asdict(p) for p in self.parameters],
            "identifiable": [dataclasses.asdict(one) for one in self.identifiable],
            "fit": self.fit,
            "disturbance": {channel: dataclasses.asdict(d) for channel, d in self.disturbance.items()},
            "fields": self.fields,
            "flights": self.flights,
            "notes": self.notes,
            "inconsistent_flights": [dataclasses.asdict(one) for one in self.inconsistent_flights],
            "paper": PAPER,
        }


@threadpool_limits.wrap(limits=1, user_api="blas")  # flights are shared among threads already
def identify(
    flights: Sequence[FlightLog],
    vehicle: Vehicle,
    *,
    heldout: Sequence[FlightLog] = (),
    platform: bool = False,
) -> Identification:
    """Return the vehicle's constants fitted to flights, with their posterior and identifiability.

    heldout: flights for the fit in percent; without them each flight is evaluated with the others' fit.
    Raises UserError when no flight can be used.
    """
    notes: list[str] = []
    flights, heldout, vehicle = as_logs(flights), as_logs(heldout), as_vehicle(vehicle)
    flights, failed = without_failed_sensors(flights)
    heldout, failed_heldout = without_failed_sensors(heldout)
    fitted = prepare_all(flights, vehicle, platform, notes)
    judged = prepare_all(heldout, vehicle, platform, notes) if heldout else []
    library, unidentifiable = identifiable_effects(
        {n: e for n, e in LIBRARY.items() if not (e.contact or e.told_by)}, fitted
    )
    notes += unidentifiable
    problem = Problem(fitted, vehicle, library)
    problem.wide_model_errors = True
    places = [name for name in problem.library if LIBRARY[name].of_the_place]
    fit, noise_model = fit_jointly(problem, list(problem.library))
    inflation = autocorrelation_inflation(problem, fit.values)
    # The vehicle is the best fit without model errors, which a vehicle file cannot represent.
    values = fit_least_squares(
        problem, {n: fit.values[n] for n in problem.library}, inflation, prior=slab_deviations
    ).values
    columns = problem.columns([*problem.library, BASE])
    near = problem.linearise(values, columns, inflation)
    inconsistent = heterogeneity.inconsistent_flights(problem, near, values)
    notes[:0] = map(heterogeneity.summary_line, inconsistent)
    failed += failed_heldout
    notes[:0] = [f"{one.flights[0]} is left out: {one.sensor}" for one in failed]
    inconsistent = (*failed, *inconsistent)
    problem.confounded = confounding(near)
    problem.between = estimate_between_flight_deviations(problem, near)
    problem.excitation = excitation(problem, near)
    values, _ = fit_vehicle(problem, values, frozenset(problem.library), inflation)
    local = LinearGaussian.of(problem, problem.linearise(values, columns, inflation), values)
    result = problem.corrected({n: v for n, v in values.items() if n not in places})
    reference, identifiable = _vehicle_posterior(problem, result, inflation, noise_model.size)
    for one in identifiable:
        if one.share > thresholds.UNIDENTIFIABLE:
            notes.append(f"{one.effect.replace('_', ' ')} is not excited enough in these flights")
    own = [problem.corrected(v) for v in leave_one_out(problem, local, frozenset(values), values)]
    test = judged or fitted
    vehicles = [result] * len(judged) if judged else own
    if not judged and len(fitted) < 2:
        notes.append("one flight only: the fit in percent is on the flight that was fitted")
    channels = {}
    for channel, (measured, before, after) in _compared_series(test, vehicle, vehicles).items():
        channels[channel] = {"before": nrmse_fit(measured, before), "after": nrmse_fit(measured, after)}
    sized = local.estimates(values)
    return Identification(
        vehicle=result,
        reference=reference,
        parameters=_parameters(problem, values, sized, vehicle),
        identifiable=identifiable,
        fit=channels,
        disturbance=disturbances(problem, noise_model),
        fields=field_half_widths(vehicle, result, _vehicles_a_half_width_away(problem, values, sized)),
        flights=tuple(f.name for f in fitted),
        notes=tuple(notes),
        inconsistent_flights=inconsistent,
    )


def _vehicle_posterior(problem: Problem, vehicle: Vehicle, inflation, size):
    """Return the posterior of the identified vehicle and the identifiability of each effect."""
    library, _ = identifiable_effects(free_effects(), problem.flights)
    around = Problem(problem.flights, vehicle, library)
    around.weight, around.wide_model_errors = problem.weight, True
    reference = identified_reference(around, size, inflation)
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
    return reference, tuple(sorted(result, key=lambda one: one.share))


def nrmse_fit(measured: np.ndarray, predicted: np.ndarray) -> float:
    """Return the NRMSE fit in percent: 100 (1 - |y - p| / |y - mean y|)."""
    spread = np.linalg.norm(measured - measured.mean())
    return float(100.0 * (1.0 - np.linalg.norm(measured - predicted) / spread)) if spread > 0 else math.nan


def _compared_series(flights: list[MeasuredFlight], before: Vehicle, after: Sequence[Vehicle]):
    """Return channel -> (measured, before, after): velocity changes over FIT_HORIZON, open-loop angles."""
    parts: dict[str, list] = {}
    for flight, own in zip(flights, after):
        predictions = [predict(flight, v) for v in (before, own)]
        n = round(FIT_HORIZON / flight.dt)
        usable = np.concatenate([[0], np.cumsum(~flight.usable)])
        first = np.arange(0, flight.samples - n - 1, max(1, n // 2))
        first = first[usable[first + n + 1] == usable[first]]
        for k, axis in enumerate("xyz"):
            rates = [np.gradient(p[:, k], flight.dt) for p in predictions]
            series = [flight.velocity[:, k], *rates]
            parts.setdefault(axis, []).append([s[first + n] - s[first] for s in series])
        rows = flight.usable
        for k, angle in enumerate(("roll", "pitch")) if flight.has_angle_commands else ():
            series = [flight.attitude[:, k], *(p[:, 3 + k] for p in predictions)]
            parts.setdefault(angle, []).append([s[rows] for s in series])
    return {c: tuple(np.concatenate(x) for x in zip(*rows)) for c, rows in parts.items()}


def _half_width(problem: Problem, known: ParameterEstimate) -> float:
    """Return the half-width of a 95 % interval."""
    return float(stats.t.ppf(0.975, max(1, problem.groups - 1))) * known.error


def _parameters(problem: Problem, values: Values, sized, before: Vehicle) -> tuple[Identified, ...]:
    """Return the identified constants, effects of the place left out."""
    result = []
    for (effect, parameter), known in sized.items():
        p, value = problem.library[effect].parameter(parameter), values[effect][parameter]
        if LIBRARY[effect].of_the_place:
            continue
        label = effect if effect.endswith(p.name) else f"{effect} {p.name}"
        c = p.constant or FittedConstant(label.replace("_", " "), field="", unit=p.unit, share=True)
        ends = (float(np.clip(value + s * _half_width(problem, known), *p.bounds)) for s in (-1, 1))
        low, high = sorted(c.number(before, x) for x in ends)
        result.append(
            Identified(
                name=c.name,
                field=c.field,
                unit=c.unit,
                before=c.number(before, p.neutral),
                value=c.number(before, value),
                ci95=(low, high),
                per_flight=tuple(c.number(before, float(x)) for x in value + known.deviation),
                spread=known.between * abs(c.number(before, 2.0) - c.number(before, 1.0)),
                note=_note(problem, effect, min(value - p.bounds[0], p.bounds[1] - value) < 1e-6),
            )
        )
    return tuple(result)


def _note(problem: Problem, effect: str, at_bound: bool) -> str:
    """Return what a constant is to be read with; empty for nothing."""
    if LIBRARY[effect].is_lag and not all(f.shows_lags for f in problem.flights):
        return "confounded with other lags at this sampling rate"
    return "at its bound" if at_bound else ""


def _vehicles_a_half_width_away(problem: Problem, values: Values, sized) -> Iterator[Vehicle]:
    """Yield the vehicle at `values` with each parameter moved by the half-width of its interval."""
    for (effect, parameter), known in sized.items():
        p = problem.library[effect].parameter(parameter)
        end = float(np.clip(values[effect][parameter] + _half_width(problem, known), *p.bounds))
        one = {**values, effect: {**values[effect], parameter: end}}
        yield problem.corrected({n: v for n, v in one.items() if not LIBRARY[n].of_the_place})


def identified_reference(problem: Problem, size: np.ndarray, inflation: np.ndarray) -> VehiclePosterior:
    """Return the posterior of the vehicle of `problem`, all effects with their slab priors.

    size (6,) of the disturbance, inflation (6,): of the fit that made the vehicle.
    """
    columns = problem.columns([*problem.library, BASE])
    near = problem.linearise({}, columns, inflation)
    problem.confounded = confounding(near)
    problem.between = estimate_between_flight_deviations(problem, near)
    problem.excitation = excitation(problem, near)
    local = LinearGaussian.of(problem, near, {})
    change, covariance = local.posterior(frozenset(problem.library))
    residual = Residual.by(problem, local, frozenset(problem.library), {}, size, inflation)
    known = covariance * np.outer(local.unit, local.unit)
    mean = (local.at + change) * local.unit
    # What its flights never met, as the ground high up, is missing from the vehicle and no error of its
    # identification: theta = 0, and flights that meet it name it.
    prior = local.slab.diagonal() * local.unit**2
    met = (known.diagonal() < thresholds.UNMET**2 * prior) | [c.effect == BASE for c in columns]
    known, mean = np.where(np.outer(met, met), known, 0.0), np.where(met, mean, 0.0)
    repeating = reference_residual(problem, residual)
    return VehiclePosterior(tuple(columns), mean, known, repeating, frozenset(free_effects()))
