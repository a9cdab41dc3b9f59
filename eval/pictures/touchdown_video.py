"""Slow-motion videos of a touchdown: contact forces as arrows, the normal force over time in a panel."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from PIL import Image, ImageDraw

from inclined_landing.envs.rendering import View, look_at, make_renderer, pose_from_state
from inclined_landing.envs.rendering.overlay import FORCE, arrow_outline, arrow_width
from inclined_landing.eval.pictures.labels import draw_labels, font, speed_label
from inclined_landing.eval.pictures.touchdown import Touchdown
from inclined_landing.models import surface

_LONGEST = 0.10  # m per unit of the vehicle's drawn scale: length of the strongest force's arrow
_FROM = np.array([-0.10, -0.42, 0.13])  # m, where the "touch" camera stands beside the vehicle
_AIM = 0.025  # m over the vehicle that it looks at
_FINE = 3  # the gauge is drawn this much larger and resampled
_INK, _MUTED, _PANEL = (20, 31, 56), (104, 117, 140), (250, 251, 255)
_RED = tuple(int(255 * c) for c in FORCE)


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
            gauge = Gauge(touchdown, renderer, metres_per_newton)
            frames = range(0, len(touchdown.t), every)
            for k in frames:
                frame = renderer.render(
                    pose_from_state(touchdown.state[k], touchdown.platform[k]),
                    forces=list(zip(touchdown.points[k], metres_per_newton * touchdown.forces[k])),
                    caption=caption(touchdown, k),
                )
                gauge.draw(frame, k)
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


class Gauge:
    """A panel in the upper left corner: net normal force over time, its value at rest, the scale of the
    arrows.
    """

    def __init__(self, touchdown: Touchdown, renderer, metres_per_newton: float):
        self._t, self._force = touchdown.t, touchdown.net_forces[:, 0]
        unit = _FINE * min(renderer.width / 960, renderer.height / 540)
        self._unit = unit
        self._size = round(300 * unit), round(180 * unit)
        self._at = (round(16 * unit / _FINE),) * 2
        self._top = _nice(float(self._force.max()), up=True)
        view = renderer.view(pose_from_state(touchdown.state[-1], touchdown.platform[-1]))
        depth = view.project(touchdown.state[-1:, :3])[1]
        self._pixels_per_newton = metres_per_newton / float(view.pixel_size(depth)[0])
        self._shaft = arrow_width(renderer.height)
        self._back = self._draw_back(touchdown.weight * surface.normals(touchdown.platform[-1:])[0, 2])

    def _point(self, t: float, force: float) -> tuple[float, float]:
        """Return the panel coordinates of time [s] and force [N]."""
        w, h = self._size
        u = self._unit
        left, right, top, bottom = 44 * u, w - 14 * u, 58 * u, h - 30 * u
        share = (t - self._t[0]) / (self._t[-1] - self._t[0])
        return left + share * (right - left), bottom - force / self._top * (bottom - top)

    def _draw_back(self, rest: float) -> Image.Image:
        (w, h), u = self._size, self._unit
        panel = Image.new("RGB", (w, h), _PANEL)
        pen = ImageDraw.Draw(panel)
        pen.text((14 * u, 19 * u), "net normal force", fill=_INK, font=font(round(14 * u)), anchor="lm")
        newton = _nice(80 * u / _FINE / self._pixels_per_newton, up=False)
        length, right = _FINE * newton * self._pixels_per_newton, w - 14 * u
        arrow = arrow_outline((right - length, 25 * u), (right, 25 * u), _FINE * self._shaft)
        pen.polygon([tuple(corner) for corner in arrow], fill=_RED)
        label = f"{newton:g} N"
        pen.text((right - 0.5 * length, 12 * u), label, fill=_INK, font=font(round(12.5 * u)), anchor="mm")
        for force in (0.0, 0.5 * self._top, self._top):
            (x0, y), (x1, _) = self._point(self._t[0], force), self._point(self._t[-1], force)
            pen.line([(x0, y), (x1, y)], fill=(222, 227, 236), width=round(u))
            label = f"{force:g}" + (" N" if force == self._top else "")
            pen.text((x0 - 5 * u, y), label, fill=_MUTED, font=font(round(12.5 * u)), anchor="rm")
        (x0, y), (x1, _) = self._point(self._t[0], rest), self._point(self._t[-1], rest)
        for left, right, height in ((x0, x1, y), (14 * u, 34 * u, 38 * u)):
            for x in np.arange(left, right, 8 * u):
                pen.line([(x, height), (min(x + 4 * u, right), height)], fill=_MUTED, width=round(1.2 * u))
        pen.text((40 * u, 38 * u), "m g cos α", fill=_MUTED, font=font(round(12.5 * u)), anchor="lm")
        span = f"{self._t[-1] - self._t[0]:.2f} s"
        pen.text((x1, h - 14 * u), span, fill=_MUTED, font=font(round(12.5 * u)), anchor="rm")
        pen.text((x0, h - 14 * u), "time", fill=_MUTED, font=font(round(12.5 * u)), anchor="lm")
        return panel

    def draw(self, frame: np.ndarray, k: int) -> None:
        """Draw the panel of step k onto frame (h, w, 3) uint8."""
        u = self._unit
        panel = self._back.copy()
        pen = ImageDraw.Draw(panel)
        line = [self._point(t, force) for t, force in zip(self._t[: k + 1], self._force[: k + 1])]
        if len(line) > 1:
            pen.line(line, fill=_RED, width=round(2.2 * u), joint="curve")
        x, y = line[-1]
        r = 4 * u
        pen.ellipse([x - r, y - r, x + r, y + r], fill=_RED, outline=_PANEL, width=round(1.2 * u))
        width, height = self._size[0] // _FINE, self._size[1] // _FINE
        small = np.asarray(panel.resize((width, height), Image.Resampling.LANCZOS), float)
        part = frame[self._at[1] : self._at[1] + height, self._at[0] : self._at[0] + width]
        part[:] = (0.1 * part + 0.9 * small + 0.5).astype(np.uint8)


def _nice(value: float, up: bool) -> float:
    """Return the nearest of 1, 2, 5 times a power of ten that is not below, or not above, `value`."""
    power = 10.0 ** math.floor(math.log10(value))
    steps = [step * power for step in (1.0, 2.0, 5.0, 10.0)]
    return next(step for step in steps if step >= value) if up else max(s for s in steps if s <= value)
