"""How probable a set of effects is, from Gram matrices: marginal likelihoods of a linearised simulator.

    white error of a flight = J (z + u),   z = theta + delta

theta: by how much the vehicle is off, known from the flights that it was identified from: normal, with the
covariance of that fit. delta: what the flights have and those had not. Of an effect of the set it has the
*slab*, as wide as what real vehicles show; of every other the *spike*, as wide as what nobody needs to
correct: no model is exact, and small errors of what is not named must not be explained by a name. u: each
flight may differ from the fleet, so that a flight counts for what it can tell, and no more. What the formula
of an effect of the set may have wrong are columns too (`search.form`).

Probabilities are averaged over flights drawn with replacement (bagged posterior: Huggins and Miller 2023),
which keeps them from being surer than the flights agree, where no set is exactly true.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from inclined_landing.eval.gap.search.evidence import REFERENCE, Problem, Values, Weighted

SPIKE = 0.35  # standard deviation of what is not named, as a share of negligible
BETWEEN = 0.35  # of the difference between flights, likewise
SLAB = 1.0  # of what is named, in plausible sizes
LARGE = 4.0  # times as wide where an effect is far larger: sizes have heavy tails
DRAWS = 60  # of flights
ROUNDS = 10  # of expectation and maximisation
# How well differences between flights are known beforehand, as if seen in so many flights.
SEEN_BEFORE = 2.0

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
    """(effect, parameter) -> its standard deviation between flights, by expectation and maximisation.

    Beforehand, flights differ by what the formulas have wrong from one manoeuvre to another, as if that had
    been seen in SEEN_BEFORE flights: where one flight shows an effect, nothing says how far flights differ.
    """
    unit = _shares(problem, weighted.columns)
    a, b = weighted.group_a * np.outer(unit, unit), weighted.group_b * unit
    prior = (unit / slabs(problem, weighted.columns)) ** 2
    known = np.array([problem.parameter(c).between for c in weighted.columns]) / unit
    known = np.maximum(BETWEEN, known) ** 2
    variance, eye = known.copy(), np.eye(len(unit))
    sized = np.array([not problem.parameter(c).is_reference for c in weighted.columns])
    share = SEEN_BEFORE / (SEEN_BEFORE + problem.groups)
    for _ in range(ROUNDS):
        inner = np.linalg.inv(eye + a * variance)
        total = (inner @ a).sum(axis=0) + np.diag(prior)
        fleet = np.linalg.solve(total, np.einsum("gpq,gq->p", inner, b))
        covariance = variance[:, None] * inner
        own = np.einsum("gpq,gq->gp", covariance, b - a @ fleet)
        second = own**2 + np.diagonal(covariance, axis1=1, axis2=2)
        found = share * known + (1.0 - share) * second.mean(axis=0)
        variance = np.where(sized, np.maximum(BETWEEN**2, found), BETWEEN**2)
    return {
        (c.effect, c.parameter): float(np.sqrt(v) * u) for c, v, u in zip(weighted.columns, variance, unit)
    }


def slabs(problem: Problem, columns: Sequence) -> np.ndarray:
    """Standard deviation (P,) of every column that is named."""
    width = []
    for column in columns:
        p = problem.parameter(column)
        width.append(REFERENCE * p.negligible if p.is_reference else SLAB * abs(p.size(p.plausible)))
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
    known: np.ndarray  # (P, P) covariance of theta
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
        inner = np.linalg.inv(np.eye(len(columns)) + a * between)
        c = c - np.einsum("gp,p,gpq,gq->g", b, between, inner, b, optimize=True)
        b = np.einsum("gpq,gq->gp", inner, b)
        a = inner @ a
        a = 0.5 * (a + a.swapaxes(1, 2))
        known = problem.known(columns) / np.outer(unit, unit)
        slab = slabs(problem, columns) / unit
        stays = np.zeros(len(columns), bool)
        return Local(problem, columns, at, a, b, c, unit, slab, held, known, between, stays, own_a, own_b)

    def index(self, names: Iterable[str]) -> np.ndarray:
        """Positions of the columns of the effects `names`."""
        names = set(names)
        return np.array([k for k, column in enumerate(self.columns) if column.effect in names], int)

    def prior(self, names: Set) -> tuple[np.ndarray, np.ndarray]:
        """Mean (P,), from the point of linearisation, and covariance (P, P) when `names` are present."""
        variance = np.ones(len(self.columns))
        own = self.index(names)
        variance[own] = self.slab[own] ** 2
        covariance = self.known + np.diag(variance)
        # What is held at a bound is there by choice: its prior is about that value.
        covariance[self.held] = covariance[:, self.held] = 0.0
        return np.where(self.held, 0.0, -self.at), covariance

    def evidence(self, weights: np.ndarray | None = None) -> Evidence:
        """Of sets of effects, the flights counted by `weights` (g,)."""
        w = np.ones(len(self.c)) if weights is None else weights
        mean, covariance = self.prior(frozenset())
        return Evidence.of(
            self, np.tensordot(w, self.a, axes=1), w @ self.b, float(w @ self.c), mean, covariance
        )

    def fit(self, names: Set, weights: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Most probable change (P,) of the columns and its covariance (P, P), in spikes."""
        w = np.ones(len(self.c)) if weights is None else weights
        mean, prior = self.prior(names)
        a, b = np.tensordot(w, self.a, axes=1), w @ self.b
        if self.stays.any():
            prior[self.stays] = prior[:, self.stays] = 0.0
            mean = np.where(self.stays, 0.0, mean)
        covariance = np.linalg.solve(np.eye(len(b)) + prior @ a, prior)
        return mean + covariance @ (b - a @ mean), 0.5 * (covariance + covariance.T)

    def errors(self, names: Set) -> np.ndarray:
        """Standard error (P,) of every column, in spikes; what is held at a bound could go the other way."""
        own = self.a.sum(axis=0).diagonal() + 1.0 / self.slab**2
        return np.where(self.held, 1.0 / np.sqrt(own), np.sqrt(self.fit(names)[1].diagonal()))

    def deviation(self, flight: int, change: np.ndarray) -> np.ndarray:
        """How far (P,) one flight lies from the fleet's change of the columns, in spikes."""
        a, b = self.own_a[flight], self.own_b[flight]
        return np.linalg.solve(a + np.diag(1.0 / self.between), b - a @ change)


@dataclasses.dataclass
class Evidence:
    """Log marginal likelihoods of many sets: all that is the same in every set is integrated out once.

    With the prior covariance K of the empty set, about its mean,
    log p = -1/2 [c - b' (1 + K a)^-1 K b + log det(1 + K a)],  and for what a set has more, the same with
    a' = (1 + a K)^-1 a,  b' = (1 + a K)^-1 b  and the wider variances of its columns.
    """

    a: np.ndarray  # (P, P)
    b: np.ndarray  # (P,)
    empty: float  # log marginal likelihood of the empty set
    own: dict[str, np.ndarray]  # effect -> its columns
    slab: np.ndarray  # (P,)

    @staticmethod
    def of(local: Local, a, b, c: float, mean: np.ndarray, covariance: np.ndarray) -> Evidence:
        """Of Gram matrices a, b, c summed over flights and the prior of the empty set."""
        c = c - 2.0 * b @ mean + mean @ a @ mean
        b = b - a @ mean
        inner = np.linalg.inv(np.eye(len(b)) + a @ covariance)
        square = b @ covariance @ inner @ b
        _, log_det = np.linalg.slogdet(inner)
        after = inner @ a
        own = {n: local.index([n]) for n in local.problem.library}
        own = {n: k[~local.held[k]] for n, k in own.items()}
        empty = -0.5 * (c - square - log_det)
        return Evidence(0.5 * (after + after.T), inner @ b, float(empty), own, local.slab)

    def __call__(self, names: Set) -> float:
        """The log marginal likelihood of a set."""
        columns = [self.own[n] for n in sorted(names) if len(self.own[n])]
        if not columns:
            return self.empty
        k = np.concatenate(columns)
        wide = self.slab[k]
        change, score = self._at(k, wide)
        far = np.abs(change) > 2.0 * wide
        if far.any():  # heavy tails: one time in five, sizes are LARGE times as large
            score = max(score, self._at(k, np.where(far, LARGE * wide, wide))[1] - far.sum() * np.log(4.0))
        return score

    def _at(self, k: np.ndarray, wide: np.ndarray) -> tuple[np.ndarray, float]:
        """Sizes of the columns k of widths (k,), and the log marginal likelihood."""
        prior = np.maximum(wide**2 - 1.0, 1e-9)
        a, b = self.a[np.ix_(k, k)], self.b[k]
        root = np.sqrt(prior)
        inner = np.eye(len(k)) + root[:, None] * a * root
        factor = np.linalg.cholesky(inner)
        z = np.linalg.solve(factor, root * b)
        change = root * np.linalg.solve(factor.T, z)
        return change, self.empty + 0.5 * float(z @ z) - float(np.log(np.diagonal(factor)).sum())


def flight_weights(groups: int, seed: int = 0) -> np.ndarray:
    """How often each of the flights is drawn (DRAWS, g), with replacement."""
    return np.random.default_rng(seed).multinomial(groups, np.full(groups, 1.0 / groups), DRAWS).astype(float)
