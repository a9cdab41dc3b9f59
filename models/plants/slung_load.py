"""Slung loads in the engine's arrays: a ball joint holds the direction of `models/load.py`."""

import math

import mujoco
import numpy as np

from inclined_landing.models.compiled import inner, kernel


def load_joint(model: mujoco.MjModel) -> np.ndarray:
    """Return the first columns (2,) of the slung load's joint in qpos and qvel; -1 if there is none."""
    k = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, "load")
    return np.array([-1, -1] if k < 0 else [model.jnt_qposadr[k], model.jnt_dofadr[k]])


@inner
def write_load(load, joint, row, columns):
    """Write a slung load (6,), see `Plant.load`, to a vehicle's row (s,) of the engine; see `load_joint`.

    columns: `engine.Columns`. The joint contains the load's attitude and rates relative to the vehicle. It
    does not turn about the string.
    """
    q, w = np.array((load[0], load[1], load[2])), np.array((load[3], load[4], load[5]))
    # Shortest turn from straight down to q: (1 - q_z, (0, 0, -1) x q), normalised; upside down any half turn.
    turn = np.array((1.0 - q[2], q[1], -q[0], 0.0))
    size = math.sqrt((turn**2).sum())
    turn = turn / size if size > 1e-9 else np.array((0.0, 1.0, 0.0, 0.0))
    qpos, qvel = row[columns.qpos :], row[columns.qvel :]
    # q_joint = conj(q_vehicle) q_load
    a, b, c, d = qpos[3], -qpos[4], -qpos[5], -qpos[6]
    at, dof = joint[0], joint[1]
    qpos[at] = a * turn[0] - b * turn[1] - c * turn[2] - d * turn[3]
    qpos[at + 1] = a * turn[1] + b * turn[0] + c * turn[3] - d * turn[2]
    qpos[at + 2] = a * turn[2] - b * turn[3] + c * turn[0] + d * turn[1]
    qpos[at + 3] = a * turn[3] + b * turn[2] - c * turn[1] + d * turn[0]
    # In the load's axes: R_load' (q x q') - R_joint' w_vehicle
    turning = matrix(turn).T @ np.cross(q, w)
    carried = matrix(qpos[at : at + 4]).T @ np.array((qvel[3], qvel[4], qvel[5]))
    for k in range(3):
        qvel[dof + k] = turning[k] - carried[k]


@kernel
def matrix(q):
    """Return the rotation matrix (3, 3) of a quaternion (4,) of any length."""
    w, x, y, z = q / math.sqrt((q**2).sum())
    return np.array(
        (
            (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
            (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
            (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
        )
    )


@kernel
def write_loads(ids, load, joint, engine, columns):
    """Write the slung loads (n, 6) of the vehicles `ids` into the engine's rows (n, s); see `write_load`."""
    for i in ids:
        write_load(load[i], joint, engine[i], columns)


@kernel
def read_loads(ids, load, joint, engine, columns):
    """Write the slung loads (n, 6) of the vehicles `ids` from the engine's rows (n, s)."""
    for i in ids:
        at, dof = joint[0], joint[1]
        qpos, qvel = engine[i, columns.qpos :], engine[i, columns.qvel :]
        turned = matrix(qpos[at : at + 4])
        world = matrix(qpos[3:7]) @ turned
        # q = -R_load e_z; q' = w x q with w = R_load (w_joint + R_joint' w_vehicle)
        carried = turned.T @ np.array((qvel[3], qvel[4], qvel[5]))
        w = world @ np.array((qvel[dof], qvel[dof + 1], qvel[dof + 2])) + world @ carried
        q = -world[:, 2]
        load[i, :3], load[i, 3:] = q, np.cross(w, q)
