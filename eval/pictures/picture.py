"""`landing-eval picture`: one rendered picture of a whole flight."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import tyro

from inclined_landing.eval.base.options import File, Flat, Flown, Look, PolicyFile
from inclined_landing.eval.pictures.flights import (
    Until,
    continue_flights,
    fly_from,
    say_outcomes,
    start_points,
)
from inclined_landing.eval.pictures.frames import FITTED, checked_look, strobe, write_picture
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError


def command(
    policy: PolicyFile,
    /,
    *,
    out: File,
    start: Annotated[str | None, tyro.conf.arg(metavar="X,Z")] = None,
    look: Flat[Look] = Look(camera=FITTED),
    until: Until = "rest",
    flown: Flat[Flown] = Flown(),
) -> None:
    """Render one picture of a whole flight, with copies of the vehicle along its path.

    Args:
        policy: file, or the name of a shipped one.
        out: .png file.
        start: where to fly from, in metres: X,Z or (setpoint) X,Y,Z; by default the task's first start.
        until: where a landing ends: rest goes on after the goal box with the motors cut, by MuJoCo, until the
            vehicle is at rest; goal ends with the policy's flight.
    """
    if out.suffix.lower() != ".png":
        raise UserError(f"a picture is a .png file, not {out.name!r}")
    storage.check_file(out)
    look = checked_look(look)
    loaded = flown.load(policy)
    flights = fly_from(loaded, start_points([] if start is None else [start], loaded.task), flown.plant)
    flight = continue_flights(flights, until)[0]
    write_picture(out, strobe(flight, **dataclasses.asdict(look)))
    say_outcomes({"flight 1": flight}, f"the picture is {out}")
