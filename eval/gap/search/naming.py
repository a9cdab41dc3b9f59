"""Forward stepwise search for the effects that explain the flights, judged on flights left out.

Each step linearises the simulator with the effects found so far, ranks all others by what they explain
on flights left out, refits the best few through the simulator, and accepts the first that is supported
by windows of all flights, larger than negligible, the same in every flight and not at a bound.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from inclined_landing.eval.gap.result import Candidate, SearchStep
from inclined_landing.eval.gap.search.evidence import Column, Linear, Problem, Values, Weighted, invert, solve
from inclined_landing.eval.gap.search.fit import Fitted, at_and_bounds, fit_at, refit, standard_errors
from inclined_landing.eval.gap.search.trial import (
    Objection,
    Reason,
    Thresholds,
    Trial,
    corrects,
    negligible,
    objection,
    trial_of,
)

PAIR_GAIN = 1.3  # linear gain of a pair over that of its better half that makes it worth a fit
# Channels that are judged together.
CHANNEL_GROUPS = np.array([0, 0, 1, 2, 2, 3])


@dataclasses.dataclass
class Search:
    """The outcome of `search`."""

    fit: Fitted
    inflation: np.ndarray  # (6,)
    steps: list[SearchStep] = dataclasses.field(default_factory=list)
    closable: float = 1.0  # squared error the whole library could close at first
    gains: dict[str, float] = dataclasses.field(default_factory=dict)  # accepted effect -> share of it
    evidence: dict[str, float] = dataclasses.field(default_factory=dict)
    classes: dict[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)
    follows: dict[str, str] = dataclasses.field(default_factory=dict)  # accepted -> earlier that entails it
    unstable: list[str] = dataclasses.field(default_factory=list)  # turned away: flights disagree, or a bound
    unexplained: bool = False  # landings: errors remain


def search(problem: Problem, limits: Thresholds | None = None) -> Search:
    """Name the effects that explain the flights of `problem`."""
    limits = limits or Thresholds()
    found = Search(fit_at(problem, {}, [], np.ones(6)), np.ones(6))
    useless: set[str] = set()  # beside what was found later: not tried again, lest they take turns
    first = None
    for _ in range(limits.most + 1):
        step = _Step(problem, found.fit, useless, limits, first)
        first = first or step
        found.inflation, found.closable = step.inflation, first.closable
        accepted, reasons = _judge(step, found.unstable)
        ranked = step.ranked
        if not accepted:
            accepted = _pair(step)
            ranked = [*accepted, *(n for n in ranked if n not in accepted)]
        for name in accepted:
            _accept(step, name, found)
        dropped: tuple[str, ...] = ()
        if accepted:
            found.fit, dropped = _drop_useless(step, accepted)
            useless.update(dropped)
        members = [n for name in accepted for n in found.classes[name]]
        rows = tuple(
            step.row(n, members, "" if n in accepted else str(reasons.get(n) or Objection(Reason.LESS)))
            for n in ranked + [n for n in step.order if n not in ranked]
        )
        found.steps += [SearchStep(name, dropped, rows) for name in accepted or (None,)]
        if not accepted:
            break
    if found.fit.values:
        found.fit = refit(problem, found.fit.values, found.inflation)
        _most_plausible(problem, found, limits)
    weight = problem.weight / found.inflation
    nothing = problem.linearise({}, []).weighted(found.inflation).c.sum()
    closable = max(1e-9, float(nothing - (weight * problem.rows[:, None]).sum()))
    found.gains = {name: _share(problem, found, name, closable) for name in found.fit.values}
    named = set(found.fit.values).union(*(found.classes.get(n, ()) for n in found.fit.values))
    found.unstable = [n for n in found.unstable if n not in named]  # others may have to be found first
    return found


class _Step:
    """What a step of the search starts from, and the candidates it tried."""

    def __init__(
        self, problem: Problem, fit: Fitted, useless: set[str], limits: Thresholds, first: _Step | None
    ):
        self.problem, self.fit, self.limits, self.first = problem, fit, limits, first or self
        names = list(problem.library)
        self.linear: Linear = problem.linearise(fit.values, problem.columns(fit.values, names))
        self.inflation = self.linear.inflation()
        self.weighted = weighted = self.linear.weighted(self.inflation)
        self.base = weighted.index(list(fit.values))
        self.before = before = weighted.left_out(self.base)
        everything = np.arange(len(weighted.columns))
        self.change = weighted.fit(everything)
        self.closable = max(1e-9, float(before.sum() - weighted.left(everything, self.change).sum()))
        self.linear_gain = {
            n: float((before - weighted.left_out(np.concatenate([self.base, weighted.index([n])]))).sum())
            for n in names
            if n not in fit.values and n not in useless
        }
        self.order = sorted(self.linear_gain, key=lambda n: -self.linear_gain[n])
        tried = [n for n in self.order[: limits.shortlist] if self.linear_gain[n] > limits.gain / 3]
        self.trials = {n: self._trial(n) for n in tried}
        self.ranked = sorted(tried, key=lambda n: -self._score(n))

    def _trial(self, name: str) -> Trial:
        start = dict(self.problem.library[name].neutral)
        if any(self.weighted.columns[k].fixed for k in self.weighted.index([name])):
            start = _profiled_start(self, name)
        trial = refit(self.problem, {**self.fit.values, name: start}, self.inflation)
        return trial_of(self.problem, trial, name, self.before - trial.weighted.left_out(trial.index))

    def _score(self, name: str) -> float:
        """Gain less what a further parameter must bring."""
        best = max(t.gain for t in self.trials.values())
        extra = len(self.problem.library[name].parameters) - 1
        return self.trials[name].gain - extra * self.limits.simpler * max(best, 0.0)

    @functools.cached_property
    def closable_by_channel(self) -> np.ndarray:
        """What the library could close in every channel (6,), each with those judged together."""
        change = self.linear.by_channel(self.inflation, self.change)
        closable = np.maximum(0.0, self.linear.by_channel(self.inflation) - change)
        return np.bincount(CHANNEL_GROUPS, closable)[CHANNEL_GROUPS]

    def at_first(self, name: str, size: np.ndarray) -> float:
        """What was closable at first in the channels where an effect of this size shows."""
        shown = self.linear.shown_by_channel(self.inflation, self.linear.index([name]), size)
        share = float(shown @ self.first.closable_by_channel / max(shown.sum(), 1e-12))
        return min(self.first.closable, share)

    def objection(self, name: str, trial: Trial) -> Objection | None:
        """As `trial.objection`, an effect beside others measured by what was closable where it shows."""
        least = self.first.closable
        if self.fit.values:
            least = self.at_first(name, _size_in(self.weighted, self.base, self.weighted.index([name])))
        return objection(self.problem, name, trial, self.closable, least, self.limits, self.fit.values)

    def row(self, name: str, members: Sequence[str], reason: str) -> Candidate:
        """A candidate in the ranking of this step."""
        trial, tie = self.trials.get(name), name in members
        if trial is None:
            gain = self.linear_gain[name]
            return Candidate(name, gain, gain / self.closable, 0.0, False, tie, reason, {})
        share = trial.gain / self.closable
        return Candidate(name, trial.gain, share, trial.evidence, True, tie, reason, trial.values)


def _judge(step: _Step, unstable: list[str]) -> tuple[tuple[str, ...], dict[str, Objection | None]]:
    """The best candidate without an objection, (), if none, and those judged with what speaks against them.

    Large ones that flights do not agree on are added to `unstable`.
    """
    limits, reasons = step.limits, {}
    refused: list[str] = []
    for name in step.ranked:
        trial = step.trials[name]
        if not corrects(step.problem, name, step.fit.values) and any(
            _overlap(step.weighted, step.base, name, other) > limits.overlap for other in refused
        ):
            reasons[name] = Objection(Reason.SAME, {"other": refused[0]})
            continue
        reasons[name] = against = step.objection(name, trial)
        if against is None:
            return (name,), reasons
        large = trial.gain > limits.share * step.first.closable
        if large and against.reason in (Reason.DIFFERS, Reason.AT_BOUND):
            unstable.append(name)
        # A worse explanation of the same error must not slip in where the best one was refused.
        if trial.gain > limits.gain and against.reason in (Reason.DIFFERS, Reason.NEGLIGIBLE):
            refused.append(name)
    return (), reasons


def _pair(step: _Step) -> tuple[str, ...]:
    """The names of a pair that explains what neither of its effects explains alone; () if there is none.

    Its trial is added to those of the step.
    """
    problem, weighted, fit, limits = step.problem, step.weighted, step.fit, step.limits
    for pair in map(tuple, problem.pairs()):
        if any(n not in step.linear_gain for n in pair):
            continue
        both = np.concatenate([step.base, weighted.index(pair)])
        gain = float((step.before - weighted.left_out(both)).sum())
        if gain < max(limits.gain, PAIR_GAIN * max(step.linear_gain[n] for n in pair)):
            continue
        start = {n: problem.library[n].neutral for n in pair}
        new = refit(problem, {**fit.values, **start}, step.inflation)
        after = new.weighted.left_out(new.index)
        trial = trial_of(problem, new, pair[0], step.before - after)
        trials = {n: dataclasses.replace(trial, values=new.values[n]) for n in pair}
        if any(step.objection(n, trials[n]) for n in pair):
            continue
        for name in pair:
            half = refit(problem, {n: v for n, v in new.values.items() if n != name}, step.inflation)
            more = half.weighted.left_out(half.index) - after
            if more.sum() < limits.gain or standard_errors(more) < limits.evidence:
                break
        else:
            step.trials |= trials
            return pair
    return ()


def _accept(step: _Step, name: str, found: Search) -> None:
    """Enter what is known of an accepted effect."""
    trial = step.trials[name]
    for cause in step.fit.values:
        entailed = name in step.problem.library[cause].entails
        if entailed and trial.gain < step.limits.share_entailed * step.first.closable:
            found.follows[name] = cause
    found.evidence[name], found.gains[name] = trial.evidence, trial.gain
    found.classes[name] = _tie_class(step, name)


def _most_plausible(problem: Problem, found: Search, limits: Thresholds) -> None:
    """Of effects that look alike, name the one whose fit asks for the least unusual sizes of all effects."""
    classes, fit = found.classes, found.fit
    for name in list(fit.values):
        parameters = problem.library[name].parameters
        best = fit
        for other in classes.get(name, ()):
            if other in fit.values or len(problem.library[other].parameters) > len(parameters):
                continue
            values = {(other if n == name else n): v for n, v in fit.values.items()}
            new = refit(problem, values | {other: dict(problem.library[other].neutral)}, found.inflation)
            worse = new.weighted.left_out(new.index) - fit.weighted.left_out(fit.index)
            # Left out is linear: a fit that stopped in a long valley would seem as good as its other end.
            loss = max(float(worse.sum()), new.squares - fit.squares)
            if (
                loss < limits.gain + (1.0 - limits.alike) * found.gains[name]
                and standard_errors(worse) < limits.evidence
                and unusual(problem, new.values) < unusual(problem, best.values)
            ):
                best = new
        if best is not fit:
            other = next(n for n in best.values if n not in fit.values)
            for table in (found.evidence, classes, found.follows, found.gains):
                if name in table:
                    table[other] = table.pop(name)
            classes[other] = (other, *(n for n in classes[other] if n != other))
            fit = best
    found.fit = fit


def unusual(problem: Problem, values: Values) -> float:
    """Sum of the squared sizes of effects, each over its plausible size."""
    return sum(
        (p.size(values[name][p.name]) / p.size(p.plausible)) ** 2
        for name in values
        for p in problem.library[name].parameters
        if not p.is_reference
    )


def _profiled_start(step: _Step, name: str) -> dict[str, float]:
    """Start of a fit whose reference shows only once its effect is not neutral: the best of a grid."""
    effect, values = step.problem.library[name], step.fit.values
    first, other = effect.parameters[0], effect.reference
    grid = np.linspace(*other.bounds, 8)[1:-1]
    columns = [Column(c.effect, c.parameter) for c in step.weighted.columns if c.effect in values]
    columns += [Column(name, first.name, ((other.name, float(x)),)) for x in grid]
    linear = step.problem.linearise(values, columns).weighted(step.inflation)
    best, start = np.inf, dict(effect.neutral)
    known = len(columns) - len(grid)
    for k, x in enumerate(grid):
        index = np.array([*range(known), known + k])
        change = linear.fit(index)
        left = float(linear.left(index, change).sum())
        if left < best:
            best = left
            value = float(np.clip(first.neutral + change[-1], *first.bounds))
            start = {**effect.neutral, first.name: value, other.name: float(x)}
    return start


def _tie_class(step: _Step, name: str) -> tuple[str, ...]:
    """Effects that change the prediction as `name` does: each is explained by the other, R2 above a limit."""
    weighted, base, alike = step.weighted, step.base, step.limits.alike
    own = weighted.index([name])
    members = [name]
    a = weighted.group_a.sum(axis=0)
    if len(base):  # what the other effects could explain does not tell these apart
        a = a - a[:, base] @ invert(a[np.ix_(base, base)]) @ a[base, :]
    size = _size_in(weighted, base, own)
    for other in step.problem.library:
        columns = weighted.index([other])
        if other == name or set(columns) & set(base) or not len(columns):
            continue
        if _explained(a, own, size, columns) > alike:
            back = _size_in(weighted, base, columns)
            if _explained(a, columns, back, own) > alike:
                members.append(other)
    return tuple(members)


def _overlap(weighted: Weighted, base: np.ndarray, name: str, other: str) -> float:
    """Share of the change by effect `name` that effect `other` can make too, beside the columns `base`."""
    own, columns = weighted.index([name]), weighted.index([other])
    return _explained(weighted.group_a.sum(axis=0), own, _size_in(weighted, base, own), columns)


def _size_in(weighted: Weighted, base: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Fitted linear change of the columns `own` beside those of `base`."""
    return weighted.fit(np.concatenate([base, own]))[len(base) :]


def _explained(a: np.ndarray, own: np.ndarray, size: np.ndarray, columns: np.ndarray) -> float:
    """R2 of the change `size` along `own`, explained by `columns`, in the metric `a`."""
    total = float(size @ a[np.ix_(own, own)] @ size)
    if total <= 0.0:
        return 0.0
    cross = a[np.ix_(columns, own)] @ size
    return float(cross @ solve(a[np.ix_(columns, columns)], cross)) / total


def _drop_useless(step: _Step, newest: Sequence[str]) -> tuple[Fitted, tuple[str, ...]]:
    """The fit of the newest effects without earlier ones that they made useless, and the names of those."""
    problem, limits, dropped = step.problem, step.limits, []
    fit = step.trials[newest[-1]].fit
    for name in [n for n in fit.values if n not in newest]:
        rest = {n: v for n, v in fit.values.items() if n != name}
        smaller = refit(problem, rest, step.inflation)
        if problem.library[name].scales_thrust and _reference_at_bound(problem, smaller):
            continue
        difference = smaller.weighted.left_out(smaller.index) - fit.weighted.left_out(fit.index)
        size = problem.sizes(name, fit.values)
        belongs = corrects(problem, name, rest)
        if (
            (negligible(problem, name, fit.values[name]) and not belongs)
            or difference.sum() < limits.gain
            or standard_errors(difference) < limits.evidence
            or (difference.sum() < limits.share_more * step.at_first(name, size) and not belongs)
        ):
            fit, _ = smaller, dropped.append(name)
    return fit, tuple(dropped)


def _reference_at_bound(problem: Problem, fit: Fitted) -> bool:
    at, bounds = at_and_bounds(problem, fit)
    near = np.minimum(at - bounds[0], bounds[1] - at) < 1e-3 * (bounds[1] - bounds[0])
    return any(near[k] and problem.parameter(c).is_reference for k, c in enumerate(fit.weighted.columns))


def _share(problem: Problem, found: Search, name: str, closable: float) -> float:
    """Share of the closable error that the fit loses without an effect, the others refitted."""
    fit = found.fit
    rest = {n: v for n, v in fit.values.items() if n != name}
    smaller = refit(problem, rest, found.inflation, iterations=3)
    loss = smaller.weighted.left_out(smaller.index).sum() - fit.weighted.left_out(fit.index).sum()
    return float(np.clip(loss / closable, 0.0, 1.0))
