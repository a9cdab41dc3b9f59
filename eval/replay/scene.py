"""The geometry of the scene and of the vehicle, from the compiled MuJoCo models."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from inclined_landing.envs.rendering import scenery
from inclined_landing.envs.rendering.pose import pose_from_state, resting_platform
from inclined_landing.models.attitude import STATE_SIZE
from inclined_landing.models.vehicle import Vehicle

_KINDS = {
    mujoco.mjtGeom.mjGEOM_PLANE: "plane",
    mujoco.mjtGeom.mjGEOM_SPHERE: "sphere",
    mujoco.mjtGeom.mjGEOM_CAPSULE: "capsule",
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: "ellipsoid",
    mujoco.mjtGeom.mjGEOM_CYLINDER: "cylinder",
    mujoco.mjtGeom.mjGEOM_BOX: "box",
    mujoco.mjtGeom.mjGEOM_MESH: "mesh",
}


def scene(vehicle: Vehicle, inclination: float | None, azimuth: float = 0.0) -> dict[str, Any]:
    """Return the geoms of the world and of the vehicle at its true size, with names, sizes [m], poses and
    colours.

    Those of the world are in the world frame, those of the vehicle in the body frame. `low`: height of the
    foot tips in the body's frame; `feet`: their spheres; `scale`: magnification of the drawn vehicle.
    """
    pose = pose_from_state(np.zeros(STATE_SIZE), resting_platform(vehicle, inclination, azimuth))
    platform = None if inclination is None else (pose.platform_pos, pose.platform_quat)
    model = scenery.rendering_model(vehicle, platform, scale=1.0)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    moving = model.body_rootid[model.geom_bodyid] == model.body("crazyflie").id
    shown = model.geom_group <= scenery.VISUAL_GROUP
    slab = {  # centre and attitude of its surface, half length along the slope and half depth
        "position": _rounded(pose.platform_pos),
        "quaternion": _rounded(pose.platform_quat),
        "half": _rounded([vehicle.slab_half_length, 0.5 * vehicle.platform_depth]),
    }
    feet = [_geom(model, data, k) for k in range(model.ngeom) if model.geom(k).name.startswith("foot_")]
    return {
        "world": [_geom(model, data, k) for k in np.flatnonzero(shown & ~moving)],
        "vehicle": [_geom(model, data, k) for k in np.flatnonzero(shown & moving)],
        "feet": feet,
        "low": min(foot["position"][2] - foot["size"][0] for foot in feet),
        "scale": scenery.SCALE,
        "arena": [list(side) for side in (vehicle.arena_x, vehicle.arena_y, vehicle.arena_z)],
        "platform": None if inclination is None else slab,
    }


def _geom(model: mujoco.MjModel, data: mujoco.MjData, k: int) -> dict[str, Any]:
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, data.geom_xmat[k])
    material = model.geom_matid[k]
    found = {
        "name": model.geom(k).name,
        "kind": _KINDS[mujoco.mjtGeom(model.geom_type[k])],
        "size": _rounded(model.geom_size[k]),
        "position": _rounded(data.geom_xpos[k]),
        "quaternion": _rounded(quaternion),
        "colour": _rounded(model.geom_rgba[k] if material < 0 else model.mat_rgba[material]),
        "glow": 0.0 if material < 0 else float(model.mat_emission[material]),
    }
    if found["kind"] == "mesh":
        mesh = model.geom_dataid[k]
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        face, faces = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
        found["vertices"] = _rounded(model.mesh_vert[first : first + count].ravel())
        found["faces"] = model.mesh_face[face : face + faces].ravel().tolist()
    return found


def _rounded(values) -> list[float]:
    """Return numbers rounded to a micrometre."""
    return [round(float(value), 6) for value in values]
