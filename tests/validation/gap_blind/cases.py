"""Cases of the blind test: a reality, what is hidden in it, and how a user gets at it.

    from tests.validation.gap_blind import cases
    case = cases.draw("dev", "single", cause="rotor_drag", size="medium", seed=(1, 7))
    flown = case.fly()      # .identify, .gap, .heldout: FlightLogs; .label: what was hidden

The first are flown without the cause: `landing-eval identify` has them. The others have it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.vehicle import Vehicle
from tests.validation import simulator
from tests.validation.simulator import Reality, World

from . import causes, generate
from .accepted import LEVEL, accepted
from .causes import DISTURBANCE, FREE_FLIGHT, SIZES, TOUCHDOWN, UNKNOWN, Drawn

# Families whose cases thresholds are chosen on, and those that are scored once.
SETS = {"dev": ("cascade", "firmware", "feed_forward"), "fresh": ("geometric", "full_state")}
# The set, and family, whose flights RotorPy simulates, and the causes that it cannot have. Its loops have no
# integral: with a centre of mass that is off it would stand 10 deg askew and fly away in steps.
ROTORPY = "rotorpy"
LACKS = {
    *("ground_effect", "second_order_attitude", "slung_load", "yaw_loss", "wall", "burst"),
    *("spin_down", "axial_inflow", "com_offset", *TOUCHDOWN),
}
_SEEDS = (*SETS, ROTORPY)  # the place of a set is part of its seed
STRATA = (
    *("single", "pair", "nothing", "few flights", "noisy", "slow log", "paper", "base off"),
    *("unknown", "disturbance", "touchdown"),
)
IDENTIFY, HELDOUT = 10, 3  # flights: every kind once to identify with
# Constants that are 10 % off after identification, by the name of the effect that rescales them.
BASE_OFF = {
    "mass": ("body_mass",),
    "rotor_drag": ("drag_coefficients",),
    "attitude_gain": ("attitude_gain",),
}
# With the paper's constants these are off in a family's reality, whatever is hidden.
_PAPER_OFF = (
    *(
        "mass",
        "rotor_drag",
        "motor_lag",
        "thrust_delay",
        "attitude_gain",
        "attitude_time_constant",
        "attitude_delay",
    ),
    *("second_order_attitude", "attitude_trim", "yaw_loop"),
)

# Causes that are one physical matter seen from one side, so that a pair of them would be no pair.
KIN = (
    ("thrust_scale", "thrust_bias", "mass"),
    ("battery_sag", "battery_voltage", "thrust_fade"),
    ("motor_lag", "spin_down", "thrust_delay"),
    ("rotor_drag", "lateral_drag", "body_drag"),
    ("wind", "attitude_trim", "com_offset", "mocap_tilt", "level_calibration"),
    ("translational_lift", "axial_inflow"),
    ("attitude_gain",),
    ("attitude_delay", "second_order_attitude", "attitude_time_constant", "mocap_delay", "log_delay"),
    ("ground_effect",),
    ("yaw_drift",),
)


@dataclasses.dataclass(frozen=True)
class Flown:
    """The logs of one case and what was hidden in them."""

    identify: list[FlightLog]  # without the cause; empty where the paper's constants are used
    gap: list[FlightLog]
    heldout: list[FlightLog]
    label: dict


@dataclasses.dataclass(frozen=True)
class Case:
    """One case: everything that the flights and the label need."""

    name: str
    family: str
    stratum: str
    causes: tuple[str, ...]  # hidden; to be named where the library has them
    size: str | None
    drawn: dict[str, Drawn]
    reality: Reality
    count: int  # flights to diagnose
    voltage: bool  # the logs have a battery channel
    base: dict[str, float]  # factors of what is off besides, by the effect's name (see BASE_OFF)
    entropy: tuple[int, ...]  # of the flights

    @property
    def identified(self) -> bool:
        """Whether the user identifies the vehicle first."""
        return self.stratum not in ("paper", "touchdown")

    def label(self) -> dict:
        """Return what the scorer needs to know, as plain data."""
        return {
            "family": self.family,
            "stratum": self.stratum,
            "causes": list(self.causes),
            "size": self.size,
            "parameters": {cause: one.parameters for cause, one in self.drawn.items()},
            "base": list(_PAPER_OFF if self.stratum == "paper" else self.base),
        }

    def vehicle(self, identified: Vehicle) -> Vehicle:
        """Return the vehicle that is diagnosed: the identified one, with the constants of `base` off."""
        changes = {}
        for name, factor in self.base.items():
            for field in BASE_OFF[name]:
                value = getattr(identified, field)
                scaled = tuple(x / factor for x in value) if isinstance(value, tuple) else value / factor
                changes[field] = scaled
        return dataclasses.replace(identified, **changes)

    def worlds(self) -> tuple[Drawn, Drawn]:
        """What flights without the cause and flights with it differ by from the reality's."""
        drawn = causes.combined(*self.drawn.values())
        charge = {"battery_voltage": (-0.15, 0.15)}
        # Without a channel that shows its battery, every flight starts on the same charge.
        spread = {} if "battery_sag" in self.causes else charge | drawn.spread
        return Drawn({}, {}, spread=charge), dataclasses.replace(drawn, spread=spread)

    def fly(self, seconds: float = generate.SECONDS) -> Flown:
        """Fly all flights, of so many seconds each where they do not land."""
        rng = np.random.default_rng(self.entropy)
        count = self.count + HELDOUT
        if self.stratum == "touchdown":
            drawn = causes.combined(*self.drawn.values())
            plain, gap = [], generate.logs(generate.land_all(drawn, rng, count=count), contact=True)
        else:
            usual, hidden = self.worlds()
            groups = ((usual, IDENTIFY * self.identified), (hidden, count))
            if self.family == ROTORPY:
                flown = _rotorpy().fly_groups(groups, rng, self.reality, seconds)
            else:
                flown = [
                    generate.fly_all(one, rng, self.reality, count=n, seconds=seconds) for one, n in groups
                ]
            plain, gap = (generate.logs(one, voltage=self.voltage) for one in flown)
        return Flown(plain, gap[: self.count], gap[self.count :], self.label())


def draw(
    family: str = "dev",
    stratum: str = "single",
    cause: str | Sequence[str] | None = None,
    size: str | None = None,
    seed: int | Sequence[int] = 0,
    name: str = "case",
) -> Case:
    """Return a case of a stratum in a reality of a family: of the simulator, of one of SETS, or ROTORPY.

    Causes and size are drawn from the seed where they are not given. Raises ValueError for a cause that the
    family cannot have.
    """
    entropy = tuple(np.atleast_1d(seed).tolist())
    rng = np.random.default_rng(entropy)
    members = SETS.get(family, (family,))
    chosen = members[rng.integers(len(members))]
    landed = stratum == "touchdown"
    reality = _fitted(_reality("reference" if landed else chosen, rng), stratum, rng)
    hidden = (
        _hidden(stratum, rng, family)
        if cause is None
        else (cause,)
        if isinstance(cause, str)
        else tuple(cause)
    )
    if lacking := [one for one in hidden if not _has(family, one)]:
        raise ValueError(f"the family {family} cannot have {', '.join(lacking)}")
    size = None if not hidden else size or str(rng.choice(SIZES if stratum == "single" else SIZES[1:]))
    drawn = {one: causes.draw(one, size, rng, reality) for one in hidden}
    while not _can_fly(reality, drawn):
        reality = _fitted(_reality(chosen, rng), stratum, rng)
        drawn = {one: causes.draw(one, size, rng, reality) for one in hidden}
    # Many vehicles log their battery, whether or not it matters.
    logged = not landed and "battery_sag" not in hidden and rng.uniform() < 0.4
    return Case(
        name=name,
        family=reality.family,
        stratum=stratum,
        causes=hidden,
        size=size,
        drawn=drawn,
        reality=reality,
        count={"few flights": 3, "touchdown": generate.LANDINGS}.get(stratum, 10),
        voltage=logged or any(one.voltage for one in drawn.values()),
        base={one: 1 + 0.1 * rng.choice([-1, 1]) for one in BASE_OFF} if stratum == "base off" else {},
        entropy=(*entropy, 1),
    )


def plans(rng: np.random.Generator, family: str = "dev") -> list[tuple[str, tuple[str, ...], str | None]]:
    """Return (stratum, causes, size) of the cases of a full set of a family, stratum by stratum."""
    names = [name for name in FREE_FLIGHT if _has(family, name)]
    # Two of the three sizes for every cause, so that each size has its share.
    result = [
        ("single", (name,), size)
        for k, name in enumerate(names)
        for j, size in enumerate(SIZES)
        if (k + j) % 3
    ]
    pairs: set[tuple[str, ...]] = set()
    while len(pairs) < 16:
        pairs.add(tuple(sorted(_hidden("pair", rng, family))))
    result += [("pair", pair, SIZES[1 + k % 2]) for k, pair in enumerate(sorted(pairs))]
    result += [("nothing", (), None)] * 20
    for stratum in ("few flights", "noisy", "slow log", "paper", "base off"):
        some = [one for one in rng.permutation(names) if one in _candidates(stratum)][:8]
        result += [(stratum, (str(one),), SIZES[1 + k % 2]) for k, one in enumerate(some)]
    for stratum, table in (("unknown", UNKNOWN), ("disturbance", DISTURBANCE)):
        result += [(stratum, (name,), size) for name in table if _has(family, name) for size in SIZES[1:]]
    if family != ROTORPY:
        result += [("touchdown", (name,), SIZES[1 + k % 2]) for k, name in enumerate(TOUCHDOWN)]
        result += [("touchdown", (), None)]
    return result


def of_set(name: str, seed: int, limit: int | None = None) -> list[Case]:
    """The cases of a set of SETS or ROTORPY, in an order and with names that tell nothing.

    limit: at most so many, the strata keeping their shares.
    """
    entropy = (_SEEDS.index(name) + 1, seed)
    rng = np.random.default_rng(entropy)
    chosen = plans(rng, name)
    if limit is not None and limit < len(chosen):
        # Every stratum is shuffled, then thinned evenly over the list.
        order = sorted(range(len(chosen)), key=lambda k: (STRATA.index(chosen[k][0]), rng.uniform()))
        chosen = [chosen[order[k]] for k in np.linspace(0, len(order) - 1, limit).round().astype(int)]
    result = []
    for number, k in enumerate(rng.permutation(len(chosen))):
        stratum, hidden, size = chosen[k]
        result.append(draw(name, stratum, hidden, size, (*entropy, number), f"case_{number:03d}"))
    return result


def _rotorpy():
    from . import rotorpy_reality

    return rotorpy_reality


def _reality(family: str, rng) -> Reality:
    return _rotorpy().draw(rng) if family == ROTORPY else simulator.draw(family, rng)


def _can_fly(reality: Reality, drawn: dict[str, Drawn]) -> bool:
    """Return whether the reality flies with these causes; RotorPy's does not with much more lag."""
    if reality.family != ROTORPY:
        return True
    return _rotorpy().flies(reality, World(**causes.combined(*drawn.values()).world))


def _has(family: str, cause: str) -> bool:
    return family != ROTORPY or cause not in LACKS


def _candidates(stratum: str) -> list[str]:
    """Return the causes for a stratum: where constants are off, those that differ in kind from them."""
    off = {"paper": _PAPER_OFF, "base off": tuple(BASE_OFF)}.get(stratum, ())
    off = {*off, *(LEVEL if off else ()), *(("body_drag", "lateral_drag") if off else ())}
    tables = {"unknown": UNKNOWN, "disturbance": DISTURBANCE, "touchdown": TOUCHDOWN}
    table = tables.get(stratum, FREE_FLIGHT)
    return [name for name in table if not any(names & off for names in accepted(name))]


def _hidden(stratum: str, rng, family: str) -> tuple[str, ...]:
    if stratum == "nothing":
        return ()
    if stratum == "pair":
        kin = [[one for one in names if _has(family, one)] for names in KIN]
        kin = [names for names in kin if names]
        first, second = (kin[k] for k in rng.choice(len(kin), 2, replace=False))
        return str(rng.choice(first)), str(rng.choice(second))
    return (str(rng.choice([one for one in _candidates(stratum) if _has(family, one)])),)


def _fitted(reality: Reality, stratum: str, rng) -> Reality:
    """Return the reality with what the stratum changes: more noise, or fewer rows."""
    c, b = reality.constants, reality.build
    if stratum == "noisy":
        angle = math.radians(rng.uniform(0.6, 1.0))
        c = c._replace(position_noise=rng.uniform(0.003, 0.005), attitude_noise=angle)
    if stratum == "slow log":
        b = b._replace(log_ticks=10.0, stamp_jitter=0.002)
    return dataclasses.replace(reality, constants=c, build=b)
