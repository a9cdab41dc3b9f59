"""What a plan says, in sentences and as plan.json: effects in doubt, manoeuvres, expected probabilities."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from inclined_landing.envs.shared import runs
from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.plan.design import Plan
from inclined_landing.eval.gap.plan.information import ModelDiscrimination
from inclined_landing.eval.gap.plan.reading import PlanInput
from inclined_landing.eval.gap.report.words import label, labels, probability, with_probabilities
from inclined_landing.eval.gap.result import ScoredSet
from inclined_landing.models.effects import LIBRARY

SHOWN_ABOVE = 0.02  # probability of an effect that is mentioned


@dataclasses.dataclass(frozen=True)
class InDoubt:
    """An effect that may be missing in the model, with its probabilities."""

    name: str
    probability: float  # before the flight, as in the report
    if_missing: float  # expected after it, if the model lacks the effect
    if_not: float  # expected after it, if the model does not
    left: float  # share of the doubt that the flight is expected to leave

    @property
    def resolved(self) -> bool:
        """Return whether the flight is expected to resolve most of the doubt."""
        return self.left < thresholds.LEFT_IN_DOUBT


def effects_in_doubt(
    plan_input: PlanInput, discrimination: ModelDiscrimination, expected: np.ndarray
) -> list[InDoubt]:
    """Return the effects that are neither sure nor excluded, most probable first.

    expected (K, K): posterior probability of every set j where the set i is true.
    """
    p, result = discrimination.probabilities, []
    for name in dict.fromkeys(n for h in discrimination.hypotheses for n in h.effects):
        before = plan_input.probabilities[name]
        has = np.array([name in h.effects for h in discrimination.hypotheses])
        if not SHOWN_ABOVE <= before < thresholds.DECIDED or has.all():
            continue
        after = expected[:, has].sum(axis=1)  # of the effect, where each set is true
        if_missing, if_not = (float(p[true] @ after[true] / p[true].sum()) for true in (has, ~has))
        q = p[has].sum()
        doubt = q * (1.0 - if_missing) + (1.0 - q) * if_not  # expected probability of the wrong answer
        result.append(InDoubt(name, before, if_missing, if_not, float(doubt / (2.0 * q * (1.0 - q)))))
    return sorted(result, key=lambda one: -one.probability)


def is_worth_flying(found: Sequence[InDoubt], gain: float) -> bool:
    """Return whether a flight with this gain is expected to show which of the effects in doubt is missing."""
    return gain >= thresholds.LEAST_GAIN and (not found or len(_beyond_flights(found)) < len(found))


def _beyond_flights(found: Sequence[InDoubt]) -> list[str]:
    """Return the effects that stay in doubt and that a flight shows only together."""
    others = {name for name, effect in LIBRARY.items() if effect.scales_thrust or effect.told_by}
    return [one.name for one in found if not one.resolved and one.name in others]


def set_label(one: ScoredSet) -> str:
    """Return the effects of a set as part of a sentence."""
    return labels(one.effects) or "nothing"


def in_doubt(found: Sequence[InDoubt]) -> list[str]:
    """Return a sentence on the effects in doubt."""
    names = with_probabilities({one.name: one.probability for one in found}, "and")
    return [f"In doubt: {names}."] if names else []


def outcome(found: Sequence[InDoubt]) -> list[str]:
    """Return a sentence on the expected probabilities after a flight."""
    beyond = _beyond_flights(found)
    rows = [
        f"{label(one.name)} from {probability(one.probability)} to {probability(one.if_missing)} if the "
        f"model lacks it, to {probability(one.if_not)} if not"
        for one in found
        if one.name not in beyond
    ]
    return [f"Expected probabilities after the flight: {'; '.join(rows)}."] if rows else []


def measured_otherwise(found: Sequence[InDoubt]) -> list[str]:
    """Return a sentence on the effects that stay in doubt, and how they are measured without a flight."""
    beyond = _beyond_flights(found)
    remedies = dict.fromkeys(t for n in beyond if (t := LIBRARY[n].told_by))
    limit = f"{'distinguish' if len(beyond) > 1 else 'show whether the model lacks'} {labels(beyond)}"
    return [" ".join([f"No flight can {limit}.", *remedies])] if remedies else []


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
    what = set_label(plan.discrimination.hypotheses[k])
    surface = "slope" if low.kind == "slope_hover" else "floor"
    return [
        f"The flight descends to {low.height:.2f} m above the {surface} because {what} cannot be identified "
        f"higher up: if the model lacks it, its expected probability is {probability(with_it[k])}, compared "
        f"with {probability(without[k])} without the descent."
    ]


def fly_command(flight: Path, platform: bool, arena: Path | None) -> str:
    """Return the command that flies a plan; arena: vehicle file of a room that is not the shipped one."""
    options = ["" if platform else " --no-platform", f" --arena {arena}" if arena else ""]
    return f"landing-eval fly --plan {flight}{''.join(options)}"


def to_json(plan: Plan, plan_input: PlanInput, found: Sequence[InDoubt], report: Path) -> dict:
    """Return the contents of plan.json; probabilities before the flight are those of the report."""
    states = np.concatenate([s.reshape(-1, s.shape[-1]) for s in plan.trajectories])
    reported = {h.effects: h.probability for h in plan_input.hypotheses}
    sets = [
        {
            "effects": h.effects,
            "probability": reported[h.effects],
            "expected": float(plan.expected[k, k]),
            "values": h.values,
        }
        for k, h in enumerate(plan.discrimination.hypotheses)
    ]
    return {
        "report": str(report),
        "platform": plan_input.platform,
        "seconds": plan.path.seconds,
        "in_doubt": [dataclasses.asdict(one) for one in found],
        "sets": sets,
        "expected": plan.expected_accuracy,
        "gain": plan.gain,
        "pieces": [
            {"kind": s.piece.kind, "start": s.start, "stop": s.stop, "text": s.piece.text}
            | {"parameters": s.piece.parameters}
            for s in plan.path.spans
        ],
        "simulated": {
            "flights": sum(len(s) for s in plan.trajectories),
            "speed": float(np.linalg.norm(states[:, 3:6], axis=1).max()),
            "tilt": float(np.abs(states[:, 6:8]).max()),
            "lowest": float(states[:, 2].min()),
        },
        "versions": runs.versions(),
    }
