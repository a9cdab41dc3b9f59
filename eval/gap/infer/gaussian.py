"""Spike-and-slab marginal likelihoods of sets of effects, in a linearised hierarchical model.

    white error of a flight = J (z + u) + noise,   z = theta + delta

theta ~ N(m, Sigma): error of the identified vehicle, with the posterior covariance of its identification.
delta: change since then. Its prior is the *slab* for an effect of the set, as wide as real vehicles differ,
and the *spike* for every other, as wide as a negligible error: no model is exact. u ~ N(0, between^2): random
effect of every flight. Model errors of the formulas are columns of J as well (`model.columns`).

Probabilities are averaged over bootstrap samples of the flights (bagged posterior: Huggins and Miller 2023),
since no set is exactly true: the posterior under misspecification would be overconfident.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numba
import numpy as np

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.model.columns import (
    SHAPE_COVARIANCE,
    Candidates,
    Column,
    ParameterColumn,
    Values,
    at_an_end,
    slab_covariance,
    slab_deviations,
)
from inclined_landing.eval.gap.model.problem import Linearisation, Problem

# These widths were chosen by hand.
SPIKE = 0.35  # standard deviation of the spike, in negligible sizes: one of 230 exceeds such a size
BETWEEN = 0.35  # least between-flight standard deviation, in negligible sizes: as of the spike
# Slab widths of the second, wider component of the slab: sizes have heavy tails. Without it a changed
# attitude gain in recorded flights is only possible, and a thrust scale is sure next to a load.
LARGE = 4.0
LARGE_ODDS = 0.25  # of that component to the first: weights 1/5 and 4/5
LARGE_BEYOND = 2.0  # slab widths: a size below is never more probable by the wider component
# Flights are sampled with the same seed every time. A sample may lack what only few flights show: in the
# bundled example 11 % have neither of the two flights of ten that are near the ground. The ground effect's
# probability there is 0.91 by 400 samples; by 24 it has a standard deviation of 0.08 between seeds.
BOOTSTRAP_SAMPLES = 24
ACTIVE_SET_ROUNDS = 4  # of the mode of a truncated normal distribution
# Largest standard deviation of the spike, in those of the slab: the slab less the spike must be a covariance.
# For the two columns of an effect about a reference that covariance has the eigenvalues 0.5 and 0.125 of the
# slab's variance (SHAPE_COVARIANCE), and sqrt(0.125) = 0.35.
MOST_SPIKE = 0.5
MOST_SPIKE_ABOUT = 0.3
MOST_BETWEEN_LOOPS = (
    0.5  # largest between-flight deviation of attitude loops, in slabs: no loop is as modelled
)
EM_ROUNDS = 3  # more let the between-flight variance of confounded parameters run away
PRIOR_FLIGHTS = 2.0  # weight of the prior between-flight variance (inverse gamma), in flights

_SHAPE_LOG_DET = math.log(np.linalg.det(SHAPE_COVARIANCE))

EffectSet = frozenset[str]
Key = tuple[str, str]


@dataclasses.dataclass(frozen=True)
class Spread:
    """The spread between flights in every parameter, and what shares its information, by key."""

    # Between-flight standard deviation; effective number of columns collinear with it, and of flights that
    # excite it, both at least 1. Of a pair of columns, which has one key, these are the second's.
    between: Mapping[Key, float] = dataclasses.field(default_factory=dict)
    collinear: Mapping[Key, float] = dataclasses.field(default_factory=dict)
    excitation: Mapping[Key, float] = dataclasses.field(default_factory=dict)

    @staticmethod
    def of(problem: Problem, linear: Linearisation) -> Spread:
        """Return the spread that the flights show, linearised at a joint fit of all effects."""
        collinear = collinearity(linear)
        negligible = _negligible_sizes(problem, linear.columns, collinear)
        between = _between_by_em(problem, linear, negligible)
        # A flight g counts as min(1, a_gkk between^2): as 1 where it resolves the differences.
        sd = np.maximum(BETWEEN * negligible, [between[c.key] for c in linear.columns])
        share = np.minimum(1.0, np.einsum("gkk->gk", linear.a) * sd**2).sum(axis=0)
        return Spread(between, collinear, {c.key: max(1.0, float(x)) for c, x in zip(linear.columns, share)})

    def between_deviations(self, problem: Problem, columns: Sequence[Column]) -> np.ndarray:
        """Return the between-flight standard deviations (P,)."""
        estimated = [self.between.get(c.key, 0.0) for c in columns]
        return np.maximum(BETWEEN * _negligible_sizes(problem, columns, self.collinear), estimated)

    def spike_deviations(self, problem: Problem, columns: Sequence[Column]) -> np.ndarray:
        """Return the spikes' standard deviations (P,)."""
        # A share of the negligible size, what all flights of a day share, and the standard error of the mean
        # over the n flights that excite a column:
        #   sigma^2 = (SPIKE negligible)^2 + placement^2 + (between^2 - placement^2) / n
        # The two columns of an effect about a reference share the placement's variance.
        count = np.array([self.excitation.get(c.key, problem.groups) for c in columns])
        pair = np.array([at_an_end(c) for c in columns])
        placement = [problem.variation(c).placement for c in columns]
        placement_squared = np.square(placement) / np.where(pair, 2.0, 1.0)
        of_one_flight = self.between_deviations(problem, columns) ** 2 - placement_squared
        of_mean = np.maximum(of_one_flight, 0.0) / count
        negligible = _negligible_sizes(problem, columns, self.collinear)
        spike = np.sqrt((SPIKE * negligible) ** 2 + placement_squared + of_mean)
        most = np.where(pair, MOST_SPIKE_ABOUT, MOST_SPIKE)
        return np.minimum(spike, most * slab_deviations(problem, columns))


def collinearity(linear: Linearisation) -> dict[Key, float]:
    """Return the effective number of columns collinear with each (>= 1), by its key."""
    # n_j = sum_k cos^2(J_j, J_k),  cos = a_jk / sqrt(a_jj a_kk)
    a = linear.a.sum(axis=0)
    scale = np.sqrt(np.maximum(np.diag(a), 1e-300))
    squared = (a / np.outer(scale, scale)) ** 2
    count = np.maximum(1.0, squared.sum(axis=0))
    return {c.key: float(x) for c, x in zip(linear.columns, count)}


def _negligible_sizes(
    candidates: Candidates, columns: Sequence[Column], collinear: Mapping[Key, float]
) -> np.ndarray:
    """Return the negligible sizes (P,), each divided by the root of the number of collinear columns.

    The two columns of an effect about a reference count as collinear.
    """
    count = [collinear.get(c.key, 1.0) * (2.0 if at_an_end(c) else 1.0) for c in columns]
    return np.array([candidates.parameter(c).negligible for c in columns]) / np.sqrt(count)


def _between_by_em(problem: Problem, linear: Linearisation, unit: np.ndarray) -> dict[Key, float]:
    """Return the between-flight standard deviations by expectation maximisation (EM), by key.

    The prior counts as PRIOR_FLIGHTS flights. unit (P,): negligible sizes.
    """
    # White errors of a flight J (z + u_g) + noise, with a common z of the slab prior N(0, S) and random
    # effects u_g ~ N(0, V), V = diag v (Laird and Ware 1982), everything in `unit`.
    a, b = linear.a * np.outer(unit, unit), linear.b * unit
    slab_information = (unit / slab_deviations(problem, linear.columns)) ** 2  # S^-1
    # v_0: a unit, which confounded columns share as they share a negligible size; what varies with the
    # manoeuvre in each of them, since no loop is quite of its form.
    parameters = [problem.parameter(c) for c in linear.columns]
    manoeuvre = np.array([problem.variation(c).manoeuvre for c in linear.columns])
    loop = manoeuvre > 0.0
    deviation = np.where(loop, np.maximum(manoeuvre, [p.negligible for p in parameters]) / unit, 1.0)
    prior_variance = np.maximum(BETWEEN, deviation) ** 2
    variance, eye = prior_variance.copy(), np.eye(len(unit))
    # Bounds: for the attitude loops a part of a slab, for the rest a whole one (days differ as vehicles do).
    # What an effect is relative to (a reference) has no size that could vary.
    most = np.maximum(prior_variance, np.where(loop, MOST_BETWEEN_LOOPS**2, 1.0) / slab_information)
    has_size = np.array([not p.is_reference for p in parameters])
    share = PRIOR_FLIGHTS / (PRIOR_FLIGHTS + problem.groups)
    for _ in range(EM_ROUNDS):
        # E, with M_g = (1 + a_g V)^-1:  z = (sum_g M_g a_g + S^-1)^-1 sum_g M_g b_g, and of every u_g the
        # covariance C_g = V M_g and the mean m_g = C_g (b_g - a_g z)
        inner = np.linalg.inv(eye + a * variance)
        total = (inner @ a).sum(axis=0) + np.diag(slab_information)
        common = np.linalg.solve(total, np.einsum("gpq,gq->p", inner, b))
        covariance = variance[:, None] * inner
        mean = np.einsum("gpq,gq->gp", covariance, b - a @ common)
        # M, with the prior v_0:  v = s v_0 + (1 - s) mean_g (m_g^2 + diag C_g),  s = n_0 / (n_0 + n)
        second = mean**2 + np.diagonal(covariance, axis1=1, axis2=2)
        found = share * prior_variance + (1.0 - share) * second.mean(axis=0)
        variance = np.where(has_size, np.clip(found, BETWEEN**2, most), BETWEEN**2)
    return {c.key: float(np.sqrt(v) * u) for c, v, u in zip(linear.columns, variance, unit)}


class Bounds(NamedTuple):
    """Bounds of the coordinates along columns."""

    low: np.ndarray  # (P,)
    high: np.ndarray  # (P,)
    # Of the n effects about a reference, whose size is the sum of two columns:
    seconds: np.ndarray  # (n,) the second column, about the highest reference, next to the other
    sizes: np.ndarray  # (n, 2) bounds of the size
    shares: np.ndarray  # (n, 2) bounds of the second column's share of it, which the reference determines

    @staticmethod
    def of(candidates: Candidates, columns: Sequence[Column], unit: np.ndarray) -> Bounds:
        """Return the bounds in units (P,), from neutral."""
        low, high = np.full(len(columns), -np.inf), np.full(len(columns), np.inf)
        seconds, sizes, shares = list[int](), list[float](), list[float]()
        for k, column in enumerate(columns):
            if not isinstance(column, ParameterColumn):
                continue
            p = candidates.parameter(column)
            least, most = (p.coordinate(x) / unit[k] for x in p.possible)
            if not column.fixed:
                low[k], high[k] = least, most
            elif k and columns[k - 1].effect == column.effect:  # the second of a pair, next to the first
                effect = candidates.library[column.effect]
                about = effect.reference
                assert about is not None  # a fixed parameter is a reference
                seconds.append(k)
                sizes += least, most
                shares += sorted(effect.at_ends(1.0, x)[1] for x in about.possible)
        of_pairs = np.array(sizes).reshape(-1, 2), np.array(shares).reshape(-1, 2)
        return Bounds(low, high, np.array(seconds, int), *of_pairs)


@numba.njit(cache=True, nogil=True)
def clipped(at, bounds):
    """Return coordinates (P,) clipped to the bounds."""
    result = np.minimum(np.maximum(at, bounds.low), bounds.high)
    for j, sizes, shares in zip(bounds.seconds, bounds.sizes, bounds.shares):
        i = j - 1
        size = at[i] + at[j]
        share = min(max(at[j] / size if size != 0.0 else 0.5, shares[0]), shares[1])
        size = min(max(size, sizes[0]), sizes[1])
        result[i], result[j] = size * (1.0 - share), size * share
    return result


@numba.njit(cache=True, nogil=True)
def truncated_mode(at, covariance, own, bounds):
    """Return the mode (P,) of a truncated normal distribution and its log density relative to the mean.

    at (P,) mean, covariance (P, P); own (k,): the coordinates that have bounds.
    """
    # Active set A of coordinates fixed at their bounds c_A; the others conditioned on them:
    #   x = m + C_.A C_AA^-1 (c_A - m_A),   log p(x) - log p(m) = -1/2 (c_A - m_A)' C_AA^-1 (c_A - m_A)
    outside, result, log_ratio = np.zeros(len(at), np.bool_), at.copy(), 0.0
    for _ in range(ACTIVE_SET_ROUNDS):
        within, inside = clipped(result, bounds), True
        for k in own:
            if abs(within[k] - result[k]) > 1e-9 * (1.0 + abs(within[k])):
                outside[k], inside = True, False
        if inside:
            break
        active = np.flatnonzero(outside)
        of_active, shift = np.ascontiguousarray(covariance[:, active]), (within - at)[active]
        solved = np.linalg.solve(of_active[active] + 1e-9 * np.eye(len(active)), shift)
        result, log_ratio = at + of_active @ solved, -0.5 * (shift @ solved)
        result[active] = within[active]
    return result, log_ratio


@dataclasses.dataclass(frozen=True)
class LinearGaussian:
    """Linear-Gaussian model of the flights at one linearisation point, coordinates in units of the spikes.

    Laplace approximation: log p = -1/2 (c - 2 b'x + x'a x) of every group of windows, random effects of the
    flights marginalised.
    """

    candidates: Candidates
    columns: tuple[Column, ...]
    values: Values  # the linearisation point
    at: np.ndarray  # (P,) the same, from neutral, in spikes
    a: np.ndarray  # (g, P, P)
    b: np.ndarray  # (g, P)
    c: np.ndarray  # (g,)
    unit: np.ndarray  # (P,) standard deviations of the spikes
    slab: np.ndarray  # (P, P) covariance of the slab, in spikes
    bounds: Bounds  # in spikes, from neutral
    theta_mean: np.ndarray  # (P,) of its prior
    theta_covariance: np.ndarray  # (P, P)
    between: np.ndarray  # (P,) between-flight variance
    flight_a: np.ndarray  # (f, P, P) of every flight, its random effect not marginalised
    flight_b: np.ndarray  # (f, P)

    @staticmethod
    def of(problem: Problem, spread: Spread, linear: Linearisation) -> LinearGaussian:
        """Return the model of a linearisation."""
        columns = linear.columns
        unit = spread.spike_deviations(problem, columns)
        units = np.outer(unit, unit)
        a, b, c = linear.a * units, linear.b * unit, linear.c
        flight_a, flight_b = linear.by_flight()
        between = (spread.between_deviations(problem, columns) / unit) ** 2
        # Marginal over the random effect u ~ N(0, B) of each flight, B diagonal, with M = (1 + a B)^-1:
        #   a -> M a,   b -> M b,   c -> c - b' B M b
        inner = np.linalg.inv(np.eye(len(columns)) + a * between)
        c = c - np.einsum("gp,p,gpq,gq->g", b, between, inner, b, optimize=True)
        b = np.einsum("gpq,gq->gp", inner, b)
        a = inner @ a
        a = 0.5 * (a + a.swapaxes(1, 2))
        mean, covariance = problem.vehicle_prior(columns)
        return LinearGaussian(
            candidates=problem,
            columns=columns,
            values=linear.values,
            at=problem.coordinates(linear.values, columns) / unit,
            a=a,
            b=b,
            c=c,
            unit=unit,
            slab=slab_covariance(problem, columns) / units,
            bounds=Bounds.of(problem, columns, unit),
            theta_mean=mean / unit,
            theta_covariance=covariance / units,
            between=between,
            flight_a=flight_a * units,
            flight_b=flight_b * unit,
        )

    def for_sizes_of(self, names: EffectSet) -> LinearGaussian:
        """Return the model from which sizes of a set are read: some effects have slabs LARGE times as wide.

        These are the columns that meet both conditions:
        - They are large: the mode exceeds the slab's standard deviation. With the usual slab, the errors of
          the identified vehicle would take a share of them.
        - The flights show them apart from the others of the set: with wide slabs for all large columns, the
          standard error is below the usual slab. Else effects that compensate one another would all grow.
        """
        slab = np.sqrt(self.slab.diagonal())
        of_set = np.array([k for k in self.index(names) if isinstance(self.columns[k], ParameterColumn)], int)
        large = of_set[np.abs(self.bounded_mode(names)[of_set]) > slab[of_set]]

        def with_wide(columns: np.ndarray) -> np.ndarray:
            """Return the slabs' covariance (P, P), those of some columns widened."""
            times = np.where(np.isin(np.arange(len(slab)), columns), LARGE, 1.0)
            return np.outer(times, times) * self.slab

        # Covariance of the set's sizes, the vehicle and all formulas as they are:  C = (a + V^-1)^-1
        square = np.ix_(of_set, of_set)
        information = self.a.sum(axis=0)[square] + np.linalg.inv(with_wide(large)[square])
        apart = of_set[np.linalg.inv(information).diagonal() < slab[of_set] ** 2]
        return dataclasses.replace(self, slab=with_wide(np.intersect1d(large, apart)))

    def index(self, names: Iterable[str]) -> np.ndarray:
        """Return the indices of the columns of the effects `names`."""
        names = set(names)
        return np.array([k for k, column in enumerate(self.columns) if column.effect in names], int)

    def change_covariance(self, names: EffectSet) -> np.ndarray:
        """Return the spike-and-slab prior covariance (P, P) of delta: slabs for `names`, else spikes."""
        named = np.isin(np.arange(len(self.columns)), self.index(names))
        return np.where(np.outer(named, named), self.slab, np.diag(~named))

    def prior(self, names: EffectSet) -> tuple[np.ndarray, np.ndarray]:
        """Return the prior mean (P,) of z, from the linearisation point, and its covariance (P, P)."""
        return self.theta_mean - self.at, self.theta_covariance + self.change_covariance(names)

    def evidence(self, weights: np.ndarray | None = None) -> Evidence:
        """Return the log marginal likelihood as a function of a set; `weights` (g,): bootstrap counts."""
        w = np.ones(len(self.c)) if weights is None else weights
        return Evidence.of(self, np.tensordot(w, self.a, axes=1), w @ self.b, float(w @ self.c))

    def posterior(self, names: EffectSet, weights: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return the posterior mean (P,) of z, from the linearisation point, and covariance, in spikes."""
        # Posterior of a linear model (Bishop 3.50) with the prior N(m, K):
        #   C = (1 + K a)^-1 K,   z = m + C (b - a m),   a = sum_g w_g a_g,   b = sum_g w_g b_g
        w = np.ones(len(self.c)) if weights is None else weights
        mean, prior = self.prior(names)
        a, b = np.tensordot(w, self.a, axes=1), w @ self.b
        covariance = np.linalg.solve(np.eye(len(b)) + prior @ a, prior)
        return mean + covariance @ (b - a @ mean), 0.5 * (covariance + covariance.T)

    def change(self, names: EffectSet, weights: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return the posterior mean (P,) and covariance (P, P) of delta, in spikes, without bounds."""
        # z = theta + delta with the prior covariance K = Sigma + V;  given z (Bishop 2.81), with G = V K^-1:
        #   E delta = G (z - m),   Cov delta = V + G (C - K) G'
        change, covariance = self.posterior(names, weights)
        mean, prior = self.prior(names)
        slab = self.change_covariance(names)
        gain = slab @ np.linalg.inv(prior)
        return gain @ (change - mean), slab + gain @ (covariance - prior) @ gain.T

    def bounded_mode(self, names: EffectSet, weights: np.ndarray | None = None) -> np.ndarray:
        """Return the posterior mode (P,) of delta within bounds (truncated normal), in spikes."""
        return truncated_mode(*self.change(names, weights), self.index(names), self.bounds)[0]

    def reproduced(self, names: EffectSet, name: str, other: str) -> float:
        """Return the share of what `name` contributes, at its mode in a set, that `other` reproduces."""
        # R^2 of the regression, with the prior V of the other:  b'(a + V^-1)^-1 b / x'a x,  b = a x
        own, its, a = self.index([name]), self.index([other]), self.a.sum(axis=0)
        x = self.bounded_mode(names)[own]
        whole = float(x @ a[np.ix_(own, own)] @ x)
        if whole <= 0.0 or not len(its):
            return 0.0
        b = a[np.ix_(its, own)] @ x
        inner = a[np.ix_(its, its)] + np.linalg.inv(self.slab[np.ix_(its, its)])
        return float(b @ np.linalg.solve(inner, b)) / whole

    def random_effect(self, flight: int, change: np.ndarray) -> np.ndarray:
        """Return the posterior mean (P,) of one flight's random effect (BLUP), in spikes."""
        a, b = self.flight_a[flight], self.flight_b[flight]
        return np.linalg.solve(a + np.diag(1.0 / self.between), b - a @ change)

    def parameter_errors(self, values: Values) -> dict[tuple[str, str], ParameterErrors]:
        """Return (effect, parameter) -> its errors, for the set of `values`."""
        names = frozenset(values)
        _, covariance = self.change(names)
        result = {}
        fitted = [c.key for c in self.columns if c.effect in names and isinstance(c, ParameterColumn)]
        for name, parameter in dict.fromkeys(fitted):
            # One column or, of an effect about a reference, two, of which the size is the sum
            k = [i for i, c in enumerate(self.columns) if c.key == (name, parameter)]
            square = covariance[np.ix_(k, k)].sum()
            p = self.candidates.parameter(self.columns[k[0]])
            unit = self.unit[k[0]] * p.slope(values[name][parameter])
            result[name, parameter] = ParameterErrors(
                error=float(np.sqrt(max(0.0, square)) * unit),
                between=float(np.sqrt(self.between[k].mean()) * unit),
            )
        return result


@dataclasses.dataclass(frozen=True)
class ParameterErrors:
    """Standard error and between-flight deviation of a parameter, in its unit."""

    error: float  # standard error
    between: float  # between-flight standard deviation


@dataclasses.dataclass(frozen=True)
class Evidence:
    """Log marginal likelihood (model evidence) as a function of the set.

    The priors that all sets share are marginalised once, so that a set costs a matrix of its own columns.
    """

    a: np.ndarray  # (P, P)
    b: np.ndarray  # (P,)
    empty: float  # log marginal likelihood of the empty set
    own: dict[str, np.ndarray]  # effect -> indices of its columns
    slab: np.ndarray  # (P, P)
    ends: list[tuple[str, np.ndarray]]  # effects about a reference, with their two columns
    bounds: Bounds

    @staticmethod
    def of(local: LinearGaussian, a: np.ndarray, b: np.ndarray, c: float) -> Evidence:
        """Return the evidence for Gram matrices a, b, c summed over flights."""
        mean, covariance = local.prior(frozenset())
        # Evidence of a linear model (Bishop 3.86), prior N(m, K) of the empty set, a, b, c taken about m:
        #   log p = -1/2 [c - b' K M b + log det(1 + a K)],  M = (1 + a K)^-1
        # and, for what a set has in addition, the same with a -> M a, b -> M b.
        c = c - 2.0 * b @ mean + mean @ a @ mean
        b = b - a @ mean
        inner = np.linalg.inv(np.eye(len(b)) + a @ covariance)
        square = b @ covariance @ inner @ b
        _, log_det = np.linalg.slogdet(inner)
        after = inner @ a
        own = {n: local.index([n]) for n in local.candidates.library}
        empty = -0.5 * (c - square - log_det)
        ends = [(n, k[:2]) for n, k in own.items() if len(k) and at_an_end(local.columns[k[0]])]
        return Evidence(0.5 * (after + after.T), inner @ b, float(empty), own, local.slab, ends, local.bounds)

    def __call__(self, names: EffectSet) -> float:
        """Return the log marginal likelihood of a set."""
        columns = [self.own[n] for n in sorted(names) if len(self.own[n])]
        if not columns:
            return self.empty
        k = np.concatenate(columns)
        at, score = self._mode(k, np.ones(len(k)))
        far = np.abs(at[k]) > LARGE_BEYOND * np.sqrt(self.slab[k, k])
        # Scale mixture: the wider component, with its odds for every such size, where that is more probable
        if far.any():
            at_large, large = self._mode(k, np.where(far, LARGE, 1.0))
            large += far.sum() * math.log(LARGE_ODDS)
            if large > score:
                at, score = at_large, large
        return score + sum(
            self._shape_log_prior(n, at[one], at[other]) for n, (one, other) in self.ends if n in names
        )

    def _shape_log_prior(self, name: str, low: float, high: float) -> float:
        """Return the log prior of a size about a reference, less that of its columns' bivariate normal."""
        # A size s about a reference at the share t from the middle: low = s (1/2 - t), high = s (1/2 + t).
        # Change of variables (low, high) -> (s, t), Jacobian |s|:  log [N(s; 0, w^2) N(t; 0, 1/4) / |s|]
        # less the log density of N(0, SHAPE_COVARIANCE w^2). That stands for t ~ N(0, 1/16), half as wide,
        # since the pair's covariance must exceed the spikes'. The least |s| taken is w/10: without a size any
        # reference does. It is at most 0, so that no set gains by a size near zero, where 1/|s| is large.
        width = math.sqrt(self.slab[self.own[name][0], self.own[name][0]] / SHAPE_COVARIANCE[0, 0])
        s, ends = low + high, np.array([low, high]) / width
        t = 0.5 * (high - low) / s if s else math.inf
        log_product = -0.5 * (s / width) ** 2 - 2.0 * t * t - math.log(0.5 * max(abs(s) / width, 0.1))
        log_normal = -0.5 * ends @ np.linalg.solve(SHAPE_COVARIANCE, ends) - 0.5 * _SHAPE_LOG_DET
        return min(0.0, log_product - log_normal)

    def _mode(self, k: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the bounded mode (P,) of the columns k, slabs `times` (k,) as wide, and the log evidence."""
        at, gain = _bounded_mode(self.a, self.b, self.slab, self.bounds, k, times)
        return at, self.empty + gain


@numba.njit(cache=True, nogil=True)
def _bounded_mode(a, b, slab, bounds, k, times):
    """Return the bounded mode (P,) of the columns k, slabs `times` (k,) as wide; gain of the log evidence."""
    # With V = L L' the additional prior covariance, a and b those of the columns k, and F F' = 1 + L' a L:
    #   H = F^-1 L',   mode H' H b,   covariance H' H,   log p = log p_0 + 1/2 |H b|^2 - log det F
    # V is the slab less the spike, which every set has and is 1 in its own units. Slabs are wider than spikes
    # (MOST_SPIKE).
    eye, prior = np.eye(len(k)), slab[k][:, k] * np.outer(times, times)
    for i in range(len(k)):
        prior[i, i] -= 1.0 - 1e-9
    root = np.linalg.cholesky(prior)
    factor = np.linalg.cholesky(eye + root.T @ (np.ascontiguousarray(a[k][:, k]) @ root))
    half = np.linalg.solve(factor, np.ascontiguousarray(root.T))
    white, at = half @ b[k], np.zeros(len(b))
    at[k] = half.T @ white
    gain = 0.5 * (white @ white) - np.log(np.diag(factor)).sum()
    if np.array_equal(at, clipped(at, bounds)):
        return at, gain
    # Beyond a bound: the density at the mode of the truncated distribution, relative to that at the mean
    covariance = np.zeros_like(a)
    inner = half.T @ half
    for i in range(len(k)):
        for j in range(len(k)):
            covariance[k[i], k[j]] = inner[i, j]
    at, log_ratio = truncated_mode(at, covariance, k, bounds)
    return at, gain + log_ratio


def prior_share(effects: int) -> float:
    """Return the prior probability of each of some effects, with which none is missing with PRIOR_EMPTY."""
    return 1.0 - thresholds.PRIOR_EMPTY ** (1.0 / max(1, effects))  # (1 - s)^n = PRIOR_EMPTY


def flight_weights(groups: int) -> np.ndarray:
    """Return bootstrap counts (BOOTSTRAP_SAMPLES, g) of the flights."""
    rng, shares = np.random.default_rng(0), np.full(groups, 1.0 / groups)
    return rng.multinomial(groups, shares, BOOTSTRAP_SAMPLES).astype(float)
