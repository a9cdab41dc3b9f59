"""Slow-motion videos of a touchdown with contact forces as arrows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from inclined_landing.envs.rendering import View, look_at, make_renderer, pose_from_state
from inclined_landing.eval.pictures.labels import draw_labels, speed_label
from inclined_landing.eval.pictures.touchdown import Touchdown
from inclined_landing.models import surface

_LONGEST = 0.10  # m per unit of the vehicle's drawn scale: length of the strongest force's arrow
_FROM = np.array([-0.10, -0.42, 0.13])  # m, where the "touch" camera stands beside the vehicle
_AIM = 0.025  # m over the vehicle that it looks at


def render_touchdowns(
    touchdowns: Sequence[Touchdown],
    *,
    every: int = 1,
    slow: float = 1.0,
    camera: str = "touch",
    width: int = 640,
    height: int = 480,
    backend: str = "auto",
) -> Iterator[tuple[np.ndarray, bool]]:
    """Yield frames (height, width, 3) uint8 of touchdowns in sequence, one for `every` engine steps.

    slow: slow-down factor, which a label in the picture states.
    camera: one of the scene's, or "touch": fixed, close to the touchdown (rays only). Each frame comes
    with whether it is the last of its touchdown. All share one scale of forces.
    """
    largest_force = max(touchdown.largest_force for touchdown in touchdowns)
    for touchdown in touchdowns:
        close = camera == "touch"
        look, scale = _touchdown_view(touchdown, width, height) if close else camera, 1.0 if close else None
        with make_renderer(width, height, look, backend, vehicle=touchdown.vehicle, scale=scale) as renderer:
            metres_per_newton = _LONGEST * renderer.scale / largest_force
            frames = range(0, len(touchdown.t), every)
            for k in frames:
                frame = renderer.render(
                    pose_from_state(touchdown.state[k], touchdown.platform[k]),
                    forces=list(zip(touchdown.points[k], metres_per_newton * touchdown.forces[k])),
                    caption=caption(touchdown, k),
                )
                draw_labels(frame, speed_label(slow) + touchdown.labels(k))
                yield frame, k == frames[-1]


def _touchdown_view(touchdown: Touchdown, width: int, height: int) -> View:
    """Return a view from the side and slightly above, at the first contact and the final place."""
    first = next(k for k, force in enumerate(touchdown.forces) if len(force))
    middle = 0.5 * (touchdown.state[first, :3] + touchdown.state[-1, :3])
    target = middle + _AIM * surface.normals(touchdown.platform[first : first + 1])[0]
    return look_at(middle + _FROM, target, width, height, fovy=33.0)


def caption(touchdown: Touchdown, k: int) -> str:
    """Return the caption of the frame of step k."""
    normal, tangential = touchdown.net_forces[k]
    weights = normal / touchdown.weight
    return (
        f"t {touchdown.t[k]:5.3f} s   normal force {normal:4.2f} N = {weights:3.1f} weights   "
        f"friction {tangential:4.2f} N   PWM {touchdown.commands[k, 0]:6.0f}"
    )
