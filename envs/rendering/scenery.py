"""The drawn scene: pure MjSpec transformations of the simulated scene."""

from __future__ import annotations

import mujoco
import numpy as np

from inclined_landing.envs.rendering.camera import look_at, nearest_position
from inclined_landing.envs.rendering.pose import qpos_of_state
from inclined_landing.models.scene import build_spec
from inclined_landing.models.vehicle import Vehicle

SCALE = 3.0  # the vehicle is a few pixels wide in a full view: it is drawn this much larger
VISUAL_GROUP = 2
_DISC_ALPHA = 0.22  # of the rotors' discs, which the scene leaves unseen
CLOSE_CAMERAS = ("closeup", "onboard")  # there it is drawn in its own size
_FRAME_RADIUS = 0.006  # m
# The camera `arena` looks along this line, and the arena fills this share of its picture: the caption and the
# drawn size of a vehicle at the edge need the rest.
_ALONG = (0.30, 0.95, -0.22)
_FOVY = 32.0  # deg
_FILLED = (0.96, 0.86)  # of width and height
_FAR_FRAME_RADIUS = 0.011  # m; thinner bars would be less than a pixel wide from there
_UPPER_FRONT = (1, 4)  # the bar along x at the lowest y and the highest z


def rendering_model(
    vehicle: Vehicle,
    platform: tuple[np.ndarray, np.ndarray] | None,
    *,
    has_base: bool = True,
    scale: float = SCALE,
    aspect: float = 4 / 3,
    far: bool = False,
) -> mujoco.MjModel:
    """Return the drawn model: visual geoms only, a closed base, the arena's edges, the camera `arena`.

    aspect: width over height of the picture. far: draw the edges for a camera that shows all of them.
    platform: (position (3,), quaternion (4,)) of the slab, None for an arena without one. has_base: whether
    it has a base; without one it is a mocap body that can be moved.
    scale: size of the drawn vehicle, see `scale_vehicle`.
    """
    spec = build_spec(vehicle)
    # These are not drawn; skins are, but rays miss them.
    for element in [*spec.actuators, *spec.sensors, *spec.keys, *spec.skins]:
        spec.delete(element)
    add_frame(spec, vehicle, _FAR_FRAME_RADIUS if far else _FRAME_RADIUS)
    spec.material("disc").rgba[3] = _DISC_ALPHA
    add_arena_camera(spec, vehicle, aspect)
    scale_vehicle(spec, scale)
    body = spec.body("platform")
    if platform is None:
        spec.delete(body)
    else:
        body.pos, body.quat = platform
        if has_base:
            add_prism(spec, *platform)
    for geom in list(spec.geoms):  # rays would try those that collide unseen; `scaled_centres` needs the feet
        if geom.group > VISUAL_GROUP and not geom.name.startswith("foot_"):
            spec.delete(geom)
    for geom in spec.geoms:  # the engine's ray culling knows colliding geoms only
        geom.contype = geom.conaffinity = 1
    return spec.compile()


def scale_vehicle(spec: mujoco.MjSpec, factor: float) -> None:
    """Draw the vehicle `factor` times its size, anchored at the centre of its four foot tips.

    The drawn feet are then on the same surface as the real feet. Only visual geoms change.
    """
    feet = [geom for geom in spec.geoms if geom.name.startswith("foot_")]
    anchor = np.array([0.0, 0.0, min(geom.pos[2] - geom.size[0] for geom in feet)])
    for geom in spec.geoms:
        if geom.group != VISUAL_GROUP:
            continue
        if np.isfinite(geom.fromto[0]):
            ends = np.asarray(geom.fromto).reshape(2, 3)
            geom.fromto = (anchor + factor * (ends - anchor)).ravel()
        else:
            geom.pos = anchor + factor * (np.asarray(geom.pos) - anchor)
        geom.size = factor * np.asarray(geom.size)


def scaled_centres(model: mujoco.MjModel, states, factor: float) -> np.ndarray:
    """Return the points (k, 3) [m] to which `scale_vehicle` moves the centre of mass of states (k, 13)."""
    qpos = qpos_of_state(states)
    feet = [k for k in range(model.ngeom) if model.geom(k).name.startswith("foot_")]
    low = (model.geom_pos[feet, 2] - model.geom_size[feet, 0]).min()
    frame, points = np.zeros(9), []
    for row in qpos:
        mujoco.mju_quat2Mat(frame, row[3:7])
        anchor = row[:3] + low * frame.reshape(3, 3)[:, 2]
        points.append(anchor + factor * (row[:3] - anchor))
    return np.array(points)


def add_prism(spec: mujoco.MjSpec, position, quaternion) -> None:
    """Add the base as a closed prism between slab and floor.

    Its eight corners are the slab's lower corners and their projections on the floor, for any pose
    of the slab.
    """
    half = np.asarray(spec.geom("slab_drawn").size) * [1.0, 1.0, 2.0] - [0.002, 0.002, 0.0]
    frame = np.zeros(9)
    mujoco.mju_quat2Mat(frame, np.asarray(quaternion, float))
    signs = np.array([(-1, -1), (-1, 1), (1, 1), (1, -1)], float)
    corners = np.column_stack([signs * half[:2], np.full(4, -half[2])])
    top = np.asarray(position) + corners @ frame.reshape(3, 3).T
    bottom = top * [1.0, 1.0, 0.0]
    faces = []
    for i in range(4):
        j = (i + 1) % 4
        faces += [(i, j, 4 + j), (i, 4 + j, 4 + i)]
    faces += [(0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7)]
    mesh = spec.add_mesh(name="prism")
    mesh.uservert = np.vstack([top, bottom]).ravel()
    mesh.userface = np.array(faces).ravel()
    spec.worldbody.add_geom(
        name="prism", type=mujoco.mjtGeom.mjGEOM_MESH, meshname="prism", group=1,
        contype=0, conaffinity=0, material="base",
    )  # fmt: skip


def arena_corners(vehicle: Vehicle) -> np.ndarray:
    """Return the corners (8, 3) of the arena [m]; bits 4, 2, 1 of the row: upper bound in x, y, z."""
    x, y, z = vehicle.arena_x, vehicle.arena_y, vehicle.arena_z
    return np.array([(a, b, c) for a in x for b in y for c in z])


def add_arena_camera(spec: mujoco.MjSpec, vehicle: Vehicle, aspect: float) -> None:
    """Add the camera `arena`, which sees the whole arena at any aspect ratio."""
    axes = look_at((0, 0, 0), _ALONG, 1, 1).axes
    half = np.tan(0.5 * np.radians(_FOVY))
    filled = aspect * half * _FILLED[0], half * _FILLED[1]
    right, up, forward = axes
    position = nearest_position(arena_corners(vehicle), axes, *filled)
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.column_stack([right, up, -forward]).ravel())
    spec.worldbody.add_camera(name="arena", pos=position, quat=quat, fovy=_FOVY)


def add_frame(spec: mujoco.MjSpec, vehicle: Vehicle, radius: float = _FRAME_RADIUS) -> None:
    """Add the edges of the arena as thin bars, except the upper front one, which would hide the scene."""
    corners = arena_corners(vehicle)
    for i in range(8):
        for bit in (1, 2, 4):
            if not i & bit and (i, bit) != _UPPER_FRONT:
                spec.worldbody.add_geom(
                    name=f"frame_{i}_{bit}", type=mujoco.mjtGeom.mjGEOM_CAPSULE, group=1,
                    contype=0, conaffinity=0, size=[radius, 0, 0], material="frame",
                    fromto=[*corners[i], *corners[i | bit]],
                )  # fmt: skip
