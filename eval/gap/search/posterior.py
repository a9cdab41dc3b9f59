"""How probable a set of effects is, from Gram matrices: marginal likelihoods of a linearised simulator.

Every parameter of every effect has a normal prior about neutral. An effect of the set has the *slab*, as
wide as what real vehicles show; every other has the *spike*, as wide as what nobody needs to correct: no
model is exact, and small errors of what is not named must not be explained by a name. Each flight may differ
from the fleet by a spike of its own, so that a flight counts for what it can tell, and no more.

The marginal likelihood is the product of predictions of every flight from those before it. Probabilities are
averaged over flights drawn with replacement (bagged posterior: Huggins and Miller 2023), which keeps them
from being surer than the flights agree, where no set is exactly true.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from inclined_landing.eval.gap.search.evidence import Problem, Values, Weighted
from inclined_landing.eval.gap.search.fit import Fitted, from_neutral

SPIKE = 0.35  # standard deviation of what is not named, as a share of negligible
BETWEEN = 0.35  # of the difference between flights, likewise
SLAB = 1.0  # of what is named, in plausible sizes
DRAWS = 60  # of flights
ROUNDS = 10  # of expectation and maximisation

Set = frozenset[str]


def spikes(problem: Problem, columns: Sequence) -> np.ndarray:
    """Standard deviation (P,) of every column that is not named.

    What nobody needs to correct, shared by all that look alike; and where flights differ, the vehicle's file
    was identified in some others.
    """
    return np.hypot(SPIKE * _shares(problem, columns), betweens(problem, columns) / np.sqrt(problem.groups))


def betweens(problem: Problem, columns: Sequence) -> np.ndarray:
    """Standard deviation (P,) of every column between flights."""
    own = [problem.between.get((c.effect, c.parameter), 0.0) for c in columns]
    return np.maximum(BETWEEN * _shares(problem, columns), own)


def _shares(problem: Problem, columns: Sequence) -> np.ndarray:
    """Each column's share (P,) of negligible, for those that look alike have it together."""
    alike = [problem.alike.get((c.effect, c.parameter), 1.0) * (2.0 if c.fixed else 1.0) for c in columns]
    return np.array([problem.parameter(c).negligible for c in columns]) / np.sqrt(alike)


def looks_alike(weighted: Weighted) -> dict[tuple[str, str], float]:
    """(effect, parameter) -> how many columns change the predictions as it does, itself included."""
    a = weighted.group_a.sum(axis=0)
    scale = np.sqrt(np.maximum(np.diag(a), 1e-300))
    squared = (a / np.outer(scale, scale)) ** 2
    count = np.maximum(1.0, squared.sum(axis=0))
    return {(c.effect, c.parameter): float(x) for c, x in zip(weighted.columns, count)}


def between_flights(problem: Problem, weighted: Weighted) -> dict[tuple[str, str], float]:
    """(effect, parameter) -> its standard deviation between flights, by expectation and maximisation."""
    unit = _shares(problem, weighted.columns)
    a, b = weighted.group_a * np.outer(unit, unit), weighted.group_b * unit
    prior = (unit / slabs(problem, weighted.columns)) ** 2
    variance, eye = np.full(len(unit), BETWEEN**2), np.eye(len(unit))
    sized = np.array([not problem.parameter(c).is_reference for c in weighted.columns])
    for _ in range(ROUNDS):
        inner = np.linalg.inv(eye + a * variance)
        total = (inner @ a).sum(axis=0) + np.diag(prior)
        fleet = np.linalg.solve(total, np.einsum("gpq,gq->p", inner, b))
        covariance = variance[:, None] * inner
        own = np.einsum("gpq,gq->gp", covariance, b - a @ fleet)
        second = own**2 + np.diagonal(covariance, axis1=1, axis2=2)
        variance = np.where(sized, np.maximum(BETWEEN**2, second.mean(axis=0)), BETWEEN**2)
    return {
        (c.effect, c.parameter): float(np.sqrt(v) * u) for c, v, u in zip(weighted.columns, variance, unit)
    }


def slabs(problem: Problem, columns: Sequence) -> np.ndarray:
    """Standard deviation (P,) of every column that is named."""
    width = []
    for column in columns:
        p = problem.parameter(column)
        about = 0.25 * (p.bounds[1] - p.bounds[0])
        width.append(about if p.is_reference else SLAB * abs(p.size(p.plausible)))
    return np.array(width)


@dataclasses.dataclass
class Local:
    """The flights as functions of the parameters near one point, in units of the spikes.

    Flights' own deviations are integrated out; a, b, c are those of every flight (or group of windows).
    """

    problem: Problem
    columns: tuple
    at: np.ndarray  # (P,) where it was linearised, from neutral, in spikes
    a: np.ndarray  # (g, P, P)
    b: np.ndarray  # (g, P)
    c: np.ndarray  # (g,)
    unit: np.ndarray  # (P,) spikes
    slab: np.ndarray  # (P,) in spikes
    held: np.ndarray  # (P,) bool: at a bound, where it cannot move
    between: np.ndarray  # (P,) variance between flights
    stays: np.ndarray  # (P,) bool: where it was fitted, since a linear step from there fails
    own_a: np.ndarray  # (f, P, P) of every flight, its deviation not integrated out
    own_b: np.ndarray  # (f, P)

    @staticmethod
    def of(problem: Problem, weighted: Weighted, values: Values) -> Local:
        """From the linearisation at `values`."""
        columns, g = weighted.columns, problem.groups
        unit = spikes(problem, columns)
        at = np.zeros(len(columns))
        held = np.zeros(len(columns), bool)
        for k, column in enumerate(columns):
            p = problem.parameter(column)
            if column.effect in values and not column.fixed:
                value = values[column.effect][p.name]
                at[k] = (value - p.neutral) / unit[k]
                low, high = p.possible
                held[k] = min(value - low, high - value) < 1e-6 * (high - low)
        a = weighted.group_a * np.outer(unit, unit)
        b = weighted.group_b * unit
        c = np.bincount(problem.group_of, weighted.c, g)
        flights = len(problem.flights)
        of = np.array([problem.flight_of[np.argmax(problem.group_of == k)] for k in range(g)])
        own_a, own_b = np.zeros((flights, *a.shape[1:])), np.zeros((flights, a.shape[1]))
        np.add.at(own_a, of, a)
        np.add.at(own_b, of, b)
        between = (betweens(problem, columns) / unit) ** 2
        # Marginal over a deviation u of each flight, u ~ N(0, between) in every column.
        eye = np.eye(len(columns))
        for k in range(g):
            inner = np.linalg.inv(eye + a[k] * between)
            c[k] -= (b[k] * between) @ inner @ b[k]
            b[k] = inner @ b[k]
            a[k] = inner @ a[k]
            a[k] = 0.5 * (a[k] + a[k].T)
        slab = slabs(problem, columns) / unit
        stays = np.zeros(len(columns), bool)
        return Local(problem, columns, at, a, b, c, unit, slab, held, between, stays, own_a, own_b)

    def index(self, names: Iterable[str]) -> np.ndarray:
        """Positions of the columns of the effects `names`."""
        names = set(names)
        return np.array([k for k, column in enumerate(self.columns) if column.effect in names], int)

    def precision(self, names: Set) -> np.ndarray:
        """Prior precision (P,) of every column when the effects `names` are present."""
        result = np.ones(len(self.columns))
        own = self.index(names)
        result[own] = 1.0 / self.slab[own] ** 2
        result[self.held] = 1e12
        return result

    def log_evidence(self, names: Set, weights: np.ndarray) -> np.ndarray:
        """Log marginal likelihood (d,) of a set, the flights counted by `weights` (d, g)."""
        precision = self.precision(names)
        a = np.tensordot(weights, self.a, axes=1) + np.diag(precision)
        # What is held at a bound is there by choice: its prior is about that value.
        at = np.where(self.held, 0.0, self.at)
        h = weights @ self.b - precision * at
        factor = np.linalg.cholesky(a)
        log_det = 2.0 * np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        if self.stays.any():
            move = ~self.stays
            h, factor = h[:, move], np.linalg.cholesky(a[:, move][:, :, move])
        z = np.linalg.solve(factor, h[..., None])[..., 0]
        left = weights @ self.c + (precision * at * at).sum() - (z * z).sum(axis=1)
        return -0.5 * (left + log_det - np.log(precision).sum())

    def fit(self, names: Set, weights: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Most probable change (P,) of the columns and its covariance (P, P), in spikes."""
        precision = self.precision(names)
        w = np.ones(len(self.c)) if weights is None else weights
        at = np.where(self.held, 0.0, self.at)
        a, h = np.tensordot(w, self.a, axes=1) + np.diag(precision), w @ self.b - precision * at
        change = np.zeros(len(h))
        move = ~self.stays
        change[move] = np.linalg.solve(a[np.ix_(move, move)], h[move])
        return change, np.linalg.inv(a)

    def errors(self, names: Set) -> np.ndarray:
        """Standard error (P,) of every column, in spikes; what is held at a bound could go the other way."""
        own = self.a.sum(axis=0).diagonal() + 1.0 / self.slab**2
        return np.where(self.held, 1.0 / np.sqrt(own), np.sqrt(self.fit(names)[1].diagonal()))

    def deviation(self, flight: int, change: np.ndarray) -> np.ndarray:
        """How far (P,) one flight lies from the fleet's change of the columns, in spikes."""
        a, b = self.own_a[flight], self.own_b[flight]
        return np.linalg.solve(a + np.diag(1.0 / self.between), b - a @ change)


def evidence_of(problem: Problem, fit: Fitted, names: Set) -> float:
    """Log marginal likelihood of the effects `names` of a fit, the others neutral."""
    columns = fit.weighted.columns
    own = np.array([c.effect in names for c in columns])
    a, b = fit.weighted.group_a.sum(axis=0), fit.weighted.group_b.sum(axis=0)
    at, precision = from_neutral(problem, columns, fit.values), slabs(problem, columns)[own] ** -2.0
    without = np.where(own, 0.0, -at)
    left = fit.squares - 2.0 * b @ without + without @ a @ without
    h = (b - a @ without)[own] - precision * at[own]
    whole = a[np.ix_(own, own)] + np.diag(precision)
    left += precision @ at[own] ** 2 - h @ np.linalg.solve(whole, h)
    return -0.5 * float(left + np.linalg.slogdet(whole)[1] - np.log(precision).sum())


class Screen:
    """Log marginal likelihoods of many sets from one linearisation, all flights counted once."""

    def __init__(self, local: Local):
        self.local = local
        n = len(local.columns)
        m = local.a.sum(axis=0) + np.diag(local.precision(frozenset()))
        self.h = local.b.sum(axis=0)
        self.inverse = np.linalg.inv(m)
        self.log_det = np.linalg.slogdet(m)[1]
        self.at = np.where(local.held, 0.0, local.at)
        self.c = local.c.sum()
        self.base = np.ones(n)
        self.base[local.held] = 1e12
        self.own = {name: local.index([name]) for name in local.problem.library}

    def __call__(self, names: Set) -> float:
        """The log marginal likelihood of a set."""
        columns = [self.own[n] for n in names if len(self.own[n])]
        own = np.concatenate(columns) if columns else np.zeros(0, int)
        own = own[~self.local.held[own]]
        precision = self.base.copy()
        precision[own] = 1.0 / self.local.slab[own] ** 2
        h = self.h - precision * self.at
        mean = self.inverse @ h
        square = h @ mean
        log_det = self.log_det
        if len(own):  # of the matrix less what the spikes of the set held it by
            change = precision[own] - 1.0
            inner = np.diag(1.0 / change) + self.inverse[np.ix_(own, own)]
            log_inner = np.linalg.slogdet(inner)[1]
            square -= mean[own] @ np.linalg.solve(inner, mean[own])
            log_det += log_inner + np.log(np.abs(change)).sum()
        left = self.c + (precision * self.at * self.at).sum() - square
        return -0.5 * (left + log_det - np.log(precision).sum())


def flight_weights(groups: int, seed: int = 0) -> np.ndarray:
    """How often each of the flights is drawn (DRAWS, g), with replacement."""
    return np.random.default_rng(seed).multinomial(groups, np.full(groups, 1.0 / groups), DRAWS).astype(float)
