"""MuJoCo's own OpenGL renderer, used only after a search for OpenGL.

Without OpenGL MuJoCo 4.0 raises at the first renderer and aborts the process at the second. The libraries are
therefore searched with ctypes first; nothing here runs at import and no environment variable of MuJoCo is
set. In a forked process whose parent has used OpenGL, the next call would hang, so it is refused.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from inclined_landing.envs.rendering import overlay
from inclined_landing.envs.rendering.pose import Ghost, Pose, place
from inclined_landing.envs.rendering.renderer import SceneRenderer
from inclined_landing.models.base.errors import UserError

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


def _check_process() -> None:
    """Raise UserError in a forked process whose parent has used OpenGL."""
    if _process not in (None, os.getpid()):
        raise UserError(_LOST)


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

    _gl: Any = None
    _mjr: Any = None

    def _prepare(self, model: mujoco.MjModel) -> None:
        _check_process()
        self._gl = self._gl or _context(self.width, self.height)
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

    def close(self) -> None:
        """Free the OpenGL context."""
        if self._mjr is not None:
            self._gl.make_current()
            self._mjr.free()
        if self._gl is not None:
            self._gl.free()
        self._gl, self._mjr, self.closed = None, None, True

    def _draw(self, pose: Pose, ghosts: Sequence[Ghost], trail, trail_colour, show_vehicle) -> np.ndarray:
        _check_process()
        self.view(pose)
        self._gl.make_current()
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        camera.fixedcamid = self.model.camera(self.camera).id
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(self.model, self.data, self._option, None, camera, everything, self._scene)
        if not show_vehicle:
            self._recolour(0, lambda rgba: 0.0 * rgba, others=False)
        for ghost in ghosts:
            self._add_ghost(ghost)
        if trail is not None:
            self._add_trail(trail, trail_colour)
        rect = mujoco.MjrRect(0, 0, self.width, self.height)
        frame = np.empty((self.height, self.width, 3), np.uint8)
        mujoco.mjr_render(rect, self._scene, self._mjr)
        mujoco.mjr_readPixels(frame, None, rect, self._mjr)
        return np.ascontiguousarray(frame[::-1])

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
        self._ghost_data.mocap_pos, self._ghost_data.mocap_quat = self.data.mocap_pos, self.data.mocap_quat
        place(self.model, self._ghost_data, ghost.qpos)
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
