"""Cases of the blind test: a reality, what is hidden in it, and how a user gets at it.

    from inclined_landing.eval.proof.gap_blind import cases
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
from inclined_landing.eval.proof import simulator
from inclined_landing.eval.proof.simulator import Reality

from . import causes, generate
from .causes import FREE_FLIGHT, SIZES, TOUCHDOWN, UNKNOWN, UNREST, Drawn

# Families whose cases thresholds are chosen on, and those that are scored once.
SETS = {"dev": ("cascade", "firmware", "feed_forward"), "fresh": ("geometric", "full_state")}
STRATA = (
    *("single", "pair", "nothing", "few flights", "noisy", "slow log", "paper", "base off"),
    *("unknown", "unrest", "touchdown"),
)
IDENTIFY, HELDOUT = 8, 3  # flights
LANDINGS = 16  # of a touchdown case

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
    entropy: tuple[int, ...]  # of the flights

    @property
    def identified(self) -> bool:
        """Does the user identify the vehicle first?"""
        return self.stratum not in ("paper", "touchdown")

    def label(self) -> dict:
        """What the scorer needs to know, as plain data."""
        return {
            "family": self.family,
            "stratum": self.stratum,
            "causes": list(self.causes),
            "size": self.size,
            "parameters": {cause: one.parameters for cause, one in self.drawn.items()},
        }

    def fly(self) -> Flown:
        """Fly all flights."""
        rng = np.random.default_rng(self.entropy)
        drawn = causes.combined(*self.drawn.values())
        count = self.count + HELDOUT
        if self.stratum == "touchdown":
            recordings = generate.land_all(drawn, rng, count=count)
            gap, plain = generate.logs(recordings, contact=True), []
        else:
            charge = {"battery_voltage": (-0.15, 0.15)}
            plain = generate.fly_all(
                Drawn({}, {}, spread=charge), rng, self.reality, count=IDENTIFY * self.identified
            )
            # Without a channel that shows its battery, every flight starts on the same charge.
            spread = {} if "battery_sag" in self.causes else charge | drawn.spread
            hidden = dataclasses.replace(drawn, spread=spread)
            gap = generate.logs(
                generate.fly_all(hidden, rng, self.reality, count=count), voltage=self.voltage
            )
        return Flown(
            generate.logs(plain, voltage=self.voltage), gap[: self.count], gap[self.count :], self.label()
        )


def draw(
    family: str = "dev",
    stratum: str = "single",
    cause: str | Sequence[str] | None = None,
    size: str | None = None,
    seed: int | Sequence[int] = 0,
    name: str = "case",
) -> Case:
    """A case of a stratum, in a reality of a family of the simulator or of one of SETS.

    Causes and size are drawn from the seed where they are not given.
    """
    entropy = tuple(np.atleast_1d(seed).tolist())
    rng = np.random.default_rng(entropy)
    members = SETS.get(family, (family,))
    chosen = members[rng.integers(len(members))]
    reality = _fitted(simulator.draw(chosen if stratum != "touchdown" else "reference", rng), stratum, rng)
    hidden = _hidden(stratum, rng) if cause is None else (cause,) if isinstance(cause, str) else tuple(cause)
    size = None if not hidden else size or str(rng.choice(SIZES if stratum == "single" else SIZES[1:]))
    drawn = {one: causes.draw(one, size, rng, reality) for one in hidden}
    # Many vehicles log their battery, whether or not it matters.
    logged = stratum != "touchdown" and "battery_sag" not in hidden and rng.uniform() < 0.4
    return Case(
        name=name,
        family=reality.family,
        stratum=stratum,
        causes=hidden,
        size=size,
        drawn=drawn,
        reality=reality,
        count={"few flights": 3, "touchdown": LANDINGS}.get(stratum, 10),
        voltage=logged or any(one.voltage for one in drawn.values()),
        entropy=(*entropy, 1),
    )


def _hidden(stratum: str, rng) -> tuple[str, ...]:
    if stratum == "nothing":
        return ()
    if stratum == "pair":
        first, second = (KIN[k] for k in rng.choice(len(KIN), 2, replace=False))
        return str(rng.choice(first)), str(rng.choice(second))
    table = {"unknown": UNKNOWN, "unrest": UNREST, "touchdown": TOUCHDOWN}.get(stratum, FREE_FLIGHT)
    return (str(rng.choice(list(table))),)


def _fitted(reality: Reality, stratum: str, rng) -> Reality:
    """The reality as the stratum wants it: more noise, or fewer rows."""
    c, b = reality.constants, reality.build
    if stratum == "noisy":
        angle = math.radians(rng.uniform(0.6, 1.0))
        c = c._replace(position_noise=rng.uniform(0.003, 0.005), attitude_noise=angle)
    if stratum == "slow log":
        b = b._replace(log_ticks=10.0, stamp_jitter=0.002)
    return dataclasses.replace(reality, constants=c, build=b)
