"""Slopes in space: the landing task with `dimensions=3`.

Inclinations are drawn from 0 to `steepest`, with an azimuth from 0 to 360 deg: the direction that the slope
faces, from +x. Without `steepest` all have the same `inclination` and `azimuth`. The slope is observed as in
the plane, with the columns of space.

The actions are thrust, roll and pitch. Roll and pitch are those of a vehicle that has the surface's heading
and the same thrust axis; `body_commands` turns them by the vehicle's own heading. Therefore a policy need not
be changed for `random_yaw`, which draws the heading of each start. Starts are drawn from the upper half of
the arena in all three dimensions, and its bounds in y apply as well.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from inclined_landing.envs.tasks.base import Start
from inclined_landing.envs.tasks.slopes import SEEN, SEEN_SCALE, SlopeLanding
from inclined_landing.models import surface
from inclined_landing.models.attitude import YAW
from inclined_landing.models.vehicle import Vehicle


class SpaceLanding(SlopeLanding):
    """The landing in space, on slopes that face any direction."""

    observation_names: tuple[str, ...] = SEEN
    observation_scale = SEEN_SCALE
    action_names = ("thrust", "roll", "pitch")
    is_planar = False
    draws_vehicles_in = (3,)
    columns = np.arange(len(SEEN))
    least = 0.0

    def __init__(self, vehicle: Vehicle | None = None, **options: Any):
        super().__init__(vehicle, **{"dimensions": 3} | options)
        self.azimuth = float(self.settings.azimuth)
        if self.steepest is not None and self.inclination < 0.0:  # as slopes are drawn
            self.inclination, self.azimuth = -self.inclination, self.azimuth + math.pi
        self._resolve(inclination=self.inclination, azimuth=self.azimuth)

    def body_commands(self, commands: np.ndarray, state: np.ndarray, platform: np.ndarray) -> np.ndarray:
        """Return `commands` (n, 4) with attitudes turned from the surface's heading to the vehicles'."""
        limits = self.vehicle.attitude_gain, self.vehicle.command_angle_limit
        surface.turn_commands(commands, *limits, state, platform)
        return commands

    def _draw_platforms(self, rng: np.random.Generator, start: Start) -> None:
        super()._draw_platforms(rng, start)
        if self.steepest is not None:
            start.azimuth = rng.uniform(-math.pi, math.pi, len(start))

    def _place(self, rng: np.random.Generator, start: Start) -> Start:
        if self.settings.random_yaw:
            start.state[:, YAW] = rng.uniform(-math.pi, math.pi, len(start))
        return super()._place(rng, start)

    def _start(self, state: np.ndarray, present: np.ndarray) -> Start:
        start = super()._start(state, present)
        start.azimuth = np.full(len(state), self.azimuth)
        return start
