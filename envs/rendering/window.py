"""MuJoCo's viewer as a window that shows one vehicle while it flies.

Without a display MuJoCo's viewer ends the whole process. A hidden window is therefore opened first, and what
is missing is reported in a sentence. The window has its own thread, so that mouse and menus work between two
updates. It belongs to the process that opened it; a forked process shows nothing.
"""

from __future__ import annotations

import os
import sys
import time
import warnings

import mujoco
import numpy as np

from inclined_landing.envs.rendering import scenery
from inclined_landing.envs.rendering.camera import look_at
from inclined_landing.envs.rendering.pose import hang_load, pose_from_state
from inclined_landing.models import geometry
from inclined_landing.models.attitude import LAG, PITCH, ROLL, VX, VZ, WX, WZ, YAW, X, Y
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.scene import build_spec
from inclined_landing.models.vehicle import Vehicle

REMEDY = (
    "without a display use `landing-eval replay` (a page for the browser), `landing-eval video`, or "
    "render_mode='rgb_array'"
)
_SHADOWS = 2048  # pixels; the scene's 8192 are for stills, and slow without a graphics card
_EYE, _TARGET = (-1.9, -3.4, 2.1), (0.0, 0.0, 1.35)  # m, where one looks from and to at first


def headless() -> bool:
    """Return whether there is no display, according to the environment variables of Linux."""
    return sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def check_display() -> None:
    """Raise UserError, with the remedy, if no window with OpenGL can be opened."""
    if headless():
        raise UserError(f"a window needs a display, and there is none; {REMEDY}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # glfw tells its errors as warnings
        try:
            import glfw

            opened = glfw.init()
            if opened:
                glfw.window_hint(glfw.VISIBLE, glfw.FALSE)
                window = glfw.create_window(16, 16, "", None, None)
                opened = bool(window)
                if window:
                    glfw.destroy_window(window)
                glfw.default_window_hints()
        except (ImportError, OSError) as error:
            raise UserError(f"a window needs GLFW, which does not load ({error}); {REMEDY}") from error
    if not opened:
        raise UserError(f"a window with OpenGL cannot be opened on this display; {REMEDY}")


class Window:
    """A window with the vehicle on its slope, in real time.

    Its model has the vehicle's true size, the contacts and the plugins: the viewer's own menus show forces
    and shapes. Raises UserError if there is no display.
    """

    def __init__(self, vehicle: Vehicle | None = None):
        check_display()
        import mujoco.viewer

        self._vehicle = vehicle or load_vehicle()
        spec = build_spec(self._vehicle)
        scenery.add_frame(spec, self._vehicle)
        spec.visual.quality.shadowsize = _SHADOWS
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._mocap = [int(self.model.body(name).mocapid[0]) for name in geometry.PLATFORM_BODIES]
        try:
            self._viewer = mujoco.viewer.launch_passive(
                self.model, self.data, show_left_ui=False, show_right_ui=False
            )
        except RuntimeError as error:  # macOS wants its own interpreter
            raise UserError(f"the viewer did not start: {error}; {REMEDY}") from error
        self._process = os.getpid()
        self._look()
        self._due = time.monotonic()

    def _look(self) -> None:
        eye, target = np.array(_EYE), np.array(_TARGET)
        forward = look_at(eye, target, 1, 1).axes[2]
        camera = self._viewer.cam
        camera.lookat[:] = target
        camera.distance = float(np.linalg.norm(target - eye))
        camera.azimuth = float(np.degrees(np.arctan2(forward[1], forward[0])))
        camera.elevation = float(np.degrees(np.arcsin(forward[2])))

    @property
    def open(self) -> bool:
        """Return whether the window is open, in the process that opened it."""
        return self._viewer is not None and self._process == os.getpid() and self._viewer.is_running()

    def show(
        self,
        state: np.ndarray,
        commands: np.ndarray,
        platform: np.ndarray | None,
        *,
        seconds: float = 0.0,
    ) -> None:
        """Show a state (13,) under commands (4,); does nothing once the window is closed.

        platform: the platform's state (12,), see `Plant.platform`; None without one. seconds: time since the
        state shown before; the call waits so that the flight is shown in real time.
        """
        if not self.open:
            return
        now = time.monotonic()
        self._due = max(self._due + seconds, now - 0.1)  # what came late is not made up for
        time.sleep(max(0.0, self._due - now))
        pose = pose_from_state(state, platform)
        there = np.zeros(WZ + 1) if platform is None else platform
        # A moving platform has no base.
        has_base = platform is not None and not there[[X, Y, VX, VX + 1, VZ, ROLL]].any()
        places = geometry.platform_poses([there[PITCH]], [has_base], self._vehicle, azimuth=[there[YAW]])
        places[0][0, 0], places[1][0, 0] = pose.platform_pos, pose.platform_quat
        with self._viewer.lock():
            data = self.data
            data.qpos[:7] = pose.qpos
            hang_load(self.model, data)
            data.qvel[:3], data.qvel[3:6] = state[VX : VX + 3], state[WX : WX + 3]
            data.act[0] = state[LAG]
            data.ctrl[:] = commands
            data.mocap_pos[self._mocap], data.mocap_quat[self._mocap] = places[0][0], places[1][0]
            mujoco.mj_forward(self.model, data)
        self._viewer.sync()

    def close(self) -> None:
        """Close the window and wait until its thread has released it."""
        viewer, self._viewer = self._viewer, None
        if viewer is None or self._process != os.getpid():
            return
        viewer.close()
        patience = time.monotonic() + 2.0
        while viewer.m is not None and time.monotonic() < patience:
            time.sleep(0.01)
