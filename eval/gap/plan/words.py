"""What a plan says: of sets that are in doubt, of the flight, of what is expected afterwards."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from inclined_landing.eval.gap.plan.design import Plan
from inclined_landing.eval.gap.plan.information import Question
from inclined_landing.models.effects import LIBRARY

ALIKE = 0.5  # share of the doubt between two sets that is left where a flight does not tell them apart


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
    """A sentence for every pair of sets that the flight does not tell apart, with what would tell them."""
    said = []
    p = question.probabilities
    for i, a in enumerate(question.hypotheses):
        for j, b in enumerate(question.hypotheses[:i]):
            left = expected[i, j] / (expected[i, i] + expected[i, j])
            if left < ALIKE * p[j] / (p[i] + p[j]):
                continue
            names = sorted(set(a.effects) ^ set(b.effects))
            remedies = " ".join(LIBRARY[n].told_by for n in names if LIBRARY[n].told_by)
            apart = f"No flight planned here tells {b.text} from {a.text}."
            said.append(f"{apart} {remedies}".strip())
    return said


def flight(plan: Plan) -> list[str]:
    """The pieces of a flight, with their times."""
    return [f"{s.start:5.1f} s  {s.piece.text}" for s in plan.path.spans]


def _listed(rows: Sequence[str], last: str) -> str:
    return rows[0] if len(rows) == 1 else f"{', '.join(rows[:-1])} {last} {rows[-1]}"
