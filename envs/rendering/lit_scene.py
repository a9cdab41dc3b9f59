"""The landing scene for ray casting: first hits, sunlight, and light reflected by surfaces.

Rays of one cast share their origin, so parallel rays (sunlight, orthographic cameras) start from a point
10 km away.
"""

from __future__ import annotations

import copy

import mujoco
import numpy as np

from inclined_landing.envs.rendering import scenery
from inclined_landing.envs.rendering.camera import FAR, dot

# Light in display units: what a white surface receives from above, below, the sun and +x.
_SKY, _GROUND, _SUN, _SIDE = 0.62, 0.46, 0.42, 0.05
SUN_RADIUS = 0.02  # rad; gives the platform's shadow its soft edge
SHADOW_BIAS = 1.5e-3  # m
_FLOOR = np.array([[0.865, 0.875, 0.9], [0.79, 0.815, 0.85]])  # squares of 1 m
_HAZE = np.array([0.865, 0.895, 0.935])  # of the floor far away
_WALL, _WALL_LINE = np.array([0.935, 0.958, 1.0]), np.array([0.76, 0.81, 0.90])
SCENE, FRAME, VEHICLE, UNSEEN = 0, 1, 2, 5  # geom groups of the private copy of the model


class LitScene:
    """A compiled model prepared for ray casting, with its own data."""

    def __init__(self, model: mujoco.MjModel):
        self.model, self.data = model, mujoco.MjData(model)
        m = model
        material, has = m.geom_matid, m.geom_matid >= 0
        self.rgba = np.where(has[:, None], m.mat_rgba[material], m.geom_rgba)
        self.specular = np.where(has, m.mat_specular[material], 0.2)
        self.shininess = np.where(has, m.mat_shininess[material], 0.3)
        self.emission = np.where(has, m.mat_emission[material], 0.0)
        frame = [k for k in range(m.ngeom) if m.geom(k).name.startswith("frame_")]
        self.floor, self.wall = m.geom("floor").id, m.geom("back_wall").id
        moving = m.body_rootid[m.geom_bodyid] == m.body("crazyflie").id
        shown = m.geom_group <= scenery.VISUAL_GROUP
        translucent = self.rgba[:, 3] < 1.0
        self.discs = np.flatnonzero(moving & shown & translucent)
        self.parts = np.flatnonzero(moving & shown & ~translucent)
        self.drawn = np.concatenate([self.parts, self.discs])  # of the vehicle
        group = np.full(m.ngeom, UNSEEN)
        group[~moving & shown] = SCENE
        group[self.parts] = VEHICLE
        group[frame] = FRAME
        self.emission[self.wall], self.emission[frame] = 0.9, 0.6  # even light
        m.geom_group[:] = group
        self.phase = np.array([self._blade_angle(k) for k in self.discs])
        direction = m.light_dir[0] / np.linalg.norm(m.light_dir[0])
        side = np.cross(direction, [0.0, 1.0, 0.0])
        side /= np.linalg.norm(side)
        self.sun = np.stack([side, np.cross(direction, side), direction])  # rows, the last one down
        self.sun_eye = np.array([0.0, 0.0, 1.0]) - FAR * direction
        self.base = self._base_rectangle()
        mujoco.mj_kinematics(model, self.data)

    def twin(self) -> LitScene:
        """Return the same scene for another thread: the model is shared, the data are not."""
        twin = copy.copy(self)
        twin.data = copy.copy(self.data)
        return twin

    def _blade_angle(self, disc: int) -> tuple[float, float]:
        """Return the angle of a blade on its disc [rad] and the sense of rotation, 1 or -1."""
        name = self.model.geom(disc).name.removeprefix("disc_")
        offset = self.model.geom(f"blade_{name}_0").pos - self.model.geom_pos[disc]
        x, y = self.model.geom_pos[disc][:2]
        return float(np.arctan2(offset[1], offset[0])), float(np.sign(x * y))

    def _base_rectangle(self) -> np.ndarray | None:
        """Return the base's footprint [[x0, y0], [x1, y1]] on the floor, for its contact shadow."""
        mesh = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_GEOM, "prism")
        if mesh < 0:
            return None
        size = self.model.geom_aabb[mesh]
        frame = np.zeros(9)
        mujoco.mju_quat2Mat(frame, self.model.geom_quat[mesh])
        centre = self.model.geom_pos[mesh] + frame.reshape(3, 3) @ size[:3]
        half = np.abs(frame.reshape(3, 3)) @ size[3:]
        return np.stack([centre[:2] - half[:2], centre[:2] + half[:2]])

    def cast(self, eye: np.ndarray, rays: np.ndarray, *groups: int, normals: bool = True):
        """Return first hits: geom (n,), -1 for none; distance (n,); normals (n, 3) or None."""
        n = len(rays)
        enabled = np.zeros(6, np.uint8)
        enabled[list(groups)] = 1
        geom, distance = np.full(n, -1, np.int32), np.full(n, -1.0)
        normal = np.zeros((n, 3)) if normals else None
        if n:
            mujoco.mj_multiRay(
                self.model, self.data, eye, np.ascontiguousarray(rays).ravel(), enabled, 1, -1,
                geom, distance, None if normal is None else normal.ravel(), n, mujoco.mjMAXVAL,
            )  # fmt: skip
        return geom, distance, normal

    def sunlit(self, points: np.ndarray, *groups: int, offset=(0.0, 0.0)) -> np.ndarray:
        """Return a mask (n,) of points (n, 3) with no geom of the groups between them and the sun."""
        eye = self.sun_eye + FAR * (offset[0] * self.sun[0] + offset[1] * self.sun[1])
        ray = points - eye
        axial = dot(ray, self.sun[2])
        _, distance, _ = self.cast(eye, ray / axial[:, None], *groups, normals=False)
        return (distance < 0) | (distance > axial - SHADOW_BIAS)

    def albedo(self, geom: np.ndarray, points: np.ndarray, footprint: np.ndarray) -> np.ndarray:
        """Return surface colours (n, 3); `footprint` (n,) is a pixel's size on them [m]."""
        colour = self.rgba[geom, :3].copy()
        on = geom == self.floor
        if on.any():
            colour[on] = _checker(points[on, :2], footprint[on])
            colour[on] *= (1.0 - self._corner_shade(points[on]))[:, None]
            haze = np.clip((np.hypot(*points[on, :2].T) - 6.0) / 12.0, 0.0, 1.0)[:, None]
            colour[on] += haze * (_HAZE - colour[on])
        on = geom == self.wall
        if on.any():
            colour[on] = _grid(points[on][:, [0, 2]], footprint[on])
            colour[on] *= (1.0 - 0.10 * np.exp(-points[on, 2] / 0.35))[:, None]
        return colour

    def _corner_shade(self, points: np.ndarray) -> np.ndarray:
        """Return the ambient occlusion (n,) of the floor (n, 3) next to the wall and the base."""
        away = np.minimum(points[:, 1] - self.model.geom_pos[self.wall][1], 0.0)
        shade = 0.12 * np.exp(away / 0.4)
        if self.base is not None:
            low, high = self.base
            outside = np.maximum(np.maximum(low - points[:, :2], points[:, :2] - high), 0.0)
            shade = shade + 0.30 * np.exp(-np.hypot(*outside.T) / 0.16)
        return np.minimum(shade, 0.6)

    def shade(self, geom, points, normal, unit, footprint):
        """Return colours (n, 3) of hits seen along `unit` (n, 3), in shadow and added by sunlight."""
        # Hemisphere ambient light, Lambert's cosine law for the sun, Blinn-Phong highlight, Fresnel-like rim:
        #   L = albedo (ambient(n) + sun max(n.s, 0)) + 0.35 k_s max(n.h, 0)^p + 0.1 k_s (1 - |n.v|)^3
        slope = dot(normal, unit)
        normal = np.where(slope[:, None] > 0, -normal, normal)
        sun = -self.sun[2]
        ambient = 0.5 * (_SKY + _GROUND) + 0.5 * (_SKY - _GROUND) * normal[:, 2]
        ambient += _SIDE * normal[:, 0]
        facing = np.maximum(dot(normal, sun), 0.0)
        gloss = np.maximum(dot(normal, unit_vectors(sun - unit)), 0.0)
        specular = self.specular[geom]
        glow = 0.35 * specular * gloss ** (8.0 + 60.0 * self.shininess[geom]) * (facing > 0)
        rim = 0.10 * specular * (1.0 - np.abs(slope)) ** 3
        emission = self.emission[geom]
        base = self.albedo(geom, points, footprint)
        shaded = base * (ambient * (1 - emission) + emission)[:, None] + rim[:, None]
        direct = base * (_SUN / sun[2] * facing * (1 - emission))[:, None] + glow[:, None]
        return shaded, direct


def unit_vectors(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (n, 3) normalised to length one."""
    return vectors / np.sqrt(dot(vectors, vectors))[:, None]


def _checker(xy: np.ndarray, footprint: np.ndarray) -> np.ndarray:
    """Return the colours of a checkerboard of 1 m, antialiased over the footprint."""
    distance = np.abs(np.mod(xy, 2.0) - 1.0) - 0.5  # signed distance to the nearest edge
    smooth = np.clip(2.0 * distance / np.maximum(footprint, 1e-4)[:, None], -1.0, 1.0)
    contrast = np.clip(1.5 - footprint, 0.0, 1.0)
    mix = 0.5 + 0.5 * smooth[:, 0] * smooth[:, 1] * contrast
    return _FLOOR[0] + mix[:, None] * (_FLOOR[1] - _FLOOR[0])


def _grid(xz: np.ndarray, footprint: np.ndarray) -> np.ndarray:
    """Return the colours of grid lines every metre, 8 mm wide, antialiased over the footprint."""
    line = 0.008
    distance = np.abs(np.mod(xz + 0.5, 1.0) - 0.5)
    wide = np.maximum(footprint, 1e-4)[:, None]
    cover = np.clip((0.5 * (line + wide) - distance) / wide, 0.0, 1.0)
    cover = np.minimum(cover, line / wide).max(axis=1)
    return _WALL + cover[:, None] * (_WALL_LINE - _WALL)
