"""`landing-eval video`: flights as .mp4 or .gif."""

from __future__ import annotations

import math
from typing import Annotated

from msgspec import Meta

from inclined_landing.eval.base.options import (
    FITTED,
    Drawn,
    File,
    Flag,
    Flat,
    Flown,
    Look,
    Only,
    PolicyFile,
    Seed,
    Starts,
    Until,
    only_with,
    only_without,
)
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError

GIF_FPS = 25.0  # players slow down faster ones
_GIF = Only(lambda values: values["out"].suffix.lower() != ".gif", "with a .gif file in --out")


def command(
    policy: PolicyFile,
    /,
    *,
    out: File,
    start: Starts = (),
    drawn: Annotated[Drawn, only_without("start")] = 0,
    seed: Annotated[Seed, only_with("drawn")] = 0,
    look: Flat[Look] = Look(camera=FITTED, width=960, height=540),
    gif: Annotated[Flag, _GIF] = False,
    slow: Annotated[float, Meta(ge=0.1, le=20)] = 1.0,
    until: Until = "rest",
    flown: Flat[Flown] = Flown(),
) -> None:
    """Render a video of flights, one after the other.

    Args:
        policy: policy file, or name of a shipped policy.
        out: .mp4 or .gif file.
        start: start of a flight in metres, X,Z or (setpoint) X,Y,Z; repeatable.
        drawn: number of flights from random starts instead, over random slopes if the policy observes them.
        seed: seed for the random starts.
        gif: also write a .gif.
        slow: slow-down factor; 2 plays at half speed, as a label in the picture states.
        until: end of a landing; goal stops with the policy's flight, rest continues with the motors cut,
            simulated in MuJoCo, until the vehicle is at rest.
    """
    from inclined_landing.envs.flights import record_flights
    from inclined_landing.eval.pictures.flights import (
        choose_starts,
        continue_flights,
        say_outcomes,
        start_points,
    )
    from inclined_landing.eval.pictures.frames import FPS, checked_look, renderer_for, write_film

    storage.check_file(out)
    if out.suffix.lower() not in (".mp4", ".gif"):
        raise UserError(f"--out must be an .mp4 or .gif file, not {out.name!r}")
    if look.width % 2 or look.height % 2:
        raise UserError(f"width and height of a video must be even, not {look.width} x {look.height}")
    look = checked_look(look)
    loaded = flown.load(policy)
    where = choose_starts(loaded.task, start_points(start, loaded.task), drawn, seed)
    flights = continue_flights(record_flights(loaded, flown.plant, where), until)
    most = GIF_FPS if out.suffix.lower() == ".gif" else FPS
    sampled = min(FPS, most * slow)  # there are no more states
    files = {out: 1}
    if gif and out.suffix.lower() != ".gif":
        files[out.with_suffix(".gif")] = math.ceil(sampled / slow / GIF_FPS - 1e-9)
    with renderer_for(flights, look) as renderer:
        write_film(files, flights, renderer, sampled, slow)
    named = {f"flight {k + 1}": flight for k, flight in enumerate(flights)}
    say_outcomes(named, f"the video is {' and '.join(map(str, files))}")
