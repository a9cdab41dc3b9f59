"""Obstacles in the arena, and paths around them."""

from __future__ import annotations

import itertools

import numpy as np

from inclined_landing.envs.hover import CLEAR
from inclined_landing.models import geometry
from inclined_landing.models.attitude import STATE_SIZE
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.scene import compile_scene
from inclined_landing.models.vehicle import Vehicle

FREE_START = 0.3  # m of a way that may begin closer to it
IMPACT_DISTANCE = 0.1  # m within which a touch may have happened unseen
CONTACT_DISTANCE = 0.01  # m: closer counts as touching; the platform's height is known to 5 mm
CEILING = 0.3  # m that a way keeps to the ceiling
LEAD = 0.4  # m that a moving target is ahead of the vehicle before it waits
_STEP = 0.05  # m between the points at which a way is checked


class Surroundings:
    """Platform and floor as obstacles; inclination of the platform [rad], present: whether it is there."""

    def __init__(self, vehicle: Vehicle, inclination: float, present: bool = True):
        self.vehicle = vehicle
        self.inclination, self.present = inclination, present
        self._shapes = geometry.shapes_of(compile_scene(vehicle))
        self._platform, _ = geometry.platform_poses([inclination], [present], vehicle)
        self.standing_height = float(
            geometry.reach_below(self._shapes, part="feet")
        )  # m, centre above the floor

    def distances(self, states: np.ndarray) -> np.ndarray:
        """Return the distances (n, 2) [m] of vehicles in states (n, 13) to platform and floor."""
        n = len(states)
        platform = np.repeat(self._platform, n, axis=0)
        to = geometry.clearances(states, np.full(n, self.inclination), platform, self._shapes).min(axis=2)
        floor = np.where(np.isfinite(to[:, 2]), to[:, 2], states[:, 2] - self._shapes.reach[0])
        return np.stack([to[:, :2].min(axis=1), floor], axis=1)

    def in_contact(self, state: np.ndarray) -> bool:
        """Return whether a vehicle in a state (13,) is in contact with platform or floor, by its position."""
        return self.is_near(state, CONTACT_DISTANCE)

    def is_near(self, state: np.ndarray, reach: float) -> bool:
        """Return whether a vehicle in a state (13,) is closer than `reach` [m] to platform or floor."""
        return bool(np.isfinite(state).all() and (self.distances(state[None]) < reach).any())

    def path_to(self, home: np.ndarray, start: np.ndarray) -> list[np.ndarray]:
        """Return waypoints (3,) [m]: up from `home`, across at one height, to `start`.

        The height is the lowest, from that of the start upwards, at which the way is clear. Raises UserError
        if there is none.
        """
        for height in np.arange(max(home[2], start[2]), self._highest, _STEP):
            points = [np.array([*home[:2], height]), np.array([*start[:2], height]), np.asarray(start, float)]
            if self._clear([home, *points]):
                return points
        a, b = (", ".join(f"{value:.2f}" for value in point) for point in (home, start))
        raise UserError(f"no path from {a} to {b} m avoids the platform")

    def path_down(self, here: np.ndarray) -> list[np.ndarray]:
        """Return waypoints (3,) [m] from `here` to a free place and below the floor, first downhill."""
        downhill = -1.0 if self.inclination < 0.0 else 1.0
        free_x = self.vehicle.slab_half_length + 2 * CLEAR
        free = not self.present or abs(here[0]) > free_x - CLEAR
        places = [here[0]] if free else [downhill * free_x, -downhill * free_x]
        for x, height in itertools.product(
            places, np.arange(here[2], max(here[2], self._highest) + 0.01, 0.1)
        ):
            points = [np.array([here[0], here[1], height]), np.array([x, here[1], height])]
            points.append(np.array([x, here[1], self.standing_height]))
            if self._clear([here, *points], leaving=FREE_START):
                break
        return [*points[:-1], np.array([points[-1][0], here[1], -self.standing_height - 0.2])]

    @property
    def _highest(self) -> float:
        return self.vehicle.arena_z[1] - CEILING + 1e-9

    def _clear(self, points: list[np.ndarray], leaving: float = 0.0) -> bool:
        """Return whether a path is clear of obstacles, except for its first `leaving` metres."""
        states, travelled = [], 0.0
        for a, b in itertools.pairwise(points):
            length = float(np.linalg.norm(b - a))
            for k in range(int(length / _STEP) + 1):
                if travelled + k * _STEP >= leaving:
                    state = np.zeros(STATE_SIZE)
                    state[:3] = a + (b - a) * min(1.0, k * _STEP / max(length, 1e-9))
                    states.append(state)
            travelled += length
        return not states or bool((self.distances(np.array(states))[:, 0] > CLEAR).all())


class MovingTarget:
    """A target that moves along a path at `speed` [m/s], and waits for a vehicle more than LEAD behind."""

    def __init__(self, begin: np.ndarray, way: list[np.ndarray], speed: float):
        self.position = np.array(begin, float)
        self._way = [np.asarray(point, float) for point in way]
        self._speed = speed

    @property
    def arrived(self) -> bool:
        """Whether the target is at the end of its path."""
        return not self._way

    def advance(self, dt: float, vehicle: np.ndarray) -> np.ndarray:
        """Return the target's position (3,) after another dt [s], the vehicle being at (3,)."""
        remaining = self._speed * dt
        while self._way and remaining > 0.0 and np.linalg.norm(self.position - vehicle) < LEAD:
            to = self._way[0] - self.position
            distance = float(np.linalg.norm(to))
            if distance > remaining:
                self.position = self.position + to * (remaining / distance)
                return self.position
            self.position, remaining = self._way.pop(0), remaining - distance
        return self.position
