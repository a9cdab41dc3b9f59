"""Do all flights tell of one vehicle on one day? Which contradict the others, and in what.

Every flight says how far it lies from the fit of all in each effect, everything else allowed the small
differences that flights may have (`posterior.BETWEEN`, and `Parameter.manoeuvre` of the effects). Flights are
split in two groups, each effect's size free to differ between them as widely as real vehicles differ
(`posterior.slab_deviations`), and the difference is compared with how far flights of one group scatter: an F test.
Every way to split them counts. All groups of one size have a share of the false alarms together, a smaller
one the larger they are, since one odd flight among many is what happens most; and each effect has its share.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from scipy import stats

from inclined_landing.eval.gap.result import Difference, InconsistentFlights
from inclined_landing.eval.gap.search.evidence import Linearisation, Problem, Values
from inclined_landing.eval.gap.search.posterior import BETWEEN, confounding, slab_deviations

SIGNIFICANCE = 0.01  # diagnoses of one vehicle in which flights are said to contradict each other
# The scatter of flights within a group is known beforehand as well as if so many more numbers had been seen,
# with the size that noise and small differences give: how it varies over effects and sets of flights.
PRIOR_DEGREES_OF_FREEDOM = 2.0
# A flight has a say in an effect when it tells more of it than was known beforehand.
LEAST_INFORMATION = 0.7  # standard error as a share of what is known
CONFOUNDED = 0.05  # likelihood beside the best effect's, above which another may be meant
UNCONFOUNDED = (
    0.5  # of what an effect changes, the share that others do not, above which it is another matter
)


def inconsistent_flights(
    problem: Problem, linear: Linearisation, values: Values
) -> tuple[InconsistentFlights, ...]:
    """Return the groups of flights that are inconsistent with the others, most significant first.

    near: the flights linearised at `values`, all effects of the library fitted together.
    """
    table = _FlightInformation.of(problem, linear)
    remaining, result = np.arange(len(problem.flights)), []
    while len(remaining) > 2:
        split = _most_significant_split(table, remaining)
        if split is None:
            break
        result.append(_described_split(problem, table, split, values))
        remaining = np.array([k for k in remaining if k not in split.group])
    return tuple(result)


def summary_line(against: InconsistentFlights) -> str:
    """Return a one-line note on inconsistent flights."""
    names, several = ", ".join(d.effect for d in against.differences), len(against.flights) > 1
    return f"{', '.join(against.flights)} contradict{'' if several else 's'} the other flights in {names}"


@dataclasses.dataclass
class _FlightInformation:
    """Gram matrices of every flight in units of `negligible`, small random effects integrated out."""

    a: np.ndarray  # (f, P, P)
    b: np.ndarray  # (f, P)
    unit: np.ndarray  # (P,)
    known: np.ndarray  # (P,) precision of what is known beforehand
    own: dict[str, np.ndarray]  # effect -> its columns

    @staticmethod
    def of(problem: Problem, linear: Linearisation) -> _FlightInformation:
        """Return the table of a linearisation."""
        columns = linear.columns
        unit = np.array([problem.parameter(c).negligible for c in columns])
        a, b = linear.by_flight()
        a, b = a * np.outer(unit, unit), b * unit
        # What looks alike shares the small differences; beside them, no loop is quite of its form.
        confounded = confounding(linear)
        small = BETWEEN**2 / np.array([confounded[c.effect, c.parameter] for c in columns])
        small += (np.array([problem.parameter(c).manoeuvre for c in columns]) / unit) ** 2
        inner = np.linalg.inv(np.eye(len(unit)) + a * small)
        own: dict[str, list[int]] = {}
        for k, column in enumerate(columns):
            if not (column.fixed or column.form):
                own.setdefault(column.effect, []).append(k)
        return _FlightInformation(
            inner @ a,
            np.einsum("fpq,fq->fp", inner, b),
            unit,
            (unit / slab_deviations(problem, columns)) ** 2,
            {name: np.array(index) for name, index in own.items()},
        )

    def part(self, index: np.ndarray, flights: Sequence[int]) -> _GroupContrast:
        """Return some columns of some flights, relative to their common fit."""
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
        return flights[np.linalg.eigvalsh(own).min(axis=-1) > 1.0 / LEAST_INFORMATION**2]


@dataclasses.dataclass
class _GroupContrast:
    """Heterogeneity of some flights in some columns."""

    precision: np.ndarray  # (n, d, n, d)
    score: np.ndarray  # (n, d)
    known: np.ndarray  # (d, d) precision of what is known beforehand

    def difference(self, members: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return gain (s,), difference (s, d) to the others and its covariance (s, d, d) of groups (s, n)."""
        score, own = self._group_information(members)
        covariance = np.linalg.inv(own + self.known)
        difference = np.einsum("sij,sj->si", covariance, score)
        return np.einsum("si,si->s", score, difference), difference, covariance

    def mean_square(self, members: np.ndarray) -> np.ndarray:
        """Return the residual mean square (s,) given groups (s, n), at least 1."""
        n, d = self.score.shape
        flat = self.score.ravel()
        squares = flat @ np.linalg.solve(self.precision.reshape(n * d, n * d), flat)
        score, own = self._group_information(members)
        closed = np.einsum("si,si->s", score, np.linalg.solve(own, score[..., None])[..., 0])
        return np.maximum(1.0, (PRIOR_DEGREES_OF_FREEDOM + squares - closed) / self.degrees_of_freedom)

    def p_value(self, members: np.ndarray) -> np.ndarray:
        """Return the p-values (s,) of groups (s, n), by an F test."""
        d = len(self.known)
        return stats.f.sf(
            self.difference(members)[0] / d / self.mean_square(members), d, self.degrees_of_freedom
        )

    @property
    def degrees_of_freedom(self) -> float:
        """Return the residual degrees of freedom."""
        n, d = self.score.shape
        return PRIOR_DEGREES_OF_FREEDOM + d * (n - 2)

    def _group_information(self, members: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        inside = members.astype(float)
        own = np.einsum("sf,figl,sg->sil", inside, self.precision, inside, optimize=True)
        return inside @ self.score, own

    def candidate_groups(self) -> np.ndarray:
        """Return candidate groups (s, n): each flight alone, all cuts of the order along some directions."""
        n, d = self.score.shape
        each = np.arange(n)
        own = self.precision[each, :, each]
        away = np.linalg.solve(own + self.known, self.score[..., None])[..., 0]
        away = away @ np.linalg.cholesky(own.mean(axis=0) + self.known)
        main = np.linalg.svd(away - away.mean(axis=0), full_matrices=False)[2][:1]
        rows = np.vstack([main, np.eye(d)]) @ away.T
        place = np.argsort(np.argsort(rows, axis=1), axis=1)
        members = np.concatenate([np.eye(n, dtype=bool), *(place < m for m in range(1, n))])
        size = members.sum(axis=1)
        flip = (2 * size > n) | ((2 * size == n) & ~members[:, 0])
        return np.unique(members ^ flip[:, None], axis=0)


@dataclasses.dataclass
class _Split:
    """Two groups of flights and the effect in which they differ most significantly."""

    name: str
    group: tuple[int, ...]  # the smaller group
    others: tuple[int, ...]
    level: float  # probability of a difference like this in any of all tests, by chance
    tested: int  # effects


def _most_significant_split(table: _FlightInformation, remaining: np.ndarray) -> _Split | None:
    """Return the most significant split; None where none is significant."""
    best: _Split | None = None
    exciting = {name: table.exciting(name, remaining) for name in table.own}
    exciting = {name: flights for name, flights in exciting.items() if len(flights) > 2}
    for name, flights in exciting.items():
        part = table.part(table.own[name], flights)
        members = part.candidate_groups()
        p = part.p_value(members) * _multiplicity(members) * len(exciting)
        k = int(np.argmin(p))
        if p[k] < SIGNIFICANCE and (best is None or p[k] < best.level):
            group = tuple(map(int, flights[members[k]]))
            others = tuple(int(f) for f in remaining if f not in group)
            best = _Split(name, group, others, float(p[k]), len(exciting))
    return best


def _multiplicity(members: np.ndarray) -> np.ndarray:
    """Return the multiple-testing factor (s,) of groups (s, n), from the number of that size."""
    n, sizes = members.shape[1], members.sum(axis=1)
    every = sum(1.0 / m for m in range(1, n // 2 + 1))
    count = np.array([math.comb(n, m) * (0.5 if 2 * m == n else 1.0) for m in sizes])
    return count * sizes * every


def _described_split(
    problem: Problem, table: _FlightInformation, split: _Split, values: Values
) -> InconsistentFlights:
    """Describe the difference of two groups: effects chosen forward, fitted jointly, with confounded ones."""
    chosen, confounded = [split.name], {}
    known = [name for name in table.own if _excited_in_both(table, split, name)]
    while True:
        last, rest = chosen[-1], [name for name in known if name not in chosen]
        after = [_conditional_test(table, split, chosen, name) for name in rest]
        explained = {
            r.name for r in after if r.own < UNCONFOUNDED or r.p_value * split.tested >= SIGNIFICANCE
        }
        first, *others = (_conditional_test(table, split, chosen[:-1], name) for name in (last, *rest))
        least = first.likelihood + math.log(CONFOUNDED)
        likely = [r for r in others if r.name in explained and r.likelihood > least]
        confounded[last] = tuple(r.name for r in sorted(likely, key=lambda r: -r.likelihood))
        more = [r for r in after if r.name not in explained]
        if not more:
            break
        chosen.append(min(more, key=lambda r: (r.p_value, -r.likelihood)).name)
    index = np.concatenate([table.own[name] for name in chosen])
    flights = split.group + split.others
    _, difference, covariance = table.part(index, flights).difference(_membership(split, flights))
    size = difference[0] * table.unit[index]
    half = np.sqrt(covariance[0].diagonal()) * table.unit[index]
    differences, at = [], 0
    for name in chosen:
        one, own = _conditional_test(table, split, [], name), slice(at, at := at + len(table.own[name]))
        times = stats.t.ppf(0.975, one.degrees_of_freedom) * math.sqrt(one.mean_square)
        differences.append(_difference(problem, name, confounded[name], size[own], times * half[own], values))
    names = [f.name for f in problem.flights]
    return InconsistentFlights(
        flights=tuple(names[k] for k in split.group),
        others=tuple(names[k] for k in split.others),
        differences=tuple(differences),
        p_value=split.level,
        false_alarms=SIGNIFICANCE,
    )


@dataclasses.dataclass(frozen=True)
class _ConditionalTest:
    """The test of one effect on a split, given the effects already chosen."""

    name: str
    p_value: float
    likelihood: float  # log, up to a constant
    mean_square: float
    degrees_of_freedom: float
    own: float  # share of what it changes in the smaller group that the others do not


def _excited_in_both(table: _FlightInformation, split: _Split, name: str) -> bool:
    """Tell whether both groups excite an effect, with enough flights for its variance."""
    exciting = set(table.exciting(name, np.array(split.group + split.others)))
    return exciting >= set(split.group) and len(exciting & set(split.others)) > 1


def _membership(split: _Split, flights: Sequence[int]) -> np.ndarray:
    """Return the membership (1, n) of the smaller group among some flights."""
    return np.isin(flights, split.group)[None]


def _conditional_test(
    table: _FlightInformation, split: _Split, chosen: Sequence[str], name: str
) -> _ConditionalTest:
    """Test one more effect as a difference between the groups of a split."""
    flights = table.exciting(name, np.array(split.group + split.others))
    members, own = _membership(split, flights), table.own[name]
    part, share = table.part(own, flights), 1.0
    gain = float(part.difference(members)[0][0])
    if chosen:
        before = np.concatenate([table.own[n] for n in chosen])
        both = np.concatenate([before, own])
        less, more = (table.part(x, flights).difference(members)[0][0] for x in (before, both))
        gain, share = max(0.0, float(more - less)), _unconfounded_share(table, split, before, own)
    mean_square, d = float(part.mean_square(members)[0]), len(own)
    p_value = float(stats.f.sf(gain / d / mean_square, d, part.degrees_of_freedom))
    likelihood = (
        0.5 * (part.degrees_of_freedom + d) * math.log1p(gain / mean_square / part.degrees_of_freedom)
    )
    return _ConditionalTest(name, p_value, likelihood, mean_square, part.degrees_of_freedom, share)


def _unconfounded_share(
    table: _FlightInformation, split: _Split, before: np.ndarray, own: np.ndarray
) -> float:
    """Return the share of the information on the columns `own` not confounded with the columns `before`."""
    index, k = np.concatenate([before, own]), len(before)
    a = table.a[list(split.group)].sum(axis=0)[np.ix_(index, index)]
    rest = a[k:, k:] - a[k:, :k] @ np.linalg.pinv(a[:k, :k]) @ a[:k, k:]
    return float(np.trace(np.linalg.pinv(a[k:, k:]) @ rest) / len(own))


def _difference(
    problem: Problem,
    name: str,
    confounded: tuple[str, ...],
    size: np.ndarray,
    half: np.ndarray,
    values: Values,
) -> Difference:
    """Return an effect's difference as its values in a model of the others, or the other way round."""
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
