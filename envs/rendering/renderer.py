"""What both renderers share: the drawn model, rebuilt when the platform's pose changes."""

from __future__ import annotations

import mujoco

from inclined_landing.envs.rendering import scenery
from inclined_landing.envs.rendering.camera import View
from inclined_landing.envs.rendering.pose import Pose, as_pose
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import Vehicle, load_vehicle


class SceneRenderer:
    """Base of the renderers: picture size, camera and the model of the latest platform."""

    def __init__(
        self,
        vehicle: Vehicle | None,
        width: int,
        height: int,
        camera: str | View,
        scale: float | None,
    ):
        if not (16 <= width <= 4096 and 16 <= height <= 4096):
            raise UserError(f"a picture has 16 to 4096 pixels a side, not {width} x {height}")
        self.vehicle = vehicle or load_vehicle()
        self.width, self.height, self.camera = int(width), int(height), camera
        self.scale = scenery.default_vehicle_scale(camera) if scale is None else float(scale)
        self._platform = "none yet"
        self.set_platform(as_pose(None, self.vehicle))

    def set_platform(self, pose: Pose) -> None:
        """Set the platform's pose: a model whose platform has a base is rebuilt for each pose."""
        if pose.platform_key != self._platform:
            self._rebuild(pose)
        if not pose.has_base:
            self._move_platform(pose)

    def _rebuild(self, pose: Pose) -> None:
        absent = pose.platform_key is None
        platform = (None, None) if absent else (pose.platform_pos, pose.platform_quat)
        model = scenery.rendering_model(
            self.vehicle,
            platform=platform,
            has_base=pose.has_base,
            scale=self.scale,
            aspect=self.width / self.height,
            far=self.camera == "arena",
        )
        if isinstance(self.camera, str):
            names = [model.camera(k).name for k in range(model.ncam)]
            if self.camera not in names:
                raise UserError(f"unknown camera {self.camera!r}; known are {', '.join(names)}")
        self._prepare(model)
        self._platform = pose.platform_key

    def _move_platform(self, pose: Pose) -> None:
        raise NotImplementedError

    def _prepare(self, model: mujoco.MjModel) -> None:
        raise NotImplementedError

    def close(self) -> None:
        """Free the renderer's resources; by default nothing."""

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()
