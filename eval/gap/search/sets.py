"""Which set of effects explains the flights: all sets are candidates, the answer is a distribution over them.

From no effect on, sets are screened with the Gram matrices of the nearest set that has been fitted, and the
most probable are fitted through the simulator and linearised anew, until no neighbour - one effect more, less
or another - promises more than what has been fitted.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence

import numpy as np
from scipy.special import ndtr

from inclined_landing.eval.gap.flights import unrest
from inclined_landing.eval.gap.search.evidence import BASE, Linear, Problem, Values
from inclined_landing.eval.gap.search.fit import Fitted, refit
from inclined_landing.eval.gap.search.posterior import (
    Evidence,
    Local,
    Set,
    between_flights,
    flight_weights,
    looks_alike,
    slabs,
    telling,
)

NOTHING = 0.5  # prior probability that nothing is missing
MOST = 16  # effects of a set
PLACES = 2  # others that are fitted in the place of every effect of the best set
FITTED = 12  # sets that are fitted through the simulator, at most
WORTH = 6.0  # log probability behind the best within which a neighbour is worth a fit
STEPS = 3  # of Newton for a set, at most
SMALL = 0.5  # negligible sizes within which a step is linear
BEHIND = 7.0  # log probability behind the best beyond which a set is not worth telling
FAR = 20.0  # beyond which it is not worth fitting well
FORMS = np.array([0.0, *np.geomspace(0.002, 0.5, 30)])  # shares of the motion by which it may be off
SETTLED = 4  # rounds in which effects and unrest are fitted in turn, at most
LEAST = 1e-3  # probability of a set that is worth telling
POINTS = 3  # linearisations in which sets are compared
CLEAR = 0.03  # above which it is fitted through the simulator


@dataclasses.dataclass
class Node:
    """A set fitted through the simulator."""

    names: Set
    at: dict[str, dict[str, float]]  # where it was linearised
    values: dict[str, dict[str, float]]  # a step on, beside the small errors of all other effects
    local: Local
    screen: Evidence
    score: float  # log probability, up to a constant


@dataclasses.dataclass(frozen=True)
class Scored:
    """A set with its probability."""

    names: Set
    probability: float
    values: dict[str, dict[str, float]]


@dataclasses.dataclass
class Search:
    """The outcome of `search`."""

    names: Set  # the most probable set, what scales the thrust counted as one
    values: dict[str, dict[str, float]]  # of the most probable set
    at: dict[str, dict[str, float]]  # effect values near it
    local: Local  # the flights at these
    sets: tuple[Scored, ...]  # most probable first
    unrest: unrest.Unrest
    whole: dict[str, dict[str, float]]  # all effects fitted together
    near: Linear  # the flights linearised there
    inflation: np.ndarray  # (6,)

    def probability(self, *names: str) -> float:
        """That one of some effects is part of what is missing."""
        return sum(s.probability for s in self.sets if s.names & set(names))


def search(problem: Problem) -> Search:
    """The sets of effects that may explain the flights of `problem`, which is whitened anew."""
    whole, stir = settle(problem, list(problem.library))
    inflation = repeated(problem, whole.values)
    columns = problem.columns([*problem.library, BASE])
    near = problem.linearise(whole.values, columns, inflation)
    problem.alike = looks_alike(near)
    problem.between = between_flights(problem, near)
    problem.telling = telling(problem, near)
    likely = backward_eliminate(problem, Local.of(problem, near, whole.values).evidence())
    nodes = _explore(problem, inflation, likely, whole.values)
    best = max(nodes.values(), key=lambda node: node.score)
    scored = _distribution(problem, nodes, best, inflation)
    names = _best(problem, scored)
    if names not in nodes:
        nodes[names] = _visit(problem, names, _start(problem, best, names), inflation)
    chosen = nodes[names]
    return Search(names, chosen.values, chosen.at, chosen.local, scored, stir, whole.values, near, inflation)


def _best(problem: Problem, scored: Sequence[Scored]) -> Set:
    """The most probable set: free flight tells thrust over mass alone, so that these are one name."""
    together: dict[Set, float] = {}

    def merged(names: Set) -> Set:
        return frozenset("thrust over mass" if problem.library[n].scales_thrust else n for n in names)

    for one in scored:
        key = merged(one.names)
        together[key] = together.get(key, 0.0) + one.probability
    most = max(together, key=lambda key: together[key])
    return next(one.names for one in scored if merged(one.names) == most)


def settle(problem: Problem, names: Sequence[str]) -> tuple[Fitted, unrest.Unrest]:
    """Effects fitted together, and the noise and unrest that they leave; the flights weighed by these."""
    values: dict[str, dict[str, float]] = {name: {} for name in (*names, BASE)}
    still, stir = np.ones(6), unrest.Unrest.none()
    for _ in range(SETTLED):
        before, fit = stir, refit(problem, values, still, iterations=3, tolerance=5.0, prior=_wide)
        values, vehicle = fit.values, problem.corrected(fit.values)
        predicted = [problem.predicted(f, values) for f in problem.flights]
        errors = [f.measured - p for f, p in zip(problem.flights, predicted)]
        ends = np.cumsum([len(f.starts) for f in problem.flights])[:-1]
        stir = unrest.estimate(problem.flights, errors, np.split(problem.weight, ends))
        problem.rewhiten(stir, vehicle)
        if not problem.identified:
            problem.reform(vehicle)
        weigh(problem, predicted, errors)
        if np.allclose(stir.size, before.size, rtol=0.15, atol=1e-3):
            break
    return fit, stir


def _wide(problem: Problem, columns: Sequence) -> np.ndarray:
    """Standard deviation (P,) of columns that are all free; of the formulas' errors where no flights told."""
    width = slabs(problem, columns)
    if problem.identified:
        return width
    known = np.sqrt(problem.known(columns)[1].diagonal())
    return np.where([c.effect == BASE for c in columns], known, width)


def weigh(problem: Problem, predicted: Sequence[np.ndarray], errors: Sequence[np.ndarray]) -> None:
    """Weigh every window by the error that the form of the model makes there.

    No formula is exact: beside noise and unrest the error grows with the motion that is predicted, by a
    share of it that is the most likely one over all windows, in every channel.
    predicted, errors: (m, 6) of every flight.
    """

    def energy(values: Sequence[np.ndarray]) -> np.ndarray:
        white = [f.whitening(f.cut(v)) for f, v in zip(problem.flights, values)]
        return np.concatenate([(x**2).mean(axis=2) for x in white])

    moved, left = energy(predicted), energy(errors)  # (w, 6)
    variance = 1.0 + FORMS[:, None, None] ** 2 * moved
    unlikely = (problem.rows[:, None] * problem.logged * (np.log(variance) + left / variance)).sum(axis=1)
    best = np.argmin(unlikely, axis=0)
    problem.weight = problem.logged / np.take_along_axis(variance, best[None, None], axis=0)[0]


def repeated(problem: Problem, values) -> np.ndarray:
    """(6,) how much less a window tells than if it were independent of the one before."""
    white = problem.white_at(values)
    scale = np.ones(6)
    for channel in range(6):
        total, apart = 0.0, np.zeros(4)
        for flight, errors in zip(problem.flights, white):
            size = flight.whitening.sizes(errors)[:, channel]
            size = size * np.sqrt(flight.whitening.power[channel])
            total += float(size @ size)
            apart += [float(size[lag:] @ size[:-lag]) if len(size) > lag else 0.0 for lag in range(1, 5)]
        if total > 0.0:
            scale[channel] = np.clip(1.0 + 2.0 * (apart / total).sum(), 1.0, 10.0)
    return scale


def log_prior(problem: Problem, names: Set) -> float:
    """Log prior probability of a set: every effect alike, nothing with probability NOTHING."""
    share = 1.0 - NOTHING ** (1.0 / max(1, len(problem.library)))
    return len(names) * math.log(share / (1.0 - share))


def _visit(problem: Problem, names: Set, start, inflation: np.ndarray, worth: float = -math.inf) -> Node:
    """Fit a set from `start`, by Newton's steps, and linearise the simulator there.

    worth: score below which one step is enough.
    """
    new = {n: problem.library[n].neutral | start.get(n, {}) for n in problem.library if n in names}
    for _ in range(STEPS):
        values = new
        columns = problem.columns([*problem.library, BASE]) + problem.form_columns(values)
        linear = problem.linearise(values, columns, inflation)
        local = Local.of(problem, linear, values)
        new = stepped(problem, local, names)
        step = problem.coordinates(new, columns) - problem.coordinates(values, columns)
        least = np.array([problem.parameter(c).negligible for c in columns])
        screen = local.evidence()
        score = screen(names) + log_prior(problem, names) if _has_sizes(problem, names, new) else -np.inf
        if np.abs(step / least).max() < SMALL or score < worth:
            break
    return Node(names, values, new, local, screen, score)


def _has_sizes(problem: Problem, names: Set, values) -> bool:
    """Whether every effect of a set has a size: without one that stayed at nothing it is another set."""
    return all(np.any(problem.sizes(name, values)) for name in names)


def stepped(problem: Problem, local: Local, names: Set, weights=None) -> dict:
    """Values of a set's effects beside the small errors of all others."""
    return problem.values_at(names, local.columns, local.within(names, weights)[0] * local.unit)


def left_out(problem: Problem, local: Local, names: Set, values: Values) -> list[dict]:
    """For every flight, the `values` of the effects `names` as the other flights alone have them."""
    result, whole = [], local.within(frozenset(names))[0]
    at = problem.coordinates(values, local.columns)
    for k in range(len(problem.flights)):
        weights = np.ones(problem.groups)
        if len(problem.flights) > 1:
            weights[np.unique(problem.group_of[problem.flight_of == k])] = 0.0
        change = (local.within(frozenset(names), weights)[0] - whole) * local.unit
        result.append(problem.values_at(names, local.columns, at + change))
    return result


def _start(problem: Problem, node: Node, names: Set) -> dict:
    """Where the fit of a neighbour starts: the linear estimate."""
    start = stepped(problem, node.local, names)
    return start | {n: dict(v) for n, v in node.values.items() if n in names}


def _neighbours(problem: Problem, node: Node) -> list[Set]:
    """Sets that differ from a node's by one effect more, less or exchanged, and by the best two more."""
    names = list(problem.library)
    others = [n for n in names if n not in node.names]
    result = [node.names - {n} for n in node.names]
    if len(node.names) < MOST:
        more = [node.names | {n} for n in others]
        result += more
    result += [(node.names - {n}) | {m} for n in node.names for m in others]
    if len(node.names) + 2 <= MOST:
        pairs = list(itertools.combinations(others, 2))
        result += [node.names | set(pair) for pair in pairs]
    return [frozenset(s) for s in result]


def backward_eliminate(problem: Problem, evidence: Evidence) -> Set:
    """All effects less those without which the flights are more probable, one after the other."""
    kept = frozenset(problem.library)

    def score(names: Set) -> float:
        return evidence(names) + log_prior(problem, names)

    while kept:
        fewer = max((kept - {n} for n in sorted(kept)), key=score)
        if score(fewer) < score(kept) and len(kept) <= MOST:
            break
        kept = fewer
    return kept


def _explore(problem: Problem, inflation: np.ndarray, likely: Set, values: Values) -> dict[Set, Node]:
    """The sets that were fitted: from nothing on, and from a likely one with `values`."""
    nodes = {names: _visit(problem, names, values, inflation) for names in (frozenset[str](), likely)}
    promised: dict[Set, tuple[float, Node]] = {}
    expanded: set[Set] = set()
    while len(nodes) < FITTED:
        best = max(nodes.values(), key=lambda node: node.score)
        if best.names not in expanded:
            expanded.add(best.names)
            for names in _neighbours(problem, best):
                promised[names] = (best.screen(names) + log_prior(problem, names), best)
        left = [(score, names) for names, (score, _) in promised.items() if names not in nodes]
        if not left:
            break
        score, names = max(left, key=lambda item: (item[0], sorted(item[1])))
        if score < best.score - WORTH:
            break
        start = _start(problem, promised[names][1], names)
        if _has_sizes(problem, names, start):
            nodes[names] = _visit(problem, names, start, inflation, best.score - FAR)
        else:  # it promises something beyond its bounds only
            del promised[names]
    best = max(nodes.values(), key=lambda node: node.score)
    for names in _in_its_place(problem, best, nodes):
        start = _start(problem, best, names)
        if _has_sizes(problem, names, start):
            nodes[names] = _visit(problem, names, start, inflation, best.score - FAR)
    return nodes


def _in_its_place(problem: Problem, best: Node, nodes: dict[Set, Node]) -> list[Set]:
    """For every effect of a set, the set with the likeliest other in its place, where that was not fitted."""
    result = []
    for name in sorted(best.names):
        rest = best.names - {name}
        near = nodes.get(rest, best)  # adding is more nearly linear than exchanging
        swaps = [rest | {n} for n in problem.library if n not in best.names]
        swaps = sorted(swaps, key=lambda names: -near.screen(names))[:PLACES]
        result += [names for names in swaps if names not in nodes]
    return result


def _distribution(problem: Problem, nodes: dict[Set, Node], best: Node, inflation) -> tuple[Scored, ...]:
    """Probabilities of sets, by the mean of their log evidence in the linearisations at the most probable.

    Every set in the same linearisations: the simulator is linear enough for a difference between sets, not
    for one between points far apart.
    """
    weights = flight_weights(problem.groups)
    near = {n: best.screen(n) + log_prior(problem, n) for n in _neighbours(problem, best) if n not in nodes}
    near = {n: x for n, x in near.items() if x > best.score - BEHIND}
    starts = {n: _start(problem, best, n) for n in near}
    near = {n: x for n, x in near.items() if _has_sizes(problem, n, starts[n])}
    fitted = {n: node for n, node in nodes.items() if np.isfinite(node.score)}
    names = [*fitted, *near]
    points = sorted(fitted.values(), key=lambda node: -node.score)[:POINTS]
    logs = np.tile([log_prior(problem, n) for n in names], (len(weights), 1)).T
    for node in points:
        for d, w in enumerate(weights):
            evidence = node.local.evidence(w)
            logs[:, d] += np.array([evidence(n) for n in names]) / len(points)
    shares = np.exp(logs - logs.max(axis=0))
    probability: dict[Set, float] = {}
    for one, share in zip(names, (shares / shares.sum(axis=0)).mean(axis=1)):
        near_it = nodes.get(one, best).local
        for subset, part in _worth_correcting(problem, near_it, one).items():
            probability[subset] = probability.get(subset, 0.0) + part * float(share)
    result: list[Scored] = []
    for one in sorted(probability, key=lambda n: -probability[n]):
        if probability[one] < LEAST and result:
            continue
        if one not in nodes and (probability[one] > CLEAR or not result):
            start = starts.get(one) or _start(problem, best, one)  # told by the linearisation alone so far
            nodes[one] = _visit(problem, one, start, inflation)
        values = nodes[one].values if one in nodes else starts.get(one) or _start(problem, best, one)
        result.append(Scored(one, probability[one], values))
    return tuple(result)


def _worth_correcting(problem: Problem, local: Local, names: Set) -> dict[Set, float]:
    """How probable every part of a set is the part whose sizes are beyond what nobody needs to correct."""
    at, spread = local.within(names)[0], local.delta(names)[1]
    errors = np.sqrt(np.maximum(spread.diagonal(), 1e-12))
    result: dict[Set, float] = {frozenset(): 1.0}
    for name in names:
        within = 1.0
        for k in local.index([name]):
            if not local.columns[k].form:
                least = problem.parameter(local.columns[k]).negligible / local.unit[k]
                within *= float(np.diff(ndtr((np.array([-least, least]) - at[k]) / errors[k]))[0])
        parts = result.items()
        result = {s: x * within for s, x in parts} | {s | {name}: x * (1.0 - within) for s, x in parts}
    return result
