"""Pinhole and orthographic views: pixels to rays and points to pixels."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np

FAR = 1e4  # m; parallel rays are cast from a point this far away
_FOCUS = np.array([0.0, 0.0, 1.2])  # parallel rays are exact on the plane through this point


def dot(vectors: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return scalar products (n,) of vectors (n, 3) with one vector (3,) or row by row with (n, 3).

    They are computed without the threads of a linear-algebra library, so that all machines give the same
    bits.
    """
    return np.einsum("ij,j->i" if other.ndim == 1 else "ij,ij->i", vectors, other)


@dataclasses.dataclass(frozen=True)
class View:
    """One camera at one moment.

    origin (3,) [m]; axes (3, 3) with rows right, up, forward; extent: height of the image, in metres for an
    orthographic view, in units of the distance for a perspective one (2 tan(fovy / 2)).
    """

    origin: np.ndarray
    axes: np.ndarray
    extent: float
    orthographic: bool
    width: int
    height: int

    @property
    def eye(self) -> np.ndarray:
        """Return the point (3,) from which all rays start."""
        if not self.orthographic:
            return self.origin
        depth = (_FOCUS - self.origin) @ self.axes[2]
        return self.origin + (depth - FAR) * self.axes[2]

    @property
    def offset(self) -> float:
        """Axial distance from the eye to the camera [m]."""
        return float((self.origin - self.eye) @ self.axes[2])

    @property
    def pixel(self) -> float:
        """Size of a pixel: metres (orthographic) or metres per metre of distance (perspective)."""
        return self.extent / self.height

    def rays(self, column: np.ndarray, row: np.ndarray) -> np.ndarray:
        """Return ray directions (n, 3) through image points (pixel (0, 0) has its centre at 0.5, 0.5).

        They are scaled so that the hit distance is the axial distance from `eye`.
        """
        # d = forward + (column - w/2) s right + (h/2 - row) s up, s: a pixel at distance 1
        pixel = self.pixel / FAR if self.orthographic else self.pixel
        right = (column - 0.5 * self.width) * pixel
        up = (0.5 * self.height - row) * pixel
        return self.axes[2] + right[:, None] * self.axes[0] + up[:, None] * self.axes[1]

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return columns and rows (n, 2) and axial distances from `eye` (n,) of points (n, 3)."""
        # Pinhole camera: column = w/2 + x / (s z), row = h/2 - y / (s z); orthographic: without z.
        local = np.asarray(points, float) - self.origin
        right, up, depth = (dot(local, axis) for axis in self.axes)
        size = self.pixel if self.orthographic else self.pixel * np.maximum(depth, 1e-6)
        column = 0.5 * self.width + right / size
        row = 0.5 * self.height - up / size
        return np.stack([column, row], axis=1), depth + self.offset

    def pixel_size(self, depth):
        """Return the size of a pixel [m] at the axial distance `depth` from `eye`."""
        return self.pixel * (np.ones_like(depth) if self.orthographic else depth)


def camera_view(model, data, camera: int | str, width: int, height: int) -> View:
    """Return the view of a camera of the model, after `mj_kinematics`."""
    mujoco.mj_comPos(model, data)
    mujoco.mj_camlight(model, data)
    k = model.camera(camera).id if isinstance(camera, str) else camera
    right, up, back = data.cam_xmat[k].reshape(3, 3).T
    orthographic = bool(model.cam_projection[k])
    fovy = float(model.cam_fovy[k])
    extent = fovy if orthographic else 2.0 * np.tan(0.5 * np.radians(fovy))
    axes = np.stack([right, up, -back])
    return View(data.cam_xpos[k].copy(), axes, extent, orthographic, width, height)


def look_at(
    position, target, width: int, height: int, *, fovy: float = 45.0, extent: float | None = None
) -> View:
    """Return a free view from `position` (3,) towards `target` (3,), z up.

    fovy in degrees; with `extent` [m] the view is orthographic and shows that height.
    """
    position, target = np.asarray(position, float), np.asarray(target, float)
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, forward), forward])
    size = 2.0 * np.tan(0.5 * np.radians(fovy)) if extent is None else extent
    return View(position, axes, size, extent is not None, width, height)


def nearest_position(
    points: np.ndarray, axes: np.ndarray, half_width: float, half_height: float
) -> np.ndarray:
    """Return the nearest position (3,) from which a perspective camera of given axes sees all points (n, 3).

    axes (3, 3): rows right, up, forward. half_width, half_height: half the size of the usable part of the
    image, in units of the distance. Every point bounds the position by planes, two horizontally and two
    vertically; along a direction that is not bounded tightly, the view is centred.
    """
    local = np.stack([dot(np.asarray(points, float), axis) for axis in axes], axis=1)
    position = np.zeros(3)
    depth = []
    for k, half in enumerate((half_width, half_height)):
        # |x_k - p_k| <= half (z - p_z) for all points: right <= p_k - half p_z and left <= -p_k - half p_z.
        # Their sum bounds the depth p_z, their difference gives the centre p_k.
        right = (local[:, k] - half * local[:, 2]).max()
        left = (-local[:, k] - half * local[:, 2]).max()
        position[k] = 0.5 * (right - left)
        depth.append(-0.5 * (right + left) / half)
    position[2] = min(depth)
    return position @ axes
