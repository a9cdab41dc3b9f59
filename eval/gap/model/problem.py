"""Whitened prediction errors of a vehicle over short windows, and their linearisation in all effects.

With white errors e and the Jacobian J of the prediction, e(x + d) = e - J d; everything after a linearisation
works on the Gram matrices of every flight (normal equations):  a = J'J,  b = J'e,  c = e'e.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from inclined_landing.eval.gap.flights.noise_model import NoiseModel
from inclined_landing.eval.gap.flights.whitening import ErrorResponses
from inclined_landing.eval.gap.flights.windows import MeasuredFlight
from inclined_landing.eval.gap.model import form
from inclined_landing.eval.gap.model.columns import BASE, Candidates, Column, Values
from inclined_landing.eval.gap.model.prediction import CHANNELS, predict, translated
from inclined_landing.eval.gap.model.reference import VehiclePosterior
from inclined_landing.models.effects import Effect
from inclined_landing.models.vehicle import Vehicle

LEAST_GROUPS = 8  # of windows: fewer flights are split into this many in all
_RIDGE = 1e-9  # on the unit diagonal of a scaled Gram matrix


# Channels of effects -> channels of a flight.
CHANNEL_GROUPS = {
    "translation": slice(0, 3),
    "attitude": slice(3, 5),
    "yaw": slice(5, 6),
    "requests": slice(6, 9),
}


class Problem(Candidates):
    """Flights cut into windows, candidate effects and a noise model: a nonlinear regression problem."""

    def __init__(
        self,
        flights: Sequence[MeasuredFlight],
        vehicle: Vehicle,
        library: Mapping[str, Effect],
        reference: VehiclePosterior | None = None,
    ):
        self.flights = list(flights)
        self.vehicle = vehicle
        self.reference = reference  # posterior of the vehicle's identification; None: its constants are exact
        self.wide_model_errors = False  # whether model errors have their full prior width without a reference
        self.channels = self.flights[0].channels  # C: 6 of the pose, and 3 of motor requests where logged
        logged = np.array([f.logged for f in self.flights])
        ignored = {"touchdown"} | {name for name, of in CHANNEL_GROUPS.items() if not logged[:, of].any()}
        self.library = {
            name: effect.sized_for(vehicle)
            for name, effect in library.items()
            if set(effect.channels) - ignored
            and all(getattr(f, channel) is not None for f in flights for channel in effect.requires)
        }
        self.requested = self.channels > len(CHANNELS)  # were the motors' requests logged
        if self.requested:
            self.library = {name: effect.seen_in_requests() for name, effect in self.library.items()}
        self.flight_of = np.concatenate([np.full(len(f.starts), k) for k, f in enumerate(self.flights)])
        self.group_of = _groups(self.flights)
        self.groups = int(self.group_of.max()) + 1
        self.rows = np.array([f.rows - 2 for f in self.flights])[self.flight_of]  # white numbers of a channel
        # Weights (w, C), zero for channels that were not logged.
        self.logged = logged[self.flight_of].astype(float)
        self.weight = self.logged.copy()
        # By (effect, parameter): between-flight standard deviation, number of collinear columns, number of
        # flights that excite it.
        self.between: dict[tuple[str, str], float] = {}
        self.confounded: dict[tuple[str, str], float] = {}
        self.excitation: dict[tuple[str, str], float] = {}
        # Whether the vehicle's model errors were identified from flights.
        self.identified = reference is not None and reference.from_flights
        self._form_jacobians: list[np.ndarray] | None = None
        self._pool = ThreadPoolExecutor(2)

    def weights_without_each_flight(self) -> list[np.ndarray]:
        """Return for every flight the weights (g,) of the groups without it; of a single one, all 1."""
        result = [np.ones(self.groups) for _ in self.flights]
        for k, weights in enumerate(result if len(result) > 1 else ()):
            weights[np.unique(self.group_of[self.flight_of == k])] = 0.0
        return result

    def rewhiten(self, noise_model: NoiseModel, vehicle: Vehicle) -> None:
        """Whiten with the estimated noise and disturbance; the attitude loops are those of `vehicle`."""
        for flight in self.flights:
            requests = flight.requests is not None
            flight.rewhiten(ErrorResponses.of(flight.rows, flight.dt, vehicle, requests), noise_model)

    def vehicle_prior(self, columns: Sequence[Column]) -> tuple[np.ndarray, np.ndarray]:
        """Return the prior of the vehicle's errors theta along `columns`: mean (P,), covariance (P, P).

        Without a reference only the base model has (form) errors, small ones unless `wide_model_errors`.
        """
        if self.reference is not None:
            return self.reference.along(columns)
        share = 1.0 if self.wide_model_errors else form.ALONE
        sd = [share * form.BASE[c.form] if c.effect == BASE else 0.0 for c in columns]
        return np.zeros(len(columns)), np.diag(np.square(sd))

    def white_errors(self, vehicles: Sequence[Vehicle]) -> list[np.ndarray]:
        """Return the white errors (w, C, q) of every flight, each with its vehicle."""
        return list(self._pool.map(self.white_errors_of, range(len(self.flights)), vehicles))

    def white_errors_at(self, values: Values) -> list[np.ndarray]:
        """Return the white errors (w, C, q) of every flight with effects at `values`."""
        if any(values.get(BASE, {}).values()):
            self.form_jacobian(self.flights[0])

        def of(flight: MeasuredFlight) -> np.ndarray:
            return flight.whitening(flight.cut(flight.measured - self.predicted(flight, values)))

        return list(self._pool.map(of, self.flights))

    def predicted(self, flight: MeasuredFlight, values: Values) -> np.ndarray:
        """Return the prediction (m, C) of a flight with effects and model errors at `values`."""
        return self._with_model_errors(flight, predict(flight, self.corrected(values)), values)

    def compute_form_jacobians(self, vehicle: Vehicle) -> None:
        """Compute the Jacobians in the base model's errors along the prediction of `vehicle`."""

        def of(flight: MeasuredFlight) -> np.ndarray:
            gravity, predicted = vehicle.environment_gravity, predict(flight, vehicle)
            return np.stack([form.base_column(f, predicted, gravity, flight) for f in form.BASE])

        self._form_jacobians = list(self._pool.map(of, self.flights))

    def form_jacobian(self, flight: MeasuredFlight) -> np.ndarray:
        """Return the Jacobian (F, m, C) of a flight's prediction in the base model's errors."""
        if self._form_jacobians is None:
            self.compute_form_jacobians(self.vehicle)
        assert self._form_jacobians is not None
        return self._form_jacobians[self.flights.index(flight)]

    def _with_model_errors(self, flight: MeasuredFlight, predicted: np.ndarray, values: Values) -> np.ndarray:
        """Return a prediction (m, C) with the base model's errors at their weights in `values`."""
        weights = values.get(BASE, {})
        if not any(weights.values()):
            return predicted
        return predicted + np.tensordot([weights[f] for f in form.BASE], self.form_jacobian(flight), axes=1)

    def white_errors_of(self, k: int, vehicle: Vehicle) -> np.ndarray:
        """Return the white errors (w, C, q) of one vehicle on the flight k."""
        flight = self.flights[k]
        return flight.whitening(flight.cut(flight.measured - predict(flight, vehicle)))

    def squares(self, values: Values, inflation: np.ndarray) -> float:
        """Return the weighted sum of squared white errors with effects at `values` (least-squares cost)."""
        squares_by_channel = np.concatenate(
            [np.einsum("wcq,wcq->wc", x, x) for x in self.white_errors_at(values)]
        )
        return float((self.weight / inflation * squares_by_channel).sum())

    def form_columns(self, values: Values) -> list[Column]:
        """Return the model error columns of the base and of the effects that are not neutral in `values`."""
        return self.columns([BASE]) + [
            Column(name, "", form=f)
            for name in values
            if name != BASE and np.any(self.sizes(name, values))
            for f in self.library[name].forms
        ]

    def jacobian(
        self, values: Values, columns: Sequence[Column]
    ) -> Callable[[MeasuredFlight], list[np.ndarray]]:
        """Return a function of a flight: prediction (m, C) at `values`, then the Jacobian's columns."""
        vehicle, order = self.corrected(values), list(form.BASE)
        differences = {c: self.one_sided_difference(values, c) for c in columns if not c.form}
        with_errors = {c.effect for c in columns if c.form} - {BASE}
        rest = {n: self.corrected({m: v for m, v in values.items() if m != n}) for n in with_errors}

        def of(flight: MeasuredFlight) -> list[np.ndarray]:
            translation = translated(flight, vehicle)
            here = predict(flight, vehicle, translation)
            contribution = {name: here - predict(flight, other) for name, other in rest.items()}
            result = [self._with_model_errors(flight, here, values)]
            for column in columns:
                if column.effect == BASE:
                    result.append(self.form_jacobian(flight)[order.index(column.form)])
                elif column.form:
                    result.append(form.column(column.form, contribution[column.effect], flight))
                else:  # finite difference: dp/dx = (p(x + h) - p(x)) / h
                    moved, step = differences[column]
                    same = translation if self.library[column.effect].in_the_loops else None
                    result.append((predict(flight, moved, same) - here) / step)
            return result

        return of

    def linearise(self, values: Values, columns: Sequence[Column], inflation: np.ndarray) -> Linearisation:
        """Return the Gram matrices of white errors and Jacobian at `values`.

        inflation (C,): variance inflation of every channel.
        """
        share = np.sqrt(self.weight / inflation)  # (w, C) weighted least squares
        a, b = np.zeros((self.groups, len(columns), len(columns))), np.zeros((self.groups, len(columns)))
        c = np.zeros(self.groups)

        if any(column.effect == BASE for column in columns):
            self.form_jacobian(self.flights[0])
        jacobian_of = self.jacobian(values, columns)

        def of(k: int) -> None:
            flight, own = self.flights[k], self.flight_of == k
            here, *jacobian = jacobian_of(flight)
            stack = np.stack([flight.measured - here, *jacobian])  # (1 + P, m, C): [e, J]
            groups = self.group_of[own]
            for channel, matrix in enumerate(flight.whitening.matrices):
                live = np.flatnonzero(np.ptp(stack[:, :, channel], axis=1))
                windows = stack[live[:, None, None], flight.starts[:, None] + np.arange(flight.rows), channel]
                white = (windows @ matrix.T) * share[own, channel, None]  # (live, w, q)
                for g in np.unique(groups):
                    part = white[:, groups == g].reshape(len(live), -1)
                    gram = part @ part.T  # [e, J]' [e, J]
                    if len(live) and live[0] == 0:
                        at = live[1:] - 1
                        c[g] += gram[0, 0]
                        b[g, at] += gram[0, 1:]
                        a[np.ix_([g], at, at)] += gram[None, 1:, 1:]

        list(self._pool.map(of, range(len(self.flights))))
        return Linearisation(tuple(columns), a, b, c, self)


def _groups(flights: Sequence[MeasuredFlight]) -> np.ndarray:
    """Return the group of every window: its flight, or part of it where there are few."""
    most = 1 if len(flights) >= LEAST_GROUPS else -(-LEAST_GROUPS // len(flights))
    groups, offset = [], 0
    for flight in flights:
        n = len(flight.starts)
        parts = min(most, n)
        groups.append(offset + np.arange(n) * parts // n)
        offset += parts
    return np.concatenate(groups)


def identifiable_effects(
    library: Mapping[str, Effect], flights: Sequence[MeasuredFlight]
) -> tuple[dict[str, Effect], list[str]]:
    """Return the effects whose required log channels were logged and excited, and notes on the others."""
    kept, notes = {}, []
    measured = any(f.thrust_is_measured for f in flights)
    requested = all(f.requests is not None for f in flights)
    for name, effect in library.items():
        if measured and effect.of_the_drive:
            continue  # the speeds of the rotors are given
        if not requested and "requests" in effect.channels and effect.requires:
            continue  # as in most logs; a note for each would hide the others
        why = {_why_unidentifiable(channel, least, flights) for channel, least in effect.requires.items()} - {
            ""
        }
        if why:
            others = ", ".join(effect.confused_with)
            notes += [f"{reason}: {name} is confounded with {others}" for reason in sorted(why)]
        else:
            kept[name] = effect
    if not requested:
        notes.append("requests of the four motors not logged: single rotors cannot be judged")
    return kept, notes


def _why_unidentifiable(channel: str, least: float, flights: Sequence[MeasuredFlight]) -> str:
    """Return why a log channel excites nothing, a clause; empty if it does."""
    logged = [getattr(f, channel) for f in flights]
    if any(x is None for x in logged):
        return f"{channel} not logged in every flight"
    used = [x[f.usable] for x, f in zip(logged, flights)]
    constant = max(map(np.ptp, used)) < least and np.ptp([x.mean() for x in used]) < least
    return f"the {channel} logged is constant" if constant else ""


@dataclasses.dataclass
class Linearisation:
    """Linearised least squares: Gram matrices of every group of windows (normal equations)."""

    columns: tuple[Column, ...]
    a: np.ndarray  # (g, P, P)
    b: np.ndarray  # (g, P)
    c: np.ndarray  # (g,) squared errors
    problem: Problem

    def by_flight(self) -> tuple[np.ndarray, np.ndarray]:
        """Return a (f, P, P) and b (f, P) summed over the groups of every flight."""
        flights = len(self.problem.flights)
        of = np.array([self.problem.flight_of[self.problem.group_of == g][0] for g in range(len(self.c))])
        a, b = np.zeros((flights, *self.a.shape[1:])), np.zeros((flights, self.b.shape[1]))
        np.add.at(a, of, self.a)
        np.add.at(b, of, self.b)
        return a, b

    def predicted_squares(self, change: np.ndarray) -> float:
        """Return the squared error that the linear model predicts after a change (P,)."""
        # |e - J d|^2 = c - 2 b'd + d'a d
        return float(self.c.sum() - 2.0 * self.b.sum(axis=0) @ change + change @ self.a.sum(axis=0) @ change)

    def covariance(self) -> np.ndarray:
        """Return the cluster-robust covariance (P, P) of the least-squares fit (sandwich estimator)."""
        # A^-1 [n/(n-1) sum_g s_g s_g'] A^-1,  s_g = b_g - a_g x the score of group g at the solution x (Liang
        # and Zeger 1986).
        inverse, n = invert(self.a.sum(axis=0)), len(self.c)
        with np.errstate(invalid="ignore"):  # columns without any excitation are NaN
            scores = self.b - self.a @ (inverse @ self.b.sum(axis=0))
            meat = scores.T @ scores * n / max(1, n - 1)
            clustered = inverse @ meat @ inverse
        # At least the variance by the windows' noise, A^-1.
        floor = np.diag(inverse)
        scale = np.sqrt(np.maximum(1.0, floor / np.maximum(np.diag(clustered), 1e-300)))
        return clustered * np.outer(scale, scale)


def solve(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Solve a x = b for a positive semidefinite matrix; columns of zeros get zero."""
    live, s, scaled = _scaled(a)
    x = np.zeros_like(b)
    x[live] = np.linalg.solve(scaled, b[live] / s) / s
    return x


def invert(a: np.ndarray) -> np.ndarray:
    """Invert a positive semidefinite matrix; columns of zeros get infinite variance."""
    live, s, scaled = _scaled(a)
    result = np.diag(np.where(live, 0.0, np.inf))
    result[np.ix_(live, live)] = np.linalg.inv(scaled) / np.outer(s, s)
    return result


def _scaled(a: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return non-zero columns, their scales, and their matrix scaled to a unit diagonal, with a ridge."""
    scale = np.sqrt(np.diag(a))
    live = scale > 0.0
    s = scale[live]
    return live, s, a[np.ix_(live, live)] / np.outer(s, s) + _RIDGE * np.eye(int(live.sum()))
