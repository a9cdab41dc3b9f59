"""Estimates with their uncertainties, all in one form: `value`, `low` and `high` of an interval, `count`."""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import Any

import numpy as np
import numpy.typing as npt

_Z = NormalDist().inv_cdf(0.975)


def proportion(successes: int, trials: int) -> dict[str, Any]:
    """Return the share of successes with its Wilson 95 % interval, None without trials; `count` of `of`."""
    found: dict[str, Any] = {"value": None, "low": None, "high": None, "count": int(successes), "of": trials}
    if trials:
        # (p + z^2/2n +- z sqrt(p(1 - p)/n + z^2/4n^2))/(1 + z^2/n), z the 97.5 % quantile of the normal
        # distribution; exact where the end is 0 or 1
        share, z2 = successes / trials, _Z**2 / trials
        middle, half = share + z2 / 2, math.sqrt(z2 * (share * (1 - share) + z2 / 4))
        low = 0.0 if successes == 0 else (middle - half) / (1 + z2)
        high = 1.0 if successes == trials else (middle + half) / (1 + z2)
        found |= {"value": share, "low": low, "high": high}
    return found


def median(values: npt.ArrayLike) -> dict[str, Any]:
    """Return the median with 5 % and 95 % quantiles and the range, of `count` values that are not NaN."""
    values = np.asarray(values, float)
    there = values[~np.isnan(values)]
    names = ("min", "low", "value", "high", "max")
    sizes = map(float, np.quantile(there, [0, 0.05, 0.5, 0.95, 1])) if len(there) else [None] * len(names)
    return dict(zip(names, sizes)) | {"count": int(np.isfinite(values).sum())}


def mean(values: npt.ArrayLike) -> dict[str, Any]:
    """Return the mean with the 95 % interval of Student's t, for more than one value."""
    values = np.asarray(values, float)
    value, low, high = float(values.mean()), None, None
    if len(values) > 1:
        from scipy.special import stdtrit  # quantiles of Student's t

        half = float(stdtrit(len(values) - 1, 0.975) * values.std(ddof=1) / np.sqrt(len(values)))
        low, high = value - half, value + half
    return {"value": value, "low": low, "high": high, "count": len(values)}


def bootstrap(values: npt.ArrayLike) -> dict[str, Any]:
    """Return the mean with its 95 % bootstrap interval, percentiles of 10 000 draws, for more than one value.

    The interval never exceeds the range of the values; for three or four values it is too narrow.
    """
    values = np.asarray(values, float)
    low = high = None
    if len(values) > 1:
        drawn = np.random.default_rng(0).choice(values, (10_000, len(values))).mean(axis=1)
        low, high = map(float, np.quantile(drawn, [0.025, 0.975]))
    return {"value": float(values.mean()), "low": low, "high": high, "count": len(values)}


def number(value: float | None) -> str:
    """Return a number with up to three significant digits as text: 0.42, 1.3e-6, 34 100."""
    if value is None or not math.isfinite(value):
        return "–"
    size = abs(value)
    if size == 0:
        return "0"
    if size < 1e-3:
        mantissa, exponent = f"{value:.1e}".split("e")
        return f"{mantissa}e{int(exponent)}"
    if size >= 1e4:
        return f"{value:,.0f}".replace(",", "\u202f")
    return f"{value:.3g}" if size < 100 else f"{value:.0f}"
