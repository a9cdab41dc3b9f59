"""What contact gave the vehicle in one engine step, from the engine's own contact forces.

A Runge-Kutta step evaluates the contact forces four times, at its beginning, twice in its middle and at
its end, and moves the vehicle by their average with the weights 1, 2, 2, 1. The force sensors see the
first of the four only, and a touch of a few steps that is summed from them is off by up to a fifth. Here
the stages are repeated and their contact forces are weighted as the engine weights them: the impulse of
the contacts, independent of the motion, which it explains to rounding errors.
"""

from __future__ import annotations

import mujoco
import numpy as np

from inclined_landing.envs.rendering.contacts import contact_forces
from inclined_landing.models.errors import UserError
from inclined_landing.models.plants import MujocoPlant

# The classical fourth-order method as in the engine's mj_RungeKutta: every stage starts at the state of the
# step, moved by this share of the step with the rates of the stage before.
_MOVED = (0.5, 0.5, 1.0)
_WEIGHTS = (1 / 6, 1 / 3, 1 / 3, 1 / 6)


def step_impulse(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Impulse (3,) [N s] of all contacts on the vehicle in the engine step from the state in `data`.

    `data` holds state, control and platform pose, and is left at the last stage of the step.
    Raises UserError for another integrator than RK4.
    """
    if model.opt.integrator != mujoco.mjtIntegrator.mjINT_RK4:
        raise UserError("impulses of engine steps are known for the integrator RK4 only")
    step = model.opt.timestep
    start = data.qpos.copy(), data.qvel.copy(), data.act.copy(), data.time
    impulse = np.zeros(3)
    for stage, weight in enumerate(_WEIGHTS):
        if stage:
            moved = _MOVED[stage - 1] * step
            speed, acceleration, rate = data.qvel.copy(), data.qacc.copy(), data.act_dot.copy()
            data.qpos[:] = start[0]
            mujoco.mj_integratePos(model, data.qpos, speed, moved)
            data.qvel[:] = start[1] + moved * acceleration
            data.act[:] = start[2] + moved * rate
            data.time = start[3] + moved
        mujoco.mj_forward(model, data)
        impulse += weight * step * contact_forces(model, data)[1].sum(axis=0)
    return impulse


def next_impulses(plant: MujocoPlant, commands: np.ndarray) -> np.ndarray:
    """Impulses (n, 3) [N s] of the contacts on every vehicle in the engine step under `commands` (n, 4).

    Ask before the plant is stepped; it is not changed. Vehicles are computed one by one.
    """
    impulses = np.empty((plant.n, 3))
    for k in range(plant.n):
        data = plant.batch.get_data(k)
        data.ctrl[:] = commands[k]
        impulses[k] = step_impulse(plant.batch.get_model(k), data)
    return impulses
