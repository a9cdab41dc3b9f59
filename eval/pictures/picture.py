"""`landing-eval picture`: a whole flight at a glance."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import tyro

from inclined_landing.envs.rendering import check_picture_options
from inclined_landing.eval.base.options import File, Flat, Flown, Look
from inclined_landing.eval.base.policies import AnyPolicy
from inclined_landing.eval.base.style import make_folder
from inclined_landing.eval.pictures.flights import (
    Until,
    check_ending,
    continue_flights,
    fly_from,
    print_outcome,
    start_points,
)
from inclined_landing.eval.pictures.frames import strobe, write_picture
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError


def command(
    policy: AnyPolicy,
    /,
    out: File,
    start: Annotated[str | None, tyro.conf.arg(metavar="X,Z")] = None,
    look: Flat[Look] = Look(),
    until: Until = "rest",
    flown: Flat[Flown] = Flown(),
) -> None:
    """One picture of a whole flight: copies of the vehicle along its way.

    Args:
        policy: file, or the name of a shipped one.
        out: .png file.
        start: where to fly from, in metres: X,Z or (setpoint) X,Y,Z.
        until: where a landing ends: rest goes on after the goal box with the motors cut, by MuJoCo, until
            the vehicle is at rest; goal ends with the policy's flight.
    """
    if out.suffix.lower() != ".png":
        raise UserError(f"a picture is a .png file, not {out.name!r}")
    check_ending(until)
    storage.check_file(out)
    check_picture_options(**dataclasses.asdict(look))
    loaded = flown.load(policy)
    flown_from = start_points([] if start is None else [start], loaded.task)
    flight = continue_flights(fly_from(loaded, flown_from, flown.plant), until)[0]
    drawn = strobe(flight, **dataclasses.asdict(look))
    make_folder(out.parent)
    write_picture(out, drawn)
    print_outcome(flight, out.name)
    print(out)
