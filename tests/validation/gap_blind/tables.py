"""Tables and calibration of many scored cases, as numbers and in Markdown."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from inclined_landing.envs.shared.statistics import proportion

from ..shared import table
from .cases import STRATA
from .causes import LANDINGS, SIZES, TOUCHDOWN
from .score import GOOD, OUTCOMES

_KINDS = (((), None), *(((cause,), size) for cause in TOUCHDOWN | LANDINGS for size in SIZES))
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


def results_of(rows: list[Mapping]) -> dict:
    """Return the numbers of all tables, and the rows."""
    lines = []
    for stratum in STRATA:
        members = [row for row in rows if row["stratum"] == stratum]
        if members:
            lines.append({"stratum": stratum} | line(members))
        for size in SIZES if stratum == "single" else ():
            if part := [row for row in members if row["size"] == size]:
                lines.append({"stratum": f"{stratum}, {size}"} | line(part))
        for cause, size in _KINDS if stratum == "touchdown" else ():
            if part := [row for row in members if (row["causes"], row["size"]) == ([*cause], size)]:
                lines.append({"stratum": f"{' '.join(cause) or 'nothing'}, {size or '-'}"} | line(part))
    more = {"shares": shares(rows), "families": families(rows), "calibration": calibration(rows)}
    return {"table": lines, **more, "cases": rows}


def shares(rows: list[Mapping]) -> dict:
    """Return the proportions over all strata by what is counted, and the wrong possible names per case."""
    total = line(rows)
    result = {"sure names that are wrong": total["sure"]}
    for text, key in SHARES.items():
        counted = [row[key] for row in rows if row[key] is not None]
        result[text] = proportion(sum(counted), len(counted))
    result["intervals that hold"] = total["covered"]
    return result | {"wrong possible names per case": sum(row["possible wrong"] for row in rows) / len(rows)}


def line(rows: list[Mapping]) -> dict:
    """Return counts, shares and medians of some cases.

    A count for each of OUTCOMES; `good` (see score.GOOD), `first` (the right cause found, spurious ones or
    not), `sure` (sure names that are wrong), `among` (of cases whose causes are all among the names, sure or
    possible) and `covered` (parameters whose interval holds the truth), proportions with Wilson's 95 %
    interval; `also flagged` among cases of the library; `error` and `closed`: medians with quartiles;
    `seconds`: their median.
    """
    outcomes = [row["outcome"] for row in rows]
    named = [row for row in rows if row["outcome"] in ("named", "tie")]
    known = ("named", "tie", "spurious", "half", "misnamed", "missed")
    held = [hit for row in rows for hits in row["covered"].values() for hit in hits.values()]
    sure = [right for row in rows for right in row["sure"]]
    among = [row["among"] for row in rows if row["among"] is not None]
    seconds = [row["seconds"] for row in rows if row["seconds"] is not None]
    return {
        "cases": len(rows),
        **{outcome: outcomes.count(outcome) for outcome in OUTCOMES},
        "good": proportion(sum(one in GOOD for one in outcomes), len(rows)),
        "first": proportion(sum(one in (*GOOD, "spurious") for one in outcomes), len(rows)),
        "also flagged": sum(row["flagged"] for row in rows if row["outcome"] in known),
        "sure": proportion(sum(not right for right in sure), len(sure)),
        "among": proportion(sum(among), len(among)),
        "covered": proportion(sum(held), len(held)),
        "error": _quartiles([error for row in rows for error in row["errors"].values()]),
        "closed": {
            plant: _quartiles([x for row in named if (x := row["closed"].get(plant)) is not None])
            for plant in sorted({plant for row in rows for plant in row["closed"]})
        },
        "seconds": float(np.median(seconds)) if seconds else None,
    }


def families(rows: Iterable[Mapping]) -> list[dict]:
    """Return for every family the share of good cases by stratum, `all` of them and the `calibration`."""
    result = []
    for family in sorted({row["family"] for row in rows}):
        members = [row for row in rows if row["family"] == family]
        shares = {}
        for stratum in STRATA:
            part = [row["outcome"] in GOOD for row in members if row["stratum"] == stratum]
            if part:
                shares[stratum] = proportion(sum(part), len(part))
        good = proportion(sum(row["outcome"] in GOOD for row in members), len(members))
        result.append({"family": family, "strata": shares, "all": good, "calibration": calibration(members)})
    return result


def calibration(rows: Iterable[Mapping]) -> dict | None:
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


def _quartiles(values: list[float]) -> dict | None:
    if not values:
        return None
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75])
    return {"of": len(values), "median": float(middle), "quartiles": [float(low), float(high)]}


def markdown(results: dict) -> str:
    """Return the tables of results, with the set and its seed."""
    parts = [f"Blind set `{results['set']}`, seed {results['seed']}, {results['cases drawn']} cases\n"]
    *counted, (text, mean) = results["shares"].items()
    rows = [[name, _count(share), _share(share)] for name, share in counted]
    parts += [table(["over all strata", "count", "share [95 %]"], [*rows, [text, f"{mean:.1f}", ""]])]
    parts += [_strata(results["table"]), _families(results["families"])]
    if c := results["calibration"]:
        parts.append(
            f"Probabilities of the likeliest set in {c['cases']} cases: expected calibration error "
            f"{c['error']:.3f} in ten bins; log score of the truth {c['log score']:.2f}.\n"
        )
    return "\n".join(parts)


def _strata(lines: list[dict]) -> str:
    """Return the counts by stratum; outcomes that never occur are left out."""
    shown = [name for name in OUTCOMES if any(line[name] for line in lines)]
    plants = sorted({plant for line in lines for plant in line["closed"]})
    header = ["stratum", "cases", *shown, "good [95 %]", "right cause found", "among sure and possible"]
    header += ["sure names wrong", "also flagged", "parameter error"]
    header += ["intervals that hold", *(f"gap closed, {plant}" for plant in plants), "seconds"]
    rows = []
    for line in lines:
        row = [line["stratum"], str(line["cases"]), *(str(line[name]) for name in shown)]
        row += [_share(line["good"]), _share(line["first"], interval=False)]
        row += [_share(line["among"], interval=False), _count(line["sure"]), str(line["also flagged"])]
        row += [_median(line["error"]), _share(line["covered"])]
        row += [_median(line["closed"].get(plant)) for plant in plants]
        row += ["" if line["seconds"] is None else f"{line['seconds']:.1f}"]
        rows.append(row)
    return table(header, rows)


def _families(families: list[dict]) -> str:
    strata = list(dict.fromkeys(name for one in families for name in one["strata"]))
    rows = []
    for one in families:
        row = [one["family"], _share(one["all"])]
        row += [_count(one["strata"].get(name)) for name in strata]
        c = one["calibration"]
        row += ["", ""] if c is None else [f"{c['error']:.2f}", f"{c['log score']:.2f}"]
        rows.append(row)
    return table(["family", "all good [95 %]", *strata, "calibration error", "log score"], rows)


def _count(proportion: dict | None) -> str:
    return "" if proportion is None else f"{proportion['count']}/{proportion['of']}"


def _share(proportion: dict, interval: bool = True) -> str:
    if proportion["share"] is None:
        return ""
    text = f"{100 * proportion['share']:.0f} %"
    if interval:
        text += " [{:.0f}, {:.0f}]".format(*(100 * end for end in proportion["interval"]))
    return text


def _median(value: dict | None) -> str:
    return "" if value is None else f"{100 * value['median']:.1f} %"
