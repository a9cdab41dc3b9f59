"""`landing-eval figure`, `video`, `picture` and `curves`: what a policy or a training looks like."""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress

from inclined_landing.envs.flights import Flight, record_flights
from inclined_landing.envs.policy import Policy, load_policy
from inclined_landing.envs.tasks import Task
from inclined_landing.eval.base.style import make_folder
from inclined_landing.eval.pictures.figures import learning_curves, save_figure, trajectory_figure
from inclined_landing.eval.pictures.touch import STEP, Touchdown, watch
from inclined_landing.eval.pictures.touch_video import render_touchdowns
from inclined_landing.eval.pictures.video import FPS, render_flight, strobe, write_video
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import PLANTS

GIF_FPS = 25.0  # players slow down faster ones
_REST = 0.6  # s that the last frame of a flight stays


def figure(policy: str, out: Path, starts: Sequence[str] = (), **options) -> list[Path]:
    """Write the trajectory figures of a policy as PNG and PDF into the folder `out`.

    starts: each as the task writes them, "X,Z" or "X,Y,Z"; default: the task's cases. options: those of
    `load`. Returns the files.
    """
    loaded = load(policy, **options)
    task = loaded.task
    cases = task.figure_starts
    if starts:
        names = ["trajectory"] if len(starts) == 1 else [f"trajectory_{k + 1}" for k in range(len(starts))]
        cases = dict(zip(names, _points(starts, task)))
    files = []
    flights = fly(loaded, list(cases.values()), options.get("plant", "mujoco"), task.judged_steps)
    for name, flight in zip(cases, flights):
        drawn = trajectory_figure(flight)
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
    if forces and not loaded.task.has_platform:
        raise UserError(f"--forces is for tasks with a platform: a {loaded.task.name} flight touches nothing")
    if forces and options.get("plant", "mujoco") != "mujoco":
        raise UserError("--forces needs the MuJoCo plant: in the analytic one nothing is felt")
    if camera == "touch" and not forces:
        raise UserError("--camera touch looks at a touchdown: it needs --forces")
    if camera == "touch" and backend == "gl":
        raise UserError("--camera touch is drawn with rays: leave --backend gl out")
    flights = fly(loaded, _points(starts, loaded.task), options.get("plant", "mujoco"))
    look = {"camera": camera, "width": width, "height": height, "backend": backend}
    touchdowns = [watch(flight) for flight in flights] if forces else []
    files = [out] + ([out.with_suffix(".gif")] if gif and out.suffix.lower() != ".gif" else [])
    for path in files:
        most = GIF_FPS if path.suffix.lower() == ".gif" else FPS
        if forces:
            every = math.ceil(1.0 / (STEP * FPS * slow) - 1e-9)  # engine steps from frame to frame
            rate = 1.0 / (every * STEP * slow)
            frames = film_touchdowns(touchdowns, every, rate, vehicle=loaded.task.vehicle, **look)
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
    drawn = strobe(flight, camera=camera, width=width, height=height, backend=backend)
    make_folder(out.parent)
    with storage.atomic(out) as part:
        Image.fromarray(drawn).save(part)
    report(flight, out.name)
    return out


def curves(folders: Sequence[Path], out: Path) -> Path:
    """Write the learning curves of run folders as one figure (.png or .pdf)."""
    return save_figure(learning_curves(folders), out)


def load(
    policy: str,
    *,
    task: str | None = None,
    inclination: float | None = None,
    vehicle: Path | None = None,
    plant: str = "mujoco",
) -> Policy:
    """The policy, for a platform at `inclination` [deg] and a vehicle file if given; checks the plant too."""
    if plant not in PLANTS:
        raise UserError(f"unknown plant {plant!r}; known are {' and '.join(PLANTS)}")
    flown = load_vehicle(vehicle)
    angle = None if inclination is None else flown.check_inclination(math.radians(inclination))
    return load_policy(policy, task, vehicle=None if vehicle is None else flown, inclination=angle)


def fly(policy: Policy, points: Sequence[tuple[float, ...]], plant: str, steps: int | None = None):
    """Flights from hover at points of the task's start axes [m], at most `steps` control steps long."""
    return record_flights(policy, plant, policy.task.states_at(points), steps=steps)


def _points(starts: Sequence[str], task: Task) -> list[tuple[float, ...]]:
    try:
        return [task.parse_start(text) for text in starts] or [task.film_starts[0]]
    except UserError as error:
        raise UserError(f"--{error}") from None


def _frame_count(flights: Sequence[Flight], sampled: float, rate: float) -> int:
    return sum(round(flight.duration * sampled) + 1 + round(_REST * rate) for flight in flights)


def _counted(frames: Iterator[np.ndarray], total: int, name: str) -> Iterator[np.ndarray]:
    """The frames, with a progress bar on stderr."""
    with Progress(console=Console(stderr=True), transient=True) as progress:
        yield from progress.track(frames, total=total, description=name)


def report(flight: Flight, name: str) -> None:
    """One line on stderr about a flight."""
    task = flight.task
    print(f"{name}: from {task.start_words(flight.state[0])}: {task.flight_words(flight)}", file=sys.stderr)
