"""Smoothing by local polynomials (Savitzky and Golay); scipy.signal would take a second to import."""

from __future__ import annotations

import math

import numpy as np


def weights(length: int, order: int, place: int, deriv: int = 0, delta: float = 1.0) -> np.ndarray:
    """Return the weights (length,) of `length` rows in the derivative of their polynomial at row `place`.

    The polynomial of this order is fitted by least squares to rows `delta` apart.
    """
    # x(t) = sum_k c_k t^k with t = 0 at `place`; the derivative d there is d! c_d
    powers = np.vander(np.arange(length) - float(place), order + 1, increasing=True)
    return np.linalg.pinv(powers)[deriv] * (math.factorial(deriv) / delta**deriv)


def smoothed(values: np.ndarray, length: int, order: int, deriv: int = 0, delta: float = 1.0) -> np.ndarray:
    """Return the derivative of `values` (m, ...) smoothed over `length` rows, an odd number up to m.

    Rows nearer to an end than half of them have the polynomial of the first or last `length` rows.
    """
    if length % 2 == 0 or not order < length <= len(values):
        raise ValueError(
            f"{length} rows of {len(values)} cannot be smoothed by a polynomial of order {order}"
        )
    values = np.asarray(values, float)
    every = np.stack([weights(length, order, place, deriv, delta) for place in range(length)])
    half, windows = length // 2, np.lib.stride_tricks.sliding_window_view(values, length, axis=0)
    first, last = (np.tensordot(every, end, 1) for end in (values[:length], values[-length:]))
    return np.concatenate([first[:half], windows @ every[half], last[half + 1 :]])
