"""Landing policies on a vehicle that differs from the known one: another thrust, every effect.

Each policy flies from the frozen grid under each condition. Only the vehicle in the plant differs; where it
reaches the goal box its motors are cut. Of an effect, medium is its plausible size, weak half as far from
neutral, strong twice.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from inclined_landing.envs.policy import Policy
from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.statistics import mean
from inclined_landing.envs.tasks import Start
from inclined_landing.eval.base.conditions import fly_all
from inclined_landing.eval.policies.evaluators import evaluator_of
from inclined_landing.eval.policies.flying import fly, groups_of
from inclined_landing.eval.policies.success import sizes
from inclined_landing.models.effects import LIBRARY, Effect
from inclined_landing.models.errors import UserError
from inclined_landing.models.vehicle import Vehicle

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
        """Return the vehicle in the plant."""
        return known if self.effect is None else self.effect.apply(known, self.values)

    @property
    def words(self) -> str:
        """Return effect and size as text, different for each condition."""
        return f"{self.effect.name} {self.size or self.values['scale']}" if self.effect else "no effect"


def sized(effect: Effect, share: float) -> dict[str, float]:
    """Return parameter values `share` times as far from neutral as plausible ones, within their bounds."""
    values = {}
    for p in effect.parameters:
        wanted = p.plausible if p.is_reference else p.neutral + share * (p.plausible - p.neutral)
        low, high = p.possible
        values[p.name] = min(max(wanted, low), high)
    return values


def conditions(
    thrusts: Sequence[float] = THRUSTS, effects: Sequence[str] = tuple(LIBRARY)
) -> list[Condition]:
    """Return the conditions: the vehicle as it is, the curve over thrust, then every effect in every size."""
    thrust = LIBRARY[_THRUST]
    result = [Condition(None, "", {"scale": 1.0})]
    result += [Condition(thrust, "", {"scale": x}) for x in sorted(set(thrusts) - {1.0})]
    for name in effects:
        result += [Condition(LIBRARY[name], size, sized(LIBRARY[name], k)) for size, k in SIZES.items()]
    return result


def evaluate(
    policies: Mapping[str, Policy],
    *,
    plant: str = "mujoco",
    every: int = 1,
    thrusts: Sequence[float] = THRUSTS,
    effects: Sequence[str] = tuple(LIBRARY),
) -> dict[str, Any]:
    """Return the report as plain numbers: `thrust` and `effects`, one entry for each condition.

    An entry has `outcomes`, one for each of the policies, which are given by their labels. every: fly from
    each k-th start of the frozen grid. Raises UserError for policies that do not land, or for
    different slopes.
    """
    names = list(policies)
    first = policies[names[0]].task
    for name, policy in policies.items():
        if not policy.task.cut_at_success:
            raise UserError(f"policy {policy.path} is for the task {policy.task.name}, not for landing")
        if policy.task.table != "goal_box":
            raise UserError(
                f"policy {policy.path} observes the slope; thrust and effects are flown from the grid of one"
            )
        if not math.isclose(policy.task.inclination, first.inclination):
            raise UserError(f"policies {names[0]} and {name} are for platforms of different inclination")
    starts = groups_of(first, 0)[evaluator_of(first).frozen][::every]
    cases = conditions(thrusts, effects)
    vehicles = {case.words: case.vehicle(first.vehicle) for case in cases}
    flown = fly_all(
        {
            (name, case.words): partial(_count, policy, plant, vehicles[case.words], starts)
            for case in cases
            for name, policy in policies.items()
        }
    )
    rows: list[dict[str, Any]] = []
    landed = np.zeros((len(cases), len(policies), len(starts)))
    for c, case in enumerate(cases):
        found = [flown[name, case.words] for name in names]
        landed[c] = [strict for _, strict in found]
        effect = case.effect or LIBRARY[_THRUST]
        rows.append(
            {
                "effect": effect.name,
                "size": case.size,
                "parameters": sizes(effect, case.values),
                "outcomes": [outcomes for outcomes, _ in found],
            }
        )
    curve = sorted((r for r in rows if not r["size"]), key=lambda r: r["parameters"]["scale"]["value"])
    return {
        "command": "robustness",
        "plant": plant,
        "starts": len(starts),
        "inclination": first.inclination,
        "policies": [_description(name, policy) for name, policy in policies.items()],
        "thrust": curve,
        "effects": [row for row in rows if row["size"]],
        "differences": _differences(cases, landed),
        "versions": runs.versions(),
    }


def _count(policy: Policy, plant: str, vehicle: Vehicle, starts: Start) -> tuple[dict, list[bool]]:
    """Return the outcome of the policy's flights, and which of them are strict successes."""
    flights, cut = fly(policy, plant, vehicle, starts)
    return evaluator_of(policy.task).effect(policy.task, flights, cut), [f.strict for f in flights]


def _differences(cases: Sequence[Condition], landed: np.ndarray) -> list[dict[str, Any]]:
    """Return the differences of the shares of each further policy from the first's, with intervals.

    landed (c, k, n): of condition, policy and start. Without an effect the interval is over the starts, which
    are the same; over the effects of one size it is over the effects.
    """
    result = []
    share = landed.mean(axis=2)
    for k in range(1, landed.shape[1]):
        by_size = {}
        for size in SIZES:
            of_size = [c for c, case in enumerate(cases) if case.size == size]
            if of_size:
                by_size[size] = mean(share[of_size, k] - share[of_size, 0])
        result.append({"none": mean(landed[0, k] - landed[0, 0]), **by_size})
    return result


def _description(name: str, policy: Policy) -> dict[str, Any]:
    return {
        "name": name,
        "policy": str(policy.path),
        "trained": policy.metadata,
        "task_options": policy.task.options,
        "history": policy.task.history,
        "randomised": "ranges" in policy.metadata,
    }
