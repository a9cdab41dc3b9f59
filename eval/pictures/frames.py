"""Videos and stroboscopic pictures of recorded flights."""

from __future__ import annotations

import contextlib
import itertools
import pathlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from PIL import Image

from inclined_landing.envs.flights import Flight, Track
from inclined_landing.envs.mission import Mission
from inclined_landing.envs.rendering import Ghost, make_renderer, pose_on, qpos_of_state
from inclined_landing.eval.pictures.labels import CUT, Label, draw_labels, ended, tempo
from inclined_landing.eval.pictures.legs import along, named
from inclined_landing.eval.pictures.to_rest import Landing
from inclined_landing.eval.pictures.way import progress, spread_copies
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError

FPS = 50.0  # one frame for every control step
_CODECS = {".mp4": "h264", ".gif": "gif"}
_SPACING = 0.13  # m; copies in a strobe picture are at least this apart
_EARLY, _LATE = np.array([0.30, 0.05, 0.62]), np.array([0.98, 0.62, 0.20])  # along a strobe picture


def scene_of(flight: Track, k: int):
    """What the renderers are given for sample k: where vehicle and platform are, or that there is none."""
    deck = None if flight.deck is None else flight.deck[k]
    return pose_on(flight.state[k], deck, based=flight.motion is None)


def caption_of(flight: Track, k: int) -> str:
    """The line under frame k."""
    s, pwm = flight.state[k], flight.commands[k, 0]
    planar = np.abs(flight.state[:, 1]).max() < 0.01
    across = "" if planar else f"y {s[1]:+5.2f}  "
    return (
        f"t {flight.t[k]:4.2f} s   x {s[0]:+5.2f}  {across}z {s[2]:4.2f} m   "
        f"pitch {np.degrees(s[7]):+6.1f} deg   PWM {pwm:6.0f}"
    )


def said(flight: Flight | Mission, k: int) -> list[Label]:
    """The labels of sample k: which leg is flown, are the motors cut, how did the flight end."""
    last = k == len(flight.t) - 1
    if isinstance(flight, Mission):
        return [named(flight, k), *([ended(flight.words, flight.success)] if last else [])]
    if isinstance(flight, Landing) and k >= flight.cut:
        settled = k >= flight.settled
        return [ended(flight.ending, flight.at_rest) if settled else CUT]
    return [ended(flight.task.flight_words(flight), flight.success)] if last else []


def render_flight(
    flight: Flight | Mission,
    *,
    camera: str = "arena",
    width: int = 640,
    height: int = 480,
    backend: str = "auto",
    fps: float = FPS,
    slow: float = 1.0,
    title: str | None = None,
    renderer: Any = None,
) -> Iterator[np.ndarray]:
    """Frames (height, width, 3) uint8, `fps` of them for a second of flight.

    slow: how much slower they will be shown, which is said in the picture; so is how the flight ended, and
    what it is called, where it has a title.
    renderer: draw with this one, made for the same look, and leave it open: it keeps its background.
    """
    times = np.arange(flight.t[0], flight.t[-1] + 0.5 / fps, 1.0 / fps)
    frames = np.minimum(np.searchsorted(flight.t, times - 1e-9), len(flight.t) - 1)
    close = camera in ("closeup", "onboard")
    ghosts = (
        [] if close or flight.motion is not None else [Ghost(qpos_of_state(goal)) for goal in flight.goals]
    )
    colours = along(flight) if isinstance(flight, Mission) else None
    with _opened(renderer, flight, width, height, camera, backend) as drawing:
        for k in frames:
            frame = drawing.render(
                scene_of(flight, k),
                trail=None if close else flight.state[: k + 1],
                trail_colour=None if colours is None else colours[: k + 1],
                ghosts=ghosts,
                caption=caption_of(flight, k),
            )
            title_label: list[Label] = [] if title is None else [(title, None)]
            draw_labels(frame, title_label + tempo(slow) + said(flight, k))
            yield frame


def _opened(renderer, flight: Track, *look):
    """Context of a renderer: of the given one, which stays open, or of a new one for this look."""
    if renderer is not None:
        return contextlib.nullcontext(renderer)
    return make_renderer(*look, vehicle=flight.task.vehicle)


def strobe(
    flight: Track,
    *,
    camera: str = "hero",
    width: int = 1280,
    height: int = 720,
    copies: int = 10,
    backend: str = "auto",
    renderer: Any = None,
) -> np.ndarray:
    """One picture of the whole flight: copies of the vehicle along its way, the last one solid.

    At most `copies` before the last, coloured from early (violet) to late (orange), a mission's by leg.
    renderer: as in `render_flight`.
    """
    chosen = spread_copies(flight.state, copies + 1, _SPACING)[:-1]
    colours = _EARLY + progress(flight.state)[:, None] * (_LATE - _EARLY)
    if isinstance(flight, Mission):
        colours = along(flight)
    ghosts = [
        Ghost(qpos_of_state(flight.state[k]), tuple(colours[k]), alpha=0.8, tint=0.7, shadow=True)
        for k in chosen
    ]
    with _opened(renderer, flight, width, height, camera, backend) as drawing:
        return drawing.render(
            scene_of(flight, -1),
            trail=flight.state,
            trail_colour=colours,
            ghosts=ghosts,
        )


def write_picture(path: pathlib.Path, picture: np.ndarray) -> pathlib.Path:
    """Write a picture (h, w, 3) uint8 to a .png file, whole or not at all; returns its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with storage.atomic(path) as part:
        Image.fromarray(picture).save(part)
    return path


def write_video(path, frames, fps: float = FPS) -> pathlib.Path:
    """Write frames (h, w, 3) uint8 to an .mp4 or .gif file; returns its path.

    The file appears under its name when it is complete. Raises UserError for another suffix and for
    no frames.
    """
    path = pathlib.Path(path)
    write_videos({path: 1}, frames, fps)
    return path


def write_videos(every: Mapping[pathlib.Path, int], frames, fps: float = FPS) -> None:
    """The same in several files, as long as each other: by file, every how many-th of the frames it has."""
    for path in every:
        if path.suffix.lower() not in _CODECS:
            raise UserError(f"a video is an .mp4 or .gif file, not {path.name!r}")
    frames = iter(frames)
    first = next(frames, None)
    if first is None:
        raise UserError(f"no frames for {' and '.join(path.name for path in every)}")
    import imageio_ffmpeg
    import mediapy

    mediapy.set_ffmpeg(imageio_ffmpeg.get_ffmpeg_exe())
    with contextlib.ExitStack() as opened:
        writers = []
        for path, step in every.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            part = opened.enter_context(storage.atomic(path))
            codec = _CODECS[path.suffix.lower()]
            quality = 20 if codec == "h264" else None
            writer = mediapy.VideoWriter(part, first.shape[:2], fps=fps / step, codec=codec, qp=quality)
            writers.append((opened.enter_context(writer), step))
        for k, frame in enumerate(itertools.chain([first], frames)):
            for writer, step in writers:
                if k % step == 0:
                    writer.add_image(frame)
