"""One picture of a whole flight: copies of the vehicle along its way (`landing-eval figure --whole`)."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from inclined_landing.envs.policy import Policy
from inclined_landing.eval.base.options import Look
from inclined_landing.eval.pictures.flights import (
    check_ending,
    continue_flights,
    fly_from,
    say_outcomes,
    start_points,
)
from inclined_landing.eval.pictures.frames import checked_look, strobe, write_picture
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError


def check(out: Path, look: Look, until: str) -> Look:
    """Return the look as it can be drawn.

    Raises UserError for a file that is no .png or cannot be written, or for an unknown look or end.
    """
    if out.suffix.lower() != ".png":
        raise UserError(f"a picture is a .png file, not {out.name!r}")
    check_ending(until)
    storage.check_file(out)
    return checked_look(look)


def draw(policy: Policy, out: Path, start: str | None, look: Look, until: str, plant: str) -> None:
    """Fly from `start`, X,Z or (setpoint) X,Y,Z in metres, and write the picture of the flight."""
    flown_from = start_points([] if start is None else [start], policy.task)
    flight = continue_flights(fly_from(policy, flown_from, plant), until)[0]
    drawn = strobe(flight, **dataclasses.asdict(look))
    write_picture(out, drawn)
    say_outcomes({"flight 1": flight}, f"the picture is {out}")
