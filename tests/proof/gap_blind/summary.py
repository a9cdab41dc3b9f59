"""Tables and calibration of many scored cases."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from inclined_landing.envs.shared.statistics import proportion

from .cases import CURVES, STRATA
from .causes import SIZES
from .score import GOOD, OUTCOMES

BINS = 10
LEAST = 1e-3  # of a probability in the log score: a report keeps its likeliest sets only


def table(rows: Iterable[Mapping]) -> list[dict]:
    """One line per stratum, and one for every size of the single effects: counts, shares, intervals.

    Keys: `stratum`, `cases`, a count for each of OUTCOMES, `good` (see score.GOOD) and `covered` (parameters
    whose interval holds the truth), proportions with Wilson's 95 % interval; `first` (the right cause found,
    spurious ones or not); `sure`: the share of sure names that are wrong; `among`: of cases whose causes are
    all among the names, sure or possible; `also flagged` among cases of the library; `error` and `closed`:
    medians with quartiles; `seconds`.
    """
    rows = list(rows)
    lines = []
    for stratum in (*STRATA, *CURVES):
        members = [row for row in rows if row["stratum"] == stratum]
        if not members:
            continue
        lines.append({"stratum": stratum} | line(members))
        if stratum == "single":
            for size in SIZES:
                part = [row for row in members if row["size"] == size]
                if part:
                    lines.append({"stratum": f"{stratum}, {size}"} | line(part))
    return lines


def by_family(rows: Iterable[Mapping]) -> list[dict]:
    """Family -> share of good cases by stratum, `all` of them and the `calibration`."""
    rows = list(rows)
    result = []
    for family in dict.fromkeys(sorted(row["family"] for row in rows)):
        members = [row for row in rows if row["family"] == family]
        shares = {}
        for stratum in (*STRATA, *CURVES):
            part = [row["outcome"] in GOOD for row in members if row["stratum"] == stratum]
            if part:
                shares[stratum] = proportion(sum(part), len(part))
        good = sum(row["outcome"] in GOOD for row in members)
        result.append(
            {
                "family": family,
                "strata": shares,
                "all": proportion(good, len(members)),
                "calibration": calibration(members),
            }
        )
    return result


def line(rows: list[Mapping]) -> dict:
    """Counts, shares and medians of some cases."""
    outcomes = [row["outcome"] for row in rows]
    n = len(rows)
    known = [
        row for row in rows if row["outcome"] in ("named", "tie", "spurious", "half", "misnamed", "missed")
    ]
    held = [hit for row in rows for hits in row["covered"].values() for hit in hits.values()]
    result: dict = {"cases": n} | {outcome: outcomes.count(outcome) for outcome in OUTCOMES}
    result["good"] = proportion(sum(outcome in GOOD for outcome in outcomes), n)
    result["first"] = proportion(sum(outcome in (*GOOD, "spurious") for outcome in outcomes), n)
    result["also flagged"] = sum(row["flagged"] for row in known)
    sure = [right for row in rows for right in row.get("sure", ())]
    among = [row["among"] for row in rows if row.get("among") is not None]
    result["sure"] = proportion(sum(not right for right in sure), len(sure))
    result["among"] = proportion(sum(among), len(among))
    result["covered"] = proportion(sum(held), len(held))
    result["error"] = _quartiles([error for row in rows for error in row["errors"].values()])
    plants = sorted({plant for row in rows for plant in row["closed"]})
    named = [row for row in rows if row["outcome"] in ("named", "tie")]
    result["closed"] = {
        plant: _quartiles([x for row in named if (x := row["closed"].get(plant)) is not None])
        for plant in plants
    }
    seconds = [row["seconds"] for row in rows if row["seconds"] is not None]
    result["seconds"] = float(np.median(seconds)) if seconds else None
    return result


def calibration(rows: Iterable[Mapping]) -> dict | None:
    """Are the probabilities right? None where no case has any.

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


def _quartiles(values: list[float]) -> dict | None:
    """Median and quartiles; None without values."""
    if not values:
        return None
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75])
    return {"of": len(values), "median": float(middle), "quartiles": [float(low), float(high)]}
