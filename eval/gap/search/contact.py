"""Naming what is wrong about contact: friction, stiffness, damping, platform height and tilt."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np

from inclined_landing.eval.gap.flights.landings import Landing
from inclined_landing.eval.gap.search.after_touch import TouchdownProblem
from inclined_landing.eval.gap.search.evidence import solve
from inclined_landing.eval.gap.search.fit import Fitted, refit, spread_between, standard_errors
from inclined_landing.models.effects import Effect, Parameter
from inclined_landing.models.parameters import Vehicle

FEWEST = 6  # landings
# Mean error, drawn in, above which landings are not explained; it is 0.7 to 0.76 where nothing is hidden.
UNEXPLAINED = 0.95
MATCHED = 0.77  # the same, below which no second effect is looked for
REFITTED = 2  # effects of every step
TIED = 0.7  # standard errors by which the best must beat an effect that is told from it
SCAN = (-2.0, -1.0, -0.4, 0.4, 1.0, 2.0)  # times the plausible deviation
SCAN_FACTOR = (0.27, 0.4, 0.6, 0.8, 1.25, 1.7, 2.5, 3.6)  # factors instead
MOST = 2  # effects
# What it takes to be named. Landings are few, and each tells more than a window of free flight.
EVIDENCE = 2.3  # standard errors of the gain over landings
ENOUGH = 0.8  # of the most standard errors that so many landings can give, where that is less
GAIN = 35.0  # decrease of the white squared error
SHARE_MORE = 0.3  # of the first effect's gain, for a second one
AGREEMENT = 0.5  # share of landings with a positive gain
SPREAD = 1.0  # between landings, as a share of the parameter's distance from neutral
# Squared error that an effect makes in a landing (noise 1) so that a gain there can be expected.
SHOWS = 9.0


@dataclasses.dataclass
class Touched:
    """The outcome of `name_contact`."""

    fit: Fitted
    gains: dict[str, float] = dataclasses.field(default_factory=dict)  # effect -> share of the squared error
    classes: dict[str, tuple[str, ...]] = dataclasses.field(
        default_factory=dict
    )  # names like it, itself first
    unexplained: bool = False  # errors remain


@dataclasses.dataclass
class Trial:
    """One candidate added to the effects found so far and refitted with them."""

    fit: Fitted
    gain: float
    evidence: float
    agreement: float
    values: dict[str, float]


def name_contact(
    landings: Sequence[Landing], vehicle: Vehicle, library: Mapping[str, Effect]
) -> tuple[TouchdownProblem, Touched]:
    """Name the contact effects that `vehicle`, corrected for free flight, lacks to explain `landings`.

    Feet that stick say nothing about how they would slide, so that every effect is scanned through the
    simulator, and the best few are refined. Effects are ranked by evidence over landings and axes, not by
    the error they take away: a few landings that go another way would decide that.
    """
    problem = TouchdownProblem(landings, vehicle, library)
    found = Touched(refit(problem, {}, np.ones(6)))
    total, most = found.fit.squares, 0.0
    size = 6 * problem.rows.sum()
    for _ in range(MOST):
        if found.fit.values and found.fit.squares < MATCHED * size:
            break
        scans = _Scans(problem, found.fit)
        best, trial = next(iter(scans.trials.items()))
        coupled = any(best in problem.library[other].couples_with for other in found.fit.values)
        if coupled or trial.gain < SHARE_MORE * most or not _clear(problem, best, trial):
            break
        most = max(most, trial.gain)
        found.fit, found.classes[best] = trial.fit, tuple(scans.alike(best))
        found.gains[best] = float(np.clip(trial.gain / total, 0.0, 1.0))
    found.unexplained = found.fit.squares > UNEXPLAINED * size
    return problem, found


def _clear(problem: TouchdownProblem, name: str, trial: Trial) -> bool:
    """Whether an effect explains enough, alike in most landings, with a value that it can have."""
    # All landings alike give the square root of their number: no more can be asked of a few.
    evidence = min(EVIDENCE, ENOUGH * math.sqrt(len(problem.flight_of)))
    if trial.gain < GAIN or trial.evidence < evidence or trial.agreement < AGREEMENT:
        return False
    (p,) = problem.library[name].parameters
    value, (low, high) = trial.values[p.name], p.bounds
    beyond = low == p.neutral and value < 0.5 * (low + high)
    if not beyond and min(value - low, high - value) < 1e-3 * (high - low):
        return False
    if abs(value - p.neutral) < p.negligible:
        return False
    change, error = trial.fit.weighted.per_flight(trial.fit.index)
    own = trial.fit.weighted.index([name])[0]
    return spread_between(change[:, own], error[:, own]) <= SPREAD * abs(value - p.neutral)


def _trial_of(problem: TouchdownProblem, fit: Fitted, name: str, gain: np.ndarray) -> Trial:
    """A trial from the decrease (n, 6) of the squared error of every landing and axis."""
    of_landing = gain.sum(axis=1)
    shows = _shown_in(problem, fit, name) > SHOWS
    # Landings where the effect cannot show say nothing about it.
    agreement = (of_landing[shows] > 0).mean() if shows.sum() >= 2 else (of_landing > 0).mean()
    return Trial(fit, float(gain.sum()), standard_errors(gain), float(agreement), fit.values[name])


def _shown_in(problem: TouchdownProblem, fit: Fitted, name: str) -> np.ndarray:
    """Squared error (n,) that an effect of its size makes in every landing, less what others absorb."""
    own = fit.weighted.index([name])
    others = np.setdiff1d(fit.index, own)
    a = fit.weighted.group_a
    total = a.sum(axis=0)
    absorbed = np.zeros(a.shape[1])
    size = absorbed[own] = problem.sizes(name, fit.values)
    absorbed[others] = -solve(total[np.ix_(others, others)], total[np.ix_(others, own)] @ size)
    return np.einsum("gpq,p,q->g", a, absorbed, absorbed)


class _Scans:
    """Every effect, of one parameter each, scanned beside those found; trials of the best few."""

    def __init__(self, problem: TouchdownProblem, fit: Fitted):
        self.problem, self.fit = problem, fit
        self.before = problem.cells(problem.corrected(fit.values))
        self.scans = {n: self._scan(n) for n in problem.library if n not in fit.values}
        best = {n: min(cells.values(), key=np.sum) for n, cells in self.scans.items()}
        self.order = sorted(self.scans, key=lambda n: -standard_errors(self.before - best[n]))
        trials: dict[str, Trial] = {}
        self.left: dict[str, np.ndarray] = {}
        for name in self.order[:REFITTED]:
            values = {**fit.values, name: {self._parameter(name).name: self._refined(name)}}
            new = refit(problem, values, fit.inflation, iterations=0)
            self.left[name] = problem.cells(problem.corrected(new.values))
            trials[name] = _trial_of(problem, new, name, self.before - self.left[name])
        self.trials = dict(sorted(trials.items(), key=lambda item: -item[1].evidence))

    def _parameter(self, name: str) -> Parameter:
        return self.problem.library[name].parameters[0]

    def _cells(self, name: str, x: float) -> np.ndarray:
        values = {**self.fit.values, name: {self._parameter(name).name: x}}
        return self.problem.cells(self.problem.corrected(values))

    def _scan(self, name: str) -> dict[float, np.ndarray]:
        """Cells for a few values."""
        p = self._parameter(name)
        grid = SCAN_FACTOR if p.is_factor else p.neutral + (p.plausible - p.neutral) * np.array(SCAN)
        return {float(x): self._cells(name, float(x)) for x in grid if p.bounds[0] <= x <= p.bounds[1]}

    def _refined(self, name: str) -> float:
        """The value of least squared error: the neighbourhood halved twice, then the vertex of a parabola."""
        cells = {self._parameter(name).neutral: self.before, **self.scans[name]}
        left = {x: float(c.sum()) for x, c in cells.items()}
        for _ in range(2):
            x = sorted(left)
            k = min(range(len(x)), key=lambda i: left[x[i]])
            for middle in [0.5 * (x[k] + x[i]) for i in (k - 1, k + 1) if 0 <= i < len(x)]:
                left[middle] = float(self._cells(name, middle).sum())
        x = np.array(sorted(left))
        k = int(np.clip(np.argmin([left[v] for v in x]), 1, len(x) - 2))
        a, b, _ = np.polyfit(x[k - 1 : k + 2] - x[k], [left[v] for v in x[k - 1 : k + 2]], 2)
        vertex = float(x[k] - 0.5 * b / a) if a > 0 else float(x[k])
        if x[k - 1] < vertex < x[k + 1] and vertex not in left:
            left[vertex] = float(self._cells(name, vertex).sum())
        return min(left, key=left.get)

    def alike(self, best: str) -> list[str]:
        """The refined effects that cannot be told from the best."""
        clear = [n for n, t in self.trials.items() if t.evidence > EVIDENCE]
        return [n for n in clear if standard_errors(self.left[n] - self.left[best]) < TIED]
