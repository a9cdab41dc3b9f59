"""Grey-box identification of what the model already has, from flights.

Two forms of the thrust are fitted, the transfer function of the paper times a gain and the static map of a
single motor (behind the same lag) times a gain; flights left out decide. With them: lag and delay of the
thrust, gain, time constant, rate lag, delay and trim of the attitude loops, rotor drag, and the tilt of the
measured attitude.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from inclined_landing.eval.gap.flights.windows import Measured, prepare_all
from inclined_landing.eval.gap.search.evidence import Problem, tellable
from inclined_landing.eval.gap.search.fit import Fitted, estimates, left_out_vehicles, refit, spread_between
from inclined_landing.eval.gap.search.prediction import predict
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import Vehicle, load_vehicle

# Effects that rescale what the model has.
EFFECTS = tuple(name for name, e in LIBRARY.items() if any(p.constant for p in e.parameters))
# What the paper reports of the attitude loops: gain, time constant [s] and fit [%].
PAPER = {name: getattr(load_vehicle(), name) for name in ("attitude_gain", "attitude_time_constant")}
PAPER["fit"] = 85.3
FIT_HORIZON = 1.0  # s, of the velocity changes that the fit of x, y and z is about
# A parameter is not identified when its 95 % interval is wider than this share of its range.
TOO_WIDE = 0.5


@dataclasses.dataclass(frozen=True)
class Identified:
    """A number of the vehicle: as it was, as identified, with its 95 % interval clustered by flight."""

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
class Identification:
    """The answer of `identify`."""

    vehicle: Vehicle
    thrust: str  # "transfer function" or "static map"
    parameters: tuple[Identified, ...]
    fit: dict[str, dict[str, float]]  # channel -> {"before", "after"}: NRMSE fit [%] on flights left out
    alternatives: dict[str, float]  # form of the thrust -> white squared error on flights left out
    fields: dict[str, tuple[float, ...] | float]  # changed Vehicle field -> half-width of its interval
    flights: tuple[str, ...]
    notes: tuple[str, ...]

    def to_json(self) -> dict:
        """Plain dicts, lists, strings and numbers."""
        result = dataclasses.asdict(self)
        result["vehicle"] = {f: getattr(self.vehicle, f) for f in self.fields}
        result["paper"] = PAPER
        return result


def static_map(vehicle: Vehicle) -> Vehicle:
    """The same vehicle with the static map of its motors behind the lag in place of the transfer function.

    The map is quadratic with two negative zeros, so that it is a line through the lagged PWM (with its
    offset as the thrust bias) times a sag, here negative, with the load.
    """
    a, b, c = (vehicle.motor_count * x for x in vehicle.motor_pwm_to_force)
    root = math.sqrt(b * b - 4.0 * a * c)
    near, far = (b - root) / (2.0 * a), (b + root) / (2.0 * a)  # minus the zeros
    reference = vehicle.effects_battery_reference
    sag = -reference / (far + reference)
    slope = a * far / (1.0 + sag)  # of the line: a (P + near)(P + far)
    return dataclasses.replace(
        vehicle,
        thrust_state_gain=slope * vehicle.thrust_lag_rate,
        thrust_direct_gain=0.0,
        effects_thrust_bias=slope * near,
        effects_battery_sag=sag,
        effects_battery_reference=reference,
    )


def identify(
    flights: Sequence[FlightLog],
    vehicle: Vehicle,
    *,
    heldout: Sequence[FlightLog] = (),
    platform: bool = False,
) -> Identification:
    """Fit the vehicle's own constants to flights.

    heldout: flights for the fit in percent; without them each flight is judged with the others' fit.
    Raises UserError when no flight can be used.
    """
    notes: list[str] = []
    fitted = prepare_all(flights, vehicle, platform, notes)
    judged = prepare_all(heldout, vehicle, platform, notes) if heldout else []
    forms = {"transfer function": vehicle, "static map": static_map(vehicle)}
    if vehicle.effects_battery_sag or vehicle.effects_thrust_bias:
        del forms["static map"]
    library, untold = tellable({name: LIBRARY[name] for name in EFFECTS}, fitted)
    notes += untold
    problems = {name: Problem(fitted, base, library) for name, base in forms.items()}
    fits = {name: _best(problem, list(problem.library)) for name, problem in problems.items()}
    scores = {name: float(fit.weighted.left_out(fit.index).sum()) for name, fit in fits.items()}
    chosen = min(scores, key=scores.get)
    problem = problems[chosen]
    fit = _without_unseen(problem, fits[chosen], notes)
    result = problem.corrected(fit.values)
    own = left_out_vehicles(problem, fit)
    test = judged or fitted
    vehicles = [result] * len(judged) if judged else own
    if not judged and len(fitted) < 2:
        notes.append("one flight only: the fit in percent is on the flight that was fitted")
    channels = {}
    for channel, (measured, before, after) in _compared(test, vehicle, vehicles).items():
        channels[channel] = {"before": nrmse_fit(measured, before), "after": nrmse_fit(measured, after)}
    parameters = _parameters(problem, fit, vehicle)
    return Identification(
        vehicle=result,
        thrust=chosen,
        parameters=parameters,
        fit=channels,
        alternatives=scores,
        fields=_fields(vehicle, result, parameters),
        flights=tuple(f.name for f in fitted),
        notes=tuple(notes),
    )


def _best(problem: Problem, names: Sequence[str]) -> Fitted:
    """The best fit from neutral and from the starts of pairs, from one to the other of which it is uphill."""
    values = {name: {} for name in names}
    fits = [refit(problem, values, np.ones(6), iterations=15)]
    for pair in problem.pairs():
        start = {n: {problem.library[n].parameters[0].name: x} for n, x in pair.items() if n in values}
        fits.append(refit(problem, values | start, np.ones(6), iterations=15))
    return min(fits, key=lambda fit: fit.squares)


def _without_unseen(problem: Problem, fit: Fitted, notes: list[str]) -> Fitted:
    """Leave out, one by one, effects that the flights do not excite enough to be told."""
    while fit.values:
        covariance = fit.weighted.covariance(fit.index)
        width = {}
        for k, column in enumerate(fit.weighted.columns):
            low, high = problem.parameter(column).bounds
            share = 4.0 * math.sqrt(covariance[k, k]) / (high - low)
            width[column.effect] = max(share, width.get(column.effect, 0.0))
        worst = max(width, key=width.get)
        if width[worst] < TOO_WIDE:
            break
        notes.append(f"{worst.replace('_', ' ')} is not excited enough in these flights; it stays as it was")
        fit = _best(problem, [name for name in fit.values if name != worst])
    return fit


def nrmse_fit(measured: np.ndarray, predicted: np.ndarray) -> float:
    """100 (1 - |y - p| / |y - mean y|) percent."""
    spread = np.linalg.norm(measured - measured.mean())
    return float(100.0 * (1.0 - np.linalg.norm(measured - predicted) / spread)) if spread > 0 else math.nan


def _compared(flights: list[Measured], before: Vehicle, after: Sequence[Vehicle]):
    """Channel -> (measured, before, after): velocity changes over FIT_HORIZON, and angles open loop."""
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
        for k, angle in enumerate(("roll", "pitch")):
            series = [flight.attitude[:, k], *(p[:, 3 + k] for p in predictions)]
            parts.setdefault(angle, []).append([s[rows] for s in series])
    return {c: tuple(np.concatenate(x) for x in zip(*rows)) for c, rows in parts.items()}


def _parameters(problem: Problem, fit: Fitted, before: Vehicle) -> tuple[Identified, ...]:
    result = []
    for _, p, value, half, change, error in estimates(problem, fit):
        c = p.constant
        ends = sorted(c.number(before, float(np.clip(value + s * half, *p.bounds))) for s in (-1, 1))
        per_unit = abs(c.number(before, 2.0) - c.number(before, 1.0))
        result.append(
            Identified(
                name=c.name,
                field=c.field,
                unit=c.unit,
                before=c.number(before, p.neutral),
                value=c.number(before, value),
                ci95=(ends[0], ends[1]),
                per_flight=tuple(c.number(before, float(x)) for x in value + change),
                spread=spread_between(change, error) * per_unit,
                note="at its bound" if min(value - p.bounds[0], p.bounds[1] - value) < 1e-6 else "",
            )
        )
    return tuple(result)


def _fields(before: Vehicle, after: Vehicle, parameters: tuple[Identified, ...]):
    """Changed fields of the vehicle with the half-width of their intervals, in the field's own unit."""
    half = {p.name: 0.5 * (p.ci95[1] - p.ci95[0]) for p in parameters}
    share = {p.name: half[p.name] / max(abs(p.value), 1e-12) for p in parameters}
    offsets: dict[str, list[float]] = {}
    factors: dict[tuple[str, int], float] = {}
    for c in (p.constant for e in LIBRARY.values() for p in e.parameters if p.constant):
        if c.name in half and c.offset:
            offsets.setdefault(c.field, []).append(half[c.name])
        elif c.name in half:
            for field in (c.field, *c.also):
                parts = c.parts or range(np.size(getattr(after, field)))
                factors |= {(field, k): share[c.name] for k in parts}
    fields = {}
    for name in (f.name for f in dataclasses.fields(after)):
        value = getattr(after, name)
        if value == getattr(before, name):
            continue
        if isinstance(value, tuple):
            scaled = (abs(x) * factors.get((name, k), 0.0) for k, x in enumerate(value))
            fields[name] = tuple(offsets.get(name) or scaled)
        else:
            fields[name] = offsets[name][0] if name in offsets else abs(value) * factors.get((name, 0), 0.0)
    return fields
