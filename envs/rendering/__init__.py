"""Pictures of the landing scene.

    renderer = make_renderer(640, 480, camera="arena")
    pose = pose_from_state(state, resting_platform(vehicle))
    ghost, trail = Ghost(qpos_of_state(goal)), renderer.centres(states)
    frame = renderer.render(pose, trail=trail, ghosts=[ghost], caption="t 1.10 s")

Two backends draw the same scene: "ray" casts rays with MuJoCo and needs no OpenGL, "gl" is MuJoCo's
own renderer.
"""

from __future__ import annotations

from inclined_landing.envs.rendering.camera import View, look_at
from inclined_landing.envs.rendering.pose import Ghost, Pose, pose_from_state, qpos_of_state, resting_platform
from inclined_landing.models.base import schema
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.models.vehicle import Vehicle

BACKENDS = ("ray", "gl")
CAMERAS = ("arena", "side", "hero", "pad", "track", "chase", "closeup", "onboard")

__all__ = [
    "BACKENDS",
    "CAMERAS",
    "Ghost",
    "Pose",
    "View",
    "check_picture_options",
    "look_at",
    "make_renderer",
    "pose_from_state",
    "qpos_of_state",
    "resting_platform",
]


def check_picture_options(width: int, height: int, camera: str | View, backend: str) -> None:
    """Raise UserError for options of a picture that no renderer supports."""
    schema.check({"width": width, "height": height}, {"width": schema.Pixels, "height": schema.Pixels})
    if not isinstance(camera, View) and not (isinstance(camera, str) and camera in CAMERAS):
        raise UserError(f"unknown camera {shown(repr(camera), 40)}; choose from {', '.join(CAMERAS)}")
    if not (isinstance(backend, str) and backend in BACKENDS):
        raise UserError(
            f"unknown rendering backend {shown(repr(backend), 40)}; choose from {', '.join(BACKENDS)}"
        )


def make_renderer(
    width: int = 640,
    height: int = 480,
    camera: str | View = "arena",
    backend: str = "ray",
    *,
    vehicle: Vehicle | None = None,
    scale: float | None = None,
):
    """Return a renderer with `render(pose, ...) -> (height, width, 3) uint8` and `close()`.

    camera: one of CAMERAS, the first of which shows the whole arena, or, for rays, a `View`. scale:
    magnification of the drawn vehicle, by default 3 (it would be only a few pixels wide otherwise; the
    caption states it) and 1 for cameras close to it. Raises UserError for an unknown backend or camera, and
    for "gl" if OpenGL is missing.
    """
    check_picture_options(width, height, camera, backend)
    if backend == "gl":
        if isinstance(camera, View):
            raise UserError("a free View needs backend='ray'; otherwise name a camera of the scene")
        from inclined_landing.envs.rendering.gl import GLRenderer

        return GLRenderer(vehicle, width, height, camera, scale)
    from inclined_landing.envs.rendering.ray import RayRenderer

    return RayRenderer(vehicle, width, height, camera, scale)
