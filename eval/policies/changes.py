"""Landing policies on a vehicle that differs from their model: another thrust, every effect.

Each policy flies from the frozen grid under each condition. Only the vehicle in the plant differs; when it
reaches the goal box, its motors are cut. The medium size of an effect is its plausible one; weak is half as
far from neutral, strong twice.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Annotated, Any

import numpy as np
import pandas as pd
from msgspec import Meta

from inclined_landing.envs.policy import Policy
from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.statistics import mean
from inclined_landing.envs.shared.tables import count_words
from inclined_landing.eval.policies.flying import effect_outcome, fly, frozen_starts
from inclined_landing.eval.policies.study import Study, fly_all, joined
from inclined_landing.eval.policies.tables import STRICT, Panel
from inclined_landing.models.effects import LIBRARY, Effect
from inclined_landing.models.errors import UserError, choices, shown
from inclined_landing.models.vehicle import Vehicle

# Of a vehicle that has the effect: how far from neutral, in distances of what is plausible.
SIZES = {"weak": 0.5, "medium": 1.0, "strong": 2.0}
ThrustScale = Annotated[float, Meta(gt=0, le=3)]
THRUSTS = tuple(round(0.70 + 0.05 * k, 2) for k in range(10))
ENOUGH, ENOUGH_MEDIUM = 0.97, 0.95  # shares from which a thrust, and a medium effect, count as survived
REMARK = (
    f"{STRICT} At rest on feet: 2 s after the motors are cut in the goal box. Normal speed: median at "
    "touchdown. The medium size of an effect is plausible for a real vehicle; weak is half of it, strong "
    "twice, within physical limits."
)
_THRUST = "thrust_scale"  # the effect that the curve goes along


@dataclasses.dataclass(frozen=True)
class Change:
    """How the vehicle in the plant differs from the one that the policies know."""

    effect: Effect | None  # of the library; None: the unchanged vehicle
    size: str  # one of SIZES; "" on the curve over thrust
    values: dict[str, float]

    def vehicle(self, known: Vehicle) -> Vehicle:
        """Return the vehicle in the plant."""
        return known if self.effect is None else self.effect.apply(known, self.values)

    @property
    def name(self) -> str:
        """Return effect and size as text, different for each change."""
        return f"{self.effect.name} {self.size or self.values['scale']}" if self.effect else "no effect"

    @property
    def row(self) -> dict[str, Any]:
        """Return what a report says of the change."""
        effect = self.effect or LIBRARY[_THRUST]
        return {"effect": effect.name, "size": self.size, "parameters": sizes(effect, self.values)}


def check_effects(names: Sequence[str]) -> None:
    """Raise UserError for a name that is not an effect of the library."""
    for name in names:
        if name not in LIBRARY:
            raise UserError(f"unknown effect {shown(name, 40)}; {choices(LIBRARY, name)}")


def sizes(effect: Effect, values: Mapping[str, float]) -> dict[str, dict[str, Any]]:
    """Return values of an effect's parameters with their units, for a report."""
    units = {p.name: p.unit for p in effect.parameters}
    return {name: {"value": value, "unit": units[name]} for name, value in values.items()}


def sized(effect: Effect, share: float) -> dict[str, float]:
    """Return parameter values `share` times as far from neutral as plausible ones, within their bounds."""
    values = {}
    for p in effect.parameters:
        value = p.plausible if p.is_reference else p.neutral + share * (p.plausible - p.neutral)
        values[p.name] = min(max(value, p.possible[0]), p.possible[1])
    return values


def changes(
    thrusts: Sequence[float] = THRUSTS,
    effects: Sequence[str] = tuple(LIBRARY),
    of_sizes: Sequence[str] = tuple(SIZES),
) -> list[Change]:
    """Return the unchanged vehicle, the curve over thrust, then every effect in every size."""
    curve = [Change(LIBRARY[_THRUST], "", {"scale": x}) for x in sorted(set(thrusts) - {1.0})]
    of_effects = [
        Change(LIBRARY[name], size, sized(LIBRARY[name], SIZES[size]))
        for name in effects
        for size in of_sizes
    ]
    return [Change(None, "", {"scale": 1.0}), *curve, *of_effects]


def run(policies: Mapping[str, Policy], cases: Sequence[Change], *, plant: str, every: int = 1) -> Study:
    """Return the study of policies, given by their labels, under changes of their vehicle.

    every: fly from each k-th start of the frozen grid. Raises UserError for policies that do not land, or for
    different slopes.
    """
    names = list(policies)
    first = policies[names[0]].task
    for name, policy in policies.items():
        if policy.task.table != "goal_box":
            what = "observes the slope" if policy.task.table == "slopes" else f"is for {policy.task.name}"
            raise UserError(
                f"policy {policy.path} {what}; --over thrust and effects needs policies that land on one "
                "slope"
            )
        if not math.isclose(policy.task.inclination, first.inclination):
            raise UserError(f"policies {names[0]} and {name} were trained for different inclinations")
    starts = frozen_starts(first)[::every]
    vehicles = {case.name: case.vehicle(first.vehicle) for case in cases}
    flown = fly_all(
        {
            (name, case.name): partial(fly, policy, starts, plant, vehicle=vehicles[case.name])
            for case in cases
            for name, policy in policies.items()
        }
    )
    rows = [
        case.row
        | {"outcomes": [effect_outcome(policies[name].task, flown[name, case.name]) for name in names]}
        for case in cases
    ]
    report = {
        "command": "robustness",
        "plant": plant,
        "starts": len(starts),
        "inclination": first.inclination,
        "policies": [
            {
                "name": name,
                "policy": str(policy.path),
                "trained": policy.metadata,
                "task_options": policy.task.options,
            }
            for name, policy in policies.items()
        ],
        "thrust": sorted((row for row in rows if not row["size"]), key=_scale),
        "effects": [row for row in rows if row["size"]],
        "differences": _differences(cases, names, flown),
        "versions": runs.versions(),
    }
    return Study(
        name="robustness",
        title=f"Other thrusts, effects of the library, {plant} plant",
        report=report,
        flights=joined(flown),
        heads=("condition", "policy"),
        rows=[
            ((case.name, name), outcome)
            for case, row in zip(cases, rows)
            for name, outcome in zip(names, row["outcomes"])
        ],
        panels=_panels(report, names),
        remarks=[REMARK, *_left_out(report), *_comparisons(report), *_answers(report)],
    )


def _differences(
    cases: Sequence[Change], names: Sequence[str], flown: Mapping[tuple[str, str], pd.DataFrame]
) -> list[dict[str, Any]]:
    """Return the differences of the shares of each further policy from the first's, with intervals.

    Without an effect the interval is over the starts, which are the same; over the effects of one size it is
    over the effects.
    """
    landed = [[flown[name, case.name]["strict"].to_numpy(float) for name in names] for case in cases]
    share = np.mean(landed, axis=2)
    result = []
    for k in range(1, len(names)):
        of_size = {size: [c for c, case in enumerate(cases) if case.size == size] for size in SIZES}
        result.append(
            {"none": mean(landed[0][k] - landed[0][0])}
            | {size: mean(share[rows, k] - share[rows, 0]) for size, rows in of_size.items() if rows}
        )
    return result


def survived(report: dict, k: int) -> tuple[float, float] | None:
    """Return the range of thrusts around 1 at which a policy nearly always lands; None if it never does."""
    scales = [_scale(row) for row in report["thrust"]]
    good = [row["outcomes"][k]["strict"]["share"] >= ENOUGH for row in report["thrust"]]
    low = high = scales.index(1.0)
    if not good[low]:
        return None
    while low > 0 and good[low - 1]:
        low -= 1
    while high < len(good) - 1 and good[high + 1]:
        high += 1
    return scales[low], scales[high]


def _panels(report: dict, names: Sequence[str]) -> list[Panel]:
    """Return strict success over the thrust, and under the effects of each size, the most costly first.

    Effects under which every policy lands nearly always, whatever their size, are left out; so are sizes
    under which this holds for all effects. The table has them.
    """
    panels = []
    if len(curve := report["thrust"]) > 1:
        lines = {n: {_scale(r): r["outcomes"][k]["strict"] for r in curve} for k, n in enumerate(names)}
        panels = [Panel("Other thrusts", lines, "actual thrust / model thrust")]
    cost: dict[str, float] = {}
    for row in report["effects"]:
        landed = sum(one["strict"]["share"] for one in row["outcomes"])
        cost[row["effect"]] = cost.get(row["effect"], 0.0) + landed
    costly = [row for row in report["effects"] if _costs(row)]
    drawn = {row["effect"] for row in costly}
    by_cost = sorted((r for r in report["effects"] if r["effect"] in drawn), key=lambda r: cost[r["effect"]])
    for size in (size for size in SIZES if any(row["size"] == size for row in costly)):
        of_size = [row for row in by_cost if row["size"] == size]
        shares = {n: {r["effect"]: r["outcomes"][k]["strict"] for r in of_size} for k, n in enumerate(names)}
        panels.append(Panel(f"{size.capitalize()} effects", shares))
    return panels or [
        Panel("No effect", {n: {"known": curve[0]["outcomes"][k]["strict"]} for k, n in enumerate(names)})
    ]


def _costs(row: dict) -> bool:
    """Return whether a policy loses more than a few landings under the effect of a row."""
    return any(one["strict"]["share"] < ENOUGH_MEDIUM for one in row["outcomes"])


def _scale(row: dict) -> float:
    return row["parameters"]["scale"]["value"]


def _comparisons(report: dict) -> list[str]:
    """Return a sentence on how each further policy differs from the first one."""
    first, *others = [policy["name"] for policy in report["policies"]]
    said = []
    for name, difference in zip(others, report["differences"]):
        parts = []
        for size, value in difference.items():
            low, high = value["interval"] or (value["mean"],) * 2
            where = "without an effect" if size == "none" else f"under {size} effects"
            parts.append(f"{100 * value['mean']:+.1f} ({100 * low:+.1f} to {100 * high:+.1f}) {where}")
        said.append(f"Strict success of {name} minus {first} in percentage points: {', '.join(parts)}.")
    return said


def _left_out(report: dict) -> list[str]:
    """Return a sentence on the effects that the figure omits, if there are any."""
    effects = {row["effect"] for row in report["effects"]}
    count = len(effects - {row["effect"] for row in report["effects"] if _costs(row)})
    if not count:
        return []
    landed = f"every policy landed in {100 * ENOUGH_MEDIUM:.0f} % or more of the flights"
    return [f"Under {count} of {len(effects)} effects {landed}; the figure of --out omits these effects."]


def _answers(report: dict) -> list[str]:
    """Return a sentence on what each policy lands under: thrusts, effects of medium size, the worst one."""
    said = []
    for k, policy in enumerate(report["policies"]):
        known = next(row for row in report["thrust"] if _scale(row) == 1.0)
        parts = [f"{policy['name']} landed in {count_words(known['outcomes'][k]['strict'])}"]
        if len(report["thrust"]) > 1 and (ends := survived(report, k)):
            parts.append(f"{100 * ENOUGH:.0f} % or more at thrusts x {ends[0]:g} to x {ends[1]:g}")
        medium = [row for row in report["effects"] if row["size"] == "medium"]
        if medium:
            shares = {row["effect"]: row["outcomes"][k]["strict"] for row in medium}
            good = sum(share["share"] >= ENOUGH_MEDIUM for share in shares.values())
            worst = min(shares, key=lambda name: shares[name]["share"])
            parts.append(
                f"{100 * ENOUGH_MEDIUM:.0f} % or more under {good} of {len(shares)} medium effects; the "
                f"worst is {worst} with {count_words(shares[worst])}"
            )
        said.append("; ".join(parts) + ".")
    return said
