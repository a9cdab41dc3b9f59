"""MuJoCo's own OpenGL renderer, used only after a search for OpenGL.

Without OpenGL MuJoCo 4.0 raises at the first renderer and aborts the process at the second. The libraries are
therefore searched with ctypes first; nothing here runs at import and no environment variable of MuJoCo is
set. In a forked process whose parent has used OpenGL, the next call would hang, so it is refused.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
from typing import Any, cast

import mujoco
import numpy as np

from inclined_landing.envs.rendering import overlay
from inclined_landing.envs.rendering.camera import View, camera_view
from inclined_landing.envs.rendering.pose import Ghost, Pose, hang_load
from inclined_landing.envs.rendering.renderer import Drawing, SceneRenderer
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.vehicle import Vehicle

_REMEDY = (
    "install it with `apt-get install libegl1 libgl1` (or `libosmesa6`), unset MUJOCO_GL and "
    "PYOPENGL_PLATFORM, or use backend='ray'"
)
_LOST = (
    "OpenGL does not work in a process forked from one that has used it; start the process with 'spawn', or "
    "use backend='ray'"
)
_MAX_GEOMS = 20000
_process: int | None = None  # the process that used OpenGL first


def lost() -> bool:
    """Return whether this is a forked process whose parent has used OpenGL, so that it cannot use OpenGL."""
    return _process not in (None, os.getpid())


def _loads(*names: str) -> bool:
    """Return whether one of these libraries loads."""
    for name in names:
        with contextlib.suppress(OSError):
            ctypes.CDLL(name)
            return True
    return False


def _kind() -> str:
    """Return "egl" or "osmesa", whose libraries are there; raises UserError, with the remedy, for neither.

    If PYOPENGL_PLATFORM is set, as after MuJoCo has loaded the OpenGL of MUJOCO_GL, no other is available.
    """
    wanted, missing = os.environ.get("PYOPENGL_PLATFORM", "").lower(), []
    needed: dict[str, dict[str, tuple[str, ...]]] = {
        "egl": {"libEGL": ("libEGL.so.1",), "libGL": ("libOpenGL.so.0", "libGL.so.1")},
        "osmesa": {"libOSMesa": ("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so")},
    }
    for kind, libraries in needed.items():
        if wanted in ("", kind):
            absent = [library for library, names in libraries.items() if not _loads(*names)]
            if not absent:
                return kind
            missing += absent
    which = " and ".join(missing) or "an off-screen OpenGL that PYOPENGL_PLATFORM allows"
    raise UserError(f"no OpenGL rendering, because {which} is missing: {_REMEDY}.")


def _context(width: int, height: int):
    """Return a current OpenGL context of MuJoCo, or raise UserError with the remedy."""
    global _process
    if lost():
        raise UserError(_LOST)
    kind = _kind()
    try:
        if kind == "egl":
            from mujoco.egl import GLContext
        else:
            from mujoco.osmesa import GLContext
        context = GLContext(width, height)
        context.make_current()
        _process = os.getpid()
    except Exception as error:  # PyOpenGL's where a library or a device lacks something, of many types
        raise UserError(f"OpenGL rendering failed to start ({error}): {_REMEDY}.") from error
    return context


class GLRenderer(SceneRenderer):
    """Renderer of the landing scene by MuJoCo's OpenGL; see `make_renderer`."""

    backend = "gl"

    def __init__(
        self,
        vehicle: Vehicle | None = None,
        width: int = 640,
        height: int = 480,
        camera: str | View = "arena",
        scale: float | None = None,
    ):
        if isinstance(camera, View):
            raise UserError("a free View needs backend='ray'; otherwise name a camera of the scene")
        self._mjr = None
        self._gl: Any = _context(width, height)
        super().__init__(vehicle, width, height, camera, scale)

    def _prepare(self, model: mujoco.MjModel) -> None:
        self._gl.make_current()
        if self._mjr is not None:
            self._mjr.free()
        model.vis.global_.offwidth, model.vis.global_.offheight = self.width, self.height
        self.model, self.data = model, mujoco.MjData(model)
        self._ghost_data = mujoco.MjData(model)
        self._scene = mujoco.MjvScene(model, maxgeom=_MAX_GEOMS)
        self._option = mujoco.MjvOption()
        self._mjr = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._mjr)
        self._vehicle_root = model.body("crazyflie").id

    def _pose(self, scene, inclination: float | None) -> Pose:
        if lost():
            raise UserError(_LOST)
        return super()._pose(scene, inclination)

    def _move_platform(self, pose: Pose) -> None:
        k = int(self.model.body("platform").mocapid[0])
        for data in (self.data, self._ghost_data):
            data.mocap_pos[k], data.mocap_quat[k] = pose.platform_pos, pose.platform_quat

    def close(self) -> None:
        """Free the OpenGL context."""
        if self._mjr is not None:
            self._gl.make_current()
            self._mjr.free()
        if self._gl is not None:
            self._gl.free()
        self._gl, self._mjr, self.closed = None, None, True

    def _draw(self, pose: Pose, drawing: Drawing) -> np.ndarray:
        self._place(self.data, pose.qpos)
        self._gl.make_current()
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        camera.fixedcamid = self.model.camera(self.camera).id
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(self.model, self.data, self._option, None, camera, everything, self._scene)
        if not drawing.show_vehicle:
            self._recolour(0, lambda rgba: 0.0 * rgba, others=False)
        for ghost in drawing.ghosts:
            self._add_ghost(ghost)
        if drawing.trail is not None:
            self._add_trail(drawing.trail, drawing.trail_colour)
        rect = mujoco.MjrRect(0, 0, self.width, self.height)
        frame = np.empty((self.height, self.width, 3), np.uint8)
        mujoco.mjr_render(rect, self._scene, self._mjr)
        mujoco.mjr_readPixels(frame, None, rect, self._mjr)
        return np.ascontiguousarray(frame[::-1])

    def _view(self, pose: Pose) -> View:
        self._place(self.data, pose.qpos)
        return camera_view(self.model, self.data, cast(str, self.camera), self.width, self.height)

    def _place(self, data: mujoco.MjData, qpos: np.ndarray) -> None:
        data.qpos[:7] = qpos
        hang_load(self.model, data)
        mujoco.mj_kinematics(self.model, data)
        mujoco.mj_comPos(self.model, data)
        mujoco.mj_camlight(self.model, data)

    def _recolour(self, first: int, change, others: bool) -> None:
        """Change the vehicle's colours from scene geom `first`; `others`: hide the rest."""
        for geom in self._scene.geoms[first : self._scene.ngeom]:
            if geom.objtype != mujoco.mjtObj.mjOBJ_GEOM:
                continue
            body = self.model.geom_bodyid[geom.objid]
            if self.model.body_rootid[body] == self._vehicle_root:
                geom.rgba[:] = change(np.array(geom.rgba))
            elif others:
                geom.rgba[3] = 0.0

    def _add_ghost(self, ghost: Ghost) -> None:
        self._place(self._ghost_data, ghost.qpos)
        first = self._scene.ngeom
        mujoco.mjv_addGeoms(
            self.model, self._ghost_data, self._option, mujoco.MjvPerturb(),
            mujoco.mjtCatBit.mjCAT_DYNAMIC.value, self._scene,
        )  # fmt: skip
        colour = np.array(ghost.colour)

        def change(rgba):
            rgb = rgba[:3] + ghost.tint * (colour * (0.45 + 0.75 * rgba[:3].mean()) - rgba[:3])
            return np.append(rgb, ghost.alpha * rgba[3])

        self._recolour(first, change, others=True)

    def _add_trail(self, trail: np.ndarray, colour) -> None:
        colours = np.broadcast_to(overlay.TRAIL if colour is None else colour, (len(trail), 3))
        capsule = mujoco.mjtGeom.mjGEOM_CAPSULE
        for k in range(min(len(trail) - 1, self._scene.maxgeom - self._scene.ngeom)):
            geom, rgba = self._scene.geoms[self._scene.ngeom], np.float32([*colours[k], 0.9])
            mujoco.mjv_initGeom(geom, capsule, np.zeros(3), np.zeros(3), np.eye(3).ravel(), rgba)
            mujoco.mjv_connector(geom, capsule, 0.0013 * self.scale, trail[k], trail[k + 1])
            self._scene.ngeom += 1
