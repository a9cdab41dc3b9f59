"""Operations on images: edges, dilation, blur, interpolation."""

from __future__ import annotations

import numpy as np


def edges(label: np.ndarray, reach: int = 1) -> np.ndarray:
    """Return a mask (h, w) of pixels whose neighbourhood holds more than one label."""
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
