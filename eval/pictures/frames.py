"""Videos and stroboscopic pictures of recorded flights."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from inclined_landing.envs.flights import Flight, Track
from inclined_landing.envs.mission import Mission
from inclined_landing.envs.rendering import (
    Ghost,
    View,
    check_picture_options,
    look_at,
    make_renderer,
    pose_from_state,
    qpos_of_state,
)
from inclined_landing.envs.rendering.camera import nearest_position
from inclined_landing.envs.rendering.renderer import SceneRenderer
from inclined_landing.envs.shared.progress import Tick, stages
from inclined_landing.eval.base.options import FITTED, Look
from inclined_landing.eval.pictures.labels import (
    MOTORS_CUT,
    Label,
    draw_labels,
    leg_colours,
    leg_label,
    outcome_label,
    speed_label,
)
from inclined_landing.eval.pictures.path import path_share, select_copies
from inclined_landing.eval.pictures.to_rest import LandedFlight
from inclined_landing.models import threads
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError

FPS = 50.0  # one frame for every control step
_REST = 1.0  # s that the last frame of a flight stays in a film
_ENDED = "ffmpeg was killed; is the disk full, the file too large (ulimit -f), or memory short?"
_CODECS = {".mp4": "h264", ".gif": "gif"}
_QUICK = ("-preset", "veryfast")  # half the time of H.264's usual search
# The palette dithers only what moves.
_GIF = ("-vf", "split[s0][s1];[s0]palettegen[p];[s1][p]paletteuse=diff_mode=rectangle")
_HERO = np.array([1.75, 2.9, -1.0])  # where the hero camera looks, from its place
_ROOM = np.array([0.2, 0.2, 0.15])  # m around a flight: the vehicle as it is drawn, and some air
_FILLED = 0.88  # of a picture's height; the caption has the rest
_NEAR = 0.35  # m; nearer, the vehicle as it is drawn would overlap a copy at the goal
_COPIES, _SPACING = 10, 0.13  # in a strobe picture: at most so many, at least so many m apart
_EARLY, _LATE = np.array([0.30, 0.05, 0.62]), np.array([0.98, 0.62, 0.20])  # along a strobe picture


def flight_view(flights: Sequence[Track], width: int, height: int) -> View:
    """Return the nearest view, in the direction of the hero camera, that contains flights and platforms."""
    points = [np.zeros((0, 3))]
    for flight in flights:
        points.append(flight.state[:, :3])
        if flight.platform is not None:
            v = flight.task.vehicle
            reach = np.array([v.slab_half_length, 0.5 * v.platform_depth, 0.0])
            corners = reach * [[-1, -1, 0], [-1, 1, 0], [1, -1, 0], [1, 1, 0]]
            points += [flight.platform[k, :3] + corners for k in (0, -1)]
    seen = np.concatenate(points)
    room = (seen + _ROOM * offset for offset in itertools.product((-1, 1), repeat=3))
    direction = look_at(np.zeros(3), _HERO, width, height, fovy=42.0)
    half = 0.5 * direction.extent
    spot = nearest_position(np.concatenate(list(room)), direction.axes, half * width / height, _FILLED * half)
    return dataclasses.replace(direction, origin=spot - (1.0 - _FILLED) * 0.5 * half * direction.axes[1])


def checked_look(look: Look) -> Look:
    """Return a look that can be drawn; raises UserError for one that cannot."""
    plain = dataclasses.replace(look, camera="hero") if look.camera == FITTED else look
    check_picture_options(**dataclasses.asdict(plain))
    return plain if look.backend == "gl" else look  # a view is drawn with rays


def renderer_for(flights: Sequence[Track], look: Look) -> SceneRenderer:
    """Return the renderer of one vehicle's flights with a look; FITTED is the nearest view of all of them."""
    camera = flight_view(flights, look.width, look.height) if look.camera == FITTED else look.camera
    return make_renderer(look.width, look.height, camera, look.backend, vehicle=flights[0].task.vehicle)


def pose_at(flight: Track, k: int):
    """Return the pose of vehicle and platform at sample k for renderers."""
    platform = None if flight.platform is None else flight.platform[k]
    return pose_from_state(flight.state[k], platform, has_base=flight.motion is None)


def caption(flight: Track, k: int) -> str:
    """Return the caption of frame k."""
    s, pwm = flight.state[k], flight.commands[k, 0]
    planar = np.abs(flight.state[:, 1]).max() < 0.01
    across = "" if planar else f"y {s[1]:+z5.2f}  "
    where = f"t {flight.t[k]:4.2f} s  x {s[0]:+z5.2f}  {across}z {s[2]:4.2f} m"
    return f"{where}  pitch {np.degrees(s[7]):+z3.0f} deg  PWM {pwm:5.0f}"


def ghosts_at(flight: Track) -> list[list[Ghost]]:
    """Return the copies of the vehicle at the goals for each sample; they fade as the vehicle approaches.

    There are none for a moving platform.
    """
    goals = [] if flight.motion is not None else flight.goals
    shown: list[list[Ghost]] = [[] for _ in flight.t]
    for goal in goals:
        distance = np.linalg.norm(flight.state[:, :3] - goal[:3], axis=1)
        share = np.clip((np.minimum.accumulate(distance) - _NEAR) / _NEAR, 0.0, 1.0)
        for ghosts, alpha in zip(shown, Ghost.alpha * share):
            if alpha > 0.0:
                ghosts.append(Ghost(qpos_of_state(goal), alpha=alpha))
    return shown


def labels_of(flight: Flight | Mission, k: int) -> list[Label]:
    """Return the labels of sample k: leg, motor cut, outcome of the flight."""
    last = k == len(flight.t) - 1
    if isinstance(flight, Mission):
        return [leg_label(flight, k), *([outcome_label(flight.summary, flight.success)] if last else [])]
    if isinstance(flight, LandedFlight) and k >= flight.cut:
        settled = k >= flight.settled
        return [outcome_label(flight.ending, flight.at_rest) if settled else MOTORS_CUT]
    return [outcome_label(flight.task.flight_words(flight), flight.success)] if last else []


def render_flight(
    flight: Flight | Mission, renderer: SceneRenderer, *, fps: float = FPS, slow: float = 1.0
) -> Iterator[np.ndarray]:
    """Yield frames (height, width, 3) uint8, `fps` of them per second of flight.

    slow: slow-down factor, stated by a label in the picture; other labels state the end of the flight.
    """
    times = np.arange(flight.t[0], flight.t[-1] + 0.5 / fps, 1.0 / fps)
    frames = np.minimum(np.searchsorted(flight.t, times - 1e-9), len(flight.t) - 1)
    close = renderer.camera in ("closeup", "onboard")
    ghosts = ghosts_at(flight)
    colours = leg_colours(flight) if isinstance(flight, Mission) else None
    trail = None if close else renderer.centres(flight.state)

    def draw(part):
        drawing, k = part
        frame = drawing.render(
            pose_at(flight, k),
            trail=None if trail is None else trail[: k + 1],
            trail_colour=None if colours is None else colours[: k + 1],
            ghosts=[] if close else ghosts[k],
            caption=caption(flight, k),
        )
        draw_labels(frame, speed_label(slow) + labels_of(flight, k))
        return frame

    yield draw((renderer, frames[0]))  # alone: its background serves the others
    renderers = renderer.several(2)
    for first in range(1, len(frames), len(renderers)):
        yield from threads.in_threads(draw, list(zip(renderers, frames[first:])))


def strobe(flight: Track, renderer: SceneRenderer) -> np.ndarray:
    """Return one picture of a whole flight, with copies of the vehicle along its path and a solid last one.

    At most _COPIES precede the last; their colours run from violet (early) to orange (late), or show the legs
    of a mission.
    """
    chosen = select_copies(flight.state, _COPIES + 1, _SPACING)[:-1]
    colours = _EARLY + path_share(flight.state)[:, None] * (_LATE - _EARLY)
    if isinstance(flight, Mission):
        colours = leg_colours(flight)
    ghosts = [
        Ghost(qpos_of_state(flight.state[k]), tuple(colours[k]), alpha=0.8, tint=0.7, shadow=True)
        for k in chosen
    ]
    trail = renderer.centres(flight.state)
    return renderer.render(pose_at(flight, -1), trail=trail, trail_colour=colours, ghosts=ghosts)


def write_picture(path: Path, picture: np.ndarray) -> Path:
    """Write a picture (h, w, 3) uint8 to a .png file, atomically; return its path."""
    with storage.made(path.parent), storage.atomic(path) as part:
        Image.fromarray(picture).save(part)
    return path


def write_videos(every: Mapping[Path, int], frames, fps: float = FPS) -> None:
    """Write frames (h, w, 3) uint8 to .mp4 or .gif files of one duration, each with every n-th frame.

    A file gets its name when it is complete. Raises UserError for any other suffix, if there are no frames,
    and if ffmpeg fails, as on a full disk.
    """
    for path in every:
        if path.suffix.lower() not in _CODECS:
            raise UserError(f"--out must be an .mp4 or .gif file, not {path.name!r}")
    frames = iter(frames)
    first = next(frames, None)
    if first is None:
        raise UserError(f"no frames for {' and '.join(path.name for path in every)}")
    with contextlib.ExitStack() as opened:
        writers = []
        for path, step in every.items():
            opened.enter_context(storage.made(path.parent))
            part = opened.enter_context(storage.atomic(path))
            writers.append((opened.enter_context(_encoded(path, part, first.shape[:2], fps / step)), step))
        for k, frame in enumerate(itertools.chain([first], frames)):
            for add, step in writers:
                if k % step == 0:
                    add(frame)


def film(
    flights: Sequence[Flight | Mission], renderer: SceneRenderer, sampled: float, slow: float = 1.0
) -> Iterator[np.ndarray]:
    """Yield the frames of one vehicle's flights in sequence, `sampled` of them per second of flight.

    The last frame of each flight is held for a moment.
    """
    for flight in flights:
        for frame in render_flight(flight, renderer, fps=sampled, slow=slow):
            yield frame
        yield from itertools.repeat(frame, round(_REST * sampled / slow))


def write_film(
    files: Mapping[Path, int],
    flights: Sequence[Flight | Mission],
    renderer: SceneRenderer,
    sampled: float,
    slow: float = 1.0,
) -> None:
    """Write `film` to videos, each with every n-th frame, and show a progress bar on stderr."""
    names = " and ".join(str(path) for path in files)

    def ticking(tick: Tick) -> Iterator[np.ndarray]:
        for frame in film(flights, renderer, sampled, slow):
            tick(names)
            yield frame

    total = sum(round(flight.t[-1] * sampled) + 1 + round(_REST * sampled / slow) for flight in flights)
    with stages(total, "frames") as tick:
        try:
            write_videos(files, ticking(tick), fps=sampled / slow)
        except OSError as error:
            raise UserError(f"cannot write {names}: {(error.strerror or str(error)).lower()}") from error


@contextlib.contextmanager
def _encoded(path: Path, part: Path, shape, fps: float) -> Iterator[Callable[[Any], None]]:
    """Yield a function that adds a frame to the video that is written to `part`, the later `path`."""
    import imageio_ffmpeg
    import mediapy

    codec = _CODECS[path.suffix.lower()]
    quality = 20 if codec == "h264" else None
    with _failures(path, part):
        mediapy.set_ffmpeg(imageio_ffmpeg.get_ffmpeg_exe())
        extra = _GIF if codec == "gif" else _QUICK
        writer = mediapy.VideoWriter(
            part, shape, fps=fps, codec=codec, qp=quality, ffmpeg_args=extra
        ).__enter__()

    def add(frame: np.ndarray) -> None:
        with _failures(path, part):
            writer.add_image(frame)

    try:
        yield add
    finally:
        with _failures(path, part):
            writer.close()


@contextlib.contextmanager
def _failures(path: Path, part: Path) -> Iterator[None]:
    """Raise UserError if ffmpeg is missing, was terminated, or cannot write `part`."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        text = storage.reason(error) if isinstance(error, OSError) else str(error)
        last = text.removeprefix(f"Error writing '{part}': ").strip().rpartition("\n")[2].rpartition(": ")[2]
        ended = isinstance(error, BrokenPipeError) or not last
        reason = _ENDED if ended else last[0].lower() + last[1:]
        raise UserError(f"cannot write {path}: {reason}") from error
