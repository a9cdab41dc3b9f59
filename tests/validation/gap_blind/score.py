"""The scorer: judges one report against what was hidden.

What counts as the right name of a cause, and what physically comes with it, was fixed on development
families. An effect whose class holds neither a hidden cause, nor an alias, nor what comes with it is
*spurious*. A cause is *alone* where it is named and no effect is spurious.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from inclined_landing.models.effects import LIBRARY
from tests.validation.simulator import constants

from .causes import DISTURBANCE, UNKNOWN

_WEIGHT = constants().mass * constants().gravity  # N
# (radius/(4 h))^2 four radii above the ground, where the library reads the strength
_NEAR_GROUND = 1.0 / 256.0

# In free flight only thrust over mass is visible: these are one name in the end.
LEVEL = ("thrust_scale", "thrust_bias", "mass")

# The library's name of a cause that is named otherwise here.
EFFECT = {
    "lateral_drag": "rotor_drag",
    "log_delay": "mocap_delay",
    "restitution": "contact_damping",
    "soft_feet": "contact_stiffness",
}

_DELAYS = frozenset({"thrust_delay", "attitude_delay"})
# A cause is also named rightly by any of these sets of effects, for the reason given.
ALIASES: tuple[tuple[str, tuple[frozenset[str], ...], str], ...] = (
    *((name, tuple(frozenset({other}) for other in LEVEL), "only thrust over mass shows") for name in LEVEL),
    (
        "slung_load",
        tuple(frozenset({other}) for other in LEVEL),
        "a load that hardly swings against the vehicle is mass",
    ),
    ("battery_voltage", (frozenset({"battery_sag"}),), "the voltage falls with the load"),
    ("battery_sag", (frozenset({"battery_voltage"}),), "where a voltage is logged, the load shows in it"),
    ("mocap_delay", (_DELAYS,), "poses late against commands are commands early against poses"),
    ("log_delay", (_DELAYS,), "poses late against commands are commands early against poses"),
)

_LOOP = ("second_order_attitude", "attitude_time_constant", "attitude_delay", "attitude_gain")
# With the causes come these effects, and naming them too is right, for the reason given.
ENTAILED: tuple[tuple[tuple[str, ...], tuple[str, ...], str], ...] = (
    (
        ("thrust_scale", "thrust_fade", "battery_sag", "battery_voltage"),
        _LOOP,
        "the torques come from the same motors: weaker thrust is a softer attitude loop, stronger a stiffer",
    ),
    (("motor_lag", "spin_down"), (*_LOOP, "yaw_loop"), "the attitude loops work through the same motors"),
    (
        ("spin_down",),
        LEVEL,
        "motors that slow down later than they speed up rectify the controller's corrections into thrust",
    ),
    (("battery_sag", "battery_voltage"), ("thrust_fade",), "the battery empties during the flight"),
    (
        ("mocap_delay",),
        ("attitude_gain", "attitude_time_constant"),
        "the flight controller leans on the late poses too: its estimate trails, and it tilts further",
    ),
    (("com_offset",), ("attitude_trim",), "the torque of the offset is met by a standing tilt"),
    (
        ("command_jitter",),
        ("thrust_delay", "attitude_delay", "motor_lag", "second_order_attitude"),
        "its mean is a delay, its spread a lag",
    ),
)

# Causes whose size is not a parameter of the library: it depends on a gain of the flight controller, or on a
# constant that the library has in another place.
NOT_COMPARED = {
    "com_offset": "the tilt that an offset makes is the one over the controller's stiffness",
    "attitude_time_constant": "a loop of higher order has no single time constant",
    "second_order_attitude": "the lag added to a rate loop is not that of the loop over it",
    "spin_down": "some motors slow down later without the cause too",
}


def accepted(cause: str) -> tuple[frozenset[str], ...]:
    """Return the sets of effect names that name `cause`, its own first."""
    return (
        frozenset({EFFECT.get(cause, cause)}),
        *(names for one, sets, _ in ALIASES if one == cause for names in sets),
    )


def entailed(cause: str) -> frozenset[str]:
    """Return the effects that physically come with `cause`."""
    return frozenset(name for ones, names, _ in ENTAILED if cause in ones for name in names)


def score_case(label: Mapping, report: Mapping) -> dict:
    """Return what a report says about a case, by what it is counted for.

    label as of `cases.Case.label`; report as report.json: `verdict`, `effects` with `name`, `members`,
    `sure`, `parameters`, and `possible`.

    - kind: nothing, disturbance, outside (the library), single or pair
    - verdict, effects: of the report; sure: whether each sure name is right
    - alone, sure alone: all causes are named, or named and sure, and no name is spurious
    - among: all causes are among the names, those confounded with them, and the possible ones
    - right sure: a sure name is right
    - possible wrong: how many of the possible names are not right
    - covered: of the number of each cause that is compared, whether its 95 % interval holds the truth
    """
    effects, possible = report["effects"], set(report.get("possible", ()))
    classes = [{effect["name"], *effect["members"]} for effect in effects]
    welcome, causes = _welcome(label), _to_name(label)
    alone = all(members & welcome for members in classes)
    sure = {effect["name"] for effect in effects if effect["sure"]}
    return {
        "causes": label["causes"],
        "size": label["size"],
        "kind": _kind(label["causes"]),
        "verdict": report["verdict"],
        "effects": [effect["name"] for effect in effects],
        "sure": [bool(members & welcome) for e, members in zip(effects, classes) if e["sure"]],
        "alone": alone and all(_named(cause, classes) for cause in causes),
        "sure alone": alone and all(_named(cause, [{name} for name in sure]) for cause in causes),
        "among": all(_named(cause, [set().union(*classes, possible)]) for cause in causes),
        "right sure": bool(sure & welcome),
        "possible wrong": len(possible - welcome),
        "covered": {c: x for c in label["causes"] if (x := covered(c, label, effects))},
    }


def _kind(causes: list[str]) -> str:
    if not causes:
        return "nothing"
    for kind, names in (("outside", UNKNOWN), ("disturbance", DISTURBANCE)):
        if set(causes) & set(names):
            return kind
    return "pair" if len(causes) > 1 else "single"


def _to_name(label: Mapping) -> list[str]:
    return [cause for cause in label["causes"] if cause not in DISTURBANCE]


def _welcome(label: Mapping) -> set[str]:
    """Return the names that are right next to, or instead of, the causes' own."""
    return {name for c in label["causes"] for names in (*accepted(c), entailed(c)) for name in names}


def _named(cause: str, classes: list[set]) -> bool:
    """Return whether every effect of one of the options that name the cause is in some class."""
    return any(
        all(any(one in members for members in classes) for one in option) for option in accepted(cause)
    )


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
