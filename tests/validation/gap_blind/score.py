"""The scorer: judges one report against what was hidden.

Outcome of one case, in this order:

- nothing hidden, or only a disturbance: `right` (verdict nothing, or names of what comes with it), `false
  alarm` (an effect is named) or `false unknown`;
- a cause outside the library: `flagged` (verdict unknown), `misnamed` (only effects) or `missed`;
- no effect and the verdict undecided, whatever is hidden: `undecided`, neither quiet nor a wrong `nothing`;
- else `named` (every hidden cause is the name of an effect, or one of its declared aliases is), `tie` (every
  one is at least in the class of an effect), `half` (some of several causes), `misnamed` (none, but effects
  are named), `missed` (no effects).

An effect whose class holds neither a hidden cause, nor an alias, nor what physically comes with it
(`accepted.py`) is *spurious*: a case with one is never `named` or `tie` but `spurious`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from inclined_landing.models.effects import LIBRARY
from tests.validation.simulator import constants

from .accepted import EFFECT, LEVEL, NOT_COMPARED, accepted, entailed
from .causes import DISTURBANCE, SIZES, UNKNOWN

_WEIGHT = constants().mass * constants().gravity  # N
# (radius/(4 h))^2 four radii above the ground, where the library reads the strength
_NEAR_GROUND = 1.0 / 256.0


def score_case(label: Mapping, report: Mapping) -> dict:
    """Return the judgement of one report against its label, a flat row.

    label as of `cases.Case.label`; report as report.json: `verdict`, `effects` with `name`, `members`,
    `parameters`, optionally `sure`, `sets` and `possible`.
    """
    effects = report["effects"]
    found = [effect["name"] for effect in effects]
    classes = [{effect["name"], *effect["members"]} for effect in effects]
    welcome = _welcome(label)
    spurious = [name for name, members in zip(found, classes) if not members & welcome]
    return {
        **{key: label[key] for key in ("family", "stratum", "causes", "size")},
        "verdict": report["verdict"],
        "effects": found,
        "spurious": spurious,
        "outcome": _outcome(label, report, spurious, found, classes),
        "sure": [bool(members & welcome) for e, members in zip(effects, classes) if e.get("sure")],
        "among": _among(label, classes, report.get("possible", ())),
        **_answers(label, report, spurious),
        "belief": belief(label, report),
        "covered": {c: x for c in label["causes"] if (x := covered(c, label, effects))},
    }


def _answers(label: Mapping, report: Mapping, spurious: list[str]) -> dict:
    """Return what the shares over all strata count; None where a case says nothing about one.

    - `quiet`: nothing is hidden; the answer is nothing
    - `alone`: one cause of the library, medium or strong; it is sure, and no name is spurious
    - `wrong nothing`: the answer is nothing; a medium or strong cause, not a mere disturbance, is hidden
    - `outside`: a cause is outside the library; the answer is unknown
    - `beside`: a cause of the library has a sure name that is right; the answer is unknown
    - `possible wrong`: how many of the possible names are not right
    """
    large = label["size"] in SIZES[1:]
    outside = set(label["causes"]) & set(UNKNOWN)
    hidden = [cause for cause in label["causes"] if cause not in DISTURBANCE]
    sure = {effect["name"] for effect in report["effects"] if effect.get("sure")}
    welcome, verdict = _welcome(label), report["verdict"]
    one = large and len(hidden) == 1 and not outside
    return {
        "quiet": None if label["causes"] else verdict == "nothing",
        "alone": _found(hidden[0], sure, []) == "named" and not spurious if one else None,
        "wrong nothing": bool(large and hidden) if verdict == "nothing" else None,
        "outside": verdict == "unknown" if outside else None,
        "beside": verdict == "unknown" if hidden and not outside and sure & welcome else None,
        "possible wrong": len(set(report.get("possible", ())) - welcome),
    }


def _welcome(label: Mapping) -> set[str]:
    """Return the names that are right next to, or instead of, the causes' own."""
    hidden = [*label["causes"], *label["base"]]
    return {name for c in hidden for names in (*accepted(c), entailed(c)) for name in names}


def _found(cause: str, names: Iterable[str], classes: list[set]) -> str | None:
    if any(option <= set(names) for option in accepted(cause)):
        return "named"
    if any(all(any(one in members for members in classes) for one in option) for option in accepted(cause)):
        return "tie"
    return None


def _among(label: Mapping, classes: list[set], possible: Iterable[str]) -> bool | None:
    """Return whether every cause is among the names, those confounded with them, and the possible ones."""
    causes = [cause for cause in label["causes"] if cause not in DISTURBANCE]
    if not causes or set(causes) & set(UNKNOWN):
        return None
    every = set().union(*classes, possible)
    return all(any(option <= every for option in accepted(cause)) for cause in causes)


def _outcome(label, report, spurious, found, classes) -> str:
    if report["verdict"] == "failed":
        return "failed"
    if report["verdict"] == "undecided" and not found:
        return "undecided"
    unknown = report["verdict"] == "unknown"
    if set(label["causes"]) <= set(DISTURBANCE):
        quiet = not unknown and report["verdict"] != "undecided"
        return "false alarm" if spurious else "right" if quiet else "false unknown"
    if set(label["causes"]) & set(UNKNOWN):
        return "flagged" if unknown else "misnamed" if found else "missed"
    if not found:
        return "missed"
    states = [_found(cause, found, classes) for cause in label["causes"]]
    if not any(states):
        return "misnamed"
    if not all(states):
        return "half"
    if spurious:
        return "spurious"
    return "named" if all(state == "named" for state in states) else "tie"


def belief(label: Mapping, report: Mapping) -> float | None:
    """Return the probability that the report gives the truth: all sets that are right.

    None where it has no probabilities, or no set of the library is true. Names that free flight cannot tell
    apart count as one.
    """
    if not report.get("sets") or set(label["causes"]) & set(UNKNOWN):
        return None
    believed: dict[frozenset[str], float] = {}
    for one in report["sets"]:
        names = frozenset(LEVEL[0] if name in LEVEL else name for name in one["effects"])
        if not 0.0 <= one["probability"] <= 1.0:
            raise ValueError(f"a probability of {one['probability']}")
        believed[names] = believed.get(names, 0.0) + one["probability"]
    welcome = _welcome(label)
    causes = [cause for cause in label["causes"] if cause not in DISTURBANCE]

    def right(names: frozenset[str]) -> bool:
        return names <= welcome and all(_found(cause, names, []) for cause in causes)

    return min(1.0, math.fsum(p for names, p in believed.items() if right(names)))


def covered(cause: str, label: Mapping, effects: Iterable[Mapping]) -> dict[str, bool]:
    """Return by number whether its 95 % interval holds the truth; empty without estimate or intervals."""
    truth = label["parameters"][cause]
    effect = _estimate(cause, effects)
    wanted = comparable(cause, truth)
    if effect is None or wanted is None:
        return {}
    values = {name: one["value"] for name, one in effect["parameters"].items()}
    references = {p.name for p in LIBRARY[effect["name"]].parameters if p.is_reference}
    result = {}
    for name, one in effect["parameters"].items():
        if name in references or not one.get("ci95"):
            continue
        low, high = (comparable(effect["name"], values | {name: end}, at=truth) or {} for end in one["ci95"])
        for key in set(wanted) & set(low):
            if low[key] != high[key]:
                result[key] = min(low[key], high[key]) <= wanted[key] <= max(low[key], high[key])
    return result


def _estimate(cause: str, effects: Iterable[Mapping]) -> Mapping | None:
    """Return the effect that names `cause` alone, if there is one."""
    names = {name for option in accepted(cause) if len(option) == 1 for name in option}
    return next((effect for effect in effects if effect["name"] in names), None)


def comparable(
    effect: str, values: Mapping[str, float], at: Mapping[str, float] | None = None
) -> dict[str, float] | None:
    """Return the deviations from neutral by which truth and estimate are compared; None for none.

    Thrust scale, thrust bias and mass by what they do to thrust over mass in hover; a battery without its
    channel by the slope of thrust over load, with it by that over voltage; ground effect by the thrust it
    adds 90 mm above the ground. The others by their own numbers, which realities of other forms share:
    factors of the drag, lag or gain that the vehicle had before, offsets, delays. at: holds the `pwm` or the
    `voltage` in hover, where the slopes of a battery are taken.
    """
    if effect in NOT_COMPARED or EFFECT.get(effect, effect) not in LIBRARY:
        return None
    if effect == "thrust_scale":
        return {"level": values["scale"] - 1}
    if effect == "thrust_bias":
        return {"level": values["force"] / _WEIGHT}
    if effect == "mass":
        return {"level": 1 / values["scale"] - 1}
    if effect == "ground_effect":
        return {"gain": values["gain"] if "gain" in values else values["strength"] * _NEAR_GROUND}
    if effect in ("battery_sag", "battery_voltage"):
        return _slope(effect, values, at)
    neutral = LIBRARY[EFFECT.get(effect, effect)].neutral
    return {name: value - neutral.get(name, 0.0) for name, value in values.items()}


def _slope(
    effect: str, values: Mapping[str, float], at: Mapping[str, float] | None
) -> dict[str, float] | None:
    key, hover = ("slope over load", "pwm") if effect == "battery_sag" else ("slope over voltage", "voltage")
    if "slope" in values:
        return {key: values["slope"]}
    if at is None or hover not in at:
        return None
    if effect == "battery_sag":
        sag, reference = values["sag"], values["reference"]
        return {key: sag / reference / (1 - sag * (at["pwm"] / reference - 1))}
    change = values["sensitivity"]
    return {key: change / (1 + change * (at["voltage"] - values["reference"]))}
