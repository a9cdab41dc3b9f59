"""Filters of evenly logged values.

They are a few lines each, whereas importing `scipy.signal` takes longer than a log takes to read.
"""

from __future__ import annotations

import math

import numpy as np

from inclined_landing.models.compiled import kernel


def polynomial_weights(rows: int, order: int, derivative: int = 0, step: float = 1.0) -> np.ndarray:
    """Return the weights (rows, rows) of a least-squares polynomial through rows `step` apart.

    Row k holds those of the polynomial's derivative at row k (Savitzky and Golay 1964).
    """
    # p(t) = sum_k c_k t^k,  c = V^+ y:   d^n p/dt^n = sum_k k!/(k - n)! c_k t^(k - n)
    t = np.arange(rows) - 0.5 * (rows - 1)
    fit = np.linalg.pinv(np.vander(t, order + 1, increasing=True))
    weights = np.zeros((rows, rows))
    for k in range(derivative, order + 1):
        weights += math.perm(k, derivative) * np.outer(t ** (k - derivative), fit[k])
    return weights / step**derivative


def smoothed(values: np.ndarray, rows: int, order: int, derivative: int = 0, step: float = 1.0) -> np.ndarray:
    """Return values (m, ...) or a derivative of theirs, by polynomials through `rows` rows (odd) about each.

    At the ends it is the polynomial through the first or last of these.
    """
    weights, half = polynomial_weights(rows, order, derivative, step), rows // 2
    windows = np.lib.stride_tricks.sliding_window_view(values, rows, axis=0)
    result = np.empty(np.shape(values))
    result[half : len(values) - half] = windows @ weights[half]
    result[:half] = np.tensordot(weights[:half], values[:rows], axes=1)
    result[len(values) - half :] = np.tensordot(weights[half + 1 :], values[len(values) - rows :], axes=1)
    return result


@kernel
def low_passed(values, share):
    """Return values (m,) behind a first-order lag that keeps a share of itself from row to row.

    It begins at rest at the first value.
    """
    out, lagged = np.empty(len(values)), values[0]
    for k in range(len(values)):
        lagged = share * lagged + (1.0 - share) * values[k]
        out[k] = lagged
    return out
