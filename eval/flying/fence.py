"""The fence of a flight: the distance that a vehicle must keep from the arena's ends at its velocity."""

from __future__ import annotations

import math

import numpy as np

from inclined_landing.envs.tasks.landing import BOUND_MARGIN
from inclined_landing.models.vehicle import Vehicle

FLOOR = 0.3  # m: the floor is a fence from here up, below it is where vehicles take off and land
REACTION_TIME = (0.25, 0.25, 0.12)  # s along x, y, z: see `stopping_distance`
BRAKING = 0.5  # share of the acceleration commands allow that the set-point policy brakes with


def stopping_distance(velocity: np.ndarray, vehicle: Vehicle, braking: float = BRAKING) -> np.ndarray:
    """Return the stopping distance (..., 3) [m] along each axis from a velocity (..., 3) [m/s].

    It is v t + v^2 / (2 a). t is the time until braking begins: a control period, the age of the newest
    position (1/120 s), the radio (10 ms) and the lag of the attitude loop (0.18 s) or of the thrust (1/15.5
    s). a is a share, `braking`, of the acceleration that the commands allow: g tan(30 deg) sideways; upwards
    g minus the lowest thrust of an action, about half of g; downwards the highest thrust minus g, also about
    half of g.
    """
    g = vehicle.environment_gravity
    sideways = g * math.tan(vehicle.command_angle_limit)
    brake = braking * np.array([sideways, sideways, 0.5 * g])
    speed = np.abs(velocity)
    return speed * REACTION_TIME + speed**2 / (2.0 * brake)


def beyond_fence(
    position: np.ndarray,
    velocity: np.ndarray,
    vehicle: Vehicle,
    margin: float = BOUND_MARGIN,
    braking: float = BRAKING,
) -> np.ndarray:
    """Return (...,) bool: whether a vehicle in the air is too fast for its distance from an end of the arena.

    position, velocity (..., 3) [m, m/s]; margin [m] kept in addition to the distance that it needs to stop,
    which is `stopping_distance` with `braking`.
    """
    ends = np.array([vehicle.arena_x, vehicle.arena_y, vehicle.arena_z], float)
    room = stopping_distance(velocity, vehicle, braking) + margin
    high = (velocity > 0.0) & (position + room > ends[:, 1])
    low = (velocity < 0.0) & (position - room < ends[:, 0])
    low[..., 2] &= position[..., 2] > FLOOR
    return (high | low).any(axis=-1)
