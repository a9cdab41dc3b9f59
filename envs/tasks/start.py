"""Starts of episodes: states, platforms and contact parameters of k vehicles."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
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
    contact: dict[str, Any] | None = None  # arguments (k,) of the plant's set_contact
    azimuth: np.ndarray | None = None  # (k,) of the slope's direction, rad; None: towards +x everywhere
    motion: Motion | None = None  # of the k platforms; None: they stand still

    def __len__(self) -> int:
        return len(self.state)

    def __getitem__(self, ids) -> Start:
        """Return the starts of the episodes `ids`."""
        azimuth = None if self.azimuth is None else self.azimuth[ids]
        contact = None if self.contact is None else {name: x[ids] for name, x in self.contact.items()}
        motion = None if self.motion is None else self.motion[ids]
        of = self.state[ids], self.inclination[ids], self.present[ids], self.goal_size[ids]
        return Start(*of, contact, azimuth, motion)

    def platforms(self, vehicle: Vehicle, t: float = 0.0) -> np.ndarray:
        """Return the states (k, 12) of the platforms t [s] after the starts."""
        rest = np.zeros((len(self), PLATFORM_SIZE))
        rest[:, Z], rest[:, PITCH] = vehicle.platform_surface_height, self.inclination
        rest[:, YAW] = 0.0 if self.azimuth is None else self.azimuth
        return rest if self.motion is None else self.motion.platforms(t, rest)

    def put(self, rows: np.ndarray, other: Start) -> None:
        """Overwrite the given rows with the starts of `other`."""
        for field in dataclasses.fields(self):
            old, new = getattr(self, field.name), getattr(other, field.name)
            pairs = [(old[key], new[key]) for key in old] if isinstance(old, dict) else [(old, new)]
            for array, values in pairs:
                if array is not None:
                    array[rows] = values


def joined(starts: Sequence[Start]) -> Start:
    """Return all starts concatenated in order; either all or none have an azimuth and contact parameters."""
    parts: dict[str, Any] = {}
    for field in dataclasses.fields(Start):
        values = [getattr(start, field.name) for start in starts]
        if isinstance(values[0], dict):
            parts[field.name] = {name: np.concatenate([x[name] for x in values]) for name in values[0]}
        elif isinstance(values[0], Motion):
            parts[field.name] = Motion(*map(np.concatenate, zip(*(motion.arrays for motion in values))))
        else:
            parts[field.name] = None if values[0] is None else np.concatenate(values)
    return Start(**parts)
