"""Cut-out pictures of the vehicle seen along an axis, to be placed in diagrams."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from inclined_landing.envs.rendering import scenery
from inclined_landing.envs.rendering.camera import look_at
from inclined_landing.envs.rendering.pose import Ghost, place, pose_from_state, qpos_of_state
from inclined_landing.envs.rendering.ray import RayRenderer
from inclined_landing.models import threads
from inclined_landing.models.attitude import STATE_SIZE
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.vehicle import Vehicle

_PLACE = np.array([0.0, 0.0, 1.2])  # m; every copy is drawn here, alone under the same light


@dataclasses.dataclass(frozen=True)
class Sprite:
    """Cut-out picture rgba (k, k, 4) uint8 and half its side [m]; the centre of mass is at its centre."""

    rgba: np.ndarray
    half: float


class SpriteRenderer:
    """Orthographic renderer of vehicles in any attitude, `scale` times their size.

    across: 0 shows x to the right and z up (seen from the side), 1 shows y to the right (from the
    front). pixels: side of the stamps. The vehicle is scaled about its centre of mass, so that a stamp
    centred at its position shows where the vehicle is.
    """

    def __init__(
        self,
        vehicle: Vehicle | None = None,
        *,
        scale: float = scenery.SCALE,
        pixels: int = 384,
        across: int = 0,
    ):
        self.vehicle = vehicle or load_vehicle()
        self.scale, self.pixels, self.across = scale, pixels, across
        self._renderer = RayRenderer(self.vehicle, pixels, pixels, "side", scale)
        self._renderer.set_platform(pose_from_state(np.zeros(STATE_SIZE), None))
        self._cache: dict[tuple, Sprite] = {}

    def __call__(self, attitude, colour=None, tint: float = 0.85) -> Sprite:
        """Return the sprite at attitude (3,): roll, pitch, yaw [rad]; tinted by a colour (3,) in 0..1."""
        attitude = np.asarray(attitude, float)
        if attitude.shape != (3,) or not np.isfinite(attitude).all():
            raise UserError("an attitude must be three finite angles: roll, pitch and yaw")
        key = _key(attitude, colour, tint)
        if key not in self._cache:
            self._cache[key] = self._draw(self._renderer, attitude, colour, tint)
        return self._cache[key]

    def prepare(self, wanted: Sequence[tuple[np.ndarray, Any]], tint: float = 0.85) -> None:
        """Draw the sprites of attitudes and colours, two at a time, so that they are at hand."""
        renderers = self._renderer.several(2)

        def draw(part) -> None:
            renderer, (attitude, colour) = part
            self._cache[_key(attitude, colour, tint)] = self._draw(renderer, attitude, colour, tint)

        for first in range(0, len(wanted), len(renderers)):
            threads.in_threads(draw, list(zip(renderers, wanted[first:])))

    def _draw(self, renderer: RayRenderer, attitude, colour, tint) -> Sprite:
        state = np.zeros(STATE_SIZE)
        state[:3], state[6:9] = _PLACE, attitude
        scene, n = renderer._scene, self.pixels
        centre = scenery.scaled_centres(scene.model, state[None], self.scale)[0]
        qpos = qpos_of_state(state)
        place(scene.model, scene.data, qpos)
        drawn = scene.drawn
        distance = np.linalg.norm(scene.data.geom_xpos[drawn] - centre, axis=1)
        half = 1.02 * float((distance + scene.model.geom_rbound[drawn]).max())
        aside = np.array([2.0, 0.0, 0.0] if self.across else [0.0, -2.0, 0.0])
        view = look_at(centre + aside, centre, n, n, extent=2.0 * half)
        ghost = None if colour is None else Ghost(qpos, tuple(colour), alpha=1.0, tint=tint)
        (row, column), rgb, cover, _ = renderer._vehicle_layer(view, qpos, (0, 0, n, n), ghost)
        picture = np.zeros((n, n, 4))
        picture[:, :, :3] = rgb.sum(axis=0) / cover.sum()  # what resampling mixes in at the edges
        picture[row, column, :3] = rgb / cover[:, None]
        picture[row, column, 3] = cover
        return Sprite((np.clip(picture, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8), half)


def _key(attitude: np.ndarray, colour, tint: float) -> tuple:
    return attitude.tobytes(), None if colour is None else tuple(np.asarray(colour, float)), tint
