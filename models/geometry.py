"""Distances between the collision shapes of vehicle and platform, without an engine.

The shapes are read from the compiled MuJoCo scene, so that the analytic plant and the start filters use the
same shapes as the engine. A vehicle is a set of spheres (foot capsules as their end points, rotor discs and
the body box as points on their outline), the platform a set of boxes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from inclined_landing.models.attitude import PITCH, ROLL, YAW, Z, rotation_entries, sine_cosine, to_world
from inclined_landing.models.compiled import inlined, inner, kernel
from inclined_landing.models.surface import slope_of
from inclined_landing.models.vehicle import Vehicle

PARTS = ("feet", "body", "rotors")
PART_BODIES = ("feet", "crazyflie", "rotors")
SURFACES = ("slab", "base", "floor")
PLATFORM_BODIES = ("platform", "base_left", "base_right", "base_core")
PLATFORM_GEOMS = ("slab", "wall_left", "wall_right", "core")
CONTACT_GEOMS = (*PLATFORM_GEOMS, "floor")
GEOM_SURFACE = (0, 1, 1, 1, 2)  # index into SURFACES of each of CONTACT_GEOMS
PARKED = -100.0  # height of an absent platform [m]
_RIM_POINTS = 16


class Shapes(NamedTuple):
    """Collision shapes of m vehicles that differ only in size: spheres in the vehicles' frames, and the boxes
    of their platforms, which are the same for all, in the frames of PLATFORM_BODIES.
    """

    centres: np.ndarray  # (m, k, 3) m
    radii: np.ndarray  # (m, k) m
    reach: np.ndarray  # (m,) no shape is farther than this from the vehicle's origin, m
    hulls: np.ndarray  # (m, 3, 3) m, of each part: width about the vehicle's axis, lowest and highest height
    parts: np.ndarray  # (k,) index into PARTS
    box_centres: np.ndarray  # (4, 3) m
    box_sizes: np.ndarray  # (4, 3) half sizes, m

    @classmethod
    def of(cls, members: Sequence[Shapes]) -> Shapes:
        """Return the shapes of all the vehicles of `members`."""
        of_all = {k: np.concatenate([getattr(s, k) for s in members]) for k in cls._fields[:4]}
        return members[0]._replace(**of_all)

    @property
    def are_equal(self) -> bool:
        """Whether all vehicles have the shape of the first, the only one here."""
        return len(self.reach) == 1


def shapes_of(model: mujoco.MjModel) -> Shapes:
    """Return the shapes of the vehicle of a compiled scene."""
    centres, radii, parts = [], [], []
    for part, body in enumerate(PART_BODIES):
        identity = model.body(body).id
        for geom in range(model.ngeom):
            if model.geom_bodyid[geom] != identity or not model.geom_contype[geom]:
                continue
            offset = model.geom_pos[geom] + (0 if body == "crazyflie" else model.body_pos[identity])
            frame = np.zeros(9)
            mujoco.mju_quat2Mat(frame, model.geom_quat[geom])
            points, radius = _outline(int(model.geom_type[geom]), model.geom_size[geom])
            centres.append(offset + points @ frame.reshape(3, 3).T)
            radii += [radius] * len(points)
            parts += [part] * len(points)
    at, sizes = np.concatenate(centres), np.array(radii)
    reach = (np.linalg.norm(at, axis=1) + sizes).max()
    hulls = np.array([_hull(at[of], sizes[of]) for of in (np.array(parts) == k for k in range(len(PARTS)))])
    geoms = [model.geom(name) for name in PLATFORM_GEOMS]
    boxes = np.array([g.pos for g in geoms]), np.array([g.size for g in geoms])
    return Shapes(at[None], sizes[None], np.array([reach]), hulls[None], np.array(parts), *boxes)


def _hull(centres: np.ndarray, radii: np.ndarray) -> tuple[float, float, float]:
    """Return the row of `Shapes.hulls` of the spheres of one part."""
    x, y, z = centres.T
    return (np.hypot(x, y) + radii).max(), (z - radii).min(), (z + radii).max()


def reach_below(shapes: Shapes, up=(0.0, 0.0, 1.0), *, lowered=0.0, part: str | None = None) -> np.ndarray:
    """Return the reach [m] of the first vehicle's shapes below its centre of mass, (...,).

    up (..., 3): the direction that counts as up, in the vehicle's axes.
    lowered (...): additional length of its feet, compared with the model [m]. part: only this one of PARTS.
    """
    of = slice(None) if part is None else shapes.parts == PARTS.index(part)
    up = np.asarray(up, float)[..., None, :]
    feet = shapes.parts[of] == PARTS.index("feet")
    x, y, z = shapes.centres[0, of].T
    z = z - np.where(feet, np.asarray(lowered, float)[..., None], 0.0)
    return (shapes.radii[0, of] - (up[..., 0] * x + up[..., 1] * y + up[..., 2] * z)).max(axis=-1)


def _outline(kind: int, size: np.ndarray) -> tuple[np.ndarray, float]:
    """Return sphere centres (k, 3) in the frame of one geom, and their radius [m]."""
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return np.zeros((1, 3)), size[0]
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return np.array([[0, 0, -size[1]], [0, 0, size[1]]]), size[0]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        return signs * size, 0.0
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        angle = np.arange(_RIM_POINTS) * (2 * np.pi / _RIM_POINTS)
        rim = size[0] - size[1]  # the sphere of radius size[1] ends where the disc ends
        return np.stack([rim * np.cos(angle), rim * np.sin(angle), 0 * angle], axis=1), size[1]
    raise ValueError(f"collision geoms of type {kind} are not supported")


def platform_poses(inclination, present, vehicle: Vehicle, surface_height=None, azimuth=0.0):
    """Return the poses of PLATFORM_BODIES for platforms of the given inclinations.

    inclination (n,) [rad], present (n,) bool, surface_height (n,) [m] if it is not the vehicle's, azimuth
    (n,) or a number [rad] by which the whole platform is turned about the vertical. The result is positions
    (n, 4, 3) [m] and quaternions (n, 4, 4). The slab's top surface passes through (0, 0, surface_height); the
    walls are under its two edges, and the core fills the space below the lower edge. Absent platforms are
    parked far below the floor.
    """
    angles = np.empty((3, len(inclination)))
    angles[0], angles[1] = inclination, azimuth
    angles[2] = vehicle.platform_surface_height if surface_height is None else surface_height
    poses = np.zeros((len(inclination), 4, 3)), np.zeros((len(inclination), 4, 4))
    size = vehicle.slab_half_length, vehicle.platform_thickness
    _platform_poses(*angles, np.asarray(present, bool), *size, *poses)
    return poses


@kernel
def _platform_poses(inclination, azimuth, height, present, half, thickness, position, quaternion):
    for i in range(len(position)):
        slope, turn, p, q = inclination[i], azimuth[i], position[i], quaternion[i]
        underside = thickness / math.cos(slope)  # measured vertically
        run, rise = half * math.cos(slope), -half * math.sin(slope)
        p[0, 2] = height[i]
        for wall, x in ((1, -run), (2, run)):
            p[wall, 0], p[wall, 1] = x * math.cos(turn), x * math.sin(turn)
        p[1, 2], p[2, 2] = height[i] - rise - underside, height[i] + rise - underside
        p[3, 2] = height[i] - abs(rise) - underside
        cos, sin = math.cos(turn / 2), math.sin(turn / 2)
        leaning, upright = math.sin(slope / 2), math.cos(slope / 2)
        for b in range(4):
            q[b, 0], q[b, 3] = cos, sin
            if not present[i]:
                p[b, 2] = PARKED
        # Number by number: an assignment of a tuple compiles numba's text of its error, which takes 2 s.
        q[0, 0], q[0, 1], q[0, 2], q[0, 3] = cos * upright, 0.0 - sin * leaning, cos * leaning, sin * upright


@inlined
def _in_body(x, y, z, turns):
    """Return a vector in the axes of a body of the platform; turns as in `_box_distance`."""
    # p = Ry(-inclination) Rx(-roll) Rz(-azimuth) (x - position)
    turn, lean, tilt = turns
    x, y = turn[1] * x + turn[0] * y, turn[1] * y - turn[0] * x
    if lean[0] != 0.0:
        y, z = lean[1] * y + lean[0] * z, lean[1] * z - lean[0] * y
    return tilt[1] * x - tilt[0] * z, y, tilt[0] * x + tilt[1] * z


@inlined
def _box_distance(dx, dy, dz, turns, centres, sizes, b):
    """Return the signed distance [m] of a point to box b of the platform, negative inside.

    dx, dy, dz [m]: position of the point relative to the origin of the box's body; turns: angles of the body,
    as (sine, cosine) of azimuth, roll and inclination; centres and half sizes (4, 3) [m] of the boxes in
    their bodies.
    """
    dx, dy, dz = _in_body(dx, dy, dz, turns)
    # q = |p - centre| - size; distance = |max(q, 0)| + min(max(q_x, q_y, q_z), 0)
    dx = abs(dx - centres[b, 0]) - sizes[b, 0]
    dy = abs(dy - centres[b, 1]) - sizes[b, 1]
    dz = abs(dz - centres[b, 2]) - sizes[b, 2]
    x, y, z = max(dx, 0.0), max(dy, 0.0), max(dz, 0.0)
    return math.sqrt(x * x + y * y + z * z) + min(max(dx, dy, dz), 0.0)


_UPRIGHT = (0.0, 1.0)  # sine, cosine of no angle


@inlined
def platform_turns(roll, inclination, azimuth):
    """Return the angles of a platform for `platform_distance`, each as (sine, cosine)."""
    lean = sine_cosine(roll) if roll != 0.0 else _UPRIGHT
    return sine_cosine(azimuth), lean, sine_cosine(inclination)


@inlined
def platform_distance(x, y, z, turns, position, boxes, sizes):
    """Return the signed distance [m] of a point to a platform.

    turns: from `platform_turns`; position (4, 3) from `platform_poses`.
    """
    base = turns[0], _UPRIGHT, _UPRIGHT  # only the slab is tilted
    dx, dy, dz = x - position[0, 0], y - position[0, 1], z - position[0, 2]
    nearest = _box_distance(dx, dy, dz, turns, boxes, sizes, 0)
    for b in range(1, len(sizes)):
        dx, dy, dz = x - position[b, 0], y - position[b, 1], z - position[b, 2]
        nearest = min(nearest, _box_distance(dx, dy, dz, base, boxes, sizes, b))
    return nearest


def platform_reach(vehicle: Vehicle) -> float:
    """Return the horizontal reach [m] of slab and base from their centre, and their reach above it."""
    return math.hypot(vehicle.slab_half_length, 0.5 * vehicle.platform_depth, vehicle.slab_depth)


@kernel
def _clearances(state, inclination, azimuth, position, which, shapes, within, out):
    """Write the smallest distance (n, 3 surfaces, 3 parts) of the vehicles' shapes to the scene [m]."""
    boxes, sizes = shapes.box_centres, shapes.box_sizes
    for i in range(state.shape[0]):
        member, x, y, z = which[i], state[i, 0], state[i, 1], state[i, 2]
        for surface in range(3):
            for part in range(3):
                out[i, surface, part] = math.inf
        near_floor = z < 2.0 * shapes.reach[member]
        slab = platform_turns(0.0, inclination[i], azimuth[i])
        base = slab[0], _UPRIGHT, _UPRIGHT
        if not near_floor:
            nearest = platform_distance(x, y, z, slab, position[i], boxes, sizes)
            if nearest - shapes.reach[member] > within:
                continue
        r = rotation_entries(sine_cosine(state[i, 6]), sine_cosine(state[i, 7]), sine_cosine(state[i, 8]))
        for k in range(shapes.centres.shape[1]):
            cx, cy, cz = (
                shapes.centres[member, k, 0],
                shapes.centres[member, k, 1],
                shapes.centres[member, k, 2],
            )
            cx, cy, cz = to_world(r, cx, cy, cz)
            px, py, pz = x + cx, y + cy, z + cz
            part, radius = shapes.parts[k], shapes.radii[member, k]
            if near_floor:
                out[i, 2, part] = min(out[i, 2, part], pz - radius)
            for b in range(sizes.shape[0]):
                dx, dy, dz = px - position[i, b, 0], py - position[i, b, 1], pz - position[i, b, 2]
                turns = slab if b == 0 else base
                distance = _box_distance(dx, dy, dz, turns, boxes, sizes, b) - radius
                surface = 0 if b == 0 else 1
                out[i, surface, part] = min(out[i, surface, part], distance)


@inlined
def reach_against(cosine, hull, lowered):
    """Return the reach [m] of a vehicle against a direction, from the cosine between that and its axis.

    hull (3, 3): a row of `Shapes.hulls`; lowered [m]: see `reach_below`.
    """
    sine, reach = math.sqrt(max(0.0, 1.0 - cosine * cosine)), -math.inf
    for part in range(3):
        low, high = hull[part, 1] - (lowered if part == 0 else 0.0), hull[part, 2]
        reach = max(reach, hull[part, 0] * sine + max(-low * cosine, -high * cosine))
    return reach


@inner
def hull_distance(place, axis, turns, position, shapes, member, lowered):
    """Return a lower bound of the distance [m] of a vehicle's shapes to a platform; -inf inside of it.

    place, axis (3,): position and thrust axis of the vehicle in the world; turns, position as in
    `platform_distance`; member: its index in `shapes`. The line from the nearest point of a box to the
    vehicle's centre is the normal of a plane that has the whole box on its other side.
    """
    least, base = math.inf, (turns[0], _UPRIGHT, _UPRIGHT)
    for b in range(len(shapes.box_sizes)):
        of = turns if b == 0 else base
        dx, dy, dz = place[0] - position[b, 0], place[1] - position[b, 1], place[2] - position[b, 2]
        dx, dy, dz = _in_body(dx, dy, dz, of)
        ax, ay, az = _in_body(axis[0], axis[1], axis[2], of)
        dx, dy, dz = (
            dx - shapes.box_centres[b, 0],
            dy - shapes.box_centres[b, 1],
            dz - shapes.box_centres[b, 2],
        )
        sizes = shapes.box_sizes[b]
        dx -= min(sizes[0], max(-sizes[0], dx))
        dy -= min(sizes[1], max(-sizes[1], dy))
        dz -= min(sizes[2], max(-sizes[2], dz))
        distance = math.sqrt(dx * dx + dy * dy + dz * dz)
        if distance == 0.0:
            return -math.inf
        cosine = (ax * dx + ay * dy + az * dz) / distance
        least = min(least, distance - reach_against(cosine, shapes.hulls[member], lowered))
    return least


def platform_clearances(state, platform, present, vehicle: Vehicle, shapes: Shapes, which=None) -> np.ndarray:
    """Return the distance (n,) [m] of vehicles in states (n, 13) to their platforms (n, 12).

    which (n,): index of each in `shapes`. Every platform has a base as in `platform_poses`, for its present
    slope. Distances are negative if shapes overlap, and more than 50 m to absent platforms.
    """
    inclination, azimuth, rolled = platform[:, PITCH], platform[:, YAW], platform[:, ROLL] != 0.0
    if rolled.any():
        inclination, azimuth = np.where(rolled, slope_of(platform), (inclination, azimuth))
    position, _ = platform_poses(inclination, present, vehicle, platform[:, Z], azimuth)
    position[:, :, :Z] += platform[:, None, :Z]
    distance = clearances(state, inclination, position, shapes, azimuth=azimuth, which=which)
    return distance[:, :2].min(axis=(1, 2))


def clearances(
    state, inclination, position, shapes: Shapes, out=None, azimuth=0.0, which=None, within=math.inf
) -> np.ndarray:
    """Return the signed distance [m] of every part to every surface, (n, 3 surfaces, 3 parts).

    state (n, 13), inclination and azimuth (n,) or a number [rad], position (n, 4, 3) from
    `platform_poses`; which (n,): index of each in `shapes`. Distances are negative if shapes overlap. The
    floor's entry is inf for vehicles well above it, and all entries may be inf if all distances exceed
    `within`.
    """
    which = np.zeros(len(state), int) if which is None else np.asarray(which)
    angles = np.empty((2, len(state)))
    angles[0], angles[1] = inclination, azimuth
    out = np.empty((len(state), 3, 3)) if out is None else out
    _clearances(np.ascontiguousarray(state), *angles, position, which, shapes, float(within), out)
    return out
