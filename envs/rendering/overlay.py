"""Overlays of a picture: polylines with depth test, and the caption bar."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import numpy as np

from inclined_landing.envs.rendering.camera import View
from inclined_landing.models.base.errors import optional

_BIAS = 0.004  # m; a line this much behind a surface still shows
TRAIL = np.array([0.88, 0.16, 0.11])
_SMALLEST = 7  # pixels, of letters
_TEXT = np.array([0.08, 0.12, 0.22], np.float32)
_BAR, _BAR_COLOUR = 0.78, np.float32([0.97, 0.98, 1.0])  # opacity and colour of the caption bar


@dataclasses.dataclass
class Canvas:
    """A part of the picture: colour (h, w, 3) and depth (h, w), its corner at (column, row)."""

    colour: np.ndarray
    depth: np.ndarray
    column: int
    row: int

    def blend(self, index: np.ndarray, rgb: np.ndarray, alpha: np.ndarray) -> None:
        """Blend colours (n, 3), weighted by alpha (n,), over the pixels of flat `index` (n,)."""
        flat = self.colour.reshape(-1, 3)
        old = flat[index]
        flat[index] = old + alpha[:, None] * (rgb - old)


def draw_polyline(canvas: Canvas, view: View, points, *, width, colour, alpha=1.0) -> None:
    """Draw a smooth line through points (k, 3) [m], hidden where the canvas is nearer.

    width: pixels, a number or (k,); colour: (3,) or (k, 3) in 0..1; alpha: a number or (k,).
    """
    points = np.asarray(points, float)
    k = len(points)
    if k < 2:
        return
    pixel, depth = view.project(points)
    values = np.column_stack(
        [
            pixel,
            depth,
            np.broadcast_to(np.asarray(width, float), (k,)),
            np.broadcast_to(np.asarray(colour, float), (k, 3)),
            np.broadcast_to(np.asarray(alpha, float), (k,)),
        ]
    )
    in_front = depth > 1e-3
    values, pixel = values[in_front], pixel[in_front]
    if len(values) < 2:
        return
    height, breadth = canvas.depth.shape
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(pixel, axis=0).T))])
    if length[-1] > 20 * (view.width + view.height):
        return  # seen from within: nothing sensible to draw
    along = np.linspace(0.0, length[-1], max(int(2.0 * length[-1]), 2))
    samples = np.column_stack([np.interp(along, length, value) for value in values.T])
    reach = int(np.ceil(0.5 * samples[:, 3].max() + 0.5))
    base = np.floor(samples[:, :2]).astype(int)
    span = np.arange(-reach, reach + 1)
    column = base[:, 0, None, None] + span[None, None, :]
    row = base[:, 1, None, None] + span[None, :, None]
    distance = np.hypot(column + 0.5 - samples[:, 0, None, None], row + 0.5 - samples[:, 1, None, None])
    cover = np.clip(0.5 * samples[:, 3, None, None] + 0.5 - distance, 0.0, 1.0)
    column, row = column - canvas.column, row - canvas.row
    inside = (column >= 0) & (column < breadth) & (row >= 0) & (row < height) & (cover > 0)
    sample, i, j = np.nonzero(inside)
    index = row[sample, i, 0] * breadth + column[sample, 0, j]
    cover = cover[inside]
    visible = samples[sample, 2] < canvas.depth.reshape(-1)[index] + _BIAS
    sample, index, cover = sample[visible], index[visible], cover[visible]
    best = np.zeros(height * breadth)
    np.maximum.at(best, index, cover)
    owner = np.zeros(height * breadth, int)
    winner = cover == best[index]
    owner[index[winner]] = sample[winner]
    touched = np.flatnonzero(best)
    chosen = samples[owner[touched]]
    canvas.blend(touched, chosen[:, 4:7], best[touched] * chosen[:, 7])


def font_file(name: str) -> Path:
    """Return the file of a DejaVu font, which comes with matplotlib."""
    with optional():
        import matplotlib

    return Path(matplotlib.get_data_path()) / "fonts" / "ttf" / f"{name}.ttf"


@functools.lru_cache(maxsize=8)
def _font(size: int):
    with optional():
        from PIL import ImageFont

    return ImageFont.truetype(font_file("DejaVuSansMono"), size)


@functools.lru_cache(maxsize=64)
def _text_mask(text: str, size: int, width: int, height: int, right: bool) -> np.ndarray:
    """Return the coverage (height, width) in 0..1 of one line of text."""
    with optional():
        from PIL import Image, ImageDraw

    image = Image.new("L", (width, height))
    x = width - 10 if right else 10
    ImageDraw.Draw(image).text(
        (x, height / 2), text, fill=255, font=_font(size), anchor="rm" if right else "lm"
    )
    return np.asarray(image, np.float32) / 255.0


def caption_height(height: int) -> int:
    """Return the rows of the caption bar in a picture of `height` rows."""
    return max(18, round(0.056 * height))


def draw_caption(frame: np.ndarray, text: str, note: str = "") -> None:
    """Write `text` on a bar at the bottom of frame (h, w, 3) uint8, and `note` at the right if it fits."""
    height, width = frame.shape[:2]
    bar = caption_height(height)
    size = max(9, round(0.036 * height))
    if 0.602 * _SMALLEST * (len(text) + len(note) + 3) > width - 20:
        note = ""
    columns = len(text) + (len(note) + 3 if note else 0)
    while size > _SMALLEST and columns * 0.602 * size > width - 20:
        size -= 1
    cover = _text_mask(text, size, width, bar, False)
    if note:
        cover = np.maximum(cover, 0.6 * _text_mask(note, size, width, bar, True))
    strip = frame[height - bar :]
    colour = strip.astype(np.float32) * ((1.0 - _BAR) / 255.0) + _BAR * _BAR_COLOUR
    colour += cover[:, :, None] * (_TEXT - colour)
    strip[:] = (colour * 255.0 + 0.5).astype(np.uint8)
