"""The report of `changes` in sentences and tables; every sentence comes from its numbers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd

from inclined_landing.envs.shared.tables import count_words, new_table, say, share_cell, show_table
from inclined_landing.eval.base.claims import Section, Table
from inclined_landing.eval.base.markdown import escaped
from inclined_landing.eval.base.markdown import table as markdown_table
from inclined_landing.eval.robustness.changes import SIZES
from inclined_landing.eval.robustness.figures import matrix

REMARK = "did not seem to improve the final performance"  # of randomisation, in the paper
ENOUGH, ENOUGH_MEDIUM = 0.97, 0.95  # shares from which a thrust, and a medium effect, count as survived


def summary(report: dict) -> dict[str, tuple]:
    """Return heads and one row for each policy: no effect, thrust range, means over effects, worst effect."""
    heads: tuple[str, ...] = ("policy", "trained", "no effect [%]", f"thrusts with {100 * ENOUGH:.0f} %")
    if report["effects"]:
        heads += tuple(f"{size} [%]" for size in SIZES)
        heads += (f"medium with {100 * ENOUGH_MEDIUM:.0f} %", "worst medium")
    rows = []
    for k, policy in enumerate(report["policies"]):
        low, high = survived(report, k)
        row = [
            *(policy["name"], _trained(policy)),
            share_cell(_nominal(report)["outcomes"][k]["strict"]),
            "-" if math.isnan(low) else f"{low:g} to {high:g}",
        ]
        rows.append((*row, *_over_effects(report, k)))
    return {"heads": heads, "rows": tuple(rows)}


def _over_effects(report: dict, k: int) -> list[str]:
    """Return the cells of a policy about effects: mean of each size, medium ones survived, the worst."""
    if not report["effects"]:
        return []
    shares: dict[str, dict[str, float]] = {size: {} for size in SIZES}
    for found in report["effects"]:
        shares[found["size"]][found["effect"]] = found["outcomes"][k]["strict"]["share"]
    medium = shares["medium"]
    worst = min(medium, key=lambda name: medium[name])
    return [
        *(f"{100 * np.mean(list(of_size.values())):.1f}" for of_size in shares.values()),
        f"{sum(x >= ENOUGH_MEDIUM for x in medium.values())} of {len(medium)}",
        f"{worst} {100 * medium[worst]:.1f}",
    ]


def _trained(policy: dict) -> str:
    """Return what the policy's training had beyond the task as it is."""
    kind = "randomised" if policy["randomised"] else "nominal"
    return f"{kind}, history {policy['history']}" if policy["history"] else kind


def thrust(report: dict, brief: bool = False) -> dict[str, tuple]:
    """Return heads and one row for each thrust: strict success, rest and touchdown speed of every policy.

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
    """Return heads and one row for each effect: weak / medium / strong of every policy, then at rest."""
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
    """Return the range of thrusts around 1 over which a policy lands nearly always; NaN where never."""
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
    """Return what the numbers say of each policy beside the first, and of the paper's remark."""
    policies = report["policies"]
    said = []
    verdicts: dict[tuple[int, int], list[str]] = {}
    for policy, difference in zip(policies[1:], report["differences"]):
        sizes = ", ".join(f"{_points(difference[size])} under {size}" for size in SIZES if size in difference)
        said.append(
            f"In strict success {policy['name']} differs from {policies[0]['name']} by "
            f"{_points(difference['none'])} points without an effect"
            + (f"; on average by {sizes} ones." if sizes else ".")
        )
        if policy["randomised"] and sizes:
            differing = _sign(difference["medium"]) or _sign(difference["strong"])
            signs = _sign(difference["none"]), differing
            verdicts.setdefault(signs, []).append(policy["name"])
    for signs, names in verdicts.items():
        paper = f'The paper says of randomisation that it "{REMARK}".'
        said.append(f"{paper} On the vehicle known to {' and '.join(names)}, {_answer(*signs)}.")
    return said


def answers(report: dict) -> list[str]:
    """Return a sentence on what each policy lands under: thrusts, effects of medium size, the worst one."""
    found = []
    for k, policy in enumerate(report["policies"]):
        parts = [f"{policy['name']} landed in {count_words(_nominal(report)['outcomes'][k]['strict'])}"]
        low, high = survived(report, k)
        if len(report["thrust"]) > 1:
            near = f"{100 * ENOUGH:.0f} % or more at thrusts x {low:g} to x {high:g}"
            parts.append(f"under {100 * ENOUGH:.0f} % at the thrust it knows" if math.isnan(low) else near)
        medium = {
            row["effect"]: row["outcomes"][k]["strict"]
            for row in report["effects"]
            if row["size"] == "medium"
        }
        if medium:
            good = sum(share["share"] >= ENOUGH_MEDIUM for share in medium.values())
            worst = min(medium, key=lambda name: medium[name]["share"])
            parts.append(
                f"{100 * ENOUGH_MEDIUM:.0f} % or more under {good} of {len(medium)} medium effects, least "
                f"under {worst}: {count_words(medium[worst])}"
            )
        found.append("; ".join(parts) + ".")
    return found


def _answer(plain: int, differing: int) -> str:
    """Return what randomisation does, 1, 0 or -1 on the known vehicle and on differing ones, in words."""
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
    """Return a difference of shares with its interval as text, in percentage points."""
    low, high = value["interval"] or (value["mean"],) * 2
    return f"{100 * value['mean']:+.1f} ({100 * low:+.1f} to {100 * high:+.1f})"


def _sign(value: dict | None) -> int:
    """Return 1 or -1 where the interval of a difference excludes 0, else 0."""
    if value is None or value["interval"] is None:
        return 0
    low, high = value["interval"]
    return int(low > 0) - int(high < 0)


def _nominal(report: dict) -> dict:
    return next(row for row in report["thrust"] if row["parameters"]["scale"]["value"] == 1.0)


def markdown(report: dict) -> str:
    """Return the report as Markdown: sentences, pictures, tables."""
    lines = [*(f"- {escaped(sentence)}" for sentence in sentences(report)), ""]
    lines += ["![Shares over thrust](robustness_thrust.png)", ""]
    if report["effects"]:
        lines += ["![Effects and policies](robustness_matrix.png)", ""]
    lines += [f"{report['starts']} starts, {report['plant']} plant, 95 % Wilson intervals.", ""]
    tables: list[dict[str, Any]] = [summary(report), thrust(report)] + (
        [effects(report)] if report["effects"] else []
    )
    for found in tables:
        lines += [*markdown_table(**found), ""]
    return "\n".join(lines)


def conditions_csv(report: dict[str, Any]) -> str:
    """Return one row for each policy and condition: shares with their counts, touchdown speed [m/s]."""
    rows = []
    for row in (*report["thrust"], *report["effects"]):
        size = "; ".join(f"{name} {p['value']:g} {p['unit']}" for name, p in row["parameters"].items())
        for policy, outcome in zip(report["policies"], row["outcomes"]):
            rows.append(
                {
                    "policy": policy["name"],
                    "effect": row["effect"],
                    "size": row["size"],
                    "parameters": size,
                    "starts": outcome["strict"]["of"],
                    "strict": outcome["strict"]["count"],
                    "success": outcome["success"]["count"],
                    "touched": outcome["touched"]["count"],
                    "at_rest_on_feet": outcome["at_rest_on_feet"]["count"],
                    "normal_speed_median": outcome["normal_speed"]["median"],
                    "normal_speed_p95": outcome["normal_speed"]["p95"],
                }
            )
    return pd.DataFrame(rows).to_csv(index=False, float_format="%.6g")


def show(report: dict[str, Any]) -> None:
    """Print the report of `evaluate`."""
    title = f"Strict success, {report['starts']} starts, {report['plant']} plant"
    brief = summary(report)
    across = tuple(zip(brief["heads"], *brief["rows"]))  # a column for each policy
    few = 1 + len(report["policies"])  # columns: what strict success is of each effect
    tables: dict[str, tuple[dict[str, Any], int | None]] = {
        title: ({"heads": across[0], "rows": across[1:]}, None),
        "Over thrust": (thrust(report, brief=True), None),
        "Effects: weak / medium / strong": (effects(report), few),
    }
    for name, (found, columns) in tables.items():
        if found["rows"]:
            printed = new_table(name, *found["heads"][:columns])
            for row in found["rows"]:
                printed.add_row(*row[:columns])
            show_table(printed)
    say(*sentences(report), *answers(report))


def sections(report: dict[str, Any]) -> list[Section]:
    """Return the sections of the page: in short, over thrust, effects of the library."""

    def tables(found: dict[str, tuple], caption: str = "") -> list[Table]:
        return [Table(caption, found["heads"], list(found["rows"]))]

    note = (
        "Strict success: the goal box within 300 steps, no touch before; means over the effects of a size. "
        f"Thrusts without a gap around 1 at which at least {100 * ENOUGH:.0f} % land. "
        f"{report['starts']} starts, {report['plant']} plant."
    )
    found = [Section("short", "In short", [], [], tables(summary(report)), {}, [note])]
    if len(report["thrust"]) > 1:
        figure = {"robustness_thrust": "Shares over the plant's thrust, with 95 % intervals."}
        found.append(Section("thrust", "Over thrust", [], [], tables(thrust(report)), figure))
    if report["effects"]:
        text = (
            "Only the vehicle in the plant has the effect. Medium is the size that a real vehicle may well "
            "have; weak is half as much, strong twice as much, within physical limits."
        )
        figure = {"robustness_matrix": "Shares for every effect in three sizes; the most costly at the top."}
        numbers = tables(effects(report), "All numbers: weak / medium / strong")
        found.append(Section("effects", "Effects of the library", text, [], numbers, figure))
    return found
