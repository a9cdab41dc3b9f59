"""`landing-eval figure`: flights of a policy on paper, or as one rendered picture."""

from __future__ import annotations

from pathlib import Path

from inclined_landing.envs.flights import Flight
from inclined_landing.eval.base.options import Flag, Flat, Flown, Folder, Look, Starts
from inclined_landing.eval.base.policies import AnyPolicy
from inclined_landing.eval.pictures import picture
from inclined_landing.eval.pictures.figures import save_figure, trajectory_figure
from inclined_landing.eval.pictures.flights import Until, fly_from, say_outcomes, start_points
from inclined_landing.eval.pictures.frames import FITTED
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError

_LOOK = Look(camera=FITTED)


def command(
    policy: AnyPolicy,
    /,
    *,
    out: Folder,
    start: Starts = (),
    whole: Flag = False,
    look: Flat[Look] = _LOOK,
    until: Until = "rest",
    flown: Flat[Flown] = Flown(),
) -> None:
    """Stroboscopic trajectory with PWM and pitch over time, or one whole picture.

    Args:
        policy: file, or the name of a shipped one.
        out: folder for the files, PNG and PDF; with --whole the .png file.
        start: where to fly from, in metres: X,Z or (setpoint) X,Y,Z; repeat the option for
            more figures. Default: the task's cases, for landing the paper's two, 1.5,1.8 and 0,2.
        whole: one rendered picture of a whole flight instead, with copies of the vehicle along its way.
        until: where the picture of a landing ends: rest goes on after the goal box with the motors cut, by
            MuJoCo, until the vehicle is at rest; goal ends with the policy's flight.
    """
    if whole:
        if len(start) > 1:
            raise UserError("--whole is a picture of one flight: give --start once")
        look = picture.check(out, look, until)
        picture.draw(flown.load(policy), out, start[0] if start else None, look, until, flown.plant)
        return
    if look != _LOOK or until != "rest":
        raise UserError("camera, size, backend and --until are of a picture: add --whole, or leave them out")
    storage.check_folder(out)
    loaded = flown.load(policy)
    task = loaded.task
    cases = task.figure_starts
    if start:
        names = ["trajectory"] if len(start) == 1 else [f"trajectory_{k + 1}" for k in range(len(start))]
        cases = dict(zip(names, start_points(start, task)))
    flights = fly_from(loaded, list(cases.values()), flown.plant, task.judged_steps)
    named = dict(zip(cases, flights))
    for name, flight in named.items():
        draw(flight, out, name)
    files = f"{name}.png and {name}.pdf" if len(named) == 1 else f"{', '.join(named)}, each as .png and .pdf"
    say_outcomes(named, f"{out} has {files}")


def draw(flight: Flight, out: Path, name: str) -> list[Path]:
    """Write the figure of one flight into the folder `out`; return its files."""
    drawn = trajectory_figure(flight)
    return [save_figure(drawn, out / f"{name}{suffix}") for suffix in (".png", ".pdf")]
