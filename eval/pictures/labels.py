"""Labels over a frame, in its upper right corner: playback speed, leg of a mission, state of the vehicle."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageColor, ImageDraw, ImageFont

from inclined_landing.envs.mission import LEGS, Mission
from inclined_landing.envs.rendering.overlay import font_file
from inclined_landing.eval.base.colours import BLUE, GREEN, INK, ORANGE, PURPLE

_FINE = 3  # labels are drawn this much larger and resampled
_PAPER, _RULE = "#fafbff", "#c3cedb"
Label = tuple[str, str | None]  # a text, and the colour of the dot before it or None
MOTORS_CUT: Label = ("motors cut", ORANGE)
LEG_COLOURS = (PURPLE, BLUE, ORANGE, GREEN)  # of LEGS, in all pictures of missions


def outcome_label(outcome: str, well: bool) -> Label:
    """Return the label of a flight's outcome, green for success."""
    return outcome, GREEN if well else ORANGE


def speed_label(slow: float) -> list[Label]:
    """Return the label of the playback speed; none at real time."""
    if slow == 1.0:
        return []
    return [(f"{slow:.3g}x slower" if slow > 1.0 else f"{1.0 / slow:.3g}x faster", None)]


def leg_label(mission: Mission, k: int) -> Label:
    """Return the label of the leg of row k, with its colour."""
    leg = mission.leg[k]
    policy = mission.plan.policies[max(leg - 1, 0)]
    return f"{LEGS[leg]}: policy {policy.name}", LEG_COLOURS[leg]


def leg_colours(mission: Mission) -> np.ndarray:
    """Return the leg colours (T, 3) of a mission's rows."""
    return np.array([ImageColor.getrgb(colour) for colour in LEG_COLOURS])[mission.leg] / 255.0


def draw_labels(frame: np.ndarray, labels: Sequence[Label]) -> None:
    """Draw labels, text with an optional coloured dot, below each other onto frame (h, w, 3) uint8."""
    height, width = frame.shape[:2]
    unit = min(width / 960, height / 540)
    margin = top = round(16 * unit)
    for text, colour in labels:
        label = _label(text, colour, max(9, round(17 * unit)), width - 2 * margin)
        h, w = label.shape[:2]
        part = frame[top : top + h, width - margin - w : width - margin]
        label = label[: len(part)]
        cover = label[..., 3:] / 255.0
        part[:] = (part + cover * (label[..., :3] - part) + 0.5).astype(np.uint8)
        top += h + round(6 * unit)


@functools.lru_cache(maxsize=32)
def _label(text: str, colour: str | None, size: int, widest: int) -> np.ndarray:
    """Return the picture (h, w, 4) of a label in letters of `size` pixels, smaller where it would be too
    wide.
    """
    dot = 0.0 if colour is None else 0.95
    while size > 7 and (length := font(size).getlength(text)) + (1.4 + dot) * size > widest:
        size -= 1
    length = min(font(size).getlength(text), widest - (1.4 + dot) * size)
    w, h = round(length + (1.4 + dot) * size), round(1.75 * size)
    picture = Image.new("RGBA", (_FINE * w, _FINE * h), (255, 255, 255, 0))
    pen, fine = ImageDraw.Draw(picture), _FINE * size
    box = [0, 0, _FINE * w - 1, _FINE * h - 1]
    pen.rounded_rectangle(box, 0.45 * fine, fill=_PAPER, outline=_RULE, width=_FINE)
    if colour is not None:
        x, y, r = 1.0 * fine, 0.5 * _FINE * h, 0.3 * fine
        pen.ellipse([x - r, y - r, x + r, y + r], fill=colour)
    at = ((0.7 + dot) * fine, 0.5 * _FINE * h)
    pen.text(at, text, fill=INK, font=font(fine), anchor="lm")
    return np.asarray(picture.resize((w, h), Image.Resampling.BOX), float)


@functools.lru_cache(maxsize=32)
def font(size: int):
    """Return the font of all overlays, `size` pixels high."""
    return ImageFont.truetype(font_file("DejaVuSans"), size)
