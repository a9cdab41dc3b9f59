"""Starts in the form of the command line, X,Z or X,Y,Z, and the usual starts of films and figures."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from inclined_landing.envs.tasks import Task, hover_states
from inclined_landing.envs.tasks.frozen import PAPER_STARTS
from inclined_landing.models.attitude import STATE_NAMES, X, Y, Z
from inclined_landing.models.base.errors import UserError, shown

Point = tuple[float, ...]  # x, z or x, y, z, m
_PLANAR = (PAPER_STARTS[2], PAPER_STARTS[0], PAPER_STARTS[1])
_IN_SPACE = ((1.5, 0.6, 1.8), (0.0, -0.8, 2.0), (-1.5, 0.3, 1.6))


def axes_of(task: Task) -> str:
    """Return the axes of the coordinates of a start: those along which the vehicle moves."""
    return "xz" if task.is_planar else "xyz"


def usual_starts(task: Task) -> tuple[Point, ...]:
    """Return the starts of films; the first one is that of a picture.

    Those of landings in the plane are the paper's, those of a task without a platform its first evaluated
    ones, to the centimetre.
    """
    if task.has_platform:
        return _PLANAR if task.is_planar else _IN_SPACE
    states = next(iter(task.evaluation_groups(0).values())).state[:3]
    columns = [STATE_NAMES.index(name) for name in axes_of(task)]
    return tuple(tuple(map(float, point)) for point in states[:, columns].round(2))


def parse_starts(texts: Sequence[str], task: Task) -> list[Point]:
    """Return the points of --start; raises UserError unless each is in the arena and free."""
    return [_parsed(text, task) for text in texts]


def start_words(task: Task, state: np.ndarray) -> str:
    """Return the position of a state (13,) in the form of a start."""
    return ", ".join(f"{name} {state[STATE_NAMES.index(name)]:g}" for name in axes_of(task)) + " m"


def read_point(text: str, option: str, axes: str, like: str = "") -> Point:
    """Return the coordinates along `axes` [m] in an option; like: an example for the message."""
    try:
        point = tuple(float(number) for number in text.split(","))
    except ValueError:
        point = ()
    if len(point) != len(axes) or not all(map(math.isfinite, point)):
        form = ",".join(axes).upper()
        raise UserError(
            f"--{option} must be {form} in metres{like and f', like {like}'}, not {shown(text)!r}"
        )
    return point


def _parsed(text: str, task: Task) -> Point:
    axes, example = axes_of(task), ",".join(f"{number:g}" for number in usual_starts(task)[0])
    point = read_point(text, "start", axes, example)
    for name, value in zip(axes, point):
        low, high = getattr(task.vehicle, f"arena_{name}")
        if not low < value < high:
            room = f"{name} must be between {low:g} and {high:g} m"
            raise UserError(f"--start {text} lies outside the arena: {room}")
    state = hover_states([point], task.vehicle)
    inside = task.has_platform and _in_platform(state[0], task)
    if inside or task.start_clearance(task.start(state))[0] <= 0.0:
        written = ",".join(f"{number:g}" for number in point)
        raise UserError(f"--start {written} lies inside the platform")
    return point


def _in_platform(state: np.ndarray, task: Task) -> bool:
    """Return whether a state (13,) is in the slab of a task's platform or in the space under it."""
    v, cos, sin = task.vehicle, math.cos(task.azimuth), math.sin(task.azimuth)
    x, y = cos * state[X] + sin * state[Y], cos * state[Y] - sin * state[X]
    z = state[Z] - v.platform_surface_height
    sin, cos = math.sin(task.inclination), math.cos(task.inclination)
    along, height = x * cos - z * sin, x * sin + z * cos  # of the slab's surface
    thick, half = v.platform_thickness, v.slab_half_length
    in_slab = abs(along) < half and -thick <= height < 0.0
    under = abs(x + thick * sin) < half * cos and height < -thick
    return bool((in_slab or under) and abs(y) < 0.5 * v.platform_depth)
