"""Heterogeneity of flights: which of them are inconsistent with the others, and in which effects.

Every flight has an estimate of each effect relative to the common fit, small random effects allowed for
(`gaussian.BETWEEN`, and `Variation.manoeuvre` of the effects). The flights are split in two groups whose
effects differ with the slab prior (`columns.slab_deviations`), and the contrast is compared with the
scatter within the groups by an F test. All splits are tested: the false alarms are shared out evenly over the
sizes of the smaller group, within one size over its groups (Bonferroni), and over the effects.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import fdtrc, stdtrit

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.infer.gaussian import BETWEEN, collinearity
from inclined_landing.eval.gap.model.columns import ParameterColumn, Values, slab_deviations
from inclined_landing.eval.gap.model.problem import Linearisation, Problem
from inclined_landing.eval.gap.result import Difference, InconsistentFlights

PRIOR_DEGREES_OF_FREEDOM = 2.0  # of the mean square within groups, whose prior value is 1


def inconsistent_flights(problem: Problem, linear: Linearisation) -> tuple[InconsistentFlights, ...]:
    """Return the groups of flights that are inconsistent with the others, most significant first.

    linear: the flights linearised where all effects of the library are fitted jointly.
    """
    table = _FlightInformation.of(problem, linear)
    remaining, result = np.arange(len(problem.flights)), []
    while len(remaining) > 2:
        split = _most_significant_split(table, remaining)
        if split is None:
            break
        result.append(_described_split(problem, table, split, linear.values))
        remaining = np.array([k for k in remaining if k not in split.group])
    return tuple(result)


def summary_line(found: InconsistentFlights) -> str:
    """Return a note of one line on inconsistent flights."""
    names, several = ", ".join(d.effect for d in found.differences), len(found.flights) > 1
    return f"{', '.join(found.flights)} contradict{'' if several else 's'} the other flights in {names}"


@dataclasses.dataclass(frozen=True)
class _FlightInformation:
    """Gram matrices of every flight in negligible sizes, small random effects marginalised."""

    a: np.ndarray  # (f, P, P)
    b: np.ndarray  # (f, P)
    unit: np.ndarray  # (P,)
    known: np.ndarray  # (P,) prior precision
    own: dict[str, np.ndarray]  # effect -> its columns

    @staticmethod
    def of(problem: Problem, linear: Linearisation) -> _FlightInformation:
        """Return the information of the flights in a linearisation."""
        columns = linear.columns
        unit = np.array([problem.parameter(c).negligible for c in columns])
        a, b = linear.by_flight()
        a, b = a * np.outer(unit, unit), b * unit
        # Random effects u ~ N(0, S) of every flight, S diagonal: BETWEEN^2 shared by collinear columns, and
        # the model error of the loops (`manoeuvre`).  Marginal:  a -> (1 + a S)^-1 a,  b -> (1 + a S)^-1 b
        collinear = collinearity(linear)
        small = BETWEEN**2 / np.array([collinear[c.key] for c in columns])
        small += (np.array([problem.variation(c).manoeuvre for c in columns]) / unit) ** 2
        inner = np.linalg.inv(np.eye(len(unit)) + a * small)
        own: dict[str, list[int]] = {}
        for k, column in enumerate(columns):
            if isinstance(column, ParameterColumn) and not column.fixed:
                own.setdefault(column.effect, []).append(k)
        return _FlightInformation(
            inner @ a,
            np.einsum("fpq,fq->fp", inner, b),
            unit,
            (unit / slab_deviations(problem, columns)) ** 2,
            {name: np.array(index) for name, index in own.items()},
        )

    def part(self, index: np.ndarray, flights: Sequence[int]) -> _GroupContrast:
        """Return the contrasts of some flights in some columns, relative to their common fit."""
        # With the common fit x = A^-1 sum_g b_g, A = sum_g a_g:  score s_g = b_g - a_g x, whose covariance is
        #   P_gh = delta_gh a_g - a_g A^-1 a_h
        rows = np.asarray(flights)
        a, b = self.a[np.ix_(rows, index, index)], self.b[np.ix_(rows, index)]
        known = np.diag(self.known[index])
        inverse = np.linalg.inv(a.sum(axis=0) + 1e-6 * known)
        score = b - a @ (inverse @ b.sum(axis=0))
        precision = -np.einsum("fij,jk,gkl->figl", a, inverse, a, optimize=True)
        each = np.arange(len(rows))
        precision[each, :, each] += a + 1e-6 * known
        return _GroupContrast(precision, score, known)

    def exciting(self, name: str, flights: np.ndarray) -> np.ndarray:
        """Return those of `flights` that excite an effect."""
        index = self.own[name]
        scale = np.sqrt(self.known[index])
        own = self.a[np.ix_(flights, index, index)] / np.outer(scale, scale)
        return flights[np.linalg.eigvalsh(own).min(axis=-1) > 1.0 / thresholds.EXCITED**2]


@dataclasses.dataclass(frozen=True)
class _GroupContrast:
    """Scores of n flights in d columns about their common fit, and what groups of them differ by."""

    precision: np.ndarray  # (n, d, n, d)
    score: np.ndarray  # (n, d)
    known: np.ndarray  # (d, d) prior precision

    def difference(self, members: np.ndarray) -> _GroupDifference:
        """Return how groups (s, n) differ from the others."""
        # d = (P + K)^-1 s with the prior precision K; decrease of the squared error s' d
        score, own = self._group_information(members)
        covariance = np.linalg.inv(own + self.known)
        difference = np.einsum("sij,sj->si", covariance, score)
        return _GroupDifference(np.einsum("si,si->s", score, difference), difference, covariance)

    def mean_square(self, members: np.ndarray) -> np.ndarray:
        """Return the mean square (s,) within groups (s, n), at least 1."""
        n, d = self.score.shape
        flat = self.score.ravel()
        squares = flat @ np.linalg.solve(self.precision.reshape(n * d, n * d), flat)
        score, own = self._group_information(members)
        closed = np.einsum("si,si->s", score, np.linalg.solve(own, score[..., None])[..., 0])
        return np.maximum(1.0, (PRIOR_DEGREES_OF_FREEDOM + squares - closed) / self.degrees_of_freedom)

    def p_value(self, members: np.ndarray) -> np.ndarray:
        """Return the p-values (s,) of groups (s, n) by an F test: F = (gain / d) / mean square."""
        d = len(self.known)
        return fdtrc(
            d, self.degrees_of_freedom, self.difference(members).gain / d / self.mean_square(members)
        )

    @property
    def degrees_of_freedom(self) -> float:
        """Return the residual degrees of freedom."""
        n, d = self.score.shape
        return PRIOR_DEGREES_OF_FREEDOM + d * (n - 2)

    def _group_information(self, members: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the score (s, d) and information (s, d, d) of groups (s, n)."""
        inside = members.astype(float)
        own = np.einsum("sf,figl,sg->sil", inside, self.precision, inside, optimize=True)
        return inside @ self.score, own

    def candidate_groups(self) -> np.ndarray:
        """Return candidate groups (s, n): single flights, and cuts of their order along some directions."""
        # Directions: the first principal component of the whitened estimates, and the columns.
        n, d = self.score.shape
        each = np.arange(n)
        own = self.precision[each, :, each]
        estimate = np.linalg.solve(own + self.known, self.score[..., None])[..., 0]
        estimate = estimate @ np.linalg.cholesky(own.mean(axis=0) + self.known)
        main = np.linalg.svd(estimate - estimate.mean(axis=0), full_matrices=False)[2][:1]
        rows = np.vstack([main, np.eye(d)]) @ estimate.T
        rank = np.argsort(np.argsort(rows, axis=1), axis=1)
        members = np.concatenate([np.eye(n, dtype=bool), *(rank < m for m in range(1, n))])
        size = members.sum(axis=1)
        flip = (2 * size > n) | ((2 * size == n) & ~members[:, 0])
        return np.unique(members ^ flip[:, None], axis=0)


class _GroupDifference(NamedTuple):
    """How s groups of flights differ from the others in d columns."""

    gain: np.ndarray  # (s,) decrease of the squared error by the contrast
    contrast: np.ndarray  # (s, d)
    covariance: np.ndarray  # (s, d, d) of the contrast


@dataclasses.dataclass(frozen=True)
class _Split:
    """Two groups of flights and the effect in which they differ most significantly."""

    name: str
    group: tuple[int, ...]  # the smaller group
    others: tuple[int, ...]
    level: float  # p-value, corrected for multiple testing
    tested: int  # number of effects tested

    def membership(self, flights: Sequence[int]) -> np.ndarray:
        """Return the membership (1, n) of the smaller group among some flights."""
        return np.isin(flights, self.group)[None]


def _most_significant_split(table: _FlightInformation, remaining: np.ndarray) -> _Split | None:
    """Return the most significant split; None where none is significant."""
    best: _Split | None = None
    exciting = {name: table.exciting(name, remaining) for name in table.own}
    exciting = {name: flights for name, flights in exciting.items() if len(flights) > 2}
    for name, flights in exciting.items():
        part = table.part(table.own[name], flights)
        members = part.candidate_groups()
        # Bonferroni: groups of m flights share the part (1/m) / H of the level, H = sum_m 1/m: small groups
        # are likelier.
        n, sizes = members.shape[1], members.sum(axis=1)
        count = np.array([math.comb(n, m) * (0.5 if 2 * m == n else 1.0) for m in sizes])
        harmonic = sum(1.0 / m for m in range(1, n // 2 + 1))
        p = part.p_value(members) * (count * sizes * harmonic) * len(exciting)
        k = int(np.argmin(p))
        if p[k] < thresholds.INCONSISTENT and (best is None or p[k] < best.level):
            group = tuple(map(int, flights[members[k]]))
            others = tuple(int(f) for f in remaining if f not in group)
            best = _Split(name, group, others, float(p[k]), len(exciting))
    return best


def _described_split(
    problem: Problem, table: _FlightInformation, split: _Split, values: Values
) -> InconsistentFlights:
    """Return the contrast of two groups in effects chosen by forward selection and fitted jointly."""
    chosen, confounded = [split.name], {}
    flights, known = split.group + split.others, []  # effects that both groups excite
    for name in table.own:
        exciting = set(table.exciting(name, np.array(flights)))
        if exciting >= set(split.group) and len(exciting & set(split.others)) > 1:
            known.append(name)
    while True:
        last, rest = chosen[-1], [name for name in known if name not in chosen]
        after = [_conditional_test(table, split, chosen, name) for name in rest]
        explained = {
            r.name
            for r in after
            if r.own < thresholds.DIFFERS_BESIDE or r.p_value * split.tested >= thresholds.INCONSISTENT
        }
        first, *others = (_conditional_test(table, split, chosen[:-1], name) for name in (last, *rest))
        least = first.likelihood + math.log(thresholds.DIFFERS_ALIKE)
        likely = [r for r in others if r.name in explained and r.likelihood > least]
        confounded[last] = tuple(r.name for r in sorted(likely, key=lambda r: -r.likelihood))
        more = [r for r in after if r.name not in explained]
        if not more:
            break
        chosen.append(min(more, key=lambda r: (r.p_value, -r.likelihood)).name)
    index = np.concatenate([table.own[name] for name in chosen])
    difference = table.part(index, flights).difference(split.membership(flights))  # of one group
    size = difference.contrast[0] * table.unit[index]
    half = np.sqrt(difference.covariance[0].diagonal()) * table.unit[index]
    differences, at = [], 0
    for name in chosen:
        one, own = _conditional_test(table, split, [], name), slice(at, at := at + len(table.own[name]))
        times = stdtrit(one.degrees_of_freedom, 0.975) * math.sqrt(one.mean_square)
        differences.append(_difference(problem, name, confounded[name], size[own], times * half[own], values))
    names = [f.name for f in problem.flights]
    return InconsistentFlights(
        flights=tuple(names[k] for k in split.group),
        others=tuple(names[k] for k in split.others),
        differences=tuple(differences),
        p_value=split.level,
    )


@dataclasses.dataclass(frozen=True)
class _ConditionalTest:
    """F test of one effect on a split, given the effects already chosen."""

    name: str
    p_value: float
    likelihood: float  # log-likelihood, up to a constant
    mean_square: float
    degrees_of_freedom: float
    own: float  # share of its information that is not confounded with the effects already chosen


def _conditional_test(
    table: _FlightInformation, split: _Split, chosen: Sequence[str], name: str
) -> _ConditionalTest:
    """Return the F test of one more effect as a contrast between the groups of a split."""
    flights = table.exciting(name, np.array(split.group + split.others))
    members, own = split.membership(flights), table.own[name]
    part, share = table.part(own, flights), 1.0
    gain = float(part.difference(members).gain[0])
    if chosen:
        before = np.concatenate([table.own[n] for n in chosen])
        both = np.concatenate([before, own])
        less, more = (table.part(x, flights).difference(members).gain[0] for x in (before, both))
        # Share of its information not confounded with those chosen, by the Schur complement:
        #   tr[a_oo^+ (a_oo - a_ob a_bb^+ a_bo)] / d
        k, a = len(before), table.a[list(split.group)].sum(axis=0)[np.ix_(both, both)]
        schur = a[k:, k:] - a[k:, :k] @ np.linalg.pinv(a[:k, :k]) @ a[:k, k:]
        gain = max(0.0, float(more - less))
        share = float(np.trace(np.linalg.pinv(a[k:, k:]) @ schur) / len(own))
    mean_square, d = float(part.mean_square(members)[0]), len(own)
    p_value = float(fdtrc(d, part.degrees_of_freedom, gain / d / mean_square))
    # Variance unknown (Student t):  log L = (nu + d) / 2 log(1 + gain / (nu s^2))
    nu = part.degrees_of_freedom
    likelihood = 0.5 * (nu + d) * math.log1p(gain / mean_square / nu)
    return _ConditionalTest(name, p_value, likelihood, mean_square, nu, share)


def _difference(
    problem: Problem,
    name: str,
    confounded: tuple[str, ...],
    size: np.ndarray,
    half: np.ndarray,
    values: Values,
) -> Difference:
    """Return an effect's contrast as its values in a model of the others, or the other way round."""
    at = dict(problem.library[name].neutral) | dict(values.get(name, {}))
    parameters = [p for p in problem.library[name].parameters if not p.is_reference]
    swapped = any(p.one_signed and change < 0.0 for p, change in zip(parameters, size))
    shown, ci95 = dict(at), {}
    for p, change, width in zip(parameters, -size if swapped else size, half):
        ends = np.array([change, change - width, change + width])
        if p.is_ratio:
            ends = np.exp(ends)
        elif p.is_factor:
            ends = 1.0 + ends / max(at[p.name], p.negligible)
        shown[p.name], ci95[p.name] = float(ends[0]), (float(ends[1]), float(ends[2]))
    return Difference(name, confounded, swapped, shown, ci95)
