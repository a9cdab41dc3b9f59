"""Naming what is wrong about contact: friction, stiffness, damping, platform height and tilt."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from inclined_landing.eval.gap.flights.landings import Landing
from inclined_landing.eval.gap.result import Candidate, SearchStep
from inclined_landing.eval.gap.search.after_touch import TouchdownProblem
from inclined_landing.eval.gap.search.evidence import Values
from inclined_landing.eval.gap.search.fit import Fitted, refit, standard_errors
from inclined_landing.eval.gap.search.naming import Search
from inclined_landing.eval.gap.search.trial import Objection, Reason, Thresholds, Trial, objection, trial_of
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
# Landings are few, and each tells more than a window of free flight.
LIMITS = Thresholds(
    **{"evidence": 2.3, "gain": 35.0, "share": 0.15, "share_more": 0.3, "share_left": 0.2},
    **{"agreement": 0.5, "spread": 1.0, "most": 2},
)


def name_contact(
    landings: Sequence[Landing],
    vehicle: Vehicle,
    library: Mapping[str, Effect],
    limits: Thresholds = LIMITS,
) -> tuple[TouchdownProblem, Search]:
    """Name the contact effects that `vehicle`, corrected for free flight, lacks to explain `landings`.

    Feet that stick say nothing about how they would slide, so that every effect is scanned through the
    simulator, and the best few are refined. Effects are ranked by evidence over landings and axes, not by
    the error they take away: a few landings that go another way would decide that.
    """
    problem = TouchdownProblem(landings, vehicle, library)
    noise = np.ones(6)
    found = Search(refit(problem, {}, noise), noise)
    total = found.fit.squares
    size = 6 * problem.rows.sum()
    for _ in range(limits.most):
        if found.fit.values and found.fit.squares < MATCHED * size:
            break
        scans = _Scans(problem, found.fit)
        best, trial = next(iter(scans.trials.items()))
        closable = max(1.0, trial.gain)
        against = _coupled(problem, best, found.fit.values) or objection(
            problem, best, trial, closable, max(found.closable, closable), limits, found.fit.values
        )
        alike = [] if against else scans.alike(best, limits)
        rows = scans.rows(best, alike, closable, against)
        found.steps.append(SearchStep(None if against else best, (), rows))
        if against:
            break
        found.closable = max(found.closable, closable)
        found.fit = trial.fit
        found.evidence[best], found.classes[best] = trial.evidence, tuple(alike)
        found.gains[best] = float(np.clip(trial.gain / total, 0.0, 1.0))
    found.unexplained = found.fit.squares > UNEXPLAINED * size
    return problem, found


def _coupled(problem: TouchdownProblem, name: str, found: Values) -> Objection | None:
    """What speaks against naming an effect beside one that the engine couples it with."""
    for other in found:
        if name in problem.library[other].couples_with:
            return Objection(Reason.COUPLED, {"other": other})
    return None


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
            gain = self.before - self.left[name]
            trial = trial_of(problem, new, name, gain.sum(axis=1))
            trials[name] = dataclasses.replace(trial, evidence=standard_errors(gain))
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

    def alike(self, best: str, limits: Thresholds) -> list[str]:
        """The refined effects that cannot be told from the best."""
        clear = [n for n, t in self.trials.items() if t.evidence > limits.evidence]
        return [n for n in clear if standard_errors(self.left[n] - self.left[best]) < TIED]

    def rows(
        self, best: str, alike: Sequence[str], closable: float, against: Objection | None
    ) -> tuple[Candidate, ...]:
        """The ranking of this step."""
        less, rows = str(Objection(Reason.LESS_EVIDENCE)), []
        for n, t in self.trials.items():
            reason, tie = less if n != best else str(against or ""), n in alike
            rows.append(Candidate(n, t.gain, t.gain / closable, t.evidence, True, tie, reason, t.values))
        for n in self.order[REFITTED:]:
            value, cells = min(self.scans[n].items(), key=lambda item: item[1].sum())
            gain, evidence = float((self.before - cells).sum()), standard_errors(self.before - cells)
            values = {self._parameter(n).name: value}
            rows.append(Candidate(n, gain, gain / closable, evidence, False, False, less, values))
        return tuple(rows)
