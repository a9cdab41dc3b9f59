"""A ray-cast renderer on `mujoco.mj_multiRay`: no OpenGL, deterministic.

The picture is made of layers. The background (floor, wall, platform, arena edges) depends on the
camera and the platform's pose only and is kept; each frame casts rays for the pixels that the
vehicle and its shadow can touch. Rays of one cast share their origin, so parallel rays (sunlight,
orthographic cameras) start from a point 10 km away.
"""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np

from inclined_landing.envs.rendering import overlay, scenery
from inclined_landing.envs.rendering.camera import FAR, View, camera_view, dot
from inclined_landing.envs.rendering.pose import Ghost, Pose, hang_load
from inclined_landing.envs.rendering.renderer import Drawing, SceneRenderer

# Light in display units: what a white surface receives from above, below, the sun and +x.
_SKY, _GROUND, _SUN, _SIDE = 0.62, 0.46, 0.42, 0.05
_SUN_RADIUS = 0.02  # rad; gives the platform's shadow its soft edge
_TALLEST = 2.0  # m; the soft edge of a shadow grows with the height of what casts it
_SHADOW_BIAS = 1.5e-3  # m
_SKY_LOW, _SKY_HIGH = np.array([0.90, 0.93, 0.97]), np.array([0.82, 0.87, 0.94])
_FLOOR = np.array([[0.865, 0.875, 0.9], [0.79, 0.815, 0.85]])  # squares of 1 m
_HAZE = np.array([0.865, 0.895, 0.935])  # of the floor far away
_WALL, _WALL_LINE = np.array([0.935, 0.958, 1.0]), np.array([0.76, 0.81, 0.90])
_SCENE, _FRAME, _VEHICLE, _UNSEEN = 0, 1, 2, 5  # geom groups of the private copy of the model
_CACHED_GHOSTS = 32
_EDGE = np.array([(i, j) for j in (0.25, 0.75) for i in (0.25, 0.75)])  # sub-pixel positions
_FINE = np.array([(i / 8, j / 8) for j in (1, 3, 5, 7) for i in (1, 3, 5, 7)])


@dataclasses.dataclass
class _Background:
    """The scene without the vehicle, in sunlight and in shadow."""

    lit: np.ndarray  # (h, w, 3) float32
    dark: np.ndarray  # (h, w, 3) float32, the same in the vehicle's shadow
    depth: np.ndarray  # (h, w) float32, axial distance from the eye [m]
    light: np.ndarray  # (h, w, 3) float32, the surface points in the frame of the light [m]
    frame: np.ndarray  # (h, w, 3) uint8, `lit` as it is shown
    ghosts: dict = dataclasses.field(default_factory=dict)  # layers seen from the same camera


class _Scene:
    """A compiled model prepared for ray casting, with its own data."""

    def __init__(self, model: mujoco.MjModel):
        self.model, self.data = model, mujoco.MjData(model)
        m = model
        joint = m.joint("crazyflie")
        self.body, self.qpos = int(joint.bodyid[0]), int(joint.qposadr[0])
        material, has = m.geom_matid, m.geom_matid >= 0
        self.rgba = np.where(has[:, None], m.mat_rgba[material], m.geom_rgba)
        self.specular = np.where(has, m.mat_specular[material], 0.2)
        self.shininess = np.where(has, m.mat_shininess[material], 0.3)
        self.emission = np.where(has, m.mat_emission[material], 0.0)
        frame = [k for k in range(m.ngeom) if m.geom(k).name.startswith("frame_")]
        self.floor, self.wall = m.geom("floor").id, m.geom("back_wall").id
        moving = m.body_rootid[m.geom_bodyid] == m.body_rootid[self.body]
        shown = m.geom_group <= scenery.VISUAL_GROUP
        translucent = self.rgba[:, 3] < 1.0
        self.discs = np.flatnonzero(moving & shown & translucent)
        self.parts = np.flatnonzero(moving & shown & ~translucent)
        group = np.full(m.ngeom, _UNSEEN)
        group[~moving & shown] = _SCENE
        group[self.parts] = _VEHICLE
        group[frame] = _FRAME
        self.emission[self.wall], self.emission[frame] = 0.9, 0.6  # even light
        m.geom_group[:] = group
        self.phase = np.array([self._blade_angle(k) for k in self.discs])
        direction = m.light_dir[0] / np.linalg.norm(m.light_dir[0])
        side = np.cross(direction, [0.0, 1.0, 0.0])
        side /= np.linalg.norm(side)
        self.sun = np.stack([side, np.cross(direction, side), direction])  # rows, the last one down
        self.sun_eye = np.array([0.0, 0.0, 1.0]) - FAR * direction
        self.base = self._base_rectangle()
        self.casters = np.flatnonzero((group == _SCENE) & (m.geom_rbound > 0))  # planes have none
        self.place(np.array([0.0, 0.0, -100.0, 1.0, 0.0, 0.0, 0.0]))
        self.shadow_box = self._shadow_box()

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

    def _shadow_box(self) -> np.ndarray:
        """Return the rectangle [low (2,), high (2,)] across the light that holds all static shadows."""
        if not len(self.casters):
            return np.zeros((2, 2))
        centre = self.data.geom_xpos[self.casters] @ self.sun[:2].T
        bound = self.model.geom_rbound[self.casters][:, None] + 2.0 * _SUN_RADIUS * _TALLEST
        return np.stack([(centre - bound).min(axis=0), (centre + bound).max(axis=0)])

    def move_platform(self, position: np.ndarray, quaternion: np.ndarray) -> None:
        """Move the slab of a model without base."""
        k = int(self.model.body("platform").mocapid[0])
        self.data.mocap_pos[k], self.data.mocap_quat[k] = position, quaternion
        mujoco.mj_kinematics(self.model, self.data)
        self.shadow_box = self._shadow_box()

    def place(self, qpos: np.ndarray) -> None:
        self.data.qpos[self.qpos : self.qpos + 7] = qpos
        hang_load(self.model, self.data)
        mujoco.mj_kinematics(self.model, self.data)

    def view(self, camera, width: int, height: int) -> View:
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        return camera_view(self.model, self.data, camera, width, height)

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

    def may_be_shadowed(self, points: np.ndarray) -> np.ndarray:
        """Return a mask (n,) of points (n, 3), False outside every shadow of the platform."""
        low, high = self.shadow_box
        u, v = dot(points, self.sun[0]), dot(points, self.sun[1])
        return (u > low[0]) & (u < high[0]) & (v > low[1]) & (v < high[1])

    def sunlit(self, points: np.ndarray, *groups: int, offset=(0.0, 0.0)) -> np.ndarray:
        """Return a mask (n,) of points (n, 3) with no geom of the groups between them and the sun."""
        eye = self.sun_eye + FAR * (offset[0] * self.sun[0] + offset[1] * self.sun[1])
        ray = points - eye
        axial = dot(ray, self.sun[2])
        _, distance, _ = self.cast(eye, ray / axial[:, None], *groups, normals=False)
        return (distance < 0) | (distance > axial - _SHADOW_BIAS)

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
        """Return the ambient occlusion (n,) of the floor (n, 3) beside the wall and the base."""
        beside = np.minimum(points[:, 1] - self.model.geom_pos[self.wall][1], 0.0)
        shade = 0.12 * np.exp(beside / 0.4)
        if self.base is not None:
            low, high = self.base
            outside = np.maximum(np.maximum(low - points[:, :2], points[:, :2] - high), 0.0)
            shade = shade + 0.30 * np.exp(-np.hypot(*outside.T) / 0.16)
        return np.minimum(shade, 0.6)

    def shade(self, geom, points, normal, unit, footprint):
        """Return colours (n, 3) of hits seen along `unit` (n, 3): in shadow, and what sunlight adds."""
        # Hemisphere ambient light, Lambert's cosine law for the sun, Blinn-Phong highlight, Fresnel-like rim:
        #   L = albedo (ambient(n) + sun max(n.s, 0)) + 0.35 k_s max(n.h, 0)^p + 0.1 k_s (1 - |n.v|)^3
        slope = dot(normal, unit)
        normal = np.where(slope[:, None] > 0, -normal, normal)
        sun = -self.sun[2]
        ambient = 0.5 * (_SKY + _GROUND) + 0.5 * (_SKY - _GROUND) * normal[:, 2]
        ambient += _SIDE * normal[:, 0]
        facing = np.maximum(dot(normal, sun), 0.0)
        gloss = np.maximum(dot(normal, _unit(sun - unit)), 0.0)
        specular = self.specular[geom]
        glow = 0.35 * specular * gloss ** (8.0 + 60.0 * self.shininess[geom]) * (facing > 0)
        rim = 0.10 * specular * (1.0 - np.abs(slope)) ** 3
        emission = self.emission[geom]
        base = self.albedo(geom, points, footprint)
        shaded = base * (ambient * (1 - emission) + emission)[:, None] + rim[:, None]
        direct = base * (_SUN / sun[2] * facing * (1 - emission))[:, None] + glow[:, None]
        return shaded, direct


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (n, 3) normalised to length one."""
    return vectors / np.sqrt(dot(vectors, vectors))[:, None]


def _checker(xy: np.ndarray, footprint: np.ndarray) -> np.ndarray:
    """Return the colours of a checkerboard of 1 m, antialiased over the footprint."""
    distance = np.abs(np.mod(xy, 2.0) - 1.0) - 0.5  # signed distance to the nearest edge
    smooth = np.clip(2.0 * distance / np.maximum(footprint, 1e-4)[:, None], -1.0, 1.0)
    contrast = np.clip(1.5 - footprint, 0.0, 1.0)
    mix = 0.5 + 0.5 * smooth[:, 0] * smooth[:, 1] * contrast
    return _FLOOR[0] + mix[:, None] * (_FLOOR[1] - _FLOOR[0])


def _grid(xz: np.ndarray, footprint: np.ndarray, line: float = 0.008) -> np.ndarray:
    """Return the colours of grid lines every metre, antialiased over the footprint."""
    distance = np.abs(np.mod(xz + 0.5, 1.0) - 0.5)
    wide = np.maximum(footprint, 1e-4)[:, None]
    cover = np.clip((0.5 * (line + wide) - distance) / wide, 0.0, 1.0)
    cover = np.minimum(cover, line / wide).max(axis=1)
    return _WALL + cover[:, None] * (_WALL_LINE - _WALL)


def _edges(label: np.ndarray, reach: int = 1) -> np.ndarray:
    """Return a mask (h, w) of pixels whose neighbourhood holds more than one label."""
    mask = np.zeros(label.shape, bool)
    across, down = label[:, 1:] != label[:, :-1], label[1:] != label[:-1]
    mask[:, 1:] |= across
    mask[:, :-1] |= across
    mask[1:] |= down
    mask[:-1] |= down
    for _ in range(reach - 1):
        mask = _grown(mask)
    return mask


def _grown(mask: np.ndarray) -> np.ndarray:
    """Return the mask (h, w) dilated to its eight neighbours."""
    wide = mask.copy()
    wide[:, 1:] |= mask[:, :-1]
    wide[:, :-1] |= mask[:, 1:]
    tall = wide.copy()
    tall[1:] |= wide[:-1]
    tall[:-1] |= wide[1:]
    return tall


class RayRenderer(SceneRenderer):
    """Renderer of the landing scene by ray casting; see `make_renderer`."""

    backend = "ray"

    def _prepare(self, model: mujoco.MjModel) -> None:
        self._scene = _Scene(model)
        self.model = model
        self._cached_background: tuple = (None, None)

    def _move_platform(self, pose: Pose) -> None:
        self._scene.move_platform(pose.platform_pos, pose.platform_quat)

    def close(self) -> None:
        """Discard the cached background."""
        self._cached_background = (None, None)

    def _draw(self, pose: Pose, drawing: Drawing) -> np.ndarray:
        view = self._view(pose)
        back = self._background(view)
        copies: list[tuple[np.ndarray, Ghost | None]] = [(ghost.qpos, ghost) for ghost in drawing.ghosts]
        copies += [(pose.qpos, None)] if drawing.show_vehicle else []
        drawn = self._draw_foreground(view, back, copies, drawing)
        frame = back.frame.copy()
        if drawn is not None:
            h, w = drawn.depth.shape
            part = frame[drawn.row : drawn.row + h, drawn.column : drawn.column + w]
            part[:] = _as_uint8(drawn.colour)
        return frame

    # --- scene and background -------------------------------------------------------------------

    def _view(self, pose: Pose) -> View:
        self._scene.place(pose.qpos)
        if isinstance(self.camera, View):
            return self.camera
        return self._scene.view(self.camera, self.width, self.height)

    def _background(self, view: View) -> _Background:
        """Return the picture without the vehicle, cached while neither camera nor platform moves."""
        key = (
            view.origin.tobytes(),
            view.axes.tobytes(),
            self._scene.data.mocap_pos.tobytes(),
            self._scene.data.mocap_quat.tobytes(),
        )
        if key != self._cached_background[0]:
            model = self._scene.model
            fixed = isinstance(self.camera, View) or model.camera(self.camera).bodyid[0] == 0
            self._cached_background = (key, self._draw_background(view, fine=fixed))
        return self._cached_background[1]

    def _draw_background(self, view: View, fine: bool) -> _Background:
        scene, h, w = self._scene, self.height, self.width
        column, row = np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5)
        column, row = column.ravel(), row.ravel()
        lit, dark, depth, points, label = self._scene_samples(view, column, row, (0.0, 0.0))
        label = label.reshape(h, w)
        mask = _edges(label >> 1)
        shadow = _edges(label & 1, reach=max(1, h // 60) if fine else 1) & (label >= 0)
        index = np.flatnonzero(mask | shadow)
        offsets = _FINE if fine else _EDGE
        sums = [np.zeros((len(index), 3), np.float32) for _ in range(2)]
        for k, (dx, dy) in enumerate(offsets):
            # every sub-sample sees its own point of the sun's disc: soft shadows
            turn, radius = 2.399963 * k, _SUN_RADIUS * np.sqrt((k + 0.5) / len(offsets)) * fine
            sun = (radius * np.cos(turn), radius * np.sin(turn))
            sample = self._scene_samples(view, column[index] - 0.5 + dx, row[index] - 0.5 + dy, sun)
            sums[0] += sample[0]
            sums[1] += sample[1]
        lit[index], dark[index] = sums[0] / len(offsets), sums[1] / len(offsets)
        light = np.stack([dot(points, axis) for axis in scene.sun], axis=1).astype(np.float32)
        lit, dark = lit.reshape(h, w, 3), dark.reshape(h, w, 3)
        return _Background(lit, dark, depth.reshape(h, w), light.reshape(h, w, 3), _as_uint8(lit))

    def _scene_samples(self, view: View, column, row, sun):
        """Return colours with and without sun (n, 3), depth (n,), points (n, 3) and labels (n,) of pixels."""
        scene = self._scene
        rays = view.rays(column, row)
        geom, distance, normal = scene.cast(view.eye, rays, _SCENE, _FRAME)
        hit = np.flatnonzero(geom >= 0)
        n = len(rays)
        lit, dark = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
        depth, points = np.full(n, np.inf, np.float32), np.full((n, 3), 1e6)
        label = np.full(n, -1, np.int64)
        missed = geom < 0
        if missed.any():
            height = np.clip(_unit(rays[missed])[:, 2], 0, 1)[:, None]
            lit[missed] = dark[missed] = _SKY_LOW + height * (_SKY_HIGH - _SKY_LOW)
        if len(hit):
            geom, ray, t, normal = geom[hit], rays[hit], distance[hit], normal[hit]
            unit = _unit(ray)
            place = view.eye + t[:, None] * ray
            towards = np.abs(dot(normal, unit))
            footprint = view.pixel_size(t) / np.maximum(towards, 0.03)
            visible = dot(normal, scene.sun[2]) < 0
            shadowed = np.flatnonzero(visible & scene.may_be_shadowed(place))
            visible[shadowed] = scene.sunlit(place[shadowed], _SCENE, offset=sun)
            shaded, direct = scene.shade(geom, place, normal, unit, footprint)
            dark[hit] = shaded
            lit[hit] = shaded + visible[:, None] * direct
            depth[hit], points[hit] = t, place
            label[hit] = 2 * geom + visible
        return lit, dark, depth, points, label

    # --- the moving part ------------------------------------------------------------------------

    def _draw_foreground(
        self, view: View, back: _Background, copies: list[tuple[np.ndarray, Ghost | None]], drawing: Drawing
    ) -> overlay.Canvas | None:
        """Return the canvas with everything in front of the background, or None."""
        scene, trail, trail_colour = self._scene, drawing.trail, drawing.trail_colour
        boxes, shadows, casters = [], [], []
        for qpos, ghost in copies:
            scene.place(qpos)
            box = self._bounds(view)
            if box is not None:
                distance = float(view.project(qpos[None, :3])[1][0])
                casters.append((distance, qpos, ghost, box))
                boxes.append(box)
            if ghost is None or ghost.shadow:
                shadow = self._shadow(view, back)
                if shadow is not None:
                    shadows.append((shadow, 1.0 if ghost is None else min(1.0, 1.3 * ghost.alpha)))
                    boxes.append(shadow[0])
        lines = [] if trail is None else [(trail, 3)]
        lines += [(np.stack([p, np.add(p, f)]), 24) for p, f in drawing.forces]
        for points, margin in lines:
            box = _clip_box(_bounding_box(view, points, margin), self.width, self.height)
            if box is not None:
                boxes.append(box)
        if not boxes:
            return None
        bounds = np.array(boxes)
        c0, r0 = bounds[:, :2].min(axis=0)
        c1, r1 = bounds[:, 2:].max(axis=0)
        part = (slice(r0, r1), slice(c0, c1))
        canvas = overlay.Canvas(back.lit[part].copy(), back.depth[part].copy(), int(c0), int(r0))
        if shadows:
            light = np.ones(canvas.depth.shape, np.float32)
            for (box, cover), strength in shadows:
                inner = light[box[1] - r0 : box[3] - r0, box[0] - c0 : box[2] - c0]
                inner *= 1.0 - strength * cover
            index = np.flatnonzero(light.ravel() < 1.0)
            canvas.blend(index, back.dark[part].reshape(-1, 3)[index], 1.0 - light.ravel()[index])
        for _, qpos, ghost, box in sorted(casters, key=lambda item: -item[0]):
            self._draw_vehicle(canvas, view, qpos, box, ghost)
        if trail is not None:
            colour = overlay.TRAIL if trail_colour is None else trail_colour
            width = max(1.6, self.height / 260)
            fade = 0.95 if trail_colour is not None else np.linspace(0.45, 0.95, len(trail))
            overlay.draw_polyline(canvas, view, trail, width=width, colour=colour, alpha=fade)
        for point, vector in drawing.forces:
            overlay.draw_arrow(canvas, view, point, vector, colour=overlay.FORCE)
        return canvas

    def _bounds(self, view: View):
        """Return the pixel box (c0, r0, c1, r1) around the placed vehicle, or None outside the picture."""
        data, model = self._scene.data, self._scene.model
        geoms = np.concatenate([self._scene.parts, self._scene.discs])
        pixel, depth = view.project(data.geom_xpos[geoms])
        if depth.min() < 0.005:
            return (0, 0, self.width, self.height) if depth.max() > 0.005 else None
        radius = model.geom_rbound[geoms] / view.pixel_size(depth) * 1.05 + 2.0
        box = (
            *np.floor((pixel - radius[:, None]).min(axis=0)).astype(int),
            *np.ceil((pixel + radius[:, None]).max(axis=0)).astype(int),
        )
        return _clip_box(box, self.width, self.height)

    def _shadow(self, view: View, back: _Background):
        """Return pixel box and coverage (h, w) of the placed vehicle's shadow on the background, or None.

        The silhouette is drawn in the light's frame and looked up from the pixels' surface points.
        """
        scene = self._scene
        geoms = np.concatenate([scene.parts, scene.discs])
        centre = scene.data.geom_xpos[geoms] @ scene.sun.T
        bound = scene.model.geom_rbound[geoms][:, None]
        low = (centre - bound).min(axis=0) - 0.02
        high = (centre + bound).max(axis=0) + 0.02
        # the shadow lies on surfaces farther along the light within the silhouette's rectangle
        reach = []
        for corner in ((a, b, low[2]) for a in (low[0], high[0]) for b in (low[1], high[1])):
            point = corner @ scene.sun
            fall = max((point[2] + 0.3) / -scene.sun[2, 2], 0.0)
            reach += [point, point + fall * scene.sun[2]]
        box = _clip_box(_bounding_box(view, np.array(reach), 2), self.width, self.height)
        if box is None:
            return None
        c0, r0, c1, r1 = box
        u, v, along = np.moveaxis(back.light[r0:r1, c0:c1], 2, 0)
        inside = (u > low[0]) & (u < high[0]) & (v > low[1]) & (v < high[1])
        inside &= along > 0.5 * (low[2] + high[2])
        rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
        if not len(rows):
            return None
        r1, r0 = r0 + rows[-1] + 1, r0 + rows[0]
        c1, c0 = c0 + columns[-1] + 1, c0 + columns[0]
        index = np.nonzero(inside[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1])
        u, v, along = (back.light[r0:r1, c0:c1][index].T).astype(float)
        extent = (high - low)[:2].max()
        pixel = view.pixel_size(back.depth[r0:r1, c0:c1][index].min())
        texel = float(np.clip(1.2 * pixel, extent / 400, extent / 40))
        size = np.ceil((high - low)[:2] / texel).astype(int) + 1
        silhouette = self._silhouette(low, size, texel)
        blur = _box_blur(silhouette, max(1, round(0.0025 * self.scale / texel)))
        cover = np.zeros((r1 - r0, c1 - c0), np.float32)
        cover[index] = _bilinear(blur, (u - low[0]) / texel, (v - low[1]) / texel)
        return (int(c0), int(r0), int(c1), int(r1)), cover

    def _silhouette(self, low, size, texel) -> np.ndarray:
        """Return the share of sunlight that the vehicle blocks, (size[1], size[0]) across the light."""
        scene = self._scene
        a, b = np.meshgrid(np.arange(size[0]) * texel + low[0], np.arange(size[1]) * texel + low[1])
        a, b = a.ravel(), b.ravel()
        depth = low[2]
        points = a[:, None] * scene.sun[0] + b[:, None] * scene.sun[1] + depth * scene.sun[2]
        ray = points - scene.sun_eye
        ray /= dot(ray, scene.sun[2])[:, None]
        geom, _, _ = scene.cast(scene.sun_eye, ray, _VEHICLE, normals=False)
        opaque = (geom >= 0).astype(np.float32)
        light = np.zeros_like(opaque)
        for k in scene.discs:
            normal = scene.data.geom_xmat[k].reshape(3, 3)[:, 2]
            centre = scene.data.geom_xpos[k]
            slope = scene.sun[2] @ normal
            if abs(slope) < 1e-3:
                continue
            offset = points - centre
            offset -= (dot(offset, normal) / slope)[:, None] * scene.sun[2]
            inside = dot(offset, offset) < scene.model.geom_size[k][0] ** 2
            light = np.maximum(light, inside * 0.16)
        return np.maximum(opaque, light).reshape(size[1], size[0])

    def _draw_vehicle(self, canvas: overlay.Canvas, view: View, qpos, box, ghost) -> None:
        """Draw the vehicle, or a ghost of it, onto the canvas where it is nearer."""
        if ghost is None:
            pixels, colour, cover, near = self._vehicle_layer(view, qpos, box, None)
        else:  # ghosts often stay where they are
            kept = self._cached_background[1].ghosts
            key = (qpos.tobytes(), tuple(ghost.colour), ghost.tint)
            if key not in kept:
                if len(kept) >= _CACHED_GHOSTS:
                    kept.clear()
                kept[key] = self._vehicle_layer(view, qpos, box, ghost)
            pixels, colour, cover, near = kept[key]
        index = (pixels[0] - canvas.row) * canvas.depth.shape[1] + pixels[1] - canvas.column
        kept = np.flatnonzero(near < canvas.depth.ravel()[index] + _SHADOW_BIAS)
        index, colour, cover, near = index[kept], colour[kept], cover[kept], near[kept]
        strength = 1.0 if ghost is None else ghost.alpha
        flat = canvas.colour.reshape(-1, 3)
        flat[index] = flat[index] * (1.0 - strength * cover)[:, None] + strength * colour
        if ghost is None:
            solid = cover > 0.5
            depths = canvas.depth.reshape(-1)
            depths[index[solid]] = near[solid]

    def _vehicle_layer(self, view: View, qpos, box, ghost: Ghost | None):
        """Return covered pixels (rows, columns), their colour weighted by coverage, coverage, depth."""
        self._scene.place(qpos)
        scene = self._scene
        c0, r0, c1, r1 = box
        h, w = r1 - r0, c1 - c0
        column, row = np.meshgrid(np.arange(c0, c1) + 0.5, np.arange(r0, r1) + 0.5)
        column, row = column.ravel(), row.ravel()
        rays = view.rays(column, row)
        geom, distance, normal = scene.cast(view.eye, rays, _VEHICLE)
        edge = _grown(_edges(geom.reshape(h, w))).ravel()
        plain, edge = np.flatnonzero(~edge), np.flatnonzero(edge)
        sub_column = (column[edge][:, None] - 0.5 + _EDGE[:, 0]).ravel()
        sub_row = (row[edge][:, None] - 0.5 + _EDGE[:, 1]).ravel()
        sub_rays = view.rays(sub_column, sub_row)
        sub_geom, sub_distance, sub_normal = scene.cast(view.eye, sub_rays, _VEHICLE)
        rgb, alpha, depth = self._vehicle_samples(
            view,
            np.concatenate([rays[plain], sub_rays]),
            np.concatenate([geom[plain], sub_geom]),
            np.concatenate([distance[plain], sub_distance]),
            np.concatenate([normal[plain], sub_normal]),
            ghost,
        )
        k = len(plain)
        n, parts = h * w, len(_EDGE)
        colour, cover, near = np.zeros((n, 3)), np.zeros(n), np.full(n, np.inf)
        colour[plain], cover[plain], near[plain] = rgb[:k], alpha[:k], depth[:k]
        colour[edge] = rgb[k:].reshape(-1, parts, 3).mean(axis=1)
        cover[edge] = alpha[k:].reshape(-1, parts).mean(axis=1)
        near[edge] = depth[k:].reshape(-1, parts).min(axis=1)
        kept = np.flatnonzero(cover > 0)
        pixels = (r0 + kept // w, c0 + kept % w)
        return pixels, colour[kept], cover[kept], near[kept]

    def _vehicle_samples(self, view: View, rays, geom, distance, normal, ghost: Ghost | None):
        """Return colour weighted by coverage (n, 3), coverage (n,) and depth (n,) along rays."""
        scene = self._scene
        n = len(rays)
        rgb, alpha, depth = np.zeros((n, 3)), np.zeros(n), np.full(n, np.inf)
        hit = np.flatnonzero(geom >= 0)
        if len(hit):
            ray, t = rays[hit], distance[hit]
            points = view.eye + t[:, None] * ray
            visible = scene.sunlit(points, _SCENE, _VEHICLE)
            shaded, direct = scene.shade(geom[hit], points, normal[hit], _unit(ray), view.pixel_size(t))
            colour = shaded + visible[:, None] * direct
            if ghost is not None:
                grey = colour.mean(axis=1, keepdims=True)
                tinted = np.asarray(ghost.colour) * (0.45 + 0.75 * grey)
                colour = colour + ghost.tint * (tinted - colour)
            rgb[hit], alpha[hit], depth[hit] = colour, 1.0, t
        for k, (phase, sense) in zip(scene.discs, scene.phase):
            frame = scene.data.geom_xmat[k].reshape(3, 3)
            centre, radius = scene.data.geom_xpos[k], scene.model.geom_size[k][0]
            # Ray e + t d meets the disc's plane (x - c).n = 0 at t = (c - e).n / (d.n).
            slope = dot(rays, frame[:, 2])
            t = ((centre - view.eye) @ frame[:, 2]) / np.where(np.abs(slope) < 1e-9, 1e-9, slope)
            with np.errstate(over="ignore", invalid="ignore"):
                offset = view.eye + t[:, None] * rays - centre
                reach = np.sqrt(dot(offset, offset))
            near = np.flatnonzero((reach < 1.1 * radius) & (t > 0))
            if not len(near):
                continue
            r, t = reach[near], t[near]
            tilt = np.maximum(np.abs(slope[near]), 0.03)
            soft = view.pixel_size(t) / tilt
            cover = np.clip((radius - r) / soft + 0.5, 0.0, 1.0)
            x, y = dot(offset[near], frame[:, 0]), dot(offset[near], frame[:, 1])
            behind = np.mod(sense * (phase - np.arctan2(y, x)), np.pi)
            blur = 0.5 * np.exp(-behind / 0.30) * np.clip(r / radius * 3.0, 0, 1)
            rim = 0.12 * (r / radius) ** 8
            rgba = scene.rgba[k]
            weight = np.clip(rgba[3] + blur + rim, 0, 0.85) * cover
            tone = rgba[:3] + (blur / (blur + rgba[3]))[:, None] * (0.2 - rgba[:3])
            if ghost is not None:
                tone = tone + ghost.tint * (np.asarray(ghost.colour) - tone)
            front = t < depth[near]
            near, weight, tone, t = near[front], weight[front], tone[front], t[front]
            rgb[near] = rgb[near] * (1 - weight)[:, None] + weight[:, None] * tone
            alpha[near] = 1 - (1 - alpha[near]) * (1 - weight)
            depth[near] = np.minimum(depth[near], np.where(weight > 0, t, np.inf))
        return rgb, alpha, depth


def _as_uint8(colour: np.ndarray) -> np.ndarray:
    """Return colours in 0..1 as uint8."""
    return (np.clip(colour, 0.0, 1.0) * np.float32(255.0) + np.float32(0.5)).astype(np.uint8)


def _bounding_box(view: View, points: np.ndarray, margin: int):
    pixel, depth = view.project(points)
    if depth.min() < 0.05:
        return (0, 0, view.width, view.height)
    low, high = pixel.min(axis=0) - margin, pixel.max(axis=0) + margin
    return (*np.floor(low).astype(int), *np.ceil(high).astype(int))


def _clip_box(box, width: int, height: int):
    c0, r0, c1, r1 = box
    c0, r0, c1, r1 = max(int(c0), 0), max(int(r0), 0), min(int(c1), width), min(int(r1), height)
    return (c0, r0, c1, r1) if c1 > c0 and r1 > r0 else None


def _box_blur(image: np.ndarray, radius: int) -> np.ndarray:
    """Return the image blurred twice by a square of 2 radius + 1 pixels."""
    for _ in range(2):
        for axis in (0, 1):
            pad = [(0, 0), (0, 0)]
            pad[axis] = (radius + 1, radius)
            total = np.cumsum(np.pad(image, pad), axis=axis, dtype=np.float64)
            n = total.shape[axis]
            high = np.take(total, range(2 * radius + 1, n), axis=axis)
            low = np.take(total, range(0, n - 2 * radius - 1), axis=axis)
            image = ((high - low) / (2 * radius + 1)).astype(np.float32)
    return image


def _bilinear(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    h, w = image.shape
    x, y = np.clip(x, 0, w - 1.001), np.clip(y, 0, h - 1.001)
    i, j = x.astype(int), y.astype(int)
    a, b = x - i, y - j
    top = image[j, i] * (1 - a) + image[j, i + 1] * a
    bottom = image[j + 1, i] * (1 - a) + image[j + 1, i + 1] * a
    return top * (1 - b) + bottom * b
