"""White window errors of a vehicle, their sensitivity to every effect, and what follows linearly.

Everything after one linearisation works on small Gram matrices per window and channel: single-effect
gains, scores on flights left out, per-flight estimates and classes of effects that look alike.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np

from inclined_landing.eval.gap.flights.unrest import Unrest
from inclined_landing.eval.gap.flights.whitening import Shapes
from inclined_landing.eval.gap.flights.windows import Measured
from inclined_landing.eval.gap.search.prediction import YAW_CHANNEL, predict
from inclined_landing.models.effects import Effect, Parameter
from inclined_landing.models.parameters import Vehicle

if TYPE_CHECKING:
    from inclined_landing.eval.gap.search.reference import Reference

Values = Mapping[str, Mapping[str, float]]  # effect -> parameter -> value

# With fewer flights than this, flights are split into this many groups of windows in all.
LEAST_GROUPS = 8
REFERENCE = 8.0  # negligible sizes by which the reference of an effect may well be off
_RIDGE = 1e-9


@dataclasses.dataclass(frozen=True)
class Column:
    """One direction in which an effect changes the prediction."""

    effect: str
    parameter: str
    fixed: tuple[tuple[str, float], ...] = ()  # other parameters of the effect, where they differ


class Suspects:
    """The vehicle that measurements are compared with, and the effects that may be added to it."""

    vehicle: Vehicle
    library: dict[str, Effect]

    def corrected(self, values: Values) -> Vehicle:
        """The vehicle with effects at `values`, applied in the order of the library."""
        vehicle = self.vehicle
        for name, effect in self.library.items():
            if name in values:
                vehicle = effect.apply(vehicle, values[name])
        return vehicle

    def parameter(self, column: Column) -> Parameter:
        """The parameter that a column is about."""
        return self.library[column.effect].parameter(column.parameter)

    def sizes(self, name: str, values: Values) -> np.ndarray:
        """How far every parameter of an effect is from neutral."""
        return np.array([p.size(values[name][p.name]) for p in self.library[name].parameters])

    def to_one_side(self, values: Values, column: Column) -> tuple[Vehicle, float]:
        """The vehicle with a parameter a step from `values`, within bounds, and that step."""
        p = self.parameter(column)
        at = {**self.library[column.effect].neutral, **values.get(column.effect, {}), **dict(column.fixed)}
        step = p.step or p.negligible
        step = step if at[p.name] + step <= p.possible[1] else -step
        beside = self.corrected({**values, column.effect: {**at, p.name: at[p.name] + step}})
        return beside, step

    def to_either_side(self, values: Values, column: Column, times: float) -> tuple[list[Vehicle], float]:
        """Vehicles some negligible sizes below and above `values`, within bounds, and what lies between."""
        p = self.parameter(column)
        at = {**self.library[column.effect].neutral, **values.get(column.effect, {}), **dict(column.fixed)}
        low = max(p.bounds[0], at[p.name] - times * p.negligible)
        high = min(p.bounds[1], at[p.name] + times * p.negligible)
        ends = [self.corrected({**values, column.effect: {**at, p.name: x}}) for x in (low, high)]
        return ends, high - low


class Problem(Suspects):
    """Flights with their windows, and what may explain them."""

    def __init__(
        self,
        flights: Sequence[Measured],
        vehicle: Vehicle,
        library: Mapping[str, Effect],
        reference: Reference | None = None,
    ):
        self.flights = list(flights)
        self.vehicle = vehicle
        self.reference = reference  # what is known of the vehicle; None: it is exact
        ignored = {"touchdown"} if any(f.has_yaw for f in flights) else {"touchdown", "yaw"}
        self.library = {
            name: effect.beside(vehicle)
            for name, effect in library.items()
            if set(effect.channels) - ignored
            and all(getattr(f, channel) is not None for f in flights for channel in effect.requires)
        }
        self.flight_of = np.concatenate([np.full(len(f.starts), k) for k, f in enumerate(self.flights)])
        self.group_of = _groups(self.flights)
        self.groups = int(self.group_of.max()) + 1
        self.rows = np.array([f.rows - 2 for f in self.flights])[self.flight_of]  # white numbers each
        # Weights (w, 6): channels that were not logged have none.
        self.logged = np.ones((len(self.flight_of), 6))
        self.logged[~np.array([f.has_yaw for f in self.flights])[self.flight_of], YAW_CHANNEL] = 0.0
        self.weight = self.logged.copy()
        # Of parameters: how much more they differ between flights, how many look alike.
        self.between: dict[tuple[str, str], float] = {}
        self.alike: dict[tuple[str, str], float] = {}
        self._pool = ThreadPoolExecutor(2)

    def rewhiten(self, unrest: Unrest, vehicle: Vehicle) -> None:
        """Weigh all errors by noise and unrest, the loops of roll, pitch and yaw those of `vehicle`."""
        for flight in self.flights:
            flight.rewhiten(Shapes.of(flight.rows, flight.dt, vehicle), unrest)

    def known(self, columns: Sequence[Column]) -> np.ndarray:
        """Covariance (P, P) of how far the vehicle may be off along `columns`."""
        if self.reference is None:
            return np.zeros((len(columns),) * 2)
        return self.reference.covariance_of(columns)

    def white(self, vehicles: Sequence[Vehicle]) -> list[np.ndarray]:
        """White errors (w, 6, q) of every flight, each with its vehicle."""
        return list(self._pool.map(self.white_of, range(len(self.flights)), vehicles))

    def white_of(self, k: int, vehicle: Vehicle) -> np.ndarray:
        """White errors (w, 6, q) of one vehicle on the flight k."""
        flight = self.flights[k]
        return flight.whitening(flight.cut(flight.measured - predict(flight, vehicle)))

    def squares(self, values: Values, inflation: np.ndarray) -> float:
        """White squared error over all windows with effects at `values`."""
        white = self.white([self.corrected(values)] * len(self.flights))
        by_channel = np.concatenate([np.einsum("wcq,wcq->wc", x, x) for x in white])
        return float((self.weight / inflation * by_channel).sum())

    def columns(self, values: Values, names: Sequence[str]) -> list[Column]:
        """Directions of the effects `names` at `values`.

        A reference changes nothing while its effect is neutral and has no direction of its own there; the
        first parameter then counts with it well to either side.
        """
        result = []
        for name in names:
            effect = self.library[name]
            first, idle = effect.parameters[0], effect.reference
            if idle and values.get(name, effect.neutral).get(first.name, first.neutral) == first.neutral:
                result += [Column(name, first.name, ((idle.name, end),)) for end in either_side(idle)]
            else:
                result += [Column(name, p.name) for p in effect.parameters]
        return result

    def linearise(self, values: Values, columns: Sequence[Column]) -> Linear:
        """Errors at `values` and their Gram matrices with all `columns`."""
        vehicles, steps = [self.corrected(values)], []
        for column in columns:
            beside, step = self.to_one_side(values, column)
            vehicles.append(beside)
            steps.append(step)

        def of(flight: Measured):
            measured = flight.measured
            predicted = [predict(flight, v) for v in vehicles]
            error = flight.whitening(flight.cut(measured - predicted[0]))
            slopes = [
                flight.whitening(flight.cut((one - predicted[0]) / step))
                for one, step in zip(predicted[1:], steps)
            ]
            return gram(error, slopes)

        parts = list(self._pool.map(of, self.flights))
        a, b, c = (np.concatenate(x) for x in zip(*parts))
        return Linear(tuple(columns), a, b, c, self)


def either_side(reference: Parameter) -> tuple[float, float]:
    """Values below and above a reference's own, as far as it may well lie: no further, or a shape would
    stand for a scale."""
    low, high = reference.bounds
    away = REFERENCE * reference.negligible
    return max(low, reference.neutral - away), min(high, reference.neutral + away)


def _groups(flights: Sequence[Measured]) -> np.ndarray:
    """Group of every window: its flight, or part of its flight where there are few."""
    parts = 1 if len(flights) >= LEAST_GROUPS else -(-LEAST_GROUPS // len(flights))
    groups, offset = [], 0
    for flight in flights:
        n = len(flight.starts)
        own = min(parts, n)
        groups.append(offset + np.arange(n) * own // n)
        offset += own
    return np.concatenate(groups)


def gram(error: np.ndarray, slopes: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gram matrices (w, 6, P, P), (w, 6, P) and squares (w, 6) of errors (w, 6, q) and slopes, P of that."""
    c = np.einsum("wcq,wcq->wc", error, error)
    if not slopes:
        return np.zeros((*c.shape, 0, 0)), np.zeros((*c.shape, 0)), c
    j = np.stack(slopes, axis=2)  # (w, 6, P, q)
    return j @ j.swapaxes(2, 3), np.einsum("wcpq,wcq->wcp", j, error), c


def tellable(
    library: Mapping[str, Effect], flights: Sequence[Measured]
) -> tuple[dict[str, Effect], list[str]]:
    """The effects whose required log channels tell something on these flights; sentences on the others."""
    kept, notes = {}, []
    for name, effect in library.items():
        why = {_untold(channel, least, flights) for channel, least in effect.requires.items()} - {""}
        if why:
            alike = ", ".join(effect.confused_with)
            notes += [f"{reason}: {name} cannot be told from {alike}" for reason in sorted(why)]
        else:
            kept[name] = effect
    return kept, notes


def _untold(channel: str, least: float, flights: Sequence[Measured]) -> str:
    """Why a log channel tells nothing; empty if it does."""
    logged = [getattr(f, channel) for f in flights]
    if any(x is None for x in logged):
        return f"{channel} not logged in every flight"
    flown = [x[f.usable] for x, f in zip(logged, flights)]
    constant = max(map(np.ptp, flown)) < least and np.ptp([x.mean() for x in flown]) < least
    return f"the {channel} logged is constant" if constant else ""


@dataclasses.dataclass
class _Grams:
    """Gram matrices a (..., P, P), b (..., P), squares c (...) of errors and slopes along columns."""

    columns: tuple[Column, ...]
    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    problem: Problem

    def index(self, names: Sequence[str]) -> np.ndarray:
        """Positions of the columns of the effects `names`."""
        return np.array([k for k, column in enumerate(self.columns) if column.effect in names], int)


class Linear(_Grams):
    """Of the white errors of every window and channel, (w, 6)."""

    def inflation(self) -> np.ndarray:
        """(6,) squared error per degree of freedom that the whole library leaves, at least 1."""
        weight = self.problem.weight
        a, b = np.einsum("wc,wcpq->pq", weight, self.a), np.einsum("wc,wcp->p", weight, self.b)
        freedom = np.maximum(1.0, (weight * self.problem.rows[:, None]).sum(axis=0))
        return np.maximum(1.0, self.by_channel(np.ones(6), solve(a, b)) / freedom)

    def by_channel(self, inflation: np.ndarray, change: np.ndarray | None = None) -> np.ndarray:
        """Squared error (6,) of every channel, after a change (P,) of all columns."""
        weight = self.problem.weight / inflation
        left = self.c
        if change is not None:
            left = left - 2.0 * self.b @ change
            left = left + np.einsum("wcpq,p,q->wc", self.a, change, change, optimize=True)
        return (weight * left).sum(axis=0)

    def weighted(self, inflation: np.ndarray) -> Weighted:
        """Channels summed up, each with its weight."""
        weight = self.problem.weight / inflation
        return Weighted(
            self.columns,
            np.einsum("wc,wcpq->wpq", weight, self.a, optimize=True),
            np.einsum("wc,wcp->wp", weight, self.b),
            np.einsum("wc,wc->w", weight, self.c),
            self.problem,
        )


@dataclasses.dataclass
class Weighted(_Grams):
    """The same with the channels summed, (w,)."""

    def __post_init__(self):
        g = self.problem.group_of
        self.group_a = np.stack([self.a[g == k].sum(axis=0) for k in range(self.problem.groups)])
        self.group_b = np.stack([self.b[g == k].sum(axis=0) for k in range(self.problem.groups)])

    def fit(self, index: np.ndarray) -> np.ndarray:
        """(k,) change of the columns `index` that fits all windows best."""
        if not len(index):
            return np.zeros(0)
        a, b = self.group_a.sum(axis=0), self.group_b.sum(axis=0)
        return solve(a[np.ix_(index, index)], b[index])

    def left(self, index: np.ndarray, change: np.ndarray, w: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Squared error of the windows `w` after a change of the columns `index`."""
        if not len(index):
            return self.c[w]
        a = self.a[w][:, index[:, None], index[None, :]]
        return self.c[w] - 2.0 * self.b[w][:, index] @ change + np.einsum("wpq,p,q->w", a, change, change)

    def left_out(self, index: np.ndarray) -> np.ndarray:
        """Squared error (w,) of every window, columns `index` fitted to the other groups."""
        if not len(index):
            return self.c
        result = np.empty(len(self.c))
        grid = np.ix_(index, index)
        total_a, total_b = self.group_a.sum(axis=0), self.group_b.sum(axis=0)
        for group in range(self.problem.groups):
            d = solve((total_a - self.group_a[group])[grid], (total_b - self.group_b[group])[index])
            w = self.problem.group_of == group
            result[w] = self.left(index, d, w)
        return result

    def per_flight(self, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Change (f, k) that fits each flight alone best, and its standard error (f, k)."""
        flights = len(self.problem.flights)
        value, error = np.full((2, flights, len(index)), np.nan)
        for f in range(flights):
            w = self.problem.flight_of == f
            a = self.a[w].sum(axis=0)[np.ix_(index, index)]
            inverse = invert(a)
            with np.errstate(invalid="ignore"):  # what a flight does not show at all is NaN
                value[f] = inverse @ self.b[w].sum(axis=0)[index]
            error[f] = np.sqrt(np.diag(inverse))
        return value, error

    def covariance(self, index: np.ndarray) -> np.ndarray:
        """Covariance (k, k) of the fit of the columns `index`, clustered by group."""
        total = self.group_a.sum(axis=0)[np.ix_(index, index)]
        inverse = invert(total)
        n = self.problem.groups
        with np.errstate(invalid="ignore"):  # what the flights do not show at all is NaN
            d = inverse @ self.group_b.sum(axis=0)[index]
            scores = self.group_b[:, index] - self.group_a[:, index[:, None], index[None, :]] @ d
            meat = scores.T @ scores * n / max(1, n - 1)
            clustered = inverse @ meat @ inverse
        # Never smaller than what the noise of the windows alone gives.
        floor = np.diag(inverse)
        scale = np.sqrt(np.maximum(1.0, floor / np.maximum(np.diag(clustered), 1e-300)))
        return clustered * np.outer(scale, scale)


def solve(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Solution of a x = b for a positive semidefinite matrix, columns without any effect left at zero."""
    live, s, scaled = _scaled(a)
    x = np.zeros_like(b)
    x[live] = np.linalg.solve(scaled, b[live] / s) / s
    return x


def invert(a: np.ndarray) -> np.ndarray:
    """Inverse of a positive semidefinite matrix; infinite variance for columns without any effect."""
    live, s, scaled = _scaled(a)
    result = np.diag(np.where(live, 0.0, np.inf))
    result[np.ix_(live, live)] = np.linalg.inv(scaled) / np.outer(s, s)
    return result


def _scaled(a: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which columns have an effect, their scales, and their matrix with a diagonal of 1 and a ridge."""
    scale = np.sqrt(np.diag(a))
    live = scale > 0.0
    s = scale[live]
    return live, s, a[np.ix_(live, live)] / np.outer(s, s) + _RIDGE * np.eye(int(live.sum()))
