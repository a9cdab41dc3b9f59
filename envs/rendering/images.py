"""Operations on images: edges, dilation, blur, interpolation, boxes of pixels."""

from __future__ import annotations

import numpy as np

from inclined_landing.envs.rendering.camera import View

_NEAR = 0.005  # m; what is nearer to the camera is not projected


def edges(label: np.ndarray, reach: int = 1) -> np.ndarray:
    """Return a mask (h, w) of pixels whose neighbourhood contains more than one label."""
    mask = np.zeros(label.shape, bool)
    across, down = label[:, 1:] != label[:, :-1], label[1:] != label[:-1]
    mask[:, 1:] |= across
    mask[:, :-1] |= across
    mask[1:] |= down
    mask[:-1] |= down
    for _ in range(reach - 1):
        mask = dilated(mask)
    return mask


def dilated(mask: np.ndarray) -> np.ndarray:
    """Return the mask (h, w) dilated to its eight neighbours."""
    wide = mask.copy()
    wide[:, 1:] |= mask[:, :-1]
    wide[:, :-1] |= mask[:, 1:]
    tall = wide.copy()
    tall[1:] |= wide[:-1]
    tall[:-1] |= wide[1:]
    return tall


def box_blur(image: np.ndarray, radius: int) -> np.ndarray:
    """Return the image blurred twice by a square of 2 radius + 1 pixels."""
    for _ in range(2):
        for axis in (0, 1):
            pad = [(0, 0), (0, 0)]
            pad[axis] = (radius + 1, radius)
            total = np.cumsum(np.pad(image, pad), axis=axis, dtype=np.float64)
            n = total.shape[axis]
            high = np.take(total, range(2 * radius + 1, n), axis=axis)
            low = np.take(total, range(0, n - 2 * radius - 1), axis=axis)
            image = ((high - low) / (2 * radius + 1)).astype(np.float32)
    return image


def bilinear(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the image (h, w) interpolated at columns x (n,) and rows y (n,)."""
    h, w = image.shape
    x, y = np.clip(x, 0, w - 1.001), np.clip(y, 0, h - 1.001)
    i, j = x.astype(int), y.astype(int)
    a, b = x - i, y - j
    top = image[j, i] * (1 - a) + image[j, i + 1] * a
    bottom = image[j + 1, i] * (1 - a) + image[j + 1, i + 1] * a
    return top * (1 - b) + bottom * b


def bounding_box(
    view: View, points: np.ndarray, margin: float, radius: float | np.ndarray = 0.0
) -> tuple[int, int, int, int] | None:
    """Return the box (c0, r0, c1, r1) in the picture around spheres, or None outside it.

    points (n, 3) and radius [m]; the box is `margin` pixels wider.
    """
    pixel, depth = view.project(points)
    if depth.min() < _NEAR:
        return (0, 0, view.width, view.height) if depth.max() > _NEAR else None
    reach = (radius / view.pixel_size(depth) + margin)[:, None]
    low, high = np.floor((pixel - reach).min(axis=0)), np.ceil((pixel + reach).max(axis=0))
    c0, r0 = max(int(low[0]), 0), max(int(low[1]), 0)
    c1, r1 = min(int(high[0]), view.width), min(int(high[1]), view.height)
    return (c0, r0, c1, r1) if c1 > c0 and r1 > r0 else None
