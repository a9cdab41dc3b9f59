"""Contact forces of a simulation as arrows to draw."""

from __future__ import annotations

import mujoco
import numpy as np


def contact_arrows(
    model: mujoco.MjModel, data: mujoco.MjData, metres_per_newton: float = 0.3
) -> list[tuple[np.ndarray, np.ndarray]]:
    """(point (3,), arrow (3,)) [m] for every contact that carries force, on the vehicle.

    The arrow is the force that the world exerts on the vehicle; `data` must hold a forward pass.
    The points are those of the real vehicle: draw it at scale 1.
    """
    arrows = []
    root = model.body("crazyflie").id
    wrench = np.zeros(6)
    for k in range(data.ncon):
        contact = data.contact[k]
        mujoco.mj_contactForce(model, data, k, wrench)
        force = contact.frame.reshape(3, 3).T @ wrench[:3]  # on the second geom
        if model.body_rootid[model.geom_bodyid[contact.geom1]] == root:
            force = -force
        if np.linalg.norm(force) > 1e-6:
            arrows.append((contact.pos.copy(), metres_per_newton * force))
    return arrows
