"""Spike-and-slab marginal likelihoods of sets of effects, in a linearised hierarchical model.

    white error of a flight = J (z + u) + noise,   z = theta + delta

theta ~ N(m, Sigma): error of the identified vehicle, with the posterior covariance of its identification.
delta: change since then. Its prior is the *slab* for an effect of the set, as wide as real vehicles differ,
and the *spike* for every other, as wide as a negligible error: no model is exact. u ~ N(0, between^2): random
effect of every flight. Model errors of the formulas are columns of J as well (`search.form`).

Probabilities are averaged over bootstrap samples of the flights (bagged posterior: Huggins and Miller 2023),
since no set is exactly true: the posterior under misspecification would be overconfident.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence

import numpy as np

from inclined_landing.eval.gap.search.evidence import Linearisation, Problem, Values
from inclined_landing.models.effects.effect import OFF

SPIKE = 0.35  # standard deviation of what is not named, as a share of negligible
BETWEEN = 0.35  # of the difference between flights, likewise
SLAB = 1.0  # of what is named, in plausible sizes
LARGE = 4.0  # times as wide where an effect is far larger: sizes have heavy tails
BOOTSTRAP_SAMPLES = 24  # of flights
MOST_SPIKE = 0.5  # plausible sizes: what is not named is no more
EM_ROUNDS = 10  # of expectation and maximisation
ACTIVE_SET_ROUNDS = 4  # rounds in which what lies outside its bounds is put there
# How well differences between flights are known beforehand, as if seen in so many flights.
PRIOR_FLIGHTS = 2.0
SHAPE_COVARIANCE = np.array(
    [[0.3125, 0.1875], [0.1875, 0.3125]]
)  # covariance of a unit size at both sides: see `slab_covariance`

EffectSet = frozenset[str]


def spike_deviations(problem: Problem, columns: Sequence) -> np.ndarray:
    """Return the spikes' standard deviations (P,).

    A share of the negligible size, split among confounded columns, plus the standard error of the mean of the
    flights that excite a column, where flights differ:  hypot(SPIKE negligible, between / sqrt(flights)).
    """
    count = np.array([problem.excitation.get((c.effect, c.parameter), problem.groups) for c in columns])
    spike = np.hypot(
        SPIKE * _shared_negligible_sizes(problem, columns),
        between_flight_deviations(problem, columns) / np.sqrt(count),
    )
    return np.minimum(spike, MOST_SPIKE * slab_deviations(problem, columns))


def between_flight_deviations(problem: Problem, columns: Sequence) -> np.ndarray:
    """Return the between-flight standard deviations (P,)."""
    own = [problem.between.get((c.effect, c.parameter), 0.0) for c in columns]
    return np.maximum(BETWEEN * _shared_negligible_sizes(problem, columns), own)


def _shared_negligible_sizes(problem: Problem, columns: Sequence) -> np.ndarray:
    """Return the negligible sizes (P,), each divided by the root of the number of confounded columns."""
    collinear = [
        problem.confounded.get((c.effect, c.parameter), 1.0) * (2.0 if c.fixed else 1.0) for c in columns
    ]
    return np.array([problem.parameter(c).negligible for c in columns]) / np.sqrt(collinear)


def confounding(linear: Linearisation) -> dict[tuple[str, str], float]:
    """Return (effect, parameter) -> effective number of columns collinear with it: sum of squared cosines."""
    a = linear.a.sum(axis=0)
    scale = np.sqrt(np.maximum(np.diag(a), 1e-300))
    squared = (a / np.outer(scale, scale)) ** 2
    count = np.maximum(1.0, squared.sum(axis=0))
    return {(c.effect, c.parameter): float(x) for c, x in zip(linear.columns, count)}


def excitation(problem: Problem, linear: Linearisation) -> dict[tuple[str, str], float]:
    """Return (effect, parameter) -> number of flights (>= 1) that excite it beyond what flights differ by."""
    spread = between_flight_deviations(problem, linear.columns)
    share = np.minimum(1.0, np.einsum("gkk->gk", linear.a) * spread**2).sum(axis=0)
    return {(c.effect, c.parameter): max(1.0, float(x)) for c, x in zip(linear.columns, share)}


def estimate_between_flight_deviations(
    problem: Problem, linear: Linearisation
) -> dict[tuple[str, str], float]:
    """Return (effect, parameter) -> between-flight standard deviation, by expectation maximisation.

    The prior counts as SEEN_BEFORE flights: with one flight that excites an effect, it is all there is.
    """
    unit = _shared_negligible_sizes(problem, linear.columns)
    a, b = linear.a * np.outer(unit, unit), linear.b * unit
    prior = (unit / slab_deviations(problem, linear.columns)) ** 2
    known = np.array([problem.parameter(c).between for c in linear.columns]) / unit
    known = np.maximum(BETWEEN, known) ** 2
    variance, eye = known.copy(), np.eye(len(unit))
    # Of a loop, it is known by how much; of the rest, days differ as vehicles do.
    loop = np.array([problem.parameter(c).manoeuvre > 0.0 for c in linear.columns])
    most = np.maximum(known, np.where(loop, MOST_SPIKE**2, 1.0) / prior)
    sized = np.array([not problem.parameter(c).is_reference for c in linear.columns])
    share = PRIOR_FLIGHTS / (PRIOR_FLIGHTS + problem.groups)
    for _ in range(EM_ROUNDS):
        inner = np.linalg.inv(eye + a * variance)
        total = (inner @ a).sum(axis=0) + np.diag(prior)
        fleet = np.linalg.solve(total, np.einsum("gpq,gq->p", inner, b))
        covariance = variance[:, None] * inner
        own = np.einsum("gpq,gq->gp", covariance, b - a @ fleet)
        second = own**2 + np.diagonal(covariance, axis1=1, axis2=2)
        found = share * known + (1.0 - share) * second.mean(axis=0)
        variance = np.where(sized, np.clip(found, BETWEEN**2, most), BETWEEN**2)
    return {(c.effect, c.parameter): float(np.sqrt(v) * u) for c, v, u in zip(linear.columns, variance, unit)}


def slab_deviations(problem: Problem, columns: Sequence) -> np.ndarray:
    """Return the slabs' standard deviations (P,)."""
    width = []
    for column in columns:
        p = problem.parameter(column)
        width.append(OFF * p.negligible if p.is_reference else SLAB * abs(p.coordinate(p.plausible)))
    return np.array(width)


def slab_covariance(problem: Problem, columns: Sequence) -> np.ndarray:
    """Return the slabs' covariance (P, P).

    A size s about a reference that lies t N(0, 1/4) of the way to either side is s (1/2 - t) and s (1/2 + t)
    about both sides: with the same sign, or it would be a scale and no shape.
    """
    width = slab_deviations(problem, columns)
    shape = np.eye(len(columns))
    for i, one in enumerate(columns):
        for j, other in enumerate(columns):
            if one.fixed and (one.effect, one.parameter) == (other.effect, other.parameter):
                shape[i, j] = SHAPE_COVARIANCE[0, int(i != j)]
    return shape * np.outer(width, width)


@dataclasses.dataclass(frozen=True)
class Bounds:
    """Bounds of the coordinates along columns."""

    low: np.ndarray  # (P,)
    high: np.ndarray  # (P,)
    # Of the two columns of an effect about a reference: their places, bounds of the size and of the share
    # that the second has of it.
    pairs: tuple[tuple[int, int, tuple[float, float], tuple[float, float]], ...]

    @staticmethod
    def of(problem: Problem, columns: Sequence, unit: np.ndarray) -> Bounds:
        """Return the bounds in units (P,), from neutral."""
        low, high = np.full(len(columns), -np.inf), np.full(len(columns), np.inf)
        pairs: list[tuple[int, int, tuple[float, float], tuple[float, float]]] = []
        for k, column in enumerate(columns):
            if column.form:
                continue
            p = problem.parameter(column)
            least, most = (p.coordinate(x) / unit[k] for x in p.possible)
            if not column.fixed:
                low[k], high[k] = least, most
            elif k and columns[k - 1].effect == column.effect:
                effect = problem.library[column.effect]
                about = effect.reference
                assert about is not None  # a fixed parameter is a reference
                first, last = sorted(effect.at_ends(1.0, x)[1] for x in about.possible)
                pairs.append((k - 1, k, (least, most), (first, last)))
        return Bounds(low, high, tuple(pairs))

    def clip(self, at: np.ndarray) -> np.ndarray:
        """Return coordinates (P,) clipped to the bounds."""
        result = np.clip(at, self.low, self.high)
        for i, j, (least, most), (first, last) in self.pairs:
            size = at[i] + at[j]
            share = min(max(at[j] / size if size else 0.5, first), last)
            size = min(max(size, least), most)
            result[i], result[j] = size * (1.0 - share), size * share
        return result

    def within(self, at: np.ndarray, covariance: np.ndarray, own: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the mode of a truncated normal distribution and its log density relative to the mean.

        at (P,) mean, covariance (P, P); own (k,): the coordinates that have bounds. Active-set iteration:
        coordinates outside are fixed at their bound, the others conditioned on them.
        """
        outside, result, unlikely = np.zeros(len(at), bool), at, 0.0
        for _ in range(ACTIVE_SET_ROUNDS):
            clipped = self.clip(result)
            off = np.zeros(len(at), bool)
            off[own] = np.abs(clipped - result)[own] > 1e-9 * (1.0 + np.abs(clipped[own]))
            if not off.any():
                break
            outside |= off
            k = np.flatnonzero(outside)
            apart = clipped[k] - at[k]
            through = np.linalg.solve(covariance[np.ix_(k, k)] + 1e-9 * np.eye(len(k)), apart)
            result, unlikely = at + covariance[:, k] @ through, -0.5 * float(apart @ through)
            result[k] = clipped[k]
        return result, unlikely


@dataclasses.dataclass
class LinearGaussian:
    """Quadratic log-likelihood of the flights near one point, coordinates in units of the spikes.

    log p = -1/2 (c - 2 b'x + x'a x) of every flight (or group of windows), random effects integrated out.
    """

    problem: Problem
    columns: tuple
    at: np.ndarray  # (P,) where it was linearised, from neutral, in spikes
    a: np.ndarray  # (g, P, P)
    b: np.ndarray  # (g, P)
    c: np.ndarray  # (g,)
    unit: np.ndarray  # (P,) spikes
    slab: np.ndarray  # (P, P) covariance of what is named, in spikes
    bounds: Bounds  # in spikes, from neutral
    off: np.ndarray  # (P,) mean of theta
    known: np.ndarray  # (P, P) covariance of theta
    between: np.ndarray  # (P,) variance between flights
    flight_a: np.ndarray  # (f, P, P) of every flight, its deviation not integrated out
    flight_b: np.ndarray  # (f, P)

    @staticmethod
    def of(problem: Problem, linear: Linearisation, values: Values) -> LinearGaussian:
        """Return the model linearised at `values`."""
        columns = linear.columns
        unit = spike_deviations(problem, columns)
        at = problem.coordinates(values, columns)
        at = at / unit
        a = linear.a * np.outer(unit, unit)
        b = linear.b * unit
        c = linear.c
        flight_a, flight_b = linear.by_flight()
        flight_a, flight_b = flight_a * np.outer(unit, unit), flight_b * unit
        between = (between_flight_deviations(problem, columns) / unit) ** 2
        # Marginal over a deviation u of each flight, u ~ N(0, between) in every column.
        inner = np.linalg.inv(np.eye(len(columns)) + a * between)
        c = c - np.einsum("gp,p,gpq,gq->g", b, between, inner, b, optimize=True)
        b = np.einsum("gpq,gq->gp", inner, b)
        a = inner @ a
        a = 0.5 * (a + a.swapaxes(1, 2))
        off, known = problem.known(columns)
        slab = slab_covariance(problem, columns) / np.outer(unit, unit)
        off, known = off / unit, known / np.outer(unit, unit)
        bounds = Bounds.of(problem, columns, unit)
        return LinearGaussian(
            problem, columns, at, a, b, c, unit, slab, bounds, off, known, between, flight_a, flight_b
        )

    def index(self, names: Iterable[str]) -> np.ndarray:
        """Return the indices of the columns of the effects `names`."""
        names = set(names)
        return np.array([k for k, column in enumerate(self.columns) if column.effect in names], int)

    def change_covariance(self, names: EffectSet) -> np.ndarray:
        """Return the prior covariance (P, P) of delta: slabs for `names`, spikes for the others."""
        own = np.isin(np.arange(len(self.columns)), self.index(names))
        return np.where(np.outer(own, own), self.slab, np.diag(~own))

    def prior(self, names: EffectSet) -> tuple[np.ndarray, np.ndarray]:
        """Return the prior mean (P,) of z, from the linearisation point, and its covariance (P, P)."""
        return self.off - self.at, self.known + self.change_covariance(names)

    def evidence(self, weights: np.ndarray | None = None) -> Evidence:
        """Return the marginal likelihood as a function of a set; `weights` (g,): bootstrap counts."""
        w = np.ones(len(self.c)) if weights is None else weights
        mean, covariance = self.prior(frozenset())
        return Evidence.of(
            self, np.tensordot(w, self.a, axes=1), w @ self.b, float(w @ self.c), mean, covariance
        )

    def fit(self, names: EffectSet, weights: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return the posterior mean (P,) of z, from the linearisation point, and covariance, in spikes."""
        w = np.ones(len(self.c)) if weights is None else weights
        mean, prior = self.prior(names)
        a, b = np.tensordot(w, self.a, axes=1), w @ self.b
        covariance = np.linalg.solve(np.eye(len(b)) + prior @ a, prior)
        return mean + covariance @ (b - a @ mean), 0.5 * (covariance + covariance.T)

    def delta(self, names: EffectSet, weights: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return the posterior mean (P,) of delta, from neutral, and covariance (P, P), in spikes, unbounded.

        With z = theta + delta and prior covariance K = Sigma + V:  delta = V K^-1 (z - m).
        """
        change, covariance = self.fit(names, weights)
        mean, prior = self.prior(names)
        change_covariance = self.change_covariance(names)
        share = change_covariance @ np.linalg.inv(prior)
        return share @ (change - mean), change_covariance + share @ (covariance - prior) @ share.T

    def within(self, names: EffectSet, weights: np.ndarray | None = None) -> np.ndarray:
        """Return the posterior mode (P,) of delta within bounds, in spikes."""
        return self.bounds.within(*self.delta(names, weights), self.index(names))[0]

    def errors(self, names: EffectSet) -> np.ndarray:
        """Return the standard errors (P,) of delta, in spikes."""
        return np.sqrt(np.maximum(self.delta(names)[1].diagonal(), 0.0))

    def deviation(self, flight: int, change: np.ndarray) -> np.ndarray:
        """Return the posterior mean (P,) of one flight's random effect, in spikes."""
        a, b = self.flight_a[flight], self.flight_b[flight]
        return np.linalg.solve(a + np.diag(1.0 / self.between), b - a @ change)

    def sized(self, values: Values) -> dict[tuple[str, str], ParameterEstimate]:
        """Return (effect, parameter) -> its standard errors, for the set of `values`."""
        names = frozenset(values)
        change, _ = self.fit(names)
        _, covariance = self.delta(names)
        variance = self.errors(names) ** 2
        deviation = np.array([self.deviation(k, change) for k in range(len(self.flight_a))])
        alone = np.linalg.inv(self.flight_a + np.diag(1.0 / self.between))
        result = {}
        own = [(c.effect, c.parameter) for c in self.columns if c.effect in names and not c.form]
        for name, parameter in dict.fromkeys(own):
            k = [i for i, c in enumerate(self.columns) if (c.effect, c.parameter) == (name, parameter)]
            square = variance[k[0]] if len(k) == 1 else covariance[np.ix_(k, k)].sum()
            unit = self.unit[k[0]] * self.problem.parameter(self.columns[k[0]]).slope(values[name][parameter])
            result[name, parameter] = ParameterEstimate(
                error=float(np.sqrt(max(0.0, square)) * unit),
                deviation=deviation[:, k].sum(axis=1) * unit,
                alone=np.sqrt(np.maximum(0.0, alone[:, k][:, :, k].sum(axis=(1, 2)))) * unit,
                between=float(np.sqrt(self.between[k].mean()) * unit),
            )
        return result


@dataclasses.dataclass(frozen=True)
class ParameterEstimate:
    """Standard errors of a parameter, in its unit."""

    error: float  # standard error
    deviation: np.ndarray  # (f,) random effect of every flight
    alone: np.ndarray  # (f,) their standard errors
    between: float  # between-flight standard deviation


@dataclasses.dataclass
class Evidence:
    """Log marginal likelihood as a function of the set; what all sets share is integrated out once.

    With the prior covariance K of the empty set, about its mean,
    log p = -1/2 [c - b' (1 + K a)^-1 K b + log det(1 + K a)],  and for what a set has more, the same with
    a' = (1 + a K)^-1 a,  b' = (1 + a K)^-1 b  and the wider variances of its columns.
    """

    a: np.ndarray  # (P, P)
    b: np.ndarray  # (P,)
    empty: float  # log marginal likelihood of the empty set
    own: dict[str, np.ndarray]  # effect -> its columns
    slab: np.ndarray  # (P, P)
    ends: list[tuple[str, np.ndarray]]  # effects about a reference, with their two columns
    bounds: Bounds

    @staticmethod
    def of(local: LinearGaussian, a, b, c: float, mean: np.ndarray, covariance: np.ndarray) -> Evidence:
        """Return it for Gram matrices a, b, c summed over flights and the prior of the empty set."""
        c = c - 2.0 * b @ mean + mean @ a @ mean
        b = b - a @ mean
        inner = np.linalg.inv(np.eye(len(b)) + a @ covariance)
        square = b @ covariance @ inner @ b
        _, log_det = np.linalg.slogdet(inner)
        after = inner @ a
        own = {n: local.index([n]) for n in local.problem.library}
        empty = -0.5 * (c - square - log_det)
        ends = [(n, k[:2]) for n, k in own.items() if len(k) and local.columns[k[0]].fixed]
        return Evidence(0.5 * (after + after.T), inner @ b, float(empty), own, local.slab, ends, local.bounds)

    def __call__(self, names: EffectSet) -> float:
        """Return the log marginal likelihood of a set."""
        columns = [self.own[n] for n in sorted(names) if len(self.own[n])]
        if not columns:
            return self.empty
        k = np.concatenate(columns)
        at, score = self._mode(k, np.ones(len(k)))
        far = np.abs(at[k]) > 2.0 * np.sqrt(self.slab[k, k])
        if far.any():  # heavy tails: one time in five, sizes are LARGE times as large
            at_large, large = self._mode(k, np.where(far, LARGE, 1.0))
            large -= far.sum() * np.log(4.0)
            at, score = max(((at, score), (at_large, large)), key=lambda one: one[1])
        return score + sum(
            self._shape_log_prior(n, at[one], at[other]) for n, (one, other) in self.ends if n in names
        )

    def _shape_log_prior(self, name: str, low: float, high: float) -> float:
        """Return the log prior ratio of two sizes about a reference, relative to their normal prior.

        A size s about a reference t of the way to one side: log N(s) N(t; 0, 1/4) / |s|, less the normal one.
        """
        width = math.sqrt(self.slab[self.own[name][0], self.own[name][0]] / SHAPE_COVARIANCE[0, 0])
        s, ends = low + high, np.array([low, high]) / width
        t = 0.5 * (high - low) / s if s else math.inf
        product = -0.5 * (s / width) ** 2 - 2.0 * t * t - math.log(0.5 * max(abs(s) / width, 0.1))
        normal = -0.5 * ends @ np.linalg.solve(SHAPE_COVARIANCE, ends) - 0.5 * math.log(
            np.linalg.det(SHAPE_COVARIANCE)
        )
        return min(0.0, product - normal)

    def _mode(self, k: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the bounded mode (P,) of the columns k, slabs `times` (k,) as wide, and the log evidence."""
        prior = self.slab[np.ix_(k, k)] * np.outer(times, times) - np.eye(len(k))
        root = np.linalg.cholesky(prior + np.diag(np.maximum(1e-9, 1e-6 - prior.diagonal())))
        inner = np.eye(len(k)) + root.T @ self.a[np.ix_(k, k)] @ root
        factor = np.linalg.cholesky(inner)
        z = np.linalg.solve(factor, root.T @ self.b[k])
        at = np.zeros(len(self.b))
        at[k] = root @ np.linalg.solve(factor.T, z)
        score = self.empty + 0.5 * float(z @ z) - float(np.log(np.diagonal(factor)).sum())
        if np.array_equal(at, self.bounds.clip(at)):
            return at, score
        half, covariance = np.linalg.solve(factor, root.T), np.zeros_like(self.a)
        covariance[np.ix_(k, k)] = half.T @ half
        at, unlikely = self.bounds.within(at, covariance, k)
        return at, score + unlikely


def flight_weights(groups: int, seed: int = 0) -> np.ndarray:
    """Return the bootstrap counts (DRAWS, g) of the flights."""
    return (
        np.random.default_rng(seed)
        .multinomial(groups, np.full(groups, 1.0 / groups), BOOTSTRAP_SAMPLES)
        .astype(float)
    )
