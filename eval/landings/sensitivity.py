"""Shares of the variance of a result by each varied parameter, from the landings of a study alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from threadpoolctl import threadpool_limits

_BINS = 20  # of a parameter, at most; one of no more values has a bin for each
_LANDINGS = 10  # for each bin, at least
_BLOCKS = 20  # of landings that the jackknife leaves out in turn
_RIDGE = 1e-6  # landings; tells parts of collinear parameters apart, evenly


@threadpool_limits.wrap(limits=1, user_api="blas")  # on matrices so small a second thread only waits
def variance_shares(parameters: Sequence[np.ndarray], y: np.ndarray) -> np.ndarray | None:
    """Return the share of the variance of y (n,) of every parameter (n,), with its 95 % interval, (P, 3).

    y is fitted by a sum of functions of one parameter each, all together: what one of them shares with
    another is not counted twice, so that the shares sum to at most 1. The rest is interactions and chance. Of
    independent parameters these are the first-order Sobol indices; a share is negative where a parameter
    counteracts another that it is correlated with. Intervals are by a jackknife over blocks of landings.
    None: too few landings, or y is constant.
    """
    known = np.isfinite(y)
    y = y[known]
    most = min(_BINS, len(y) // (_LANDINGS * max(1, len(parameters))))
    if most < 2 or np.ptp(y) == 0.0:
        return None
    bins = [_bins(x[known], most) for x in parameters]
    columns = np.hstack([np.ones((len(y), 1)), *(b[:, None] == np.unique(b) for b in bins), y[:, None]])
    owner = np.concatenate([[-1], *(np.full(len(np.unique(b)), k) for k, b in enumerate(bins))])
    block = np.random.default_rng(0).permutation(len(y)) % _BLOCKS
    grams = np.array([columns[block == k].T @ columns[block == k] for k in range(_BLOCKS)])
    every = grams.sum(axis=0)
    value = _additive_shares(every, owner)
    without = np.array([_additive_shares(every - gram, owner) for gram in grams])
    error = np.sqrt((_BLOCKS - 1) * without.var(axis=0))
    return np.stack([value, value - 1.96 * error, value + 1.96 * error], axis=1)


def _bins(x: np.ndarray, most: int) -> np.ndarray:
    """Return the bin number (n,): the value, or one of `most` bins with the same number of landings."""
    values, number = np.unique(x, return_inverse=True)
    if len(values) <= most:
        return number
    return np.searchsorted(np.quantile(x, np.linspace(0, 1, most + 1)[1:-1]), x, side="right")


def _additive_shares(gram: np.ndarray, owner: np.ndarray) -> np.ndarray:
    """Return the shares (P,) of the variance by the least-squares fit of additive parts.

    gram: products of [1, bins of all parameters, y] over all landings; owner: each column's parameter.
    """
    # y ~ sum_k f_k(x_k),  S_k = Cov(f_k, y)/Var y  (Li et al. 2010): they sum to R^2. By chance a part of p_k
    # free numbers explains (1 - R^2) p_k/(n - p - 1), p in all.
    a, b, n = gram[:-1, :-1], gram[:-1, -1], gram[0, 0]
    mean = b[0] / n
    weights = np.linalg.solve(a + _RIDGE * np.diag(owner >= 0), b)
    parts = np.bincount(owner[1:], weights[1:] * (b[1:] - mean * a[0, 1:]))
    shares, free = parts / (gram[-1, -1] - n * mean**2), np.bincount(owner[1:]) - 1.0
    return shares - (1.0 - shares.sum()) * free / (n - free.sum() - 1.0)
