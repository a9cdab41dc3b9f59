"""Films of flights, one after the other."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from inclined_landing.envs.flights import Flight
from inclined_landing.envs.mission import Mission
from inclined_landing.envs.rendering.renderer import SceneRenderer
from inclined_landing.envs.shared.progress import Tick, stages
from inclined_landing.eval.pictures.frames import render_flight, write_videos
from inclined_landing.models.base.errors import UserError

_REST = 1.0  # s that the last frame of a flight stays


def film(
    flights: Sequence[Flight | Mission], renderer: SceneRenderer, sampled: float, slow: float
) -> tuple[Iterator[np.ndarray], int, float]:
    """Return the frames of one vehicle's flights in sequence, their number, and the video's rate [1/s].

    sampled: frames per second of flight. The last frame of each flight is held for a moment.
    """
    rest = round(_REST * sampled / slow)

    def frames():
        for flight in flights:
            for frame in render_flight(flight, renderer, fps=sampled, slow=slow):
                yield frame
            yield from itertools.repeat(frame, rest)

    total = sum(round(flight.t[-1] * sampled) + 1 + rest for flight in flights)
    return frames(), total, sampled / slow


def write(files: Mapping[Path, int], frames: Iterator[np.ndarray], total: int, rate: float) -> None:
    """Write the videos, each with every n-th frame, and show a progress bar on stderr."""
    names = " and ".join(str(path) for path in files)

    def ticking(tick: Tick) -> Iterator[np.ndarray]:
        for frame in frames:
            tick(names)
            yield frame

    with stages(total, "frames") as tick:
        try:
            write_videos(files, ticking(tick), fps=rate)
        except OSError as error:
            raise UserError(f"cannot write {names}: {(error.strerror or str(error)).lower()}") from error
