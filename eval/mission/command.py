"""`landing-eval mission`: set-point flight, landing and touchdown as one flight, counted and filmed."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from msgspec import Meta
from rich.console import Console
from rich.progress import Progress

from inclined_landing.envs.hover import HAND_OVER_SPEED, HAND_OVER_TIME
from inclined_landing.envs.mission import HAND_OVER, Mission, Plan, fly_missions
from inclined_landing.envs.policy import load_policy
from inclined_landing.envs.rendering import check_picture_options
from inclined_landing.envs.shared import runs
from inclined_landing.envs.tasks.setpoint import TOLERANCE
from inclined_landing.eval.base.options import (
    Degrees,
    Flag,
    Flat,
    Look,
    NewFolder,
    PolicyName,
    Seed,
    VehicleFile,
)
from inclined_landing.eval.mission.report import report_of, show
from inclined_landing.eval.pictures import video
from inclined_landing.eval.pictures.figures import mission_figure, save_figure
from inclined_landing.eval.pictures.frames import FPS, strobe, write_picture
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.parameters import load_vehicle

DRAWN = 100  # missions without --missions
Starts = Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="X,Y,Z")]


@dataclasses.dataclass(frozen=True)
class HandOver:
    """When the landing policy takes over.

    Args:
        hand_over: the point that the set-point policy flies to, in metres; y is 0.
        near: distance to that point below which the landing policy may take over, in metres.
        slow: speed below which it may take over, in m/s.
        dwell: time for which both must hold, in seconds.
        drift: let y drift where a policy commands no roll; otherwise the set-point policy's roll holds it.
    """

    hand_over: Annotated[str, tyro.conf.arg(metavar="X,Z")] = ",".join(f"{value:g}" for value in HAND_OVER)
    near: Annotated[float, Meta(ge=0.005, le=0.5)] = TOLERANCE
    slow: Annotated[float, Meta(ge=0.01, le=3.0)] = HAND_OVER_SPEED
    dwell: Annotated[float, Meta(ge=0.0, le=5.0)] = HAND_OVER_TIME
    drift: Flag = False


def command(
    *,
    setpoint: PolicyName = "setpoint",
    landing: PolicyName = "landing",
    touchdown: PolicyName = "touchdown",
    start: Starts = (),
    missions: Annotated[int, Meta(ge=1, le=2000)] | None = None,
    seed: Seed = 0,
    hand_overs: Flat[HandOver] = HandOver(),
    inclination: Degrees = None,
    vehicle: VehicleFile = None,
    look: Flat[Look] = Look(camera="arena", width=960, height=540),
    no_film: Flag = False,
    json: Flag = False,
    out: NewFolder = None,
) -> None:
    """Whole missions: from anywhere in the room to the slope, onto it, and to rest, counted and filmed.

    The set-point policy flies to a hand-over point over the platform, the landing policy from there into the
    goal box, the touchdown policy to rest on the feet with motors at idle: one flight in MuJoCo with real
    contact.

    Args:
        setpoint: policy file, or the name of a shipped one, for the set-point task.
        landing: the same, for the landing task.
        touchdown: the same, for the touchdown task.
        start: where a mission begins, in metres; repeat the option for more. Default: random starts.
        missions: number of random starts, 100 by default.
        seed: of the random starts.
        inclination: of the platform in degrees, where it differs from the training's.
        vehicle: vehicle file (TOML), where it differs from the shipped one.
        no_film: leave the first mission's video and picture out.
        json: print JSON, and nothing else, on standard output.
        out: new folder for mission.json, the figure mission.png and .pdf, and of the first mission
            flight.mp4, flight.gif and flight.png.
    """
    if out is not None:
        runs.check_new_run(out)
    if start and missions is not None:
        raise UserError("--missions is how many random starts are drawn: leave it out with --start")
    if look.width % 2 or look.height % 2:
        raise UserError(f"a video has an even number of pixels a side, not {look.width} x {look.height}")
    check_picture_options(**dataclasses.asdict(look))
    plan = make_plan((setpoint, landing, touchdown), hand_overs, inclination, vehicle)
    if start:
        starts = np.array([_point(text, "start", "X,Y,Z") for text in start])
        plan.check_starts(starts)
    else:
        starts = plan.sample(np.random.default_rng(seed), DRAWN if missions is None else missions)
    flown = fly(plan, starts)
    report = report_of(flown) | {
        "seed": None if start else seed,
        "vehicle": str(vehicle) if vehicle is not None else "crazyflie.toml",
    }
    if out is not None:
        with runs.staged_run(out) as folder:
            storage.write_json(folder / "mission.json", report)
            draw(flown, folder, None if no_film else look)
    print(storage.to_json(report)) if json else show(report)


def make_plan(
    policies: tuple[str, str, str], given: HandOver, inclination: float | None, vehicle: Path | None
) -> Plan:
    """Return the plan of the options. Raises UserError for invalid ones."""
    loaded = load_vehicle(vehicle) if vehicle is not None else None
    slope = None if inclination is None else math.radians(inclination)
    if slope is not None:
        (loaded or load_vehicle()).check_inclination(slope)
    setpoint, landing, touchdown = policies
    x, z = _point(given.hand_over, "hand-over", "X,Z")
    return Plan(
        load_policy(setpoint, "setpoint", vehicle=loaded),
        load_policy(landing, vehicle=loaded, inclination=slope),
        load_policy(touchdown, "touchdown", vehicle=loaded, inclination=slope),
        (x, z),
        *(given.near, given.slow, given.dwell, not given.drift),
    )


def fly(plan: Plan, starts: np.ndarray) -> list[Mission]:
    """Return the missions from starts (n, 3) [m], with a progress bar on stderr."""
    with Progress(console=Console(stderr=True), transient=True) as progress:
        bar = progress.add_task("missions", total=len(starts))
        return fly_missions(plan, starts, lambda count: progress.update(bar, completed=count))


def _point(text: str, option: str, form: str) -> tuple[float, ...]:
    """Return the numbers of an option written as `form`."""
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != form.count(",") + 1 or not all(map(math.isfinite, numbers)):
        raise UserError(f"--{option} is {form} in metres, not {shown(text)!r}")
    return numbers


def draw(missions: list[Mission], folder: Path, look: Look | None) -> None:
    """Write the figure of missions into the folder; with a look also video and picture of the first one."""
    figure = mission_figure(missions[0], missions[1:])
    for suffix in (".png", ".pdf"):
        save_figure(figure, folder / f"mission{suffix}")
    if look is None:
        return
    how = dataclasses.asdict(look)
    write_picture(folder / "flight.png", strobe(missions[0], **how))
    frames, total, rate = video.film(missions[:1], FPS, 1.0, **how)
    video.write({folder / "flight.mp4": 1, folder / "flight.gif": 2}, frames, total, rate)
