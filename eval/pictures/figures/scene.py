"""The scene as a drawing in the x-z or y-z plane: platform as shapes, vehicles as rendered stamps."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage

from inclined_landing.envs.rendering.sprite import SpriteRenderer
from inclined_landing.eval.base.colours import AIR, BASE, GREEN, SLAB
from inclined_landing.models.vehicle import Vehicle

GOAL_COLOUR = tuple(int(GREEN[i : i + 2], 16) / 255.0 for i in (1, 3, 5))


def draw_background(axes: Axes, x: tuple[float, float], z: tuple[float, float], name: str = "x") -> None:
    """Draw an empty scene over x (or y, by its name) and z [m], equal scales."""
    axes.set_facecolor(AIR)
    axes.grid(True)
    axes.set(xlim=x, ylim=z, aspect="equal", xlabel=f"{name} [m]", ylabel="z [m]")


def platform_outline(inclination: float, vehicle: Vehicle) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners [m] of the slab (4, 2) and of the base under it (4, 2) as x, z."""
    half, thick = vehicle.slab_half_length, vehicle.platform_thickness
    cos, sin = np.cos(inclination), np.sin(inclination)
    along, up = np.array([cos, -sin]), np.array([sin, cos])
    middle = np.array([0.0, vehicle.platform_surface_height])
    top = middle + np.outer([-half, half], along)
    under = top - thick * up
    slab = np.vstack([top, under[::-1]])
    base = np.vstack([under, under[::-1] * [1.0, 0.0]])
    return slab, base


def draw_platform(axes: Axes, inclination: float, vehicle: Vehicle) -> None:
    """Draw slab and base, clipped at the lower edge of the axes."""
    slab, base = platform_outline(inclination, vehicle)
    axes.fill(*base.T, color=BASE, lw=0, zorder=2, gid="base")
    axes.fill(*slab.T, facecolor=SLAB, edgecolor="#8b939c", lw=0.5, zorder=2.1, gid="slab")


def draw_vehicle(
    axes: Axes, sprites: SpriteRenderer, state: np.ndarray, *, colour=None, alpha=1.0, zorder=4.0, gid=None
) -> AxesImage:
    """Draw a rendered copy at state (13,), its centre of mass at the state's x (or y) and z."""
    sprite = sprites(state[6:9], colour)
    x, z = state[sprites.across], state[2]
    extent = (x - sprite.half, x + sprite.half, z - sprite.half, z + sprite.half)
    limits = axes.get_xlim(), axes.get_ylim()
    image = axes.imshow(
        sprite.rgba, extent=extent, alpha=alpha, zorder=zorder, interpolation="antialiased", aspect="equal",
        interpolation_stage="rgba",
    )  # fmt: skip
    axes.set(xlim=limits[0], ylim=limits[1])
    image.set_gid(gid)
    return image
