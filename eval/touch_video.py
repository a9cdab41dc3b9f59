"""Slow pictures of a touchdown: contact forces as arrows, the normal force over time in a gauge."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from inclined_landing.envs.rendering import make_renderer
from inclined_landing.envs.rendering.overlay import FORCE
from inclined_landing.eval.touch import Touchdown
from inclined_landing.models.parameters import Vehicle, load_vehicle

_LONGEST = 0.10  # m per unit of the vehicle's drawn scale: length of the strongest force's arrow
_FINE = 3  # the gauge is drawn this much larger and resampled
_INK, _MUTED, _PANEL = (20, 31, 56), (104, 117, 140), (250, 251, 255)
_RED = tuple(int(255 * c) for c in FORCE)
_NICE = (1.0, 2.0, 5.0)


def render_touchdowns(
    touchdowns: list[Touchdown],
    *,
    every: int = 1,
    camera: str = "hero",
    width: int = 640,
    height: int = 480,
    backend: str = "auto",
    vehicle: Vehicle | None = None,
) -> Iterator[tuple[np.ndarray, bool]]:
    """Frames (height, width, 3) uint8 of touchdowns one after the other, one for `every` engine steps.

    With each frame: is it the last of its touchdown. All share one scale of forces.
    """
    vehicle = vehicle or load_vehicle()
    strongest = max(touchdown.strongest for touchdown in touchdowns)
    with make_renderer(width, height, camera, backend, vehicle=vehicle) as renderer:
        metres_per_newton = _LONGEST * renderer.scale / strongest
        for touchdown in touchdowns:
            gauge = Gauge(touchdown, width, height, vehicle)
            frames = [*range(0, len(touchdown.t), every)]
            for k in frames:
                frame = renderer.render(
                    touchdown.state[k],
                    inclination=touchdown.inclination,
                    forces=[
                        (point, metres_per_newton * force)
                        for point, force in zip(touchdown.points[k], touchdown.forces[k])
                    ],
                    caption=caption_of(touchdown, k, vehicle),
                )
                gauge.draw(frame, k)
                yield frame, k == frames[-1]


def caption_of(touchdown: Touchdown, k: int, vehicle: Vehicle) -> str:
    """The line under the frame of step k."""
    normal, tangential = touchdown.net[k]
    weights = normal / (vehicle.body_mass * vehicle.environment_gravity)
    return (
        f"t {touchdown.t[k]:5.3f} s   normal force {normal:4.2f} N = {weights:3.1f} weights   "
        f"friction {tangential:4.2f} N   PWM {touchdown.commands[k, 0]:6.0f}"
    )


class Gauge:
    """A panel in the upper left corner: net normal force until now, and what it is at rest."""

    def __init__(self, touchdown: Touchdown, width: int, height: int, vehicle: Vehicle):
        self._t, self._force = touchdown.t, touchdown.net[:, 0]
        unit = _FINE * min(width / 960, height / 540)
        self._unit = unit
        self._size = round(300 * unit), round(172 * unit)
        self._at = round(16 * unit / _FINE), round(16 * unit / _FINE)
        self._top = _nice_above(float(self._force.max()))
        rest = vehicle.body_mass * vehicle.environment_gravity * math.cos(touchdown.inclination)
        self._back = self._draw_back(rest)

    def _point(self, t: float, force: float) -> tuple[float, float]:
        """Where time [s] and force [N] are in the panel."""
        w, h = self._size
        u = self._unit
        left, right, top, bottom = 34 * u, w - 14 * u, 40 * u, h - 14 * u
        share = (t - self._t[0]) / (self._t[-1] - self._t[0])
        return left + share * (right - left), bottom - force / self._top * (bottom - top)

    def _draw_back(self, rest: float) -> Image.Image:
        (w, h), u = self._size, self._unit
        panel = Image.new("RGB", (w, h), _PANEL)
        pen = ImageDraw.Draw(panel)
        pen.text((14 * u, 18 * u), "net normal force", fill=_INK, font=_font(round(13.5 * u)), anchor="lm")
        for force in (0.0, 0.5 * self._top, self._top):
            (x0, y), (x1, _) = self._point(self._t[0], force), self._point(self._t[-1], force)
            pen.line([(x0, y), (x1, y)], fill=(222, 227, 236), width=round(u))
            label = f"{force:g}" + (" N" if force == self._top else "")
            pen.text((x0 - 5 * u, y), label, fill=_MUTED, font=_font(round(10.5 * u)), anchor="rm")
        (x0, y), (x1, _) = self._point(self._t[0], rest), self._point(self._t[-1], rest)
        for x in np.arange(x0, x1, 8 * u):
            pen.line([(x, y), (min(x + 4 * u, x1), y)], fill=_MUTED, width=round(1.2 * u))
        pen.text((x1, y - 8 * u), "m g cos α", fill=_MUTED, font=_font(round(10.5 * u)), anchor="rm")
        return panel

    def draw(self, frame: np.ndarray, k: int) -> None:
        """Put the panel as it is at step k over frame (h, w, 3) uint8."""
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


def _nice_above(value: float) -> float:
    """The smallest of 1, 2, 5 times a power of ten that is not below `value`."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(nice * power for nice in (*_NICE, 10.0) if nice * power >= value)


@functools.lru_cache(maxsize=8)
def _font(size: int):
    from matplotlib import font_manager

    return ImageFont.truetype(font_manager.findfont("DejaVu Sans"), size)
