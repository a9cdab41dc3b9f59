"""Cases of the blind test: a reality, what is hidden in it, and the flights that a user has of it.

    from tests.validation.gap_blind import cases
    case = cases.draw("dev", "single", cause="rotor_drag", size="medium", seed=(1, 7))
    healthy, flights = case.fly()       # FlightLogs; case.label() says what was hidden

The first are flown without the cause, for `landing-eval identify`. The others have it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from inclined_landing.eval.logs import FlightLog
from tests.validation import simulator
from tests.validation.simulator import Reality, World

from . import causes, generate
from .causes import DISTURBANCE, FREE_FLIGHT, SIZES, UNKNOWN, Drawn

ROTORPY = "rotorpy"
# Families by the set whose cases are drawn from them: thresholds were chosen on dev, and fresh shares no
# structure with it. RotorPy's flights are simulated by others.
SETS = {
    "dev": ("cascade", "firmware", "feed_forward"),
    "fresh": ("geometric", "full_state"),
    ROTORPY: (ROTORPY,),
}
# Causes that RotorPy cannot have. Its loops have no integral: with a centre of mass that is off it would
# stand 10 deg askew and fly away in steps.
LACKS = {
    *("ground_effect", "second_order_attitude", "slung_load", "yaw_loss", "wall", "burst"),
    *("spin_down", "axial_inflow", "com_offset"),
}
FLIGHTS = 6  # to identify with, and to diagnose
WEAK, PAIRS, NOTHING = 6, 6, 12  # cases of a set with a weak cause, two causes, none

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
class Case:
    """One case: everything that the flights and the label need."""

    name: str
    family: str
    causes: tuple[str, ...]  # hidden; to be named where the library has them
    size: str | None
    drawn: dict[str, Drawn]
    reality: Reality
    voltage: bool  # the logs have a battery channel
    entropy: tuple[int, ...]  # of the flights

    def label(self) -> dict:
        """Return what the scorer needs to know, as plain data."""
        parameters = {cause: one.parameters for cause, one in self.drawn.items()}
        return {"causes": list(self.causes), "size": self.size, "parameters": parameters}

    def worlds(self) -> tuple[Drawn, Drawn]:
        """Return what flights without the cause and flights with it differ by from the reality's."""
        drawn = causes.combined(*self.drawn.values())
        charge = {"battery_voltage": (-0.15, 0.15)}
        # Without a channel that shows its battery, every flight starts on the same charge.
        spread = {} if "battery_sag" in self.causes else charge | drawn.spread
        return Drawn({}, {}, spread=charge), dataclasses.replace(drawn, spread=spread)

    def fly(self, seconds: float = generate.SECONDS) -> tuple[list[FlightLog], list[FlightLog]]:
        """Return the flights without the cause and those with it, each of so many seconds."""
        rng = np.random.default_rng(self.entropy)
        if self.family == ROTORPY:
            groups = [(world, FLIGHTS) for world in self.worlds()]
            flown = _rotorpy().fly_groups(groups, rng, self.reality, seconds)
        else:
            common = {"count": FLIGHTS, "seconds": seconds}
            flown = [generate.fly_all(world, rng, self.reality, **common) for world in self.worlds()]
        healthy, hidden = (generate.logs(one, voltage=self.voltage) for one in flown)
        return healthy, hidden


def draw(
    family: str, cause: str | Sequence[str], size: str | None, seed: int | Sequence[int], name: str = "case"
) -> Case:
    """Return a case in a reality of a family, or of one of the families of a set of SETS.

    Raises ValueError for a cause that the family cannot have.
    """
    hidden = (cause,) if isinstance(cause, str) else tuple(cause)
    if lacking := [one for one in hidden if not _has(family, one)]:
        raise ValueError(f"the family {family} cannot have {', '.join(lacking)}")
    entropy = tuple(np.atleast_1d(seed).tolist())
    rng = np.random.default_rng(entropy)
    members = SETS.get(family, (family,))
    chosen = members[rng.integers(len(members))]
    reality, drawn = _drawn(chosen, hidden, size, rng)
    while not _can_fly(reality, drawn):
        reality, drawn = _drawn(chosen, hidden, size, rng)
    # Many vehicles log their battery, whether or not it matters.
    logged = "battery_sag" not in hidden and rng.uniform() < 0.4
    voltage = logged or any(one.voltage for one in drawn.values())
    return Case(name, chosen, hidden, size, drawn, reality, voltage, (*entropy, 1))


def plans(family: str, rng: np.random.Generator) -> list[tuple[tuple[str, ...], str | None]]:
    """Return causes and size of all cases of a set: every cause, medium and strong, and some of the rest."""
    names = [name for name in FREE_FLIGHT if _has(family, name)]
    result: list[tuple[tuple[str, ...], str | None]] = [
        ((name,), size) for name in names for size in SIZES[1:]
    ]
    result += [((str(name),), SIZES[0]) for name in rng.permutation(names)[:WEAK]]
    result += [(_pair(family, rng), SIZES[1 + k % 2]) for k in range(PAIRS)]
    result += [((), None)] * NOTHING
    others = [name for name in (*UNKNOWN, *DISTURBANCE) if _has(family, name)]
    return result + [((name,), SIZES[1 + k % 2]) for k, name in enumerate(others)]


def population(sets: Sequence[str], seed: int, count: int) -> list[Case]:
    """Return so many cases of these sets, in a random order; at most all of their plans."""
    rng = np.random.default_rng(seed)
    every = [(family, *plan) for family in sets for plan in plans(family, rng)]
    chosen = []
    for number, k in enumerate(rng.permutation(len(every))[:count]):
        family, hidden, size = every[k]
        words = [family, *hidden, *([size] if size else ["nothing"]), str(seed), str(number)]
        chosen.append(draw(family, hidden, size, (seed, number), "_".join(words)))
    return chosen


def _rotorpy():
    from . import rotorpy_reality

    return rotorpy_reality


def _drawn(family: str, hidden: Sequence[str], size, rng) -> tuple[Reality, dict[str, Drawn]]:
    reality = _rotorpy().draw(rng) if family == ROTORPY else simulator.draw(family, rng)
    return reality, {one: causes.draw(one, size, rng, reality) for one in hidden}


def _can_fly(reality: Reality, drawn: dict[str, Drawn]) -> bool:
    """Return whether the reality flies with these causes; RotorPy's does not with much more lag."""
    if reality.family != ROTORPY:
        return True
    return _rotorpy().flies(reality, World(**causes.combined(*drawn.values()).world))


def _has(family: str, cause: str) -> bool:
    return family != ROTORPY or cause not in LACKS


def _pair(family: str, rng) -> tuple[str, ...]:
    kin = [[one for one in names if _has(family, one)] for names in KIN]
    kin = [names for names in kin if names]
    first, second = (kin[k] for k in rng.choice(len(kin), 2, replace=False))
    return str(rng.choice(first)), str(rng.choice(second))
