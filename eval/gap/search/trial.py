"""One candidate tried beside the effects found: what it explains, and what speaks against naming it."""

from __future__ import annotations

import dataclasses
import enum
import math

import numpy as np

from inclined_landing.eval.gap.search.evidence import Problem, Values, solve
from inclined_landing.eval.gap.search.fit import Fitted, spread_between, standard_errors

# Share of the evidence that a few windows can give at most, where it is less than the limit.
ENOUGH = 0.8
# Squared error that an effect makes in a group (noise 1) so that a gain there can be expected.
SHOWS = 9.0
# Share of the first step that the form of an effect with a reference may leave.
FORM_LEAVES = 0.02


@dataclasses.dataclass(frozen=True)
class Thresholds:
    """What it takes to be named. Fixed on development seeds of the hidden-effect benchmark."""

    evidence: float = 4.5  # standard errors of the gain over windows left out
    gain: float = 30.0  # decrease of the white squared error, over all windows
    share: float = 0.06  # of what the whole library could close at the first step
    share_more: float = 0.0015  # the same for effects beside others, in the channels where they show
    nearly_all: float = 0.9  # share of what is left that needs fewer standard errors
    evidence_all: float = 3.0  # those
    share_entailed: float = 0.30  # below which an effect follows from one that entails it
    share_left: float = 0.10  # of what it could close at this step
    agreement: float = 0.7  # share of groups of windows with a positive gain
    spread: float = 0.45  # between flights, as a share of the parameter's distance from neutral
    alike: float = 0.98  # R2 above which two effects are one class
    overlap: float = 0.3  # R2 above which an effect explains the same as one that was refused
    simpler: float = 0.025  # share of the gain that a further parameter must add
    most: int = 5  # effects
    shortlist: int = 6


class Reason(enum.Enum):
    """Why a candidate is not named, with the sentence that says so."""

    INSIGNIFICANT = "not significant ({errors:.1f} standard errors)"
    SOME_FLIGHTS = "helps in {percent:.0f} % of the flights only"
    SMALL = "explains {percent:.0f} % only"
    WRONG_WAY = "the wrong way round ({parameter} = {value:g} {unit})"
    AT_BOUND = "at its bound ({parameter} = {value:g} {unit})"
    NEGLIGIBLE = "negligible"
    DIFFERS = "differs between flights"
    SAME = "explains the same as {other}, worse"
    COUPLED = "coupled with {other} in MuJoCo"
    LESS = "explains less"
    LESS_EVIDENCE = "less evidence"


@dataclasses.dataclass(frozen=True)
class Objection:
    """A reason with the numbers of its sentence."""

    reason: Reason
    numbers: dict = dataclasses.field(default_factory=dict)

    def __str__(self) -> str:
        return self.reason.value.format(**self.numbers)


@dataclasses.dataclass
class Trial:
    """One candidate added to the effects found so far and refitted with them."""

    fit: Fitted
    gain: float
    evidence: float
    agreement: float
    values: dict[str, float]


def trial_of(problem: Problem, fit: Fitted, name: str, difference: np.ndarray) -> Trial:
    """A trial from the decrease (w,) of the squared error of every window."""
    by_group = np.bincount(problem.group_of, difference, minlength=problem.groups)
    shows = _shown_in(problem, fit, name) > SHOWS
    # Flights where the effect cannot show say nothing about it.
    agreement = (by_group[shows] > 0).mean() if shows.sum() >= 2 else (by_group > 0).mean()
    return Trial(
        fit, float(difference.sum()), standard_errors(difference), float(agreement), fit.values[name]
    )


def _shown_in(problem: Problem, fit: Fitted, name: str) -> np.ndarray:
    """Squared error (g,) that an effect of the fitted size makes in every group, what others absorb apart."""
    own = fit.weighted.index([name])
    others = np.setdiff1d(fit.index, own)
    a = fit.weighted.group_a
    total = a.sum(axis=0)
    absorbed = np.zeros(a.shape[1])
    size = absorbed[own] = problem.sizes(name, fit.values)
    absorbed[others] = -solve(total[np.ix_(others, others)], total[np.ix_(others, own)] @ size)
    return np.einsum("gpq,p,q->g", a, absorbed, absorbed)


def objection(
    problem: Problem,
    name: str,
    trial: Trial,
    closable: float,
    at_first: float,
    limits: Thresholds,
    found: Values,
) -> Objection | None:
    """Why a candidate is not accepted beside the effects `found`; None if it is.

    closable: what the library could close at this step; at_first: what it could at first where the
    candidate shows.
    """
    share = trial.gain / closable
    # All windows alike give the square root of their number: no more can be asked of a few.
    evidence = min(limits.evidence, ENOUGH * math.sqrt(len(problem.flight_of)))
    if share > limits.nearly_all and trial.gain > 10.0 * limits.gain:
        evidence = min(evidence, limits.evidence_all)
    if trial.gain < limits.gain or trial.evidence < evidence:
        return Objection(Reason.INSIGNIFICANT, {"errors": trial.evidence})
    if trial.agreement < limits.agreement:
        return Objection(Reason.SOME_FLIGHTS, {"percent": 100 * trial.agreement})
    small = Objection(Reason.SMALL, {"percent": 100 * share})
    if share < limits.share_left:
        return small
    bound = _bound(problem, trial, name, found)
    # What follows from another effect corrects its form: it need be neither large nor the same everywhere.
    if bound or corrects(problem, name, found):
        return bound
    if negligible(problem, name, trial.values):
        return Objection(Reason.NEGLIGIBLE)
    least = limits.share_more if found else limits.share
    # A reference carries an overall factor already: what more there is, is its form.
    if problem.library[name].scales_thrust and any(problem.library[n].reference for n in found):
        least = min(limits.share, FORM_LEAVES)
    if trial.gain < least * at_first:
        return small
    if disagreement(problem, trial.fit, name) > limits.spread:
        return Objection(Reason.DIFFERS)
    return None


def corrects(problem: Problem, name: str, found: Values) -> bool:
    """Whether an effect belongs to the form of one found already."""
    return any(name in problem.library[cause].corrects for cause in found)


def negligible(problem: Problem, name: str, values: dict[str, float]) -> bool:
    """Whether no parameter of an effect is worth correcting."""
    sized = [p for p in problem.library[name].parameters if not p.is_reference]
    return not any(abs(values[p.name] - p.neutral) > p.negligible for p in sized)


def _bound(problem: Problem, trial: Trial, name: str, found: Values) -> Objection | None:
    """Why a value is none that the effect can have; None if it can."""
    for p in problem.library[name].parameters:
        value, (lo, hi) = trial.values[p.name], p.bounds
        numbers = {"parameter": p.name, "value": value, "unit": p.unit}
        if p.one_signed and value < -p.negligible:
            return Objection(Reason.WRONG_WAY, numbers)
        if lo == p.neutral and value < 0.5 * (lo + hi):
            continue
        # A reference goes to its bound where it has to scale the thrust as well, unless something else does.
        if p.is_reference and any(problem.library[n].scales_thrust for n in found):
            continue
        if min(value - lo, hi - value) < 1e-3 * (hi - lo):
            return Objection(Reason.AT_BOUND, numbers)
    return None


def disagreement(problem: Problem, fit: Fitted, name: str) -> float:
    """Spread of an effect's first-order size between flights beyond their errors, as a share of its size."""
    if len(problem.flights) < 3:
        return 0.0
    change, error = fit.weighted.per_flight(fit.index)
    sizes = np.abs(problem.sizes(name, fit.values))
    main = int(np.argmax(sizes))
    k = fit.weighted.index([name])[main]
    return spread_between(change[:, k], error[:, k]) / max(float(sizes[main]), 1e-12)
