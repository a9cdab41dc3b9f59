"""Contact forces of a simulation as arrows to draw."""

from __future__ import annotations

import mujoco
import numpy as np

from inclined_landing.models.plants.recorder import contact_forces


def contact_arrows(
    model: mujoco.MjModel, data: mujoco.MjData, metres_per_newton: float = 0.3
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return (point (3,), arrow (3,)) [m] of every contact that carries force, for `render(forces=...)`."""
    return [(point, metres_per_newton * force) for point, force in zip(*contact_forces(model, data))]
