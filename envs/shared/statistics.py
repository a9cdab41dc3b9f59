"""Estimates with their uncertainties."""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import Any

import numpy as np
import numpy.typing as npt

_Z = NormalDist().inv_cdf(0.975)


def proportion(successes: int, trials: int) -> dict[str, Any]:
    """Return the share of successes with its Wilson 95 % interval (null without trials)."""
    result: dict[str, Any] = {"count": int(successes), "of": int(trials), "share": None, "interval": None}
    if trials:
        # (p + z^2/2n +- z sqrt(p(1 - p)/n + z^2/4n^2))/(1 + z^2/n), z the 97.5 % quantile of the normal
        # distribution; exact where the end is 0 or 1
        share, z2 = successes / trials, _Z**2 / trials
        middle, half = share + z2 / 2, math.sqrt(z2 * (share * (1 - share) + z2 / 4))
        low = 0.0 if successes == 0 else (middle - half) / (1 + z2)
        high = 1.0 if successes == trials else (middle + half) / (1 + z2)
        result |= {"share": share, "interval": [low, high]}
    return result


def spread(values: npt.ArrayLike) -> dict[str, Any]:
    """Return median, 5 % and 95 % quantiles, smallest and largest of the values that are not NaN."""
    values = np.asarray(values, float)
    values = values[~np.isnan(values)]
    names = ("min", "p5", "median", "p95", "max")
    if not len(values):
        return dict.fromkeys(names)
    return dict(zip(names, map(float, np.quantile(values, [0, 0.05, 0.5, 0.95, 1]))))


def mean(values: npt.ArrayLike) -> dict[str, Any]:
    """Return the mean with the 95 % interval of Student's t, for more than one value."""
    values = np.asarray(values, float)
    result: dict[str, Any] = {"mean": float(values.mean()), "interval": None}
    if len(values) > 1:
        from scipy.special import stdtrit  # quantiles of Student's t

        half = stdtrit(len(values) - 1, 0.975) * values.std(ddof=1) / np.sqrt(len(values))
        result["interval"] = [result["mean"] - float(half), result["mean"] + float(half)]
    return result


def bootstrap(values: npt.ArrayLike) -> dict[str, Any]:
    """Return the mean with its 95 % bootstrap interval, percentiles of 10 000 draws, for more than one value.

    The interval never exceeds the range of the values; for three or four values it is too narrow.
    """
    values = np.asarray(values, float)
    result: dict[str, Any] = {"mean": float(values.mean()), "interval": None}
    if len(values) > 1:
        drawn = np.random.default_rng(0).choice(values, (10_000, len(values))).mean(axis=1)
        result["interval"] = [float(end) for end in np.quantile(drawn, [0.025, 0.975])]
    return result


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
