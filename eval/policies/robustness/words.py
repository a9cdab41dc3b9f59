"""What a robustness report says, in sentences and tables; every sentence comes from its numbers."""

from __future__ import annotations

import math

import numpy as np

from inclined_landing.eval.base.tables import share_cell
from inclined_landing.eval.policies.robustness.figures import matrix
from inclined_landing.eval.policies.robustness.study import SIZES

REMARK = "did not seem to improve the final performance"  # of randomisation, in the paper
ENOUGH, ENOUGH_MEDIUM = 0.97, 0.95  # shares from which a thrust, and a medium effect, count as survived


def summary(report: dict) -> dict[str, tuple]:
    """Heads and one row for each policy: no effect, thrusts survived, means over effects, the worst one."""
    heads = ("policy", "trained", "no effect [%]", f"thrusts with {100 * ENOUGH:.0f} %")
    heads += (*(f"{size} [%]" for size in SIZES), f"medium with {100 * ENOUGH_MEDIUM:.0f} %", "worst medium")
    rows = []
    for k, policy in enumerate(report["policies"]):
        low, high = survived(report, k)
        row = [
            *(policy["name"], _trained(policy)),
            share_cell(_nominal(report)["outcomes"][k]["strict"]),
            "-" if math.isnan(low) else f"{low:g} to {high:g}",
        ]
        shares = {size: {} for size in SIZES}
        for found in report["effects"]:
            shares[found["size"]][found["effect"]] = found["outcomes"][k]["strict"]["share"]
        row += [f"{100 * np.mean(list(own.values())):.1f}" for own in shares.values()]
        medium = shares["medium"]
        worst = min(medium, key=lambda name: medium[name])
        row.append(f"{sum(x >= ENOUGH_MEDIUM for x in medium.values())} of {len(medium)}")
        row.append(f"{worst} {100 * medium[worst]:.1f}")
        rows.append(tuple(row))
    return {"heads": heads, "rows": tuple(rows)}


def _trained(policy: dict) -> str:
    """What the policy's training had beyond the task as it is."""
    kind = "randomised" if policy["randomised"] else "nominal"
    return f"{kind}, history {policy['history']}" if policy["history"] else kind


def thrust(report: dict, brief: bool = False) -> dict[str, tuple]:
    """Heads and one row for each thrust: strict success, rest and touchdown speed of every policy.

    brief: strict success and rest without their intervals, in one cell.
    """
    names = [policy["name"] for policy in report["policies"]]
    parts = ("strict, at rest [%]",) if brief else ("strict [%]", "at rest [%]", "touch [m/s]")
    heads = ("thrust", *(f"{name}: {part}" for name in names for part in parts))
    rows = []
    for row in report["thrust"]:
        cells = [f"x {row['parameters']['scale']['value']:g}"]
        for outcome in row["outcomes"]:
            if brief:
                shares = (outcome[key]["share"] for key in ("strict", "at_rest_on_feet"))
                cells.append(", ".join(f"{100 * share:.1f}" for share in shares))
                continue
            speed = outcome["normal_speed"]["median"]
            cells += [share_cell(outcome["strict"]), share_cell(outcome["at_rest_on_feet"])]
            cells.append("-" if speed is None else f"{speed:.2f}")
        rows.append(tuple(cells))
    return {"heads": heads, "rows": tuple(rows)}


def effects(report: dict) -> dict[str, tuple]:
    """Heads and one row for each effect: weak / medium / strong of every policy, then at rest."""
    names = [policy["name"] for policy in report["policies"]]
    keys = {"strict": "strict [%]", "at_rest_on_feet": "at rest [%]"}
    heads = ("effect", *(f"{name}: {label}" for label in keys.values() for name in names))
    rows = []
    for name, found in matrix(report).items():
        cells = [name]
        for key in keys:
            for k in range(len(names)):
                cells.append(" / ".join(f"{100 * row['outcomes'][k][key]['share']:.1f}" for row in found))
        rows.append(tuple(cells))
    return {"heads": heads, "rows": tuple(rows)}


def survived(report: dict, k: int) -> tuple[float, float]:
    """The thrusts around 1 from which to which the k-th policy lands nearly always; NaN where never."""
    scale = np.array([row["parameters"]["scale"]["value"] for row in report["thrust"]])
    good = np.array([row["outcomes"][k]["strict"]["share"] >= ENOUGH for row in report["thrust"]])
    middle = int(np.flatnonzero(scale == 1.0)[0])
    if not good[middle]:
        return math.nan, math.nan
    bad = np.flatnonzero(~good)
    low = bad[bad < middle].max(initial=-1) + 1
    high = bad[bad > middle].min(initial=len(scale)) - 1
    return float(scale[low]), float(scale[high])


def sentences(report: dict) -> list[str]:
    """What the numbers say of each policy beside the first, and of the paper's remark."""
    policies = report["policies"]
    said = []
    verdicts: dict[tuple[int, int], list[str]] = {}
    for policy, difference in zip(policies[1:], report["differences"]):
        sizes = ", ".join(f"{_points(difference[size])} under {size}" for size in SIZES)
        said.append(
            f"In strict success {policy['name']} differs from {policies[0]['name']} by "
            f"{_points(difference['none'])} points without an effect; on average by {sizes} ones."
        )
        if policy["randomised"]:
            differing = _sign(difference["medium"]) or _sign(difference["strong"])
            signs = _sign(difference["none"]), differing
            verdicts.setdefault(signs, []).append(policy["name"])
    for signs, names in verdicts.items():
        paper = f'The paper says of randomisation that it "{REMARK}".'
        said.append(f"{paper} On the vehicle known to {' and '.join(names)}, {_answer(*signs)}.")
    return said


def _answer(plain: int, differing: int) -> str:
    """What randomisation does, as 1, 0 or -1, on the known vehicle and on those that differ from it."""
    here = {
        1: "it does improve it",
        0: "that is so: no difference can be told",
        -1: "it costs some of it",
    }[plain]
    there = {
        1: "where the vehicle differs from the model it improves it",
        0: "where the vehicle differs from the model no difference can be told",
        -1: "where the vehicle differs from the model it makes it worse",
    }[differing]
    return f"{here}; {'but ' if differing != plain and differing else ''}{there}"


def _points(value: dict) -> str:
    """A difference of shares with its interval, in points."""
    low, high = value["interval"] or (value["mean"],) * 2
    return f"{100 * value['mean']:+.1f} ({100 * low:+.1f} to {100 * high:+.1f})"


def _sign(value: dict | None) -> int:
    """1 or -1 where a difference's interval leaves 0 out."""
    if value is None or value["interval"] is None:
        return 0
    low, high = value["interval"]
    return int(low > 0) - int(high < 0)


def _nominal(report: dict) -> dict:
    return next(row for row in report["thrust"] if row["parameters"]["scale"]["value"] == 1.0)


def markdown(report: dict) -> str:
    """The report for a page of the documents: sentences, pictures, tables."""
    lines = [*(f"- {sentence}" for sentence in sentences(report)), ""]
    lines += [
        "![Shares over thrust](robustness_thrust.png)",
        "",
        "![Effects and policies](robustness_matrix.png)",
        "",
    ]
    lines += [f"{report['starts']} starts, {report['plant']} plant, 95 % Wilson intervals.", ""]
    for table in (summary(report), thrust(report), effects(report)):
        heads = table["heads"]
        lines += [_row(heads), "|---" * len(heads) + "|", *map(_row, table["rows"]), ""]
    return "\n".join(lines)


def _row(cells: tuple) -> str:
    return "| " + " | ".join(cells) + " |"
