"""Sensitivity to each varied parameter, computed from the landings of a study without further runs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy import optimize

_BINS = 20  # of a parameter drawn from a range
_LEVELS = 24  # up to so many different values are taken as they are
_RESAMPLES = 200
_PENALTY = 1e-3  # of the logistic fit; keeps coefficients finite where the classes separate


def rows(
    parameters: dict[str, np.ndarray], outputs: dict[str, np.ndarray], rests: np.ndarray, seed: int
) -> Iterator[dict[str, Any]]:
    """Yield rows for each parameter (n,): its log odds of resting, and first-order indices of each output.

    `log_odds`: coefficient of a logistic regression of `rests` (n,) bool on all parameters,
    standardised: change of the log odds for one standard deviation of the parameter.
    `index_*`: for `rests` and each output (n,), the share of the variance that this parameter alone explains
    (first-order Sobol index, from the variance between bins, corrected for their number), with a 95 %
    bootstrap interval; NaN outputs are omitted.
    """
    odds = _logistic(parameters, rests)
    targets = {"rests": rests.astype(float)} | outputs
    for k, (name, x) in enumerate(parameters.items()):
        bins = _bins(x)
        about = {"parameter": name, "measure": "log_odds", "statistic": "logistic regression"}
        yield about | {"value": odds[k]}
        for target, y in targets.items():
            value, interval = _first_order(bins, y, np.random.default_rng([seed, k]))
            about = {"parameter": name, "measure": f"index_{target}", "statistic": "first-order index"}
            yield about | {"value": value} | dict(zip(("low", "high"), interval))


def _bins(x: np.ndarray) -> np.ndarray:
    """Return the bin number (n,): the level, or one of 20 bins with the same number of landings."""
    levels, number = np.unique(x, return_inverse=True)
    if len(levels) <= _LEVELS:
        return number
    edges = np.quantile(x, np.linspace(0, 1, _BINS + 1)[1:-1])
    return np.searchsorted(edges, x, side="right")


def _share(bins: np.ndarray, y: np.ndarray) -> float:
    """Return the variance of y between bins over its variance, corrected for the number of bins."""
    count = np.bincount(bins)
    used = count > 0
    mean = np.bincount(bins, y)[used] / count[used]
    total = ((y - y.mean()) ** 2).sum()
    if total <= 0.0 or len(y) <= used.sum():
        return float("nan")
    between = (count[used] * (mean - y.mean()) ** 2).sum()
    return 1.0 - (1.0 - between / total) * (len(y) - 1) / (len(y) - used.sum())


def _first_order(
    bins: np.ndarray, y: np.ndarray, rng: np.random.Generator
) -> tuple[float | None, tuple[float, ...]]:
    """Return the index and the ends of its interval; None and an empty list if it is undefined."""
    known = np.isfinite(y)
    bins, y = bins[known], y[known]
    if len(y) < 2 * (_LEVELS + 1):
        return None, ()
    again = []
    for _ in range(_RESAMPLES):
        pick = rng.integers(0, len(y), len(y))
        again.append(_share(bins[pick], y[pick]))
    index = _share(bins, y)
    if not np.isfinite(index):
        return None, ()
    low, high = np.nanquantile(again, [0.025, 0.975])
    return max(0.0, index), (max(0.0, float(low)), max(0.0, float(high)))


def _logistic(parameters: dict[str, np.ndarray], rests: np.ndarray) -> list[float | None]:
    """Return the standardised coefficients; null when all or no landings rest."""
    if not parameters or rests.all() or not rests.any():
        return [None] * len(parameters)
    x = np.column_stack(list(parameters.values()))
    x = np.column_stack([np.ones(len(x)), (x - x.mean(axis=0)) / x.std(axis=0)])
    sign = np.where(rests, 1.0, -1.0)

    def loss(w):
        margin = sign * (x @ w)
        pull = -sign / (1.0 + np.exp(np.clip(margin, -500, 500)))
        value = np.logaddexp(0.0, -margin).mean() + 0.5 * _PENALTY * (w[1:] ** 2).sum()
        gradient = x.T @ pull / len(x)
        gradient[1:] += _PENALTY * w[1:]
        return value, gradient

    fit = optimize.minimize(loss, np.zeros(x.shape[1]), jac=True, method="L-BFGS-B")
    return [float(w) for w in fit.x[1:]]
