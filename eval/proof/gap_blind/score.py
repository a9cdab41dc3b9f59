"""The scorer: opens the labels after the diagnoses are written, and counts.

Outcome of one case, in this order:

- nothing hidden: `right` (verdict nothing) or `false alarm`;
- a cause outside the library: `flagged` (verdict unknown), `misnamed` (only effects) or `missed`;
- else `named` (every hidden cause is the name of an effect, or one of its declared aliases is), `tie` (every
  one is at least in the class of an effect), `half` (some of several causes), `misnamed` (none, but effects
  are named), `missed` (no effects).

An effect whose class holds neither a hidden cause, nor an alias, nor what physically comes with it
(`strata.py`) is *spurious*: a case with one is never `named` or `tie` but `spurious`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from inclined_landing.eval.base.statistics import proportion
from inclined_landing.eval.proof.simulator import constants
from inclined_landing.models.effects import LIBRARY

from .strata import ALIASES, ENTAILED, STRATA

_HOVER = constants().mass * constants().gravity  # N

OUTCOMES = (
    *("named", "tie", "spurious", "half", "misnamed", "missed"),
    *("right", "false alarm", "flagged"),
)
GOOD = ("named", "tie", "right", "flagged")


def accepted(cause: str) -> tuple[frozenset[str], ...]:
    """The sets of effect names that name `cause`, itself first."""
    return (
        frozenset({cause}),
        *(names for one, sets, _ in ALIASES if one == cause for names in sets),
    )


def entailed(cause: str) -> frozenset[str]:
    """The effects that physically come with `cause`."""
    return frozenset(name for ones, names, _ in ENTAILED if cause in ones for name in names)


def score_case(label: Mapping, report: Mapping) -> dict:
    """Judge one report against its label: a flat row.

    label as in labels.json (see `strata.Case.label`); report as in report.json: `verdict`, `effects` with
    `name`, `class`, `parameters`, optionally `gap` and `seconds`.
    """
    effects = report["effects"]
    found = [effect["name"] for effect in effects]
    classes = [{effect["name"], *effect.get("class", ())} for effect in effects]
    hidden = [*label["causes"], *label["base"]]
    welcome = set().union(*(set().union(*accepted(c)) | entailed(c) for c in hidden)) if hidden else set()
    spurious = [name for name, members in zip(found, classes) if not members & welcome]
    states = [_found(cause, found, classes) for cause in label["causes"]]
    row = {
        "stratum": label["stratum"],
        "causes": list(label["causes"]),
        "size": label["size"],
        "verdict": report["verdict"],
        "effects": found,
        "classes": [sorted(members) for members in classes],
        "spurious": spurious,
        "outcome": _outcome(label, report, states, spurious, found),
        "flagged": report["verdict"] == "unknown",
        "errors": {
            cause: error
            for cause in label["causes"]
            if (error := parameter_error(cause, label["parameters"][cause], effects)) is not None
        },
        "closed": {plant: closed_share(gap) for plant, gap in report.get("gap", {}).items()},
        "seconds": report.get("seconds"),
    }
    return row


def _found(cause: str, names: list[str], classes: list[set]) -> str | None:
    if any(option <= set(names) for option in accepted(cause)):
        return "named"
    if any(all(any(one in members for members in classes) for one in option) for option in accepted(cause)):
        return "tie"
    return None


def _outcome(label, report, states, spurious, found) -> str:
    if not label["causes"]:
        # Base constants that are off are no causes, but naming them is right.
        alarm = report["verdict"] != "nothing" and (spurious or not label["base"])
        return "false alarm" if alarm else "right"
    if not label["known"]:
        if report["verdict"] == "unknown":
            return "flagged"
        return "misnamed" if found else "missed"
    if not found:
        return "missed"
    if not any(states):
        return "misnamed"
    if not all(states):
        return "half"
    if spurious:
        return "spurious"
    return "named" if all(state == "named" for state in states) else "tie"


def closed_share(gap: Mapping) -> float | None:
    """Share of the closable gap that is closed, (before - after)/(before - floor).

    None where `before` is less than 1.5 times the floor: too little to close for a share to tell.
    """
    before, after, floor = (gap.get(key) for key in ("before", "after", "floor"))
    if None in (before, after, floor) or not before > 1.5 * floor:
        return None
    return (before - after) / (before - floor)


def parameter_error(cause: str, truth: Mapping[str, float], effects: Iterable[Mapping]) -> float | None:
    """Error of the estimate as a share of how far the truth is from neutral; None without an estimate.

    Thrust scale, thrust bias and mass are compared by what they do to thrust over mass in hover, a battery
    without its channel by the slope of thrust over load.
    """
    for effect in effects:
        values = {name: one["value"] for name, one in effect["parameters"].items()}
        wanted = comparable(cause, truth)
        given = comparable(effect["name"], values, at=truth)
        if wanted is None or given is None or set(wanted) != set(given):
            continue
        if effect["name"] != cause and frozenset({effect["name"]}) not in accepted(cause):
            continue
        size = math.hypot(*(value for value in wanted.values()))
        off = math.hypot(*(given[key] - value for key, value in wanted.items()))
        return off / size if size > 0 else None
    return None


def comparable(
    effect: str, values: Mapping[str, float], at: Mapping[str, float] | None = None
) -> dict[str, float] | None:
    """What two estimates of an effect are compared by: deviations from neutral.

    at: holds the `pwm` or the `voltage` in hover, where the slopes of a battery are taken.
    """
    weight = _HOVER
    if effect == "thrust_scale":
        return {"level": values["scale"] - 1}
    if effect == "thrust_bias":
        return {"level": values["force"] / weight}
    if effect == "mass":
        return {"level": 1 / values["scale"] - 1}
    if effect == "battery_sag":
        if "slope" in values:
            return {"slope over load": values["slope"]}
        if at is None or "pwm" not in at:
            return None
        sag, reference = values["sag"], values["reference"]
        return {"slope over load": sag / reference / (1 - sag * (at["pwm"] / reference - 1))}
    if effect == "battery_voltage":
        if "slope" in values:
            return {"slope over voltage": values["slope"]}
        if at is None or "voltage" not in at:
            return None
        change = values["sensitivity"]
        return {"slope over voltage": change / (1 + change * (at["voltage"] - values["reference"]))}
    neutral = LIBRARY[effect].neutral if effect in LIBRARY else {}
    return {name: value - neutral.get(name, 0.0) for name, value in values.items()}


def table(rows: Iterable[Mapping]) -> list[dict]:
    """One line per stratum and one for every size of the single effects: counts, shares, intervals.

    Keys: `stratum`, `cases`, a count for each of OUTCOMES, `good` (named or tie; right; flagged), `first`
    (the right cause found, spurious ones or not), `also flagged` among cases of the library, each a
    proportion with Wilson's 95 % interval; `error` and `closed`: medians with quartiles.
    """
    rows = list(rows)
    lines = []
    for stratum in STRATA:
        members = [row for row in rows if row["stratum"] == stratum]
        if not members:
            continue
        lines.append(_line(stratum, members))
        if stratum in ("single", "unknown"):
            for size in ("weak", "medium", "strong"):
                part = [row for row in members if row["size"] == size]
                if part:
                    lines.append(_line(f"{stratum}, {size}", part))
    return lines


def _line(name: str, rows: list[Mapping]) -> dict:
    outcomes = [row["outcome"] for row in rows]
    n = len(rows)
    found = sum(outcome in (*GOOD, "spurious") for outcome in outcomes)
    known = [row for row in rows if row["outcome"] not in ("flagged", "right", "false alarm")]
    errors = [error for row in rows for error in row["errors"].values()]
    line = {"stratum": name, "cases": n}
    line |= {outcome: outcomes.count(outcome) for outcome in OUTCOMES}
    line["good"] = proportion(sum(outcome in GOOD for outcome in outcomes), n)
    line["first"] = proportion(found, n)
    line["also flagged"] = sum(row["flagged"] for row in known)
    line["error"] = _quartiles(errors)
    plants = sorted({plant for row in rows for plant in row["closed"]})
    line["closed"] = {
        plant: _quartiles(
            [
                row["closed"][plant]
                for row in rows
                if row["outcome"] in ("named", "tie") and row["closed"].get(plant) is not None
            ]
        )
        for plant in plants
    }
    seconds = [row["seconds"] for row in rows if row["seconds"] is not None]
    line["seconds"] = float(np.median(seconds)) if seconds else None
    return line


def _quartiles(values: list[float]) -> dict | None:
    """Median and quartiles; None without values."""
    if not values:
        return None
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75])
    return {"of": len(values), "median": float(middle), "quartiles": [float(low), float(high)]}
