"""Contact forces of a simulation, as vectors and as arrows to draw."""

from __future__ import annotations

import mujoco
import numpy as np


def contact_forces(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
    """Points (k, 3) [m] and forces (k, 3) [N] of the vehicle's contacts; `data` must hold a forward pass.

    A force is what the world exerts on the vehicle. Contacts without force are left out.
    """
    points, forces = [], []
    root = model.body("crazyflie").id
    wrench = np.zeros(6)
    for k in range(data.ncon):
        contact = data.contact[k]
        mujoco.mj_contactForce(model, data, k, wrench)
        force = contact.frame.reshape(3, 3).T @ wrench[:3]  # on the second geom
        if model.body_rootid[model.geom_bodyid[contact.geom1]] == root:
            force = -force
        if np.linalg.norm(force) > 1e-6:
            points.append(contact.pos.copy())
            forces.append(force)
    return np.reshape(points, (-1, 3)), np.reshape(forces, (-1, 3))


def contact_arrows(
    model: mujoco.MjModel, data: mujoco.MjData, metres_per_newton: float = 0.3
) -> list[tuple[np.ndarray, np.ndarray]]:
    """(point (3,), arrow (3,)) [m] for every contact that carries force, as for `render(forces=...)`."""
    return [(point, metres_per_newton * force) for point, force in zip(*contact_forces(model, data))]
