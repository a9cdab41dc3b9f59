"""Base of both renderers: the drawn model, rebuilt when the platform's pose changes."""

from __future__ import annotations

import abc
import contextlib
from collections.abc import Sequence

import mujoco
import numpy as np

from inclined_landing.envs.rendering import overlay, scenery
from inclined_landing.envs.rendering.camera import View, camera_view
from inclined_landing.envs.rendering.pose import Ghost, Pose, place, pose_from_state, resting_platform
from inclined_landing.models.attitude import STATE_SIZE
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.vehicle import Vehicle


class SceneRenderer(contextlib.AbstractContextManager, abc.ABC):
    """Base of the renderers: picture size, camera, and the model of the latest platform with its data."""

    closed = False
    model: mujoco.MjModel
    data: mujoco.MjData

    def __init__(
        self,
        vehicle: Vehicle | None = None,
        width: int = 640,
        height: int = 480,
        camera: str | View = "arena",
        scale: float | None = None,
    ):
        self.vehicle = vehicle or load_vehicle()
        self.width, self.height, self.camera = int(width), int(height), camera
        usual = 1.0 if camera in scenery.CLOSE_CAMERAS else scenery.SCALE
        self.scale = usual if scale is None else float(scale)
        self._platform = "none yet"
        self.set_platform(pose_from_state(np.zeros(STATE_SIZE), resting_platform(self.vehicle)))

    def render(
        self,
        pose: Pose,
        *,
        trail=None,
        trail_colour=None,
        ghosts: Sequence[Ghost] = (),
        caption: str = "",
        show_vehicle: bool = True,
    ) -> np.ndarray:
        """Return one frame (height, width, 3) uint8.

        trail: points (k, 3) [m], as from `centres`; trail_colour (3,) or (k, 3).
        """
        trail = None if trail is None or len(trail) < 2 else np.asarray(trail, float)
        frame = self._draw(pose, ghosts, trail, trail_colour, show_vehicle)
        if caption:
            note = "" if self.scale == 1.0 else f"vehicle drawn {self.scale:g}x"
            overlay.draw_caption(frame, caption, note)
        return frame

    def centres(self, states) -> np.ndarray:
        """Return the centres (k, 3) [m] of the drawn vehicle at states (k, 13)."""
        return scenery.scaled_centres(self.model, states, self.scale)

    def several(self, count: int) -> Sequence[SceneRenderer]:
        """Return at most `count` renderers of this scene that draw in threads of their own; itself first."""
        return [self]

    def view(self, pose: Pose) -> View:
        """Return the view that `render` uses at a pose, at which vehicle and platform are placed."""
        if self.closed:
            raise UserError("this renderer has been closed")
        self.set_platform(pose)
        place(self.model, self.data, pose.qpos)
        if isinstance(self.camera, View):
            return self.camera
        return camera_view(self.model, self.data, self.camera, self.width, self.height)

    def set_platform(self, pose: Pose) -> None:
        """Set the platform's pose; a model whose platform has a base is rebuilt for each pose."""
        if pose.platform_key != self._platform:
            self._platform = pose.platform_key
            platform = None if self._platform is None else (pose.platform_pos, pose.platform_quat)
            model = scenery.rendering_model(
                self.vehicle,
                platform,
                has_base=pose.has_base,
                scale=self.scale,
                aspect=self.width / self.height,
                far=self.camera == "arena",
            )
            self._prepare(model)
        if not pose.has_base:
            k = int(self.model.body("platform").mocapid[0])
            self.data.mocap_pos[k], self.data.mocap_quat[k] = pose.platform_pos, pose.platform_quat

    @abc.abstractmethod
    def _prepare(self, model: mujoco.MjModel) -> None:
        """Prepare a new model for drawing."""

    @abc.abstractmethod
    def _draw(self, pose: Pose, ghosts: Sequence[Ghost], trail, trail_colour, show_vehicle) -> np.ndarray:
        """Return the frame (height, width, 3) uint8 without a caption; see `render`."""

    @abc.abstractmethod
    def close(self) -> None:
        """Free the resources; the renderer cannot be used afterwards."""

    def __exit__(self, *_):
        self.close()
