"""`landing-eval figure`, `video`, `picture` and `curves`: what a policy or a training looks like."""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.path import Path as Outline
from rich.console import Console
from rich.progress import Progress

from inclined_landing.envs.flights import Flight, record_flights
from inclined_landing.envs.policy import Policy, load_policy
from inclined_landing.envs.tasks.base import hover_states
from inclined_landing.envs.tasks.landing import PAPER_STARTS
from inclined_landing.eval.base.style import make_folder
from inclined_landing.eval.pictures.figures import learning_curves, save_figure, trajectory_figure
from inclined_landing.eval.pictures.figures.scene import platform_outline
from inclined_landing.eval.pictures.touch import STEP, Touchdown, watch
from inclined_landing.eval.pictures.touch_video import render_touchdowns
from inclined_landing.eval.pictures.video import FPS, render_flight, strobe, write_video
from inclined_landing.eval.policies.success import SETPOINT_TIME
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError
from inclined_landing.models.plants import PLANTS

CASES = {"above_right": PAPER_STARTS[2], "above": PAPER_STARTS[0]}  # the paper's figures
SETPOINT_START = (1.5, 1.0, 0.6)  # m
GIF_FPS = 25.0  # players slow down faster ones
_REST = 0.6  # s that the last frame of a flight stays


def figure(policy: str, out: Path, starts: Sequence[str] = (), **options) -> list[Path]:
    """Write the trajectory figures of a policy as PNG and PDF into the folder `out`.

    starts: "X,Z" (landing) or "X,Y,Z" (set-point) each; default: the paper's two cases. options: those
    of `fly`. Returns the files.
    """
    loaded = load(policy, **options)
    if starts:
        names = ["trajectory"] if len(starts) == 1 else [f"trajectory_{k + 1}" for k in range(len(starts))]
        points = [parse_start(text, loaded.task) for text in starts]
    elif loaded.task.name != "setpoint":
        names, points = [f"trajectory_{name}" for name in CASES], list(CASES.values())
    else:
        names, points = ["trajectory"], [SETPOINT_START]
    files = []
    landing, period = loaded.task.name != "setpoint", loaded.task.vehicle.command_control_period
    steps = None if landing else round(SETPOINT_TIME / period)
    for name, flight in zip(names, fly(loaded, points, options.get("plant", "mujoco"), steps)):
        drawn = trajectory_figure(flight, vehicle=loaded.task.vehicle)
        files += [save_figure(drawn, Path(out) / f"{name}{suffix}") for suffix in (".png", ".pdf")]
        report(flight, name)
    return files


def video(
    policy: str,
    out: Path,
    starts: Sequence[str] = (),
    *,
    camera: str = "hero",
    gif: bool = False,
    width: int = 960,
    height: int = 540,
    backend: str = "auto",
    slow: float = 1.0,
    forces: bool = False,
    **options,
) -> list[Path]:
    """Write one video with a flight from each start after the other; returns the files.

    out: .mp4 or .gif; with `gif` also the other kind beside an .mp4. slow: 2 plays at half speed.
    forces: only the touchdowns, with their contact forces.
    """
    out = Path(out)
    if out.suffix.lower() not in (".mp4", ".gif"):
        raise UserError(f"a video is an .mp4 or .gif file, not {out.name!r}")
    if not (math.isfinite(slow) and 0.1 <= slow <= 20.0):
        raise UserError(f"--slow must be from 0.1 to 20, not {slow:g}")
    if width % 2 or height % 2:
        raise UserError(f"a video has an even number of pixels a side, not {width} x {height}")
    loaded = load(policy, **options)
    if forces and loaded.task.name == "setpoint":
        raise UserError("--forces is for landing and touchdown policies: a set-point flight touches nothing")
    if forces and options.get("plant", "mujoco") != "mujoco":
        raise UserError("--forces needs the MuJoCo plant: in the analytic one nothing is felt")
    if camera == "touch" and not forces:
        raise UserError("--camera touch looks at a touchdown: it needs --forces")
    if camera == "touch" and backend == "gl":
        raise UserError("--camera touch is drawn with rays: leave --backend gl out")
    flights = fly(loaded, _points(starts, loaded.task), options.get("plant", "mujoco"))
    look = {"camera": camera, "width": width, "height": height, "backend": backend}
    look["vehicle"] = loaded.task.vehicle
    touchdowns = [watch(flight, loaded.task.vehicle) for flight in flights] if forces else []
    files = [out] + ([out.with_suffix(".gif")] if gif and out.suffix.lower() != ".gif" else [])
    for path in files:
        most = GIF_FPS if path.suffix.lower() == ".gif" else FPS
        if forces:
            every = math.ceil(1.0 / (STEP * FPS * slow) - 1e-9)  # engine steps from frame to frame
            rate = 1.0 / (every * STEP * slow)
            frames = film_touchdowns(touchdowns, every, rate, **look)
            total = sum(len(range(0, len(x.t), every)) + round(_REST * rate) for x in touchdowns)
        else:
            sampled = min(FPS, most * slow)  # frames for a second of flight; there are no more states
            rate = sampled / slow
            frames = film(flights, sampled, rate, **look)
            total = _frame_count(flights, sampled, rate)
        frames = _counted(frames, total, path.name)
        try:
            write_video(path, frames, fps=rate)
        except OSError as error:
            raise UserError(f"cannot write {path}: {(error.strerror or str(error)).lower()}") from error
    for k, flight in enumerate(flights):
        report(flight, f"flight {k + 1}")
    return files


def film(flights: Sequence[Flight], sampled: float, rate: float, **look) -> Iterator[np.ndarray]:
    """Frames of flights after each other; the last frame of each stays for a moment."""
    for flight in flights:
        for frame in render_flight(flight, fps=sampled, **look):
            yield frame
        yield from itertools.repeat(frame, round(_REST * rate))


def film_touchdowns(touchdowns: Sequence[Touchdown], every: int, rate: float, **look) -> Iterator[np.ndarray]:
    """Frames of touchdowns after each other; the last frame of each stays for a moment."""
    for frame, last in render_touchdowns(touchdowns, every=every, **look):
        yield frame
        if last:
            yield from itertools.repeat(frame, round(_REST * rate))


def picture(
    policy: str,
    out: Path,
    start: str | None = None,
    *,
    camera: str = "hero",
    width: int = 1280,
    height: int = 720,
    backend: str = "auto",
    **options,
) -> Path:
    """Write the whole flight as one picture, copies of the vehicle along its way (.png)."""
    from PIL import Image

    out = Path(out)
    if out.suffix.lower() != ".png":
        raise UserError(f"a picture is a .png file, not {out.name!r}")
    loaded = load(policy, **options)
    points = _points([start] if start else [], loaded.task)
    flight = fly(loaded, points, options.get("plant", "mujoco"))[0]
    drawn = strobe(
        flight, camera=camera, width=width, height=height, backend=backend, vehicle=loaded.task.vehicle
    )
    make_folder(out.parent)
    with storage.atomic(out) as part:
        Image.fromarray(drawn).save(part)
    report(flight, out.name)
    return out


def curves(folders: Sequence[Path], out: Path) -> Path:
    """Write the learning curves of run folders as one figure (.png or .pdf)."""
    return save_figure(learning_curves(folders), out)


def load(
    policy: str, *, task: str | None = None, inclination: float | None = None, plant: str = "mujoco"
) -> Policy:
    """The policy, for a platform at `inclination` [deg] if given; checks the plant's name too."""
    if plant not in PLANTS:
        raise UserError(f"unknown plant {plant!r}; known are {' and '.join(PLANTS)}")
    if inclination is None:
        return load_policy(policy, task)
    loaded = load_policy(policy, task)
    if loaded.task.name == "setpoint":
        raise UserError("--inclination is for landing policies; the setpoint task has no platform")
    angle = loaded.task.vehicle.check_inclination(math.radians(inclination))
    return load_policy(policy, task, inclination=angle)


def fly(policy: Policy, points: Sequence[tuple[float, ...]], plant: str, steps: int | None = None):
    """Flights from hover at points (x, z) or (x, y, z) [m], at most `steps` control steps long."""
    return record_flights(policy, plant, _states(points, policy.task), steps=steps)


def parse_start(text: str, task) -> tuple[float, ...]:
    """The point in "X,Z" (landing) or "X,Y,Z" (set-point) [m], inside the arena, clear of the platform."""
    form = "X,Z" if task.name != "setpoint" else "X,Y,Z"
    try:
        point = tuple(float(number) for number in text.split(","))
    except ValueError:
        point = ()
    if len(point) != form.count(",") + 1 or not all(map(math.isfinite, point)):
        example = "1.5,1.8" if task.name != "setpoint" else "1.5,1,0.6"
        raise UserError(f"--start must be {form} in metres, like {example}, not {text!r}")
    v = task.vehicle
    sides = (v.arena_x, v.arena_z) if len(point) == 2 else (v.arena_x, v.arena_y, v.arena_z)
    for name, value, (low, high) in zip(form.split(","), point, sides):
        if not low < value < high:
            room = f"{name.lower()} must be between {low:g} and {high:g} m"
            raise UserError(f"--start {text} lies outside the arena: {room}")
    if task.name != "setpoint" and _inside_platform(point, task):
        raise UserError(f"--start {text} lies in the platform")
    return point


def _inside_platform(point: tuple[float, float], task) -> bool:
    """Does a vehicle at (x, z) touch the platform, or lie in the hollow under the slab."""
    outlines = platform_outline(task.inclination, task.vehicle)
    start = task.start(_states([point], task))
    return any(Outline(o).contains_point(point) for o in outlines) or task.start_clearance(start)[0] <= 0.0


def _points(starts: Sequence[str], task) -> list[tuple[float, ...]]:
    default = CASES["above_right"] if task.name != "setpoint" else SETPOINT_START
    return [parse_start(text, task) for text in starts] or [default]


def _states(points, task) -> np.ndarray:
    positions = np.zeros((len(points), 3))
    positions[:, [0, 2] if task.name != "setpoint" else [0, 1, 2]] = points
    return hover_states(positions, task.vehicle)


def _frame_count(flights: Sequence[Flight], sampled: float, rate: float) -> int:
    return sum(round(flight.duration * sampled) + 1 + round(_REST * rate) for flight in flights)


def _counted(frames: Iterator[np.ndarray], total: int, name: str) -> Iterator[np.ndarray]:
    """The frames, with a progress bar on stderr."""
    with Progress(console=Console(stderr=True), transient=True) as progress:
        yield from progress.track(frames, total=total, description=name)


def report(flight: Flight, name: str) -> None:
    """One line on stderr about a flight."""
    x, y, z = flight.state[0, :3]
    place = f"x {x:g}, z {z:g} m" if flight.task != "setpoint" else f"x {x:g}, y {y:g}, z {z:g} m"
    if flight.task == "landing":
        end = f"goal box after {flight.duration:.2f} s" if flight.success else "goal box not reached"
        end += ", platform touched before" if flight.touched else ""
    elif flight.task == "touchdown":
        end = f"at rest on the slope after {flight.duration:.2f} s" if flight.success else "not at rest"
    else:
        away = np.linalg.norm(flight.state[-1, :3] - flight.goal[:3])
        end = f"{100 * away:.1f} cm from the goal after {flight.duration:.2f} s"
    print(f"{name}: from {place}: {end}", file=sys.stderr)
