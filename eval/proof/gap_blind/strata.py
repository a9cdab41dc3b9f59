"""What a blind set consists of, and what counts as right: fixed on development sets before a fresh one.

Strata (cases in a full set): every effect weak, medium and strong; pairs; nothing hidden; causes that no
library effect describes; three flights only; three times the noise; mass and drag 10 % off besides the cause;
touchdowns. Development and fresh sets differ by their seed alone.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from . import causes
from .causes import FREE_FLIGHT, SIZES, TOUCHDOWN, UNKNOWN, Drawn

# Causes that are one physical matter seen from one side, so that a pair of them would be no pair.
FAMILIES = (
    ("thrust_scale", "thrust_bias", "mass"),
    ("battery_sag", "battery_voltage", "thrust_fade"),
    ("motor_lag", "spin_down", "thrust_delay"),
    ("rotor_drag", "body_drag"),
    ("wind", "attitude_trim", "com_offset", "mocap_tilt"),
    ("translational_lift", "axial_inflow"),
    ("attitude_gain",),
    ("attitude_delay", "second_order_attitude", "attitude_time_constant", "mocap_delay"),
    ("ground_effect",),
    ("yaw_drift",),
)

_LEVEL = ("thrust_scale", "thrust_bias", "mass")
_SOFT = ("second_order_attitude", "attitude_time_constant", "attitude_delay", "attitude_gain")

# A cause is also named rightly by any of these sets of effects. (cause, sets of names, physical reason)
ALIASES: tuple[tuple[str, tuple[frozenset[str], ...], str], ...] = (
    *(
        (
            name,
            tuple(frozenset({other}) for other in _LEVEL if other != name),
            "in free flight only thrust over mass is visible",
        )
        for name in _LEVEL
    ),
    (
        "battery_voltage",
        (frozenset({"battery_sag"}),),
        "the voltage falls with the load, so that sag is the same battery without its channel",
    ),
    (
        "battery_sag",
        (frozenset({"battery_voltage"}),),
        "where a voltage channel is logged, the load shows in it",
    ),
    (
        "mocap_delay",
        (frozenset({"thrust_delay", "attitude_delay"}),),
        "poses late against commands are commands early against poses: all delays together shift time",
    ),
)

# With the cause come these effects, and naming them too is right. (causes, names, physical reason)
ENTAILED: tuple[tuple[tuple[str, ...], tuple[str, ...], str], ...] = (
    (
        ("thrust_scale", "thrust_fade", "battery_sag", "battery_voltage"),
        _SOFT,
        "the torques come from the same motors: weaker thrust is a softer attitude loop, stronger a stiffer",
    ),
    (
        ("translational_lift", "axial_inflow", "ground_effect"),
        _SOFT,
        "the same, where the rotors carry more or less",
    ),
    (
        ("motor_lag", "spin_down"),
        _SOFT,
        "the flight controller makes up for the nominal lag of the motors; with another lag its loops answer "
        "later or overshoot",
    ),
    (
        ("motor_lag", "spin_down"),
        ("thrust_delay",),
        "a longer lag is, to first order, a later thrust",
    ),
    (
        ("spin_down",),
        _LEVEL,
        "motors that slow down later than they speed up rectify the controller's small corrections: a little "
        "more thrust on average",
    ),
    (
        ("battery_sag", "battery_voltage"),
        ("thrust_fade",),
        "the battery empties during the flight",
    ),
    (
        ("battery_sag", "battery_voltage"),
        ("motor_lag",),
        "the current follows the rotors, not the command: thrust overshoots and settles, a shorter lag",
    ),
    (
        ("mocap_delay",),
        ("attitude_gain", "attitude_time_constant"),
        "the flight controller leans on the late poses too: its estimate trails, and it tilts further",
    ),
    (
        ("com_offset",),
        ("attitude_trim",),
        "the torque of the offset is met by a standing tilt, a trim that grows with thrust",
    ),
    (
        ("slung_load",),
        (*_LEVEL, *_SOFT),
        "the load hangs on the vehicle: its weight is carried, and its pull swings",
    ),
    (
        ("updraft",),
        ("axial_inflow", "ground_effect", *_LEVEL),
        "rising air lifts on average, more where the flights go low or slow",
    ),
    (
        ("dead_zone",),
        ("attitude_gain", "attitude_time_constant", "attitude_delay", "second_order_attitude"),
        "small commands are lost: less angle per command on average, and later",
    ),
    (
        ("updraft",),
        ("wind", "body_drag", "rotor_drag"),
        "gusts over a short flight have a mean, and air that moves changes drag",
    ),
)


@dataclasses.dataclass(frozen=True)
class Case:
    """One case of the set: what is hidden, and how it is flown. Everything the label needs."""

    name: str
    stratum: str
    causes: tuple[str, ...]  # hidden and to be named
    size: str | None
    parameters: dict[str, dict[str, float]]  # cause -> parameter -> value
    base: dict[str, dict[str, float]]  # base constants that are off, likewise
    drawn: Drawn
    count: int  # flights to diagnose
    noise: float
    landings: bool
    voltage: bool  # the logs have a battery channel
    entropy: tuple[int, ...]  # of the flights

    def label(self) -> dict:
        """The sealed label as plain data."""
        return {
            "stratum": self.stratum,
            "causes": list(self.causes),
            "size": self.size,
            "parameters": self.parameters,
            "base": self.base,
            "known": all(cause not in UNKNOWN for cause in self.causes),
        }


@dataclasses.dataclass(frozen=True)
class _Plan:
    stratum: str
    causes: tuple[str, ...] = ()
    size: str | None = None
    count: int = 10
    noise: float = 1.0
    base: bool = False
    landings: bool = False


STRATA = ("single", "pair", "nothing", "unknown", "few flights", "noisy", "base off", "touchdown")
LANDINGS = 16  # of a touchdown case
HELDOUT = 3  # flights of the same vehicle beyond those to diagnose, to measure the gap on


def plans(rng: np.random.Generator) -> list[_Plan]:
    """The cases of a full set, stratum by stratum."""
    names = list(FREE_FLIGHT)
    result = [_Plan("single", (name,), size) for name in names for size in SIZES]
    pairs = set()
    while len(pairs) < 16:
        first, second = (FAMILIES[k] for k in rng.choice(len(FAMILIES), 2, replace=False))
        pairs.add(tuple(sorted((str(rng.choice(first)), str(rng.choice(second))))))
    result += [_Plan("pair", pair, SIZES[1 + k % 2]) for k, pair in enumerate(sorted(pairs))]
    result += [_Plan("nothing")] * 20
    result += [_Plan("unknown", (name,), size) for name in UNKNOWN for size in SIZES]
    some = [names[k] for k in rng.permutation(len(names))]
    result += [_Plan("few flights", (name,), SIZES[1 + k % 2], count=3) for k, name in enumerate(some[:10])]
    some = [names[k] for k in rng.permutation(len(names))]
    result += [_Plan("noisy", (name,), SIZES[1 + k % 2], noise=3.0) for k, name in enumerate(some[:10])]
    apart = [name for name in some[::-1] if name not in (*_LEVEL, "rotor_drag", "body_drag")]
    result += [_Plan("base off", (name,), SIZES[1 + k % 2], base=True) for k, name in enumerate(apart[:8])]
    result += [
        _Plan("touchdown", (name,), size, LANDINGS, landings=True) for name in TOUCHDOWN for size in SIZES[1:]
    ]
    result += [_Plan("touchdown", count=LANDINGS, landings=True)] * 2
    return result


def cases(entropy: tuple[int, ...], limit: int | None = None) -> list[Case]:
    """The cases of the set drawn from `entropy`, in an order and with names that tell nothing.

    limit: at most so many, the strata keeping their shares.
    """
    rng = np.random.default_rng(entropy)
    chosen = plans(rng)
    if limit is not None and limit < len(chosen):
        # Every stratum is shuffled, then thinned evenly over the list.
        order = sorted(range(len(chosen)), key=lambda k: (STRATA.index(chosen[k].stratum), rng.uniform()))
        chosen = [chosen[order[k]] for k in np.linspace(0, len(order) - 1, limit).round().astype(int)]
    result = []
    for number, k in enumerate(rng.permutation(len(chosen))):
        result.append(_case(f"case_{number:03d}", chosen[k], rng, (*entropy, number)))
    return result


def _case(name: str, plan: _Plan, rng: np.random.Generator, entropy: tuple[int, ...]) -> Case:
    drawn = {cause: causes.draw(cause, plan.size, rng) for cause in plan.causes}
    base = causes.base_constants(rng) if plan.base else {}
    together = causes.combined(*drawn.values(), *base.values())
    # Many vehicles log their battery, whether or not it matters.
    logged = rng.uniform() < 0.4 and "battery_sag" not in plan.causes
    spread = dict(together.spread)
    spread.setdefault("battery_voltage", (-0.15, 0.15))
    if "battery_sag" in plan.causes:
        spread.pop("battery_voltage")  # without its channel, every flight starts on the same charge
    return Case(
        name=name,
        stratum=plan.stratum,
        causes=plan.causes,
        size=plan.size,
        parameters={cause: one.parameters for cause, one in drawn.items()},
        base={cause: one.parameters for cause, one in base.items()},
        drawn=dataclasses.replace(together, spread=spread),
        count=plan.count,
        noise=plan.noise,
        landings=plan.landings,
        voltage=together.voltage or (logged and not plan.landings),
        entropy=entropy,
    )
