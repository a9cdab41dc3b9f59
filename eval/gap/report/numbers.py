"""Numbers with their units as a person reads them: degrees, ms, mm, g; with the digits of their intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence

# Unit -> factor to the displayed unit, and its name.
SHOWN = {
    "1": (1.0, ""),
    "rad": (180.0 / math.pi, "deg"),
    "rad/s": (180.0 / math.pi, "deg/s"),
    "s": (1e3, "ms"),
    "m": (1e3, "mm"),
    "N": (1e3, "mN"),
    "kg": (1e3, "g"),
    "1/s": (100.0, "%/s"),
    "rad/(rad s)": (1.0, "per s"),
    "1/V": (100.0, "%/V"),
    "1/m": (1.0, "per m"),
    "m/s2": (1.0, "m/s²"),
    "rad/s2": (180.0 / math.pi, "deg/s²"),
    "s2/m2": (1.0, "s²/m²"),
}


def shown(unit: str) -> tuple[float, str]:
    """Return the factor to the displayed unit, and its name."""
    return SHOWN.get(unit, (1.0, unit))


def quantity(value: float, unit: str) -> str:
    """Return a number with three digits in the displayed unit: 0.012 s is 12 ms."""
    factor, name = shown(unit)
    value *= factor
    text = f"{value:.0f}" if abs(value) >= 1000 else f"{value:#.3g}".rstrip(".")
    return f"{text} {name}".rstrip()


def exact(value: float, unit: str) -> str:
    """Return a number of the model with four digits in the displayed unit."""
    factor, name = shown(unit)
    value *= factor
    return f"{value:.0f} {name}".rstrip() if abs(value) >= 1e4 else f"{value:.4g} {name}".rstrip()


def interval(ends: Sequence[float], unit: str) -> str:
    """Return an interval with the significant digits of its width, `0.876 to 0.884`."""
    factor, name = shown(unit)
    low, high = (factor * x for x in ends)
    if not (math.isfinite(low) and math.isfinite(high)):
        return "not known"
    if high - low <= 1e-6 * abs(high):
        return quantity(ends[0], unit)
    places = _places(max(high - low, 1e-3 * abs(high)))
    return f"{_fixed_point(low, places)} to {_fixed_point(high, places)} {name}".rstrip()


def rounded(value: float, ends: Sequence[float], unit: str) -> str:
    """Return a number with the decimal places of its interval."""
    factor, name = shown(unit)
    width = factor * (ends[1] - ends[0])
    if not (math.isfinite(width) and width):
        return quantity(value, unit)
    return f"{_fixed_point(factor * value, _places(max(width, 1e-3 * abs(factor * value))))} {name}".rstrip()


def _places(width: float) -> int:
    """Return the decimal places that show two digits of a width; negative: tens, hundreds."""
    return min(6, 1 - math.floor(math.log10(abs(width)))) if width else 3


def _fixed_point(value: float, places: int) -> str:
    """Return a number rounded to decimal places, never -0; negative places: tens, hundreds."""
    return f"{round(value, places) + 0.0:.{max(0, places)}f}" if value else "0"
