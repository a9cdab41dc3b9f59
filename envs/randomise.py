"""Ranges from which vehicles deviate from the vehicle file, drawn anew for every episode.

A file of ranges is TOML, one line for each deviation, lowest and highest value:

    thrust_scale = [0.8, 1.1]  # uniform between the two; equal ones fix it

The names are those of `models.perturbation`: what both plants can change of single vehicles without compiling
the scene again.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.perturbation import NAMES

Ranges = dict[str, tuple[float, float]]

_SCALE = (0.1, 10.0)
_LIMITS = {"thrust_bias": (-1.0, 1.0), "drag_change": (-1.0, 10.0)}  # N, and relative


def read_ranges(path: str | Path) -> Ranges:
    """The ranges in a file; raises UserError for what is none, or cannot differ from vehicle to vehicle."""
    what = f"randomise file {path}"
    table = storage.read_toml(path, "randomise file")
    if not table:
        raise UserError(f"{what} is empty; it should hold ranges of {', '.join(NAMES)}")
    return {name: _checked(name, value, what) for name, value in table.items()}


def _checked(name: str, value, what: str) -> tuple[float, float]:
    if name not in NAMES:
        raise UserError(
            f"{what}: {shown(name, 40)} cannot differ from vehicle to vehicle; {', '.join(NAMES)} can"
        )
    low, high = _LIMITS.get(name, _SCALE)
    numbers: list = value if isinstance(value, list) and len(value) == 2 else [None]
    if not all(type(x) in (int, float) and low <= x <= high for x in numbers):
        raise UserError(
            f"{what}: {name} must be two numbers from {low:g} to {high:g}, not {shown(repr(value), 40)}"
        )
    if numbers[0] > numbers[1]:
        raise UserError(f"{what}: {name} begins at {numbers[0]:g} and ends below it, at {numbers[1]:g}")
    return float(numbers[0]), float(numbers[1])


def deviate(plant, ids: np.ndarray, ranges: Ranges, rng: np.random.Generator) -> None:
    """Draw the deviations of the vehicles `ids` (k,) of a plant; the others keep theirs."""
    changes = {}
    for name, (low, high) in ranges.items():
        changes[name] = plant.perturbation[:, NAMES.index(name)].copy()
        changes[name][ids] = rng.uniform(low, high, len(ids))
    plant.perturb(**changes)
