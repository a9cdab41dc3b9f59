"""Shared parts of the landing tasks: the record of their options, and the space inside the platform."""

from __future__ import annotations

import dataclasses
import math
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from inclined_landing.envs.tasks.options import TaskOptions, option
from inclined_landing.models.attitude import X, Y, Z
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.vehicle import Vehicle


@dataclasses.dataclass(frozen=True)
class LandingOptions(TaskOptions):
    """Options of the landing task."""

    inclination: float | None = option(None, recorded=True)
    """Platform inclination [rad] (default: the vehicle file's); negative rises towards +x."""
    steepest: float | None = option(None, trained_with=True)
    """Draw a slope for every episode, up to this inclination [rad], in both directions or, in three
    dimensions, in any direction. The policy observes it."""
    dimensions: Literal[2, 3] = option(2, trained_with=True)
    """3: the vehicle flies in space, with roll; 2: in a plane."""
    azimuth: float = 0.0
    """Direction that the slope faces, from +x [rad]."""
    random_yaw: bool = False
    """In three dimensions, draw the initial heading of every episode."""
    fastest: Annotated[float, Meta(ge=0, le=10)] | None = option(None, trained_with=True)
    """In three dimensions, platforms travel in any direction at up to this constant speed [m/s]."""
    swell: Annotated[float, Meta(ge=0, le=2)] = option(0.0, trained_with=True)
    """With `fastest`, platforms also heave, roll and pitch; 1 is up to 0.24 m and 16 deg."""

    def check(self) -> None:
        """Raise UserError for a value beyond its limits, or for options that cannot be combined."""
        super().check()
        if self.dimensions == 2 and (self.azimuth or self.random_yaw):
            named = "azimuth" if self.azimuth else "random_yaw"
            raise UserError(f"{named} needs dimensions=3: in the plane a vehicle cannot follow it")
        if self.fastest is None and self.swell:
            raise UserError("swell applies to moving platforms: set fastest too (0 is allowed)")
        if self.fastest is not None and self.dimensions == 2:
            raise UserError("fastest needs dimensions=3: in the plane a vehicle cannot follow a platform")


def in_platform(position: np.ndarray, inclination: float, azimuth: float, vehicle: Vehicle) -> bool:
    """Return whether a point (3,) [m] is in the slab or in the space under it."""
    cos, sin = math.cos(azimuth), math.sin(azimuth)
    x, y = cos * position[X] + sin * position[Y], cos * position[Y] - sin * position[X]
    z = position[Z] - vehicle.platform_surface_height
    sin, cos = math.sin(inclination), math.cos(inclination)
    along, height = x * cos - z * sin, x * sin + z * cos  # of the slab's surface
    thick, half = vehicle.platform_thickness, vehicle.slab_half_length
    in_slab = abs(along) < half and -thick <= height < 0.0
    under = abs(x + thick * sin) < half * cos and height < -thick
    return bool((in_slab or under) and abs(y) < 0.5 * vehicle.platform_depth)
