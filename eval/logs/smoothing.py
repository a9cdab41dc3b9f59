"""Smoothing of evenly sampled values, and their derivatives.

`scipy.signal` has the same filters; its import takes as long as reading twenty logs.
"""

from __future__ import annotations

import functools
import itertools

import numpy as np
from numpy.polynomial.polynomial import polyder, polyvander
from scipy.ndimage import correlate1d


@functools.cache
def polynomial_weights(rows: int, degree: int, derivative: int = 0, dt: float = 1.0) -> np.ndarray:
    """Return the weights (rows, rows) of samples `dt` apart in the derivative, at each of them, of their fit.

    The fit is a polynomial by least squares; derivative: its order.
    """
    # y = V c at the places s = t/h from -1 to 1:  c = V^+ y,  d^n y/dt^n = h^-n sum_k c_k (s^k)^(n)
    half = 0.5 * (rows - 1)
    places = (np.arange(rows) - half) / half
    fit = polyder(np.linalg.pinv(polyvander(places, degree)), derivative)
    return polyvander(places, degree - derivative) @ fit / (half * dt) ** derivative


def smoothed(values: np.ndarray, rows: int, degree: int, derivative: int = 0, dt: float = 1.0) -> np.ndarray:
    """Return the derivative of values (m,) or (m, k), smoothed by the filter of Savitzky and Golay.

    Each is that of the polynomial through the odd number of `rows` around it; at both ends, of the last one.
    """
    weights, half = polynomial_weights(rows, degree, derivative, dt), rows // 2
    result = correlate1d(np.asarray(values, float), weights[half], axis=0)
    result[:half] = weights[:half] @ values[:rows]
    result[-half:] = weights[-half:] @ values[-rows:]
    return result


def lagged(values: np.ndarray, keep: float) -> np.ndarray:
    """Return values (m,) through a first-order lag, at first steady; keep: exp(-step/time constant)."""
    return np.array(list(itertools.accumulate(values.tolist(), lambda y, x: keep * y + (1.0 - keep) * x)))
