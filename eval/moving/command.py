"""`landing-eval moving`: controllers on the frozen benchmark of moving decks."""

from __future__ import annotations

import math
import shlex
import sys
from typing import Annotated

import tyro

from inclined_landing.eval.base import runs
from inclined_landing.eval.base.options import COMPARED, Flag, NewFolder, Range
from inclined_landing.eval.base.page import embedded, png, render
from inclined_landing.eval.base.style import save_figure
from inclined_landing.eval.moving import report as made
from inclined_landing.eval.moving.controllers import PLANNER, find
from inclined_landing.eval.moving.flying import ride
from inclined_landing.eval.moving.scenario import read_scenario, shipped
from inclined_landing.eval.pictures import video
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import Vehicle, load_vehicle

BASELINES = ("touchdown-moving", "landing-moving", PLANNER)
_FPS, _LOOK = 12.5, {"camera": "chase", "width": 400, "height": 226, "backend": "auto"}  # of the film
ANGLE_LIMIT = math.radians(55.0)  # of attitude commands: 50 deg of slope and some to steer with

Controllers = Annotated[
    tuple[str, ...],
    tyro.conf.Positional,
    tyro.conf.arg(
        metavar="[CONTROLLER ...]",
        help="policies, files or shipped ones, of three dimensions; planner; or a controller of your own, "
        "module:NAME or file.py:NAME.",
        help_behavior_hint=f"(default: {' '.join(BASELINES)})",
    ),
    COMPARED,
]


def vehicle_flown() -> Vehicle:
    """The vehicle of the benchmark: the shipped one, with attitude commands up to 55 deg."""
    return load_vehicle().changed(command_angle_limit=ANGLE_LIMIT)


def command(
    controllers: Controllers = (),
    /,
    scenario: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME|FILE [NAME|FILE ...]")] = (),
    flights: Annotated[int | None, Range(1, 100_000)] = None,
    film: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE")] = None,
    json: Flag = False,
    out: NewFolder = None,
) -> None:
    """Landings on moving decks: the frozen benchmark, for policies and controllers of your own (minutes).

    Args:
        controllers: what is scored.
        scenario: of the benchmark, or scenario files (default: all of the benchmark).
        flights: only the first ones of each scenario, to try something.
        film: scenario whose first flight, of the first controller, becomes flight.gif.
        json: print JSON, and nothing else, on standard output.
        out: new folder for index.html, moving.json, flights.csv and the figure.
    """
    if out is not None:
        runs.check_new_run(out)
    if film is not None and out is None:
        raise UserError("--film needs --out, the folder that the film is put into")
    filmed = None if film is None else read_scenario(film)
    vehicle = vehicle_flown()
    scenarios = [read_scenario(name) for name in dict.fromkeys(scenario or shipped())]
    found = [find(name, vehicle) for name in dict.fromkeys(controllers or BASELINES)]
    names = [controller.name for controller in found]
    if twice := [name for name in names if names.count(name) > 1]:
        raise UserError(f"two controllers are called {twice[0]}; rename one")
    report, flown = made.evaluate(scenarios, found, flights)
    if out is not None:
        with runs.staged_run(out) as folder:
            picture = made.figure(report)
            save_figure(picture, folder / "moving.png")
            page = render(
                __package__,
                "moving.html.j2",
                title="Landings on moving decks",
                heads=made.heads(report),
                rows=made.cells(report),
                scenarios=[[s["name"], s["title"], s["fingerprint"][:12]] for s in report["scenarios"]],
                whole=all(s["whole"] for s in report["scenarios"]),
                image=embedded(png(picture)),
                run=shlex.join(["landing-eval", *sys.argv[1:]]),
                versions=report["versions"],
            )
            storage.write_text(folder / "index.html", page)
            storage.write_text(folder / "flights.csv", flown.to_csv(index=False, float_format="%.6g"))
            storage.write_json(folder / "moving.json", report)
            if filmed is not None:
                frames, total, rate = video.film([ride(filmed, found[0])], _FPS, 1.0, **_LOOK)
                video.write({folder / "flight.gif": 1}, frames, total, rate)
    if json:
        print(storage.to_json(report))
    else:
        made.show(report)
