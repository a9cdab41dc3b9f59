"""What a plan says: of sets that are in doubt, of the flight, of what is expected afterwards."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse.csgraph import connected_components

from inclined_landing.eval.gap.plan.design import MOST_SETS, SECONDS, Plan, telling
from inclined_landing.eval.gap.plan.information import Question, in_doubt
from inclined_landing.eval.gap.plan.pieces import Space
from inclined_landing.eval.gap.search.evidence import Problem
from inclined_landing.eval.gap.search.sets import Search
from inclined_landing.models.effects import LIBRARY

ALONE = 0.95  # probability at which a set stands alone
TELLS = 0.05  # nat, least gain of a flight that is worth flying
ALIKE = 0.5  # share of the doubt between two sets that is left where a flight does not tell them apart


def separating(problem: Problem, found: Search, platform: bool) -> str:
    """What tells apart what a search holds for possible, in words (see `short`)."""
    hypotheses, quiet = in_doubt(problem, found)
    return short(Question(hypotheses[:MOST_SETS], problem.vehicle, quiet, problem.library), platform)


def short(question: Question, platform: bool) -> str:
    """What tells the sets in doubt apart, in words: one kind of piece, or no flight; "": nothing is in doubt.

    platform: the slab of the vehicle file stands in the arena.
    """
    if question.probabilities.max() >= ALONE:
        return ""
    piece, expected = telling(question, Space.of(question.vehicle, platform))
    said = alike(question, expected)
    right, before = question.probabilities @ np.diag(expected), (question.probabilities**2).sum()
    if right > before + TELLS:
        flown = f"{piece.text[0].upper()}{piece.text[1:]}, again and again: after {SECONDS:.0f} s"
        said.insert(0, f"{flown} the right one is expected to have a probability of {right:.2f}.")
    return " ".join(said)


def doubt(question: Question) -> str:
    """What is held for possible, in one sentence."""
    rows = [f"{h.text} ({h.probability:.2f})" for h in question.hypotheses]
    return f"In doubt: {_listed(rows, 'or')}."


def outcome(question: Question, expected: np.ndarray) -> str:
    """Expected probabilities after a flight, in one sentence."""
    before = question.probabilities
    right = float(before @ np.diag(expected))
    rows = [
        f"{h.text} from {b:.2f} to {a:.2f}" for h, b, a in zip(question.hypotheses, before, np.diag(expected))
    ]
    return (
        f"Expected afterwards: the right one has a probability of {right:.2f}, before it had "
        f"{float(before @ before):.2f} (each if it is right: {', '.join(rows)})."
    )


def alike(question: Question, expected: np.ndarray) -> list[str]:
    """A sentence for every group of sets that the flight does not tell apart, with what would tell them."""
    p, said = question.probabilities, []
    left = expected / (expected + np.diag(expected)[:, None])  # of the doubt between two, after
    pairs = left > ALIKE * p / (p + p[:, None])
    np.fill_diagonal(pairs, False)
    count, group = connected_components(pairs & pairs.T, directed=False)
    for k in range(count):
        own = [h for h, g in zip(question.hypotheses, group) if g == k]
        if len(own) > 1:
            names = [h.effects for h in own]
            apart = set().union(*names) - set(names[0]).intersection(*names[1:])
            told = dict.fromkeys(t for n in sorted(apart) if (t := LIBRARY[n].told_by))
            first = f"No flight planned here tells {_listed([h.text for h in own], 'and')} apart."
            said.append(" ".join([first, *told]))
    return said


def broad(names: Sequence[str]) -> str:
    """What the flight varies for the sake of what nothing explains, in one sentence."""
    what = _listed(list(dict.fromkeys(names)), "and")
    return f"Something unknown goes with {what}: the flight varies that as broadly as it can."


def flight(plan: Plan) -> list[str]:
    """The pieces of a flight, with their times."""
    return [f"{s.start:5.1f} s  {s.piece.text}" for s in plan.path.spans]


def _listed(rows: Sequence[str], last: str) -> str:
    return rows[0] if len(rows) == 1 else f"{', '.join(rows[:-1])} {last} {rows[-1]}"
