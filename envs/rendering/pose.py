"""Poses of vehicle and platform for renderers, and translucent copies of the vehicle."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np

from inclined_landing.models.attitude import PITCH, ROLL, YAW, Z, quaternion
from inclined_landing.models.plants.base import PLATFORM_SIZE
from inclined_landing.models.vehicle import Vehicle

_PARKED = -10.0  # m; a platform below this height is absent


@dataclasses.dataclass(frozen=True)
class Pose:
    """Pose of the vehicle as qpos (7,), position [m] and quaternion, and position and quaternion of the slab.

    has_base: the slab has its base. Without one it can move, without a rebuild of the drawn model.
    """

    qpos: np.ndarray
    platform_pos: np.ndarray
    platform_quat: np.ndarray
    has_base: bool = True

    @property
    def platform_key(self):
        """Return a key that is equal if the same model is drawn, None for an absent platform."""
        if self.platform_pos[2] < _PARKED:
            return None
        if not self.has_base:
            return "moving"
        return (*np.round(self.platform_pos, 9), *np.round(self.platform_quat, 9))


@dataclasses.dataclass(frozen=True)
class Ghost:
    """A copy of the vehicle at qpos (7,): `colour` mixed in by `tint`, opacity `alpha`.

    `shadow`: whether the copy casts a shadow (backend "ray").
    """

    qpos: np.ndarray
    colour: tuple[float, float, float] = (0.12, 0.62, 0.30)
    alpha: float = 0.45
    tint: float = 0.8
    shadow: bool = False


def qpos_of_state(state) -> np.ndarray:
    """Return qpos (..., 7) of states (..., 13) with Euler angles R = Rz(yaw) Rx(roll) Ry(pitch)."""
    state = np.asarray(state, float)
    quaternions = [quaternion(*angles) for angles in state[..., 6:9].reshape(-1, 3)]
    turned = np.reshape(quaternions, (*state.shape[:-1], 4))
    return np.concatenate([state[..., :3], turned], axis=-1)


def place(model: mujoco.MjModel, data: mujoco.MjData, qpos: np.ndarray) -> None:
    """Place the vehicle at qpos (7,) in `data`.

    A slung load hangs straight down, because states do not contain its direction.
    """
    data.joint("crazyflie").qpos[:] = qpos
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, "load") >= 0:
        data.joint("load").qpos[:] = qpos[3:] * [1.0, -1.0, -1.0, -1.0]
    mujoco.mj_kinematics(model, data)


def pose_from_state(state, platform, has_base: bool = True) -> Pose:
    """Return the pose of a state (13,) and its platform's state (12,), see `Plant.platform`, or None."""
    if platform is None:
        return Pose(qpos_of_state(state), np.array([0.0, 0.0, 10.0 * _PARKED]), np.array([1.0, 0, 0, 0]))
    platform = np.asarray(platform, float)
    return Pose(
        qpos_of_state(state),
        platform[: Z + 1].copy(),
        np.array(quaternion(*platform[ROLL : YAW + 1])),
        has_base,
    )


def resting_platform(vehicle: Vehicle, inclination: float | None = None, azimuth: float = 0.0) -> np.ndarray:
    """Return the state (12,) of a platform at rest; without `inclination` [rad] that of the vehicle."""
    state = np.zeros(PLATFORM_SIZE)
    state[Z] = vehicle.platform_surface_height
    state[PITCH] = vehicle.platform_inclination if inclination is None else inclination
    state[YAW] = azimuth
    return state
