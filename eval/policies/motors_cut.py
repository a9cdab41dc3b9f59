"""What becomes of a vehicle whose motors are cut where the policy hands over: the real landing.

From each given state the vehicle flies on in the MuJoCo plant with PWM 0 and no attitude torque (the
torques come from the motors too) for two seconds, watched at every engine step.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from inclined_landing.models.attitude import VX, VZ, WX, WZ
from inclined_landing.models.parameters import Vehicle
from inclined_landing.models.plants import MujocoPlant

DURATION = 2.0  # s
_TIMESTEP = 0.004  # s, of the engine and of the observation
_NO_TORQUE = 1e-12  # N m
REST_SPEED = 0.02  # m/s
REST_RATE = 0.2  # rad/s


@dataclasses.dataclass
class Aftermath:
    """One entry per vehicle; speeds are those of the centre of mass, NaN without a touchdown."""

    touched: np.ndarray  # (n,) bool: did any part reach the slab
    normal_speed: np.ndarray  # (n,) m/s into the surface, up to 8 ms before the first touch
    tangential_speed: np.ndarray  # (n,) m/s along the surface, unsigned
    at_rest: np.ndarray  # (n,) bool: at the end still, feet and nothing else on the slab


def normal_of(inclination) -> np.ndarray:
    """Unit normal of the surface (..., 3) for platforms inclined by `inclination` [rad]."""
    a = np.asarray(inclination, float)
    return np.stack([np.sin(a), np.zeros_like(a), np.cos(a)], axis=-1)


def split_velocity(velocity: np.ndarray, inclination) -> tuple[np.ndarray, np.ndarray]:
    """Normal speed, positive away from the surface, and tangential speed (n,), unsigned [m/s]."""
    normal = normal_of(inclination)
    away = (velocity * normal).sum(axis=-1)
    return away, np.linalg.norm(velocity - away[..., None] * normal, axis=-1)


def cut_motors(
    states: np.ndarray, inclination: float, vehicle: Vehicle, thrust_scale: float = 1.0
) -> Aftermath:
    """Cut the motors at `states` (n, 13) over a platform inclined by `inclination` [rad].

    thrust_scale: of the thrust that still decays.
    """
    n = len(states)
    unpowered = dataclasses.replace(
        vehicle,
        attitude_torque_limit=_NO_TORQUE,
        attitude_yaw_torque_limit=_NO_TORQUE,
    )
    plant = MujocoPlant(n, unpowered, control_period=_TIMESTEP, timestep=_TIMESTEP)
    ids = np.arange(n)
    plant.set_platform(ids, np.full(n, inclination))
    plant.reset(ids, states)
    plant.perturb(thrust_scale=thrust_scale)
    commands = np.zeros((n, 4))
    touched = np.zeros(n, bool)
    normal_speed, tangential_speed = np.full(n, np.nan), np.full(n, np.nan)
    before = now = states[:, VX : VZ + 1].copy()
    for _ in range(round(DURATION / _TIMESTEP)):
        # A touch is seen at the beginning of a step, but the stages of the step before may have met
        # the surface already: the last velocity free of contact is one step older.
        before, now = now, plant.state[:, VX : VZ + 1].copy()
        plant.step(commands)
        first = plant.contacts.touch[:, 0].any(axis=1) & ~touched
        touched |= first
        away, along = split_velocity(before, inclination)
        normal_speed[first], tangential_speed[first] = -away[first], along[first]
    state, touch = plant.state, plant.contacts.touch
    still = (np.linalg.norm(state[:, VX : VZ + 1], axis=1) < REST_SPEED) & (
        np.linalg.norm(state[:, WX : WZ + 1], axis=1) < REST_RATE
    )
    on_feet = touch[:, 0, 0] & ~touch[:, :, 1:].any(axis=(1, 2)) & ~touch[:, 1:].any(axis=(1, 2))
    return Aftermath(touched, normal_speed, tangential_speed, still & on_feet)
