"""Moving platforms: the landing in space with `fastest` [m/s].

Every platform travels at a constant velocity in any direction, at up to this speed, and with `swell` it also
heaves, rolls and pitches (`envs.swell`). The vehicle starts at rest in the room. Observations and success are
relative to the platform: velocities are relative to its centre, and six more observations are the platform's
velocity and rates along the axes of the heading frame. The arena moves with the platform's centre, and is
wider by half a second of travel at `fastest`, so that there is room to catch up. Given starts have platforms
at rest.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from inclined_landing.envs import swell as swells
from inclined_landing.envs.tasks.base import Start
from inclined_landing.envs.tasks.slopes import SEEN, SEEN_SCALE
from inclined_landing.envs.tasks.space import SpaceLanding
from inclined_landing.models import surface
from inclined_landing.models.attitude import Z
from inclined_landing.models.vehicle import Vehicle

SEEN_MOVING = ("platform vx", "platform vy", "platform vz", "platform wx", "platform wy", "platform wz")
SEEN_MOVING_SCALE = np.array([1.0, 1.0, 0.5, 0.5, 0.5, 0.5])
CATCHING_UP = 0.5  # s of the fastest platform's way by which the arena is wider


class MovingLanding(SpaceLanding):
    """The landing in space on platforms that move."""

    observation_names = (*SEEN, *SEEN_MOVING)
    observation_scale = np.append(SEEN_SCALE, SEEN_MOVING_SCALE)
    platform_moves = True
    observed_motion = len(SEEN_MOVING)

    table = "moving"

    def __init__(self, vehicle: Vehicle | None = None, **options: Any):
        super().__init__(vehicle, **{"fastest": 0.0} | options)
        self.fastest = float(self.settings.fastest or 0.0)
        self._resolve(fastest=self.fastest, swell=float(self.settings.swell))
        self.extra_room = CATCHING_UP * self.fastest

    @property
    def plant_options(self) -> dict[str, Any]:
        """A plant with moving platforms."""
        return {"moving": True}

    def _draw_platforms(self, rng: np.random.Generator, start: Start) -> None:
        super()._draw_platforms(rng, start)
        share = self.conditions.motion
        # No platform is steeper than attitude commands reach.
        room = np.maximum(self.vehicle.command_angle_limit - np.abs(start.inclination), 0.0)
        start.motion = swells.draw(rng, share * self.fastest, share * self.settings.swell, room)

    def at_standstill(self, start: Start) -> Start:
        """Return the starts relative to platforms in their usual place, with their slopes of the start."""
        if start.motion is None:
            return start
        platform = start.platforms(self.vehicle)
        state = start.state.copy()
        state[:, : Z + 1] -= platform[:, : Z + 1]
        state[:, Z] += self.vehicle.platform_surface_height
        slope, azimuth = surface.slope_of(platform)
        return dataclasses.replace(start, state=state, inclination=slope, azimuth=azimuth, motion=None)
