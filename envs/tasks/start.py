"""Starts of episodes: states, platforms and contact parameters of k vehicles."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from inclined_landing.models.attitude import PITCH, YAW, Z
from inclined_landing.models.motion import Motion
from inclined_landing.models.plants.base import PLATFORM_SIZE
from inclined_landing.models.vehicle import Vehicle


@dataclasses.dataclass
class Start:
    """Initial states of k episodes, with their platforms and contact parameters."""

    state: np.ndarray  # (k, 13)
    inclination: np.ndarray  # (k,) rad
    present: np.ndarray  # (k,) bool: is there a platform
    goal_size: np.ndarray  # (k,) d of the goal box; NaN for tasks without one
    contact: dict[str, np.ndarray] | None = None  # arguments (k,) of the plant's set_contact
    azimuth: np.ndarray | None = None  # (k,) of the slope's direction, rad; None: towards +x everywhere
    motion: Motion | None = None  # of the k platforms; None: they stand still

    def __len__(self) -> int:
        return len(self.state)

    def __getitem__(self, ids) -> Start:
        """Return the starts of the episodes `ids`."""
        return _of_each(lambda x: x[ids], self)

    def platforms(self, vehicle: Vehicle, t: float = 0.0) -> np.ndarray:
        """Return the states (k, 12) of the platforms t [s] after the starts."""
        rest = np.zeros((len(self), PLATFORM_SIZE))
        rest[:, Z], rest[:, PITCH] = vehicle.platform_surface_height, self.inclination
        rest[:, YAW] = 0.0 if self.azimuth is None else self.azimuth
        return rest if self.motion is None else self.motion.platforms(t, rest)

    def put(self, rows: np.ndarray, other: Start) -> None:
        """Overwrite the given rows with the starts of `other`."""
        _of_each(lambda old, new: old.__setitem__(rows, new), self, other)


def joined(starts: Sequence[Start]) -> Start:
    """Return all starts concatenated in order; either all or none have an azimuth and contact parameters."""

    def concatenated(*parts):
        if isinstance(parts[0], Motion):
            return Motion(*map(np.concatenate, zip(*(motion.waves for motion in parts))))
        return np.concatenate(parts)

    return _of_each(concatenated, *starts)


def _of_each(call: Callable[..., Any], *starts: Start) -> Start:
    """Return the start of what `call` returns for the arrays of each field of `starts`."""

    def of(first, *others):
        if isinstance(first, dict):
            return {name: of(x, *(other[name] for other in others)) for name, x in first.items()}
        return None if first is None else call(first, *others)

    return Start(*map(of, *(vars(start).values() for start in starts)))
