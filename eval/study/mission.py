"""`landing-eval mission`: set-point flight, landing and touchdown as one flight (`missions`)."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import numpy as np
import tyro
from msgspec import Meta

from inclined_landing.envs.hover import HAND_OVER
from inclined_landing.eval.base.options import (
    Degrees,
    Flag,
    Flat,
    Look,
    NewFolder,
    PolicyName,
    Seed,
    VehicleFile,
    only_with,
    only_without,
)
from inclined_landing.models.base.errors import UserError

DRAWN = 100  # missions without --missions
_HAND_OVER = ",".join(f"{value:g}" for value in HAND_OVER)
Starts = Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="X,Y,Z")]


def command(
    *,
    setpoint: PolicyName = "setpoint",
    landing: PolicyName = "landing",
    touchdown: PolicyName = "touchdown",
    start: Starts = (),
    missions: Annotated[Annotated[int, Meta(ge=1, le=2000)] | None, only_without("start")] = None,
    seed: Annotated[Seed, only_without("start")] = 0,
    hand_over: Annotated[str, tyro.conf.arg(metavar="X,Z")] = _HAND_OVER,
    inclination: Degrees = None,
    vehicle: VehicleFile = None,
    look: Annotated[Flat[Look], only_with("out"), only_without("no_film")] = Look(
        camera="arena", width=960, height=540
    ),
    no_film: Annotated[Flag, only_with("out")] = False,
    json: Flag = False,
    out: NewFolder = None,
) -> None:
    """Fly whole missions, from anywhere in the room to rest on the slope; count and film them.

    The set-point policy flies to a hand-over point over the platform, the landing policy from there into the
    goal box, and the touchdown policy to rest on the feet with motors at idle, all in one flight in MuJoCo
    with contact.

    Args:
        setpoint: policy file, or name of a shipped policy, for the set-point task.
        landing: the same for the landing task.
        touchdown: the same for the touchdown task.
        start: start of a mission in metres; repeatable (default: random starts).
        missions: number of random starts (default: 100).
        seed: seed for the random starts.
        hand_over: point that the set-point policy flies to, in metres; y is 0. The landing policy takes over
            once the vehicle hovers there.
        inclination: platform inclination in degrees (default: that of the training).
        vehicle: vehicle file (TOML) or name of a shipped vehicle (default: Crazyflie 2.1).
        no_film: omit the video and picture of the first mission.
        json: print only JSON on standard output.
        out: new folder for index.html, the numbers as JSON, flights.csv, the figure mission.png and .pdf, and
            flight.mp4, flight.gif and flight.png of the first mission.
    """
    if look.width % 2 or look.height % 2:
        raise UserError(f"width and height of a video must be even, not {look.width} x {look.height}")
    from inclined_landing.envs.rendering import check_picture_options
    from inclined_landing.eval.pictures.starts import read_point
    from inclined_landing.eval.study import show
    from inclined_landing.eval.study.engine import fact
    from inclined_landing.eval.study.missions import fly, make_plan, study

    check_picture_options(**dataclasses.asdict(look))
    plan = make_plan((setpoint, landing, touchdown), hand_over, inclination, vehicle)
    if start:
        starts = np.array([read_point(text, "start", "xyz") for text in start])
        plan.check_starts(starts)
    else:
        starts = plan.sample(np.random.default_rng(seed), DRAWN if missions is None else missions)
    facts = [fact("mission", "vehicle", str(vehicle or "crazyflie.toml"))]
    facts += [] if start else [fact("mission", "seed", seed)]
    found = study(fly(plan, starts), facts, None if no_film else look)
    show.hand_over("mission", [found], json=json, out=out)
