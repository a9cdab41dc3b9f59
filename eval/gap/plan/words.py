"""Sentences on a plan: sets in doubt, manoeuvres, expected probabilities."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse.csgraph import connected_components

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.answer.named import scored_sets
from inclined_landing.eval.gap.infer.sets import SetPosterior
from inclined_landing.eval.gap.plan.design import SECONDS, Plan, most_informative_piece, probable_sets
from inclined_landing.eval.gap.plan.information import ModelDiscrimination, NoiseLevels
from inclined_landing.eval.gap.plan.pieces import Space
from inclined_landing.models.effects import LIBRARY

SHOWN_ABOVE = 0.02  # probability of a set that is mentioned


def discriminating_manoeuvre(found: SetPosterior, platform: bool) -> str:
    """Return sentences on the manoeuvre that discriminates between the probable sets of a posterior."""
    discrimination = ModelDiscrimination(
        probable_sets(scored_sets(found)),
        found.problem.vehicle,
        NoiseLevels.of(found),
        found.problem.library,
        found.problem.reference,
    )
    return discrimination_text(discrimination, platform)


def discrimination_text(discrimination: ModelDiscrimination, platform: bool) -> str:
    """Return sentences on the manoeuvre that discriminates best between the sets; "": nothing is in doubt.

    platform: the slab of the vehicle file stands in the arena.
    """
    if discrimination.probabilities.max() >= thresholds.DECIDED:
        return ""
    piece, expected = most_informative_piece(discrimination, Space.of(discrimination.vehicle, platform))
    lines = indistinguishable(discrimination, expected)
    right, before = discrimination.probabilities @ np.diag(expected), (discrimination.probabilities**2).sum()
    if right > before + thresholds.LEAST_GAIN:
        flown = f"{piece.text[0].upper()}{piece.text[1:]}, again and again: after {SECONDS:.0f} s"
        lines.insert(0, f"{flown} the right one is expected to have a probability of {100 * right:.0f} %.")
    return " ".join(lines)


def _shown(discrimination: ModelDiscrimination) -> tuple[str, dict[int, str]]:
    """Return a sentence on the effects common to the probable sets, and the rest of each by its index."""
    shown = {k: h.effects for k, h in enumerate(discrimination.hypotheses) if h.probability >= SHOWN_ABOVE}
    shared = [n for n in next(iter(shown.values())) if all(n in names for names in shown.values())]
    rest = {k: [n for n in names if n not in shared] for k, names in shown.items()}
    texts = {k: " with ".join(names) or "nothing" + " else" * bool(shared) for k, names in rest.items()}
    return f"Missing in any case: {_joined(shared, 'and')}. " if shared else "", texts


def competing_sets(discrimination: ModelDiscrimination) -> str:
    """Return a sentence or two on the sets in doubt."""
    shared, texts = _shown(discrimination)
    rows = [f"{text} ({discrimination.probabilities[k]:.2f})" for k, text in texts.items()]
    return f"{shared}In doubt: {_joined(rows, 'or')}."


def outcome(discrimination: ModelDiscrimination, expected: np.ndarray) -> str:
    """Return a sentence on the expected probabilities after a flight."""
    before, after = discrimination.probabilities, np.diag(expected)
    rows = [f"{text} from {before[k]:.2f} to {after[k]:.2f}" for k, text in _shown(discrimination)[1].items()]
    return (
        f"Expected afterwards: the right one has a probability of {before @ after:.2f}, without a flight "
        f"{before @ before:.2f} (each if it is right: {', '.join(rows)})."
    )


def indistinguishable(discrimination: ModelDiscrimination, expected: np.ndarray) -> list[str]:
    """Return a sentence for every group of sets that stays indistinguishable, with a remedy."""
    p, lines, texts = discrimination.probabilities, [], _shown(discrimination)[1]
    remaining = expected / (expected + np.diag(expected)[:, None])  # of the doubt between two, after
    pairs = remaining > thresholds.LEFT_IN_DOUBT * p / (p + p[:, None])
    np.fill_diagonal(pairs, False)
    count, group = connected_components(pairs & pairs.T, directed=False)
    for k in range(count):
        own = [i for i in texts if group[i] == k]
        if len(own) > 1:
            names = [discrimination.hypotheses[i].effects for i in own]
            apart = set().union(*names) - set(names[0]).intersection(*names[1:])
            shown = dict.fromkeys(t for n in sorted(apart) if (t := LIBRARY[n].told_by))
            what = _joined(
                sorted(apart) if len(apart) > 1 else [f"with {name} and without" for name in apart], "and"
            )
            first = f"No flight that could be planned separates these candidates: {what}."
            lines.append(" ".join([first, *shown]))
    return lines


def variation(names: Sequence[str]) -> str:
    """Return a sentence on the regressors that the flight varies."""
    what = _joined(list(dict.fromkeys(names)), "and")
    return f"The residual depends on {what}: the flight varies that as broadly as it can."


def flight(plan: Plan) -> list[str]:
    """Return a line for every piece of a flight, with its time."""
    return [f"{s.start:5.1f} s  {s.piece.text}" for s in plan.path.spans]


def why_near(plan: Plan) -> list[str]:
    """Return a sentence on why a flight goes close to a surface; none where it does not."""
    near = [s.piece for s in plan.path.spans if s.piece.near]
    if not near or plan.without is None:
        return []
    low = min(near, key=lambda piece: piece.height)
    with_it, without = np.diag(plan.expected), np.diag(plan.without)
    named = [bool(h.effects) for h in plan.discrimination.hypotheses]  # "nothing" needs no going anywhere
    k = int(np.argmax(np.where(named, with_it - without, -1.0)))
    what = plan.discrimination.hypotheses[k].text
    surface = "slope" if low.kind == "slope_hover" else "floor"
    return [
        f"It goes down to {low.height:.2f} m above the {surface} because {what} cannot be told higher up: if "
        f"that is right, it is expected to have {with_it[k]:.2f} afterwards, without going there "
        f"{without[k]:.2f}."
    ]


def next_command(flight: str, platform: bool, arena: str | None) -> str:
    """Return the command that flies a plan; arena: vehicle file of a room that is not the shipped one."""
    options = ["" if platform else " --no-platform", f" --arena {arena}" if arena else ""]
    return f"landing-eval fly --plan {flight}{''.join(options)} --uri URI --mocap TYPE:HOST:BODY"


def _joined(rows: Sequence[str], last: str) -> str:
    return rows[0] if len(rows) == 1 else f"{', '.join(rows[:-1])} {last} {rows[-1]}"
