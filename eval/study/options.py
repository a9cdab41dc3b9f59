"""Options of the studies and their defaults; nothing slow is imported."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import tyro
from msgspec import Meta

from inclined_landing.envs.hover import HAND_OVER, HAND_OVER_SPEED, HAND_OVER_TIME, TOLERANCE
from inclined_landing.eval.base.options import Flag

THRUSTS = tuple(round(0.70 + 0.05 * k, 2) for k in range(10))  # actual thrust over that of the training
VEHICLES = ("crazyflie-2.0", "crazyflie-2.1", "crazyflie-2.1-brushless", "hummingbird")
PLANNER = "planner"
BASELINES = ("touchdown-moving", "landing-moving", PLANNER)  # on moving platforms
NOMINAL = "landing-nominal"  # whose motors are cut, for comparison with touchdown policies
FRICTIONS = (0.5, 0.6, 0.8, 1.2)
RESTITUTIONS = (0.0, 0.25, 0.5)


@dataclasses.dataclass(frozen=True)
class HandOver:
    """Condition for handing over to the landing policy.

    Args:
        hand_over: point that the set-point policy flies to, in metres; y is 0.
        near: distance to that point below which the landing policy may take over, in metres.
        slow: speed below which it may take over, in m/s.
        dwell: time for which both conditions must hold, in seconds.
        drift: let y drift under policies that command no roll; otherwise the set-point policy holds y.
    """

    hand_over: Annotated[str, tyro.conf.arg(metavar="X,Z")] = ",".join(f"{value:g}" for value in HAND_OVER)
    near: Annotated[float, Meta(ge=0.005, le=0.5)] = TOLERANCE
    slow: Annotated[float, Meta(ge=0.01, le=3.0)] = HAND_OVER_SPEED
    dwell: Annotated[float, Meta(ge=0.0, le=5.0)] = HAND_OVER_TIME
    drift: Flag = False
