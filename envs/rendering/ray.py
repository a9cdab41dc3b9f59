"""A ray-cast renderer on `mujoco.mj_multiRay`: no OpenGL, deterministic.

The picture is made of layers. The background (floor, wall, platform, arena edges) depends only on the camera
and the platform's pose and is cached; each frame casts rays for the boxes around the vehicle and its shadow.
"""

from __future__ import annotations

import copy
import dataclasses
import itertools
from collections.abc import Sequence

import mujoco
import numpy as np

from inclined_landing.envs.rendering import overlay
from inclined_landing.envs.rendering.camera import View, dot
from inclined_landing.envs.rendering.images import (
    bilinear,
    bounding_box,
    box_blur,
    dilated,
    edges,
)
from inclined_landing.envs.rendering.lit_scene import (
    FRAME,
    SCENE,
    SHADOW_BIAS,
    SUN_RADIUS,
    VEHICLE,
    LitScene,
    unit_vectors,
)
from inclined_landing.envs.rendering.pose import Ghost, Pose, place
from inclined_landing.envs.rendering.renderer import SceneRenderer
from inclined_landing.models import threads

_SKY_LOW, _SKY_HIGH = np.array([0.90, 0.93, 0.97]), np.array([0.82, 0.87, 0.94])
_CACHED_GHOSTS = 32
_AT_ONCE = 8192  # pixels; their numbers fit into a processor's cache
_RIM = 1.1  # radii of a rotor's disc within which it is drawn, with its soft edge
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


class RayRenderer(SceneRenderer):
    """Renderer of the landing scene by ray casting; see `make_renderer`."""

    backend = "ray"

    def _prepare(self, model: mujoco.MjModel) -> None:
        self._scene = LitScene(model)
        self.model, self.data = model, self._scene.data
        self._cached_background: tuple = (None, None)

    def several(self, count: int) -> list[RayRenderer]:
        """Return `count` renderers, which share the background and the ghosts that have been drawn."""
        renderers = [self, *(copy.copy(self) for _ in range(count - 1))]
        for renderer in renderers[1:]:
            renderer._scene = self._scene.twin()
            renderer.data = renderer._scene.data
        return renderers

    def close(self) -> None:
        """Discard the cached background."""
        self._cached_background = (None, None)

    def _draw(self, pose: Pose, ghosts: Sequence[Ghost], trail, trail_colour, show_vehicle) -> np.ndarray:
        view = self.view(pose)
        back = self._background(view)
        copies: list[tuple[np.ndarray, Ghost | None]] = [(ghost.qpos, ghost) for ghost in ghosts]
        copies += [(pose.qpos, None)] if show_vehicle else []
        drawn = self._draw_foreground(view, back, copies, trail, trail_colour)
        frame = back.frame.copy()
        if drawn is not None:
            h, w = drawn.depth.shape
            part = frame[drawn.row : drawn.row + h, drawn.column : drawn.column + w]
            part[:] = _as_uint8(drawn.colour)
        return frame

    # --- scene and background -------------------------------------------------------------------

    def _background(self, view: View) -> _Background:
        """Return the picture without the vehicle, cached while neither camera nor platform moves."""
        key = (
            view.origin.tobytes(),
            view.axes.tobytes(),
            self.data.mocap_pos.tobytes(),
            self.data.mocap_quat.tobytes(),
        )
        if key != self._cached_background[0]:
            fixed = isinstance(self.camera, View) or self.model.camera(self.camera).bodyid[0] == 0
            self._cached_background = (key, self._draw_background(view, fine=fixed))
        return self._cached_background[1]

    def _draw_background(self, view: View, fine: bool) -> _Background:
        scene, h, w = self._scene, self.height, self.width
        scenes = scene, scene.twin()
        column, row = np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5)
        column, row = column.ravel(), row.ravel()
        lit, dark, depth, points, label = self._in_parts(scenes, view, column, row, (0.0, 0.0))
        label = label.reshape(h, w)
        mask = edges(label >> 1)
        shadow = edges(label & 1, reach=max(1, h // 60) if fine else 1) & (label >= 0)
        index = np.flatnonzero(mask | shadow)
        offsets = _FINE if fine else _EDGE
        sums = [np.zeros((len(index), 3), np.float32) for _ in range(2)]
        for k, (dx, dy) in enumerate(offsets):
            # every sub-sample sees its own point of the sun's disc: soft shadows
            turn, radius = 2.399963 * k, SUN_RADIUS * np.sqrt((k + 0.5) / len(offsets)) * fine
            sun = (radius * np.cos(turn), radius * np.sin(turn))
            at = column[index] - 0.5 + dx, row[index] - 0.5 + dy
            sample = self._in_parts(scenes, view, *at, sun)
            sums[0] += sample[0]
            sums[1] += sample[1]
        lit[index], dark[index] = sums[0] / len(offsets), sums[1] / len(offsets)
        light = np.stack([dot(points, axis) for axis in scene.sun], axis=1).astype(np.float32)
        lit, dark = lit.reshape(h, w, 3), dark.reshape(h, w, 3)
        return _Background(lit, dark, depth.reshape(h, w), light.reshape(h, w, 3), _as_uint8(lit))

    def _in_parts(self, scenes: Sequence[LitScene], view: View, column, row, sun) -> list[np.ndarray]:
        """Return what `_scene_samples` does, computed in small parts and by a thread for each scene."""
        parts = threads.shares(len(column), -(-len(column) // _AT_ONCE))

        def samples(share: tuple[LitScene, tuple[int, int]]):
            scene, (first, end) = share
            inside = [slice(*part) for part in parts[first:end]]
            return [self._scene_samples(scene, view, column[part], row[part], sun) for part in inside]

        done = threads.in_threads(samples, list(zip(scenes, threads.shares(len(parts), len(scenes)))))
        return [np.concatenate(arrays) for arrays in zip(*itertools.chain(*done))]

    def _scene_samples(self, scene: LitScene, view: View, column, row, sun):
        """Return colours with and without sun (n, 3), depth (n,), points (n, 3) and labels (n,) of pixels."""
        rays = view.rays(column, row)
        geom, distance, normal = scene.cast(view.eye, rays, SCENE, FRAME)
        hit = np.flatnonzero(geom >= 0)
        n = len(rays)
        lit, dark = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
        depth, points = np.full(n, np.inf, np.float32), np.full((n, 3), 1e6)
        label = np.full(n, -1, np.int64)
        missed = geom < 0
        if missed.any():
            height = np.clip(unit_vectors(rays[missed])[:, 2], 0, 1)[:, None]
            lit[missed] = dark[missed] = _SKY_LOW + height * (_SKY_HIGH - _SKY_LOW)
        if len(hit):
            geom, ray, t, normal = geom[hit], rays[hit], distance[hit], normal[hit]
            unit = unit_vectors(ray)
            place = view.eye + t[:, None] * ray
            towards = np.abs(dot(normal, unit))
            footprint = view.pixel_size(t) / np.maximum(towards, 0.03)
            visible = dot(normal, scene.sun[2]) < 0
            facing = np.flatnonzero(visible)
            visible[facing] = scene.sunlit(place[facing], SCENE, offset=sun)
            shaded, direct = scene.shade(geom, place, normal, unit, footprint)
            dark[hit] = shaded
            lit[hit] = shaded + visible[:, None] * direct
            depth[hit], points[hit] = t, place
            label[hit] = 2 * geom + visible
        return lit, dark, depth, points, label

    # --- the moving part ------------------------------------------------------------------------

    def _draw_foreground(
        self,
        view: View,
        back: _Background,
        copies: list[tuple[np.ndarray, Ghost | None]],
        trail: np.ndarray | None,
        trail_colour,
    ) -> overlay.Canvas | None:
        """Return the canvas with everything in front of the background, or None."""
        boxes, shadows, casters, drawn = [], [], [], self._scene.drawn
        for qpos, ghost in copies:
            place(self.model, self.data, qpos)
            box = bounding_box(view, self.data.geom_xpos[drawn], 2.0, 1.05 * self.model.geom_rbound[drawn])
            if box is not None:
                distance = float(view.project(qpos[None, :3])[1][0])
                casters.append((distance, qpos, ghost, box))
                boxes.append(box)
            if ghost is None or ghost.shadow:
                shadow = self._shadow(view, back)
                if shadow is not None:
                    shadows.append((shadow, 1.0 if ghost is None else min(1.0, 1.3 * ghost.alpha)))
                    boxes.append(shadow[0])
        if trail is not None:
            box = bounding_box(view, trail, 3.0)
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
        return canvas

    def _shadow(self, view: View, back: _Background):
        """Return pixel box and coverage (h, w) of the placed vehicle's shadow on the background, or None.

        The silhouette is drawn in the light's frame and looked up from the pixels' surface points.
        """
        scene = self._scene
        centre = scene.data.geom_xpos[scene.drawn] @ scene.sun.T
        bound = scene.model.geom_rbound[scene.drawn][:, None]
        low = (centre - bound).min(axis=0) - 0.02
        high = (centre + bound).max(axis=0) + 0.02
        # the shadow lies on surfaces farther along the light within the silhouette's rectangle
        reach = []
        for corner in ((a, b, low[2]) for a in (low[0], high[0]) for b in (low[1], high[1])):
            point = corner @ scene.sun
            fall = max((point[2] + 0.3) / -scene.sun[2, 2], 0.0)
            reach += [point, point + fall * scene.sun[2]]
        box = bounding_box(view, np.array(reach), 2.0)
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
        blur = box_blur(silhouette, max(1, round(0.0025 * self.scale / texel)))
        cover = np.zeros((r1 - r0, c1 - c0), np.float32)
        cover[index] = bilinear(blur, (u - low[0]) / texel, (v - low[1]) / texel)
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
        opaque = (scene.cast(scene.sun_eye, ray, VEHICLE, normals=False)[0] >= 0).astype(np.float32)
        light = np.zeros(len(points), np.float32)
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
            layer = self._vehicle_layer(view, qpos, box, None)
        else:  # ghosts often stay where they are
            kept = self._cached_background[1].ghosts
            key = (qpos.tobytes(), tuple(ghost.colour), ghost.tint)
            layer = kept.get(key)
            if layer is None:
                if len(kept) >= _CACHED_GHOSTS:
                    kept.clear()
                layer = kept[key] = self._vehicle_layer(view, qpos, box, ghost)
        pixels, colour, cover, near = layer
        index = (pixels[0] - canvas.row) * canvas.depth.shape[1] + pixels[1] - canvas.column
        kept = np.flatnonzero(near < canvas.depth.ravel()[index] + SHADOW_BIAS)
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
        place(self.model, self.data, qpos)
        scene = self._scene
        c0, r0, c1, r1 = box
        column, row = np.meshgrid(np.arange(c0, c1) + 0.5, np.arange(r0, r1) + 0.5)
        column, row = column.ravel(), row.ravel()
        rays = view.rays(column, row)
        geom, distance, normal = scene.cast(view.eye, rays, VEHICLE)
        edge = dilated(edges(geom.reshape(r1 - r0, c1 - c0))).ravel()
        plain, edge = np.flatnonzero(~edge), np.flatnonzero(edge)
        sub_column = (column[edge][:, None] - 0.5 + _EDGE[:, 0]).ravel()
        sub_row = (row[edge][:, None] - 0.5 + _EDGE[:, 1]).ravel()
        sub_rays = view.rays(sub_column, sub_row)
        sub_geom, sub_distance, sub_normal = scene.cast(view.eye, sub_rays, VEHICLE)
        rgb, alpha, depth = self._vehicle_samples(
            view,
            np.concatenate([rays[plain], sub_rays]),
            np.concatenate([geom[plain], sub_geom]),
            np.concatenate([distance[plain], sub_distance]),
            np.concatenate([normal[plain], sub_normal]),
            ghost,
        )
        k = len(plain)
        n, parts = len(rays), len(_EDGE)
        colour, cover, near = np.zeros((n, 3)), np.zeros(n), np.full(n, np.inf)
        colour[plain], cover[plain], near[plain] = rgb[:k], alpha[:k], depth[:k]
        colour[edge] = rgb[k:].reshape(-1, parts, 3).mean(axis=1)
        cover[edge] = alpha[k:].reshape(-1, parts).mean(axis=1)
        near[edge] = depth[k:].reshape(-1, parts).min(axis=1)
        kept = np.flatnonzero(cover > 0)
        pixels = (r0 + kept // (c1 - c0), c0 + kept % (c1 - c0))
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
            colour, direct = scene.shade(
                geom[hit], points, normal[hit], unit_vectors(ray), view.pixel_size(t)
            )
            facing = np.flatnonzero(direct.any(axis=1))
            colour[facing] += scene.sunlit(points[facing], SCENE, VEHICLE)[:, None] * direct[facing]
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
            near = np.flatnonzero((reach < _RIM * radius) & (t > 0))
            slope, t, offset, r = (x[near] for x in (slope, t, offset, reach))
            tilt = np.maximum(np.abs(slope), 0.03)
            soft = view.pixel_size(t) / tilt
            cover = np.clip((radius - r) / soft + 0.5, 0.0, 1.0)
            x, y = dot(offset, frame[:, 0]), dot(offset, frame[:, 1])
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
