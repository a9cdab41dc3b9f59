"""Tables and calibration of many scored cases, as numbers and in Markdown."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from inclined_landing.envs.shared.statistics import proportion, spread

from ..shared import table, table_of
from .cases import STRATA
from .score import GOOD, OUTCOMES

BINS = 10
# Shares over all strata: what is said of a row of the results (`score.score_case`).
SHARES = {
    "nothing hidden: the answer is nothing": "quiet",
    "one cause, medium or strong: sure and alone": "alone",
    "answers nothing with a medium or strong cause hidden": "wrong nothing",
    "cause outside the library: unknown": "outside",
    "unknown beside a right sure name": "beside",
}
LEAST = 1e-3  # of a probability in the log score: a report keeps its likeliest sets only
IN_LIBRARY = ("named", "tie", "spurious", "half", "misnamed", "missed")  # outcomes where it has the cause


def results_of(rows: Sequence[Mapping]) -> dict:
    """Return the numbers of all tables, and the rows."""
    lines = [{"stratum": name} | line(members) for name, members in _groups(rows)]
    return {"table": lines, "shares": shares(rows), "calibration": calibration(rows), "cases": rows}


def _groups(rows: Sequence[Mapping]) -> Iterator[tuple[str, list[Mapping]]]:
    """Yield the strata, the sizes and kinds within some of them, and the families."""
    kinds = {
        "single": lambda row: row["size"],
        "touchdown": lambda row: f"{' '.join(row['causes']) or 'nothing'}, {row['size'] or '-'}",
    }
    for stratum in STRATA:
        members = [row for row in rows if row["stratum"] == stratum]
        if members:
            yield stratum, members
        if kind := kinds.get(stratum):
            for name in sorted({kind(row) for row in members}):
                yield f"{stratum}, {name}", [row for row in members if kind(row) == name]
    for family in sorted({row["family"] for row in rows}):
        yield f"family {family}", [row for row in rows if row["family"] == family]


def shares(rows: Sequence[Mapping]) -> dict:
    """Return the proportions over all strata by what is counted, and the wrong possible names per case."""
    total = line(rows)
    result = {"sure names that are wrong": total["sure names wrong"]}
    for text, key in SHARES.items():
        counted = [row[key] for row in rows if row[key] is not None]
        result[text] = proportion(sum(counted), len(counted))
    result["intervals that hold"] = total["intervals that hold"]
    return result | {"wrong possible names per case": sum(row["possible wrong"] for row in rows) / len(rows)}


def line(rows: Sequence[Mapping]) -> dict:
    """Return counts, proportions with Wilson's 95 % interval and spreads of some cases.

    The counts are those of OUTCOMES, and the cases of the library that are called unknown as well. *Good*:
    see `score.GOOD`. *Right cause found*: spurious names beside it or not. *Among*: all causes are among the
    names, sure or possible, of the cases that have such causes.
    """
    outcomes = Counter(row["outcome"] for row in rows)
    named = [row for row in rows if row["outcome"] in ("named", "tie")]
    sure = [right for row in rows for right in row["sure"]]
    among = [row["among"] for row in rows if row["among"] is not None]
    held = [hit for row in rows for hits in row["covered"].values() for hit in hits.values()]
    believed = calibration(rows) or {"error": None, "log score": None}
    closed = {
        f"gap closed, {plant}": spread([x for row in named if (x := row["closed"].get(plant)) is not None])
        for plant in ("analytic", "mujoco")
    }
    return {
        "cases": len(rows),
        **{outcome: outcomes[outcome] for outcome in OUTCOMES},
        "good": proportion(sum(outcomes[one] for one in GOOD), len(rows)),
        "right cause found": proportion(sum(outcomes[one] for one in (*GOOD, "spurious")), len(rows)),
        "among sure and possible": proportion(sum(among), len(among)),
        "sure names wrong": proportion(sum(not right for right in sure), len(sure)),
        "also flagged": sum(row["flagged"] for row in rows if row["outcome"] in IN_LIBRARY),
        "parameter error": spread([error for row in rows for error in row["errors"].values()]),
        "intervals that hold": proportion(sum(held), len(held)),
        **closed,
        "calibration error": believed["error"],
        "log score": believed["log score"],
        "seconds": spread([row["seconds"] for row in rows if row["seconds"] is not None]),
    }


def calibration(rows: Sequence[Mapping]) -> dict | None:
    """Return whether the probabilities are right; None where no case has any.

    `bins`: BINS of the probability of the likeliest set, each with its cases, their mean probability and the
    share of them that is right (Wilson's interval); `error`: their differences, weighed by cases (expected
    calibration error); `log score`: mean of -log of the probability of the truth, at least LEAST.
    """
    beliefs = [row["belief"] for row in rows if row["belief"]]
    if not beliefs:
        return None
    p = np.array([b["probability"] for b in beliefs])
    right = np.array([b["right"] for b in beliefs])
    bins, error = [], 0.0
    for k in range(BINS):
        member = np.minimum((p * BINS).astype(int), BINS - 1) == k
        if member.any():
            share = proportion(int(right[member].sum()), int(member.sum()))
            bins.append({"probability": float(p[member].mean()), "right": share})
            error += member.mean() * abs(bins[-1]["probability"] - share["share"])
    score = [-math.log(max(b["truth"], LEAST)) for b in beliefs]
    return {"cases": len(beliefs), "bins": bins, "error": float(error), "log score": float(np.mean(score))}


def markdown(results: Mapping) -> str:
    """Return the tables of results, with the set and its seed; outcomes that never occur are left out."""
    never = [name for name in OUTCOMES if not any(line[name] for line in results["table"])]
    lines = [{key: x for key, x in line.items() if key not in never} for line in results["table"]]
    return "\n".join(
        (
            f"Blind set `{results['set']}`, seed {results['seed']}, {results['cases drawn']} cases\n",
            table(["over all strata", "share [95 %]"], results["shares"].items()),
            table_of(lines),
        )
    )
