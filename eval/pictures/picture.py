"""`landing-eval picture`: one rendered picture of a whole flight."""

from __future__ import annotations

from typing import Annotated

import tyro

from inclined_landing.eval.base.options import FITTED, File, Flat, Flown, Look, PolicyFile, Until
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError


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
        policy: policy file, or name of a shipped policy.
        out: .png file.
        start: start of the flight in metres, X,Z or (setpoint) X,Y,Z (default: the task's first start).
        until: end of a landing; goal stops with the policy's flight, rest continues with the motors cut,
            simulated in MuJoCo, until the vehicle is at rest.
    """
    from inclined_landing.eval.pictures.flights import continue_flights, fly_from, say_outcomes, start_points
    from inclined_landing.eval.pictures.frames import checked_look, renderer_for, strobe, write_picture

    if out.suffix.lower() != ".png":
        raise UserError(f"--out must be a .png file, not {out.name!r}")
    storage.check_file(out)
    look = checked_look(look)
    loaded = flown.load(policy)
    flights = fly_from(loaded, start_points([] if start is None else [start], loaded.task), flown.plant)
    flight = continue_flights(flights, until)[0]
    with renderer_for([flight], look) as renderer:
        write_picture(out, strobe(flight, renderer))
    say_outcomes({"flight 1": flight}, f"the picture is {out}")
