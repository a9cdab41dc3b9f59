"""Many scored cases as one table: the shares of all, of every stratum, and of every family."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from inclined_landing.envs.shared.statistics import proportion

from ..shared import table_of
from .cases import STRATA

# Shares: what is said of a row of the results (`score.score_case`).
SHARES = {
    "nothing hidden: the answer is nothing": "quiet",
    "one cause, medium or strong: sure and alone": "alone",
    "all causes among the names": "among",
    "answers nothing with a medium or strong cause hidden": "wrong nothing",
    "cause outside the library: unknown": "outside",
    "unknown beside a right sure name": "beside",
}


def results_of(rows: Sequence[Mapping]) -> dict:
    """Return the shares of each group that has cases, and the rows."""
    groups = {"all": list(rows)}
    groups |= {name: [row for row in rows if row["stratum"] == name] for name in STRATA}
    families = sorted({row["family"] for row in rows})
    groups |= {f"family {name}": [row for row in rows if row["family"] == name] for name in families}
    return {"shares": {name: shares(some) for name, some in groups.items() if some}, "cases": rows}


def shares(rows: Sequence[Mapping]) -> dict:
    """Return the proportions of some cases by what is counted, and their wrong possible names per case."""
    sure = [right for row in rows for right in row["sure"]]
    held = [hit for row in rows for hits in row["covered"].values() for hit in hits.values()]
    result = {"cases": len(rows), "sure names that are wrong": proportion(sure.count(False), len(sure))}
    for text, key in SHARES.items():
        counted = [row[key] for row in rows if row[key] is not None]
        result[text] = proportion(sum(counted), len(counted))
    result["95 % intervals that hold the truth"] = proportion(sum(held), len(held))
    return result | {"wrong possible names per case": sum(row["possible wrong"] for row in rows) / len(rows)}


def markdown(results: Mapping) -> str:
    """Return the table of results, with the set and its seed."""
    lines = [{"": name} | found for name, found in results["shares"].items()]
    head = f"Blind set `{results['set']}`, seed {results['seed']}, {results['cases drawn']} cases\n\n"
    return head + table_of(lines)
