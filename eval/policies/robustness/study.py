"""Landing policies in a plant that differs from what they know: another thrust, every effect of the library.

Each flies from the frozen grid under each condition. Only the vehicle in the plant is another; where the goal
box is reached, its motors are cut.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.progress import track

from inclined_landing.envs.policy import Policy
from inclined_landing.eval.base import runs
from inclined_landing.eval.base.statistics import mean
from inclined_landing.eval.policies import success_effects
from inclined_landing.eval.policies.judges import judge_of
from inclined_landing.models.effects import LIBRARY, Effect
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.parameters import Vehicle

# Of a vehicle that has the effect: how far from neutral, in distances of what is plausible.
SIZES = {"weak": 0.5, "medium": 1.0, "strong": 2.0}
THRUSTS = tuple(round(0.70 + 0.05 * k, 2) for k in range(10))
_THRUST = "thrust_scale"  # the effect that the curve goes along


@dataclasses.dataclass(frozen=True)
class Condition:
    """What the plant's vehicle is, beside what the policies know."""

    effect: Effect | None  # of the library; None: the vehicle as it is
    size: str  # one of SIZES; "" on the curve over thrust
    values: dict[str, float]

    def vehicle(self, known: Vehicle) -> Vehicle:
        """The vehicle in the plant."""
        return known if self.effect is None else self.effect.apply(known, self.values)

    @property
    def words(self) -> str:
        """Effect and size."""
        return f"{self.effect.name if self.effect else 'no effect'} {self.size}".strip()


def sized(effect: Effect, share: float) -> dict[str, float]:
    """Parameter values `share` times as far from neutral as plausible ones, within what is possible."""
    values = {}
    for p in effect.parameters:
        wanted = p.plausible if p.is_reference else p.neutral + share * (p.plausible - p.neutral)
        low, high = p.possible
        values[p.name] = min(max(wanted, low), high)
    return values


def conditions(
    thrusts: Sequence[float] = THRUSTS, effects: Sequence[str] = tuple(LIBRARY)
) -> list[Condition]:
    """The vehicle as it is, the curve over thrust, then every effect in every size."""
    thrust = LIBRARY[_THRUST]
    result = [Condition(None, "", {"scale": 1.0})]
    result += [Condition(thrust, "", {"scale": x}) for x in sorted(set(thrusts) - {1.0})]
    for name in effects:
        result += [Condition(LIBRARY[name], size, sized(LIBRARY[name], k)) for size, k in SIZES.items()]
    return result


def evaluate(
    policies: Sequence[Policy],
    *,
    plant: str = "mujoco",
    every: int = 1,
    thrusts: Sequence[float] = THRUSTS,
    effects: Sequence[str] = tuple(LIBRARY),
) -> dict:
    """The report as plain numbers: `thrust` and `effects`, one entry for each condition.

    An entry has `outcomes`, one for each policy. every: flies from each k-th start of the frozen grid.
    Raises UserError for policies that do not land, or on slopes that differ.
    """
    for policy in policies:
        if not policy.task.cut_at_success:
            raise UserError(f"policy {policy.path} is for the task {policy.task.name}, not for landing")
        if policy.task.table != "goal_box":
            raise UserError(f"policy {policy.path} observes the slope; robustness flies from the grid of one")
        if not math.isclose(policy.task.inclination, policies[0].task.inclination):
            raise UserError(
                f"policies {policies[0].name} and {policy.name} are for platforms of different inclination"
            )
    names = _labels(policies)
    judge, first = judge_of(policies[0].task), policies[0].task
    starts = judge.groups(first, 0)[judge.frozen][::every]
    cases = conditions(thrusts, effects)
    rows, landed = [], np.zeros((len(cases), len(policies), len(starts)))
    for c, case in enumerate(track(cases, "flying", console=Console(stderr=True), transient=True)):
        vehicle = case.vehicle(first.vehicle)
        outcomes = []
        for k, policy in enumerate(policies):
            try:
                flights = success_effects.fly(policy, plant, vehicle, starts)
            except FloatingPointError as error:
                raise UserError(f"{names[k]}, {case.words}: {error}") from error
            outcomes.append(judge.effect(policy.task, flights, vehicle))
            landed[c, k] = [flight.strict for flight in flights]
        effect, values = case.effect or LIBRARY[_THRUST], case.values
        sizes = success_effects.sizes(effect, values)
        rows.append({"effect": effect.name, "size": case.size, "parameters": sizes, "outcomes": outcomes})
    curve = sorted((r for r in rows if not r["size"]), key=lambda r: r["parameters"]["scale"]["value"])
    return {
        "command": "robustness",
        "plant": plant,
        "starts": len(starts),
        "inclination": first.inclination,
        "policies": [_description(name, policy) for name, policy in zip(names, policies)],
        "thrust": curve,
        "effects": [row for row in rows if row["size"]],
        "differences": _differences(cases, landed),
        "versions": runs.versions(),
    }


def _differences(cases: Sequence[Condition], landed: np.ndarray) -> list[dict]:
    """By how much each further policy lands more often than the first: differences of shares, with intervals.

    landed (c, k, n) of condition, policy and start. Without an effect the interval is over the starts, which
    are the same; over the effects of one size it is over the effects.
    """
    result = []
    share = landed.mean(axis=2)
    for k in range(1, landed.shape[1]):
        sizes = {}
        for size in SIZES:
            own = [c for c, case in enumerate(cases) if case.size == size]
            if own:
                sizes[size] = mean(share[own, k] - share[own, 0])
        result.append({"none": mean(landed[0, k] - landed[0, 0]), **sizes})
    return result


def _labels(policies: Sequence[Policy]) -> list[str]:
    """A name for each policy: that of its file, where others have the same with its folder before it."""
    names = [policy.name for policy in policies]
    labels = [
        f"{policy.path.parent.name}/{name}" if names.count(name) > 1 else name
        for name, policy in zip(names, policies)
    ]
    for k, label in enumerate(labels):
        if label in labels[:k]:
            raise UserError(f"policy {shown(label, 100)} is named twice")
    return labels


def _description(name: str, policy: Policy) -> dict:
    return {
        "name": name,
        "policy": str(policy.path),
        "trained": policy.metadata,
        "task_options": policy.task.options,
        "history": policy.task.history,
        "randomised": "ranges" in policy.metadata,
    }
