"""The regression of measured flights on candidate effects, and its linearisation.

With white errors e and the Jacobian J of the prediction, e(x + d) = e - J d; everything after a linearisation
works on the Gram matrices of every flight (normal equations):  a = J'J,  b = J'e,  c = e'e.

Each channel is whitened alone. Jacobians, (k, m, C) in all signatures, therefore lie in memory one channel
after another, (k, C, m): `transpose(0, 2, 1)` leads from either to the other without a copy.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

import numpy as np

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.measured.noise import ChannelNoise, ErrorResponses, NoiseModel
from inclined_landing.eval.gap.measured.windows import MeasuredFlight
from inclined_landing.eval.gap.model.columns import (
    ALONE,
    BASE,
    BASE_DEVIATIONS,
    BaseColumn,
    Candidates,
    Column,
    FormColumn,
    ParameterColumn,
    Values,
    Variation,
    fitting,
    without,
)
from inclined_landing.eval.gap.model.prediction import (
    CHANNEL_GROUPS,
    POSE_CHANNELS,
    predict,
    predictor,
    thrust_elasticity,
)
from inclined_landing.eval.gap.model.reference import VehiclePosterior
from inclined_landing.eval.gap.model.swing import stretches
from inclined_landing.models.effects import Effect
from inclined_landing.models.threads import two_at_a_time
from inclined_landing.models.vehicle import Vehicle

KEPT = 12  # linearisations: some megabytes each where flights are many
LEAST_GROUPS = 8  # of windows: fewer flights are split into this many in all
_RIDGE = 1e-9  # on the unit diagonal of a scaled Gram matrix


@dataclasses.dataclass(frozen=True)
class Problem(Candidates):
    """Flights cut into windows, candidate effects and a noise model: a nonlinear regression problem.

    Windows: w in all, of C channels; they fall into g groups, flights or parts of them.
    """

    flights: tuple[MeasuredFlight, ...]  # whitened by the noise model
    reference: VehiclePosterior | None  # from flights or the vehicle's file; None: its constants are exact
    model_errors: float  # standard deviation of model errors without a reference, over the full one
    noise_model: NoiseModel
    weight: np.ndarray  # (w, C) inverse variance by model errors; 0 in channels that were not logged
    inflation: np.ndarray  # (C,) variance inflation, by dispersion and the autocorrelation of windows
    form_jacobians: tuple[np.ndarray, ...]  # (F, m, C) of every flight, in the base model's errors

    @staticmethod
    def of(
        flights: Sequence[MeasuredFlight],
        vehicle: Vehicle,
        library: Mapping[str, Effect],
        reference: VehiclePosterior | None = None,
        model_errors: float = ALONE,
    ) -> Problem:
        """Return the problem before its noise is estimated: measurement noise alone, windows of equal weight.

        Effects of which these flights have no channel are left out of the library.
        """
        channels = flights[0].channels  # C: 6 of the pose, and 3 of motor requests where logged
        logged = np.array([f.logged for f in flights])
        ignored = {"touchdown"} | {name for name, of in CHANNEL_GROUPS.items() if not logged[:, of].any()}
        kept = {  # an effect requires fields of a flight, which are None where the log has no such channel
            name: effect.sized_for(vehicle)
            for name, effect in library.items()
            if set(effect.channels) - ignored
            and all(getattr(f, field) is not None for f in flights for field in effect.requires)
        }
        if channels > len(POSE_CHANNELS):
            kept = {name: effect.seen_in_requests() for name, effect in kept.items()}
            if reference is not None:
                # Hover shows only the sum of errors of bias, scale and sag. Each alone would change the slope
                # of the requests, and so the size of moments: all flights have the reference's slope.
                slope = thrust_elasticity(vehicle)
                flights = [f.with_request_slope(slope) for f in flights]
        windows = np.concatenate([np.tile(f.logged, (len(f.starts), 1)) for f in flights])
        return Problem(
            vehicle=vehicle,
            library=kept,
            flights=tuple(flights),
            reference=reference,
            model_errors=model_errors,
            noise_model=(ChannelNoise(),) * channels,
            weight=windows.astype(float),
            inflation=np.ones(channels),
            form_jacobians=_form_jacobians(flights, vehicle),
        )

    def whitened(self, noise_model: NoiseModel, vehicle: Vehicle) -> Problem:
        """Return the problem with flights whitened by a noise model and the attitude loops of `vehicle`.

        Where no flights of a reference have shown model errors, these are taken along its motion.
        """
        flights = []
        for f in self.flights:
            responses = ErrorResponses.of(f.rows, f.dt, vehicle, f.requests is not None)
            flights.append(f.whitened(responses, noise_model))
        jacobians = self.form_jacobians if self.identified else _form_jacobians(flights, vehicle)
        return dataclasses.replace(
            self, flights=tuple(flights), noise_model=noise_model, form_jacobians=jacobians
        )

    @property
    def channels(self) -> int:
        """Return the number of channels C."""
        return self.flights[0].channels

    @property
    def requested(self) -> bool:
        """Return whether the motors' requests were logged."""
        return self.channels > len(POSE_CHANNELS)

    @property
    def identified(self) -> bool:
        """Return whether the vehicle's model errors were identified from flights."""
        return self.reference is not None and self.reference.from_flights

    @cached_property
    def flight_of(self) -> np.ndarray:
        """Return the flight (w,) of every window."""
        return np.concatenate([np.full(len(f.starts), k) for k, f in enumerate(self.flights)])

    @cached_property
    def group_of(self) -> np.ndarray:
        """Return the group (w,) of every window: its flight, or part of it where there are few."""
        most = 1 if len(self.flights) >= LEAST_GROUPS else -(-LEAST_GROUPS // len(self.flights))
        groups, offset = [], 0
        for flight in self.flights:
            n = len(flight.starts)
            parts = min(most, n)
            groups.append(offset + np.arange(n) * parts // n)
            offset += parts
        return np.concatenate(groups)

    @cached_property
    def groups(self) -> int:
        """Return the number g of groups."""
        return int(self.group_of.max()) + 1

    @cached_property
    def logged(self) -> np.ndarray:
        """Return 1 for the channels of windows (w, C) that were logged, else 0."""
        return np.array([f.logged for f in self.flights])[self.flight_of].astype(float)

    @cached_property
    def swing_starts(self) -> int:
        """Return the number of stretches in which a slung load's start is fitted."""
        return sum(len(stretches(f.starts, f.rows, f.dt)) - 1 for f in self.flights)

    @property
    def white_count(self) -> np.ndarray:
        """Return how many white errors (w,) every window has in a channel."""
        return np.array([f.rows - 2 for f in self.flights])[self.flight_of]

    def split(self, values: np.ndarray) -> list[np.ndarray]:
        """Return values (w, ...) of the windows, those of each flight apart."""
        return np.split(values, np.cumsum([len(f.starts) for f in self.flights])[:-1])

    def weights_without_each_flight(self) -> list[np.ndarray]:
        """Return for every flight the weights (g,) of the groups without it; of a single one, all 1.

        If there are few flights, only every second part of it is left out, because the others may not excite
        what it shows.
        """
        few = len(self.flights) < thresholds.FEW_FLIGHTS
        result = [np.ones(self.groups) for _ in self.flights]
        if len(self.flights) == 1:
            return result
        for k, weights in enumerate(result):
            parts = np.unique(self.group_of[self.flight_of == k])
            left_out = parts[1::2] if few else parts
            weights[left_out] = 0.0
        return result

    def vehicle_prior(self, columns: Sequence[Column]) -> tuple[np.ndarray, np.ndarray]:
        """Return the prior of the vehicle's errors theta along `columns`: mean (P,), covariance (P, P).

        Without a reference only the base model has (form) errors, of `model_errors` times their full size.
        """
        if self.reference is not None:
            return self.reference.along(columns)
        sd = [
            self.model_errors * BASE_DEVIATIONS[c.form] if isinstance(c, BaseColumn) else 0.0 for c in columns
        ]
        return np.zeros(len(columns)), np.diag(np.square(sd))

    def variation(self, column: Column) -> Variation:
        """Return by how much what fits a column best varies; in the motors' requests with placements too."""
        known = super().variation(column)
        if self.requested:
            return Variation(max(known.manoeuvre, known.placement), known.placement, known.step)
        return Variation(known.manoeuvre, 0.0, known.step)

    def white_errors_at(self, values: Values) -> list[np.ndarray]:
        """Return the white errors (w, C, q) of every flight with effects at `values`."""
        predicted = self._prediction(values)
        return two_at_a_time(lambda f, j: _whitened(f, predicted(f, j)), self.flights, self.form_jacobians)

    def predicted(self, values: Values) -> list[np.ndarray]:
        """Return the prediction (m, C) of every flight with effects and model errors at `values`."""
        return two_at_a_time(self._prediction(values), self.flights, self.form_jacobians)

    def _prediction(self, values: Values) -> Callable[[MeasuredFlight, np.ndarray], np.ndarray]:
        """Return the prediction (m, C) as a function of a flight and its Jacobian in model errors."""
        predicted = predictor(self.flights[0], [self.corrected(values)])
        return lambda flight, jacobian: _with_model_errors(predicted(flight)[0], jacobian, values)

    def squares(self, values: Values) -> float:
        """Return the weighted sum of squared white errors with effects at `values` (least squares)."""
        return float(self.squares_by_channel(values).sum())

    def squares_by_channel(self, values: Values) -> np.ndarray:
        """Return the weighted sum of squared white errors (C,) of every channel with effects at `values`."""
        squares = [np.einsum("wcq,wcq->wc", x, x) for x in self.white_errors_at(values)]
        return (self.weight / self.inflation * np.concatenate(squares)).sum(axis=0)

    def form_columns(self, values: Values) -> list[Column]:
        """Return the model error columns of the effects that are not neutral in `values`."""
        return [
            FormColumn(name, f)
            for name in values
            if np.any(self.sizes(name, values))
            for f in fitting(name).forms
        ]

    def jacobian(
        self, values: Values, columns: Sequence[Column]
    ) -> Callable[[MeasuredFlight, np.ndarray], np.ndarray]:
        """Return a function of a flight and its Jacobian in the base model's errors.

        It returns (1 + P, m, C): the flight's prediction at `values`, then its Jacobian's columns.
        """
        order = list(BASE_DEVIATIONS)
        differences = {
            c: self.one_sided_difference(values, c) for c in columns if isinstance(c, ParameterColumn)
        }
        others = {c.effect: without(values, c.effect) for c in columns if isinstance(c, FormColumn)}
        vehicles = [self.corrected(v) for v in (values, *others.values())]
        vehicles += [one.vehicle for one in differences.values()]
        predicted = predictor(self.flights[0], vehicles)

        def of(flight: MeasuredFlight, form_jacobian: np.ndarray) -> np.ndarray:
            of_vehicles = iter(predicted(flight))  # in the order of `vehicles`
            here = next(of_vehicles)
            rest = {effect: next(of_vehicles) for effect in others}
            moved = {column: next(of_vehicles) for column in differences}
            result = np.empty((1 + len(columns), *here.T.shape)).transpose(0, 2, 1)
            result[0] = _with_model_errors(here, form_jacobian, values)
            for column, out in zip(columns, result[1:]):
                if isinstance(column, BaseColumn):
                    out[:] = form_jacobian[order.index(column.form)]
                elif isinstance(column, FormColumn):
                    out[:] = column.along(here - rest[column.effect], flight)
                else:  # finite difference: dp/dx = (p(x + h) - p(x)) / h
                    np.subtract(moved[column], here, out=out)
                    out /= differences[column].step
            return result

        return of

    def linearise(self, values: Values, columns: Sequence[Column]) -> Linearisation:
        """Return the Gram matrices of white errors and Jacobian at `values`; the last KEPT are kept."""
        at = tuple((name, tuple(sorted(values[name].items()))) for name in sorted(values))
        known = self._linearised.get(at)
        if known is None or not set(columns) <= set(known.columns):
            if len(self._linearised) == KEPT:
                del self._linearised[next(iter(self._linearised))]
            known = self._linearised[at] = self._linearise(values, list(dict.fromkeys(columns)))
        return known.along(columns)

    @cached_property
    def _linearised(self) -> dict[tuple, Linearisation]:
        return {}

    def _linearise(self, values: Values, columns: Sequence[Column]) -> Linearisation:
        # The Gram matrices [e, J]' [e, J] of the groups have c in their corner, b beside it, and a below.
        grams = np.zeros((self.groups, 1 + len(columns), 1 + len(columns)))
        jacobian_of = self.jacobian(values, columns)

        def add(k: int) -> None:
            stack = jacobian_of(self.flights[k], self.form_jacobians[k])
            stack[0] = self.flights[k].measured - stack[0]  # [e, J]
            self._add_to_grams(k, stack, grams)

        two_at_a_time(add, range(len(self.flights)))  # no two flights are in one group
        flight_of_group = np.array([self.flight_of[self.group_of == g][0] for g in range(self.groups)])
        return Linearisation(
            values,
            tuple(columns),
            a=grams[:, 1:, 1:],
            b=grams[:, 1:, 0],
            c=grams[:, 0, 0],
            flight_of_group=flight_of_group,
        )

    def _add_to_grams(self, k: int, stack: np.ndarray, grams: np.ndarray) -> None:
        """Add the windows of flight k to the Gram matrices (g, 1 + P, 1 + P) of their groups.

        stack (1 + P, m, C): its errors and Jacobian, of which each channel is whitened and weighted.
        """
        flight, own = self.flights[k], self.flight_of == k
        share = np.sqrt(self.weight[own] / self.inflation)  # (w, C) weighted least squares
        of_windows, groups = flight.starts[:, None] + np.arange(flight.rows), self.group_of[own]
        ends = [0, *(np.flatnonzero(np.diff(groups)) + 1), len(groups)]  # of the groups' windows
        for channel, matrix in enumerate(flight.whitening.matrices):
            series = stack[:, :, channel]
            live = _live(series, of_the_pose=channel < len(POSE_CHANNELS))
            windows = np.take(series[live], of_windows, axis=1)  # (live, w, rows)
            white = (windows.reshape(-1, flight.rows) @ matrix.T).reshape(*windows.shape[:2], -1)
            white *= share[:, channel, None]
            for first, last in itertools.pairwise(ends):
                part = white[:, first:last].reshape(len(live), -1)
                grams[np.ix_([groups[first]], live, live)] += part @ part.T


def _live(series: np.ndarray, of_the_pose: bool) -> np.ndarray:
    """Return the indices of the series (n, m) in one channel that add to its Gram matrix.

    A series that is constant in time adds nothing to that of a pose, whose start state is projected out; in
    the requests it is a moment, and only zeros add nothing.
    """
    nothing = series[:, 0] if of_the_pose else np.zeros(len(series))
    live = series[:, -1] != nothing  # the last row decides for most
    live[~live] = (series[~live] != nothing[~live, None]).any(axis=1)
    return np.flatnonzero(live)


def _whitened(flight: MeasuredFlight, predicted: np.ndarray) -> np.ndarray:
    """Return the white errors (w, C, q) of a prediction (m, C)."""
    return flight.whitening(flight.cut(flight.measured - predicted))


def _form_jacobians(flights: Sequence[MeasuredFlight], vehicle: Vehicle) -> tuple[np.ndarray, ...]:
    """Return the Jacobians (F, m, C) in the base model's errors along the prediction of `vehicle`."""

    def of(flight: MeasuredFlight) -> np.ndarray:
        gravity, predicted = vehicle.environment_gravity, predict(flight, vehicle)
        columns = [BaseColumn(f).along(predicted, gravity, flight).T for f in BASE_DEVIATIONS]
        return np.stack(columns).transpose(0, 2, 1)

    return tuple(two_at_a_time(of, flights))


def _with_model_errors(predicted: np.ndarray, form_jacobian: np.ndarray, values: Values) -> np.ndarray:
    """Return a prediction (m, C) with the base model's errors at their weights in `values`."""
    weights = values.get(BASE, {})
    if not any(weights.values()):
        return predicted
    jacobian = form_jacobian.transpose(0, 2, 1)
    return predicted + np.tensordot([weights[f] for f in BASE_DEVIATIONS], jacobian, axes=1).T


def identifiable_effects(
    library: Mapping[str, Effect], flights: Sequence[MeasuredFlight]
) -> tuple[dict[str, Effect], list[str]]:
    """Return the effects whose required log channels were logged and excited, and notes on the others."""
    kept, notes = {}, []
    speeds_measured = any(f.thrust_is_measured for f in flights)
    requested = all(f.requests is not None for f in flights)
    for name, effect in library.items():
        shows_in_requests = "requests" in effect.channels
        if effect.of_the_drive and speeds_measured:  # the speeds of the rotors contain it
            continue
        if not effect.identified and not shows_in_requests:  # flights show it as lags and gains of the loops
            continue
        # As in most logs: one note for all, below
        if shows_in_requests and effect.requires and not requested:
            continue
        reasons = [_why_unidentifiable(channel, least, flights) for channel, least in effect.requires.items()]
        if any(reasons):
            others = ", ".join(effect.confused_with)
            notes += [f"{why}: {name} is confounded with {others}" for why in sorted({*reasons} - {""})]
        else:
            kept[name] = effect
    if not requested:
        notes.append("the four motor commands are not logged, so individual rotors cannot be diagnosed")
    return kept, notes


def _why_unidentifiable(channel: str, least: float, flights: Sequence[MeasuredFlight]) -> str:
    """Return why a log channel excites nothing, a clause; empty if it does."""
    logged = [getattr(f, channel) for f in flights]
    if any(x is None for x in logged):
        return f"{channel} is not logged in every flight"
    used = [x[f.usable] for x, f in zip(logged, flights)]
    constant = max(map(np.ptp, used)) < least and np.ptp([x.mean() for x in used]) < least
    return f"the logged {channel} is constant" if constant else ""


@dataclasses.dataclass(frozen=True)
class Linearisation:
    """Linearised least squares: Gram matrices of every group of windows (normal equations)."""

    values: Values  # at which it is linearised
    columns: tuple[Column, ...]
    a: np.ndarray  # (g, P, P)
    b: np.ndarray  # (g, P)
    c: np.ndarray  # (g,) squared errors
    flight_of_group: np.ndarray  # (g,)

    def along(self, columns: Sequence[Column]) -> Linearisation:
        """Return the linearisation along some of its columns."""
        place = {column: k for k, column in enumerate(self.columns)}
        k = [place[column] for column in columns]
        a = self.a[np.ix_(range(len(self.a)), k, k)]
        return dataclasses.replace(self, columns=tuple(columns), a=a, b=self.b[:, k])

    def by_flight(self) -> tuple[np.ndarray, np.ndarray]:
        """Return a (f, P, P) and b (f, P) summed over the groups of every flight."""
        flights = int(self.flight_of_group.max()) + 1
        a, b = np.zeros((flights, *self.a.shape[1:])), np.zeros((flights, self.b.shape[1]))
        np.add.at(a, self.flight_of_group, self.a)
        np.add.at(b, self.flight_of_group, self.b)
        return a, b

    def predicted_squares(self, change: np.ndarray) -> float:
        """Return the squared error that the linear model predicts after a change (P,)."""
        # |e - J d|^2 = c - 2 b'd + d'a d
        return float(self.c.sum() - 2.0 * self.b.sum(axis=0) @ change + change @ self.a.sum(axis=0) @ change)


def solve(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Solve a x = b for a positive semidefinite matrix; columns of zeros get zero."""
    scale, x = np.sqrt(np.diag(a)), np.zeros_like(b)
    live = scale > 0.0
    s = scale[live]
    scaled = a[np.ix_(live, live)] / np.outer(s, s) + _RIDGE * np.eye(int(live.sum()))
    x[live] = np.linalg.solve(scaled, b[live] / s) / s
    return x
