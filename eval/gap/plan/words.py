"""What a plan says: of sets that are in doubt, of the flight, of what is expected afterwards."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse.csgraph import connected_components

from inclined_landing.eval.gap.plan.design import SECONDS, Plan, telling, worth_telling
from inclined_landing.eval.gap.plan.information import Question, in_doubt
from inclined_landing.eval.gap.plan.pieces import Space
from inclined_landing.eval.gap.search.evidence import Problem
from inclined_landing.eval.gap.search.sets import Search
from inclined_landing.models.effects import LIBRARY

ALONE = 0.95  # probability at which a set stands alone
TELLS = 0.05  # nat, least gain of a flight that is worth flying
TOLD = 0.02  # probability from which a set is worth a word
ALIKE = 0.5  # share of the doubt between two sets that is left where a flight does not tell them apart


def separating(problem: Problem, found: Search, platform: bool) -> str:
    """What tells apart what a search holds for possible, in words (see `short`)."""
    hypotheses, quiet = in_doubt(problem, found)
    question = Question(worth_telling(hypotheses), problem.vehicle, quiet, problem.library)
    return short(question, platform)


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
        said.insert(0, f"{flown} the right one is expected to have a probability of {100 * right:.0f} %.")
    return " ".join(said)


def _shown(question: Question) -> tuple[str, dict[int, str]]:
    """A sentence on what all sets worth telling share, and what else is in each, by its place."""
    told = {k: h.effects for k, h in enumerate(question.hypotheses) if h.probability >= TOLD}
    shared = [n for n in next(iter(told.values())) if all(n in names for names in told.values())]
    rest = {k: [n for n in names if n not in shared] for k, names in told.items()}
    texts = {k: " with ".join(names) or "nothing" + " else" * bool(shared) for k, names in rest.items()}
    return f"Missing in any case: {_listed(shared, 'and')}. " if shared else "", texts


def doubt(question: Question) -> str:
    """What is held for possible, in a sentence or two."""
    shared, texts = _shown(question)
    rows = [f"{text} ({question.probabilities[k]:.2f})" for k, text in texts.items()]
    return f"{shared}In doubt: {_listed(rows, 'or')}."


def outcome(question: Question, expected: np.ndarray) -> str:
    """Expected probabilities after a flight, in one sentence."""
    before, after = question.probabilities, np.diag(expected)
    rows = [f"{text} from {before[k]:.2f} to {after[k]:.2f}" for k, text in _shown(question)[1].items()]
    return (
        f"Expected afterwards: the right one has a probability of {before @ after:.2f}, without a flight "
        f"{before @ before:.2f} (each if it is right: {', '.join(rows)})."
    )


def alike(question: Question, expected: np.ndarray) -> list[str]:
    """A sentence for every group of sets that the flight does not tell apart, with what would tell them."""
    p, said, texts = question.probabilities, [], _shown(question)[1]
    left = expected / (expected + np.diag(expected)[:, None])  # of the doubt between two, after
    pairs = left > ALIKE * p / (p + p[:, None])
    np.fill_diagonal(pairs, False)
    count, group = connected_components(pairs & pairs.T, directed=False)
    for k in range(count):
        own = [i for i in texts if group[i] == k]
        if len(own) > 1:
            names = [question.hypotheses[i].effects for i in own]
            apart = set().union(*names) - set(names[0]).intersection(*names[1:])
            told = dict.fromkeys(t for n in sorted(apart) if (t := LIBRARY[n].told_by))
            what = _listed(sorted(apart) if len(apart) > 1 else [*apart, "not"], "or")
            first = f"No flight planned here tells whether it is {what}."
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
