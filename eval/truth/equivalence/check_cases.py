"""NASA's check cases 1 to 3 for a rigid body (Murri, Jackson, Shelton, TM-2015-218675): the engine alone.

A sphere falls without drag, and a brick tumbles, without and with aerodynamic damping, for 30 s from 9 144 m.
The earth is flat here and gravity the vehicle's. The sphere is compared with g t^2/2, the brick with Euler's
equations solved to rounding.
"""

from __future__ import annotations

import functools

import mujoco
import numpy as np

from inclined_landing.eval.base.claims import Section, Table
from inclined_landing.eval.truth.equivalence.flying import WORDS
from inclined_landing.models.plausible import ENGINE_STEP
from inclined_landing.models.scene import INTEGRATORS
from inclined_landing.models.vehicle import Vehicle

DURATION, HEIGHT = 30.0, 9144.0  # s, m
FOOT, SLUG = 0.3048, 14.59390294  # m, kg
# The brick of cases 2 and 3: mass, moments of inertia, reference area, rates at the start.
MASS = 0.155404754 * SLUG
INERTIA = np.array([0.001894220, 0.006211019, 0.007194665]) * SLUG * FOOT**2
AREA = 0.22222 * FOOT**2
LENGTHS = np.array([1 / 3, 2 / 3, 1 / 3]) * FOOT  # of roll, pitch and yaw
DAMPING = 1.0  # minus the derivatives of the moments' coefficients by p b/2V, q c/2V, r b/2V
RATES = np.radians([10.0, 20.0, 30.0])


def damping(time: float, gravity: float) -> np.ndarray:
    """Return the moments (3,) per rate [N m s] on a brick that has fallen for a time [s] from HEIGHT."""
    # L = C (p b/2V) (rho V^2/2) S b = C rho V S b^2/4 p, at V = g t in the standard atmosphere
    speed, height = gravity * time, HEIGHT - 0.5 * gravity * time**2
    density = 1.225 * (1.0 - 2.25577e-5 * height) ** 4.2559
    return 0.25 * DAMPING * density * speed * AREA * LENGTHS**2


def simulate(integrator: str, gravity: float, damped: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return heights (steps + 1,) [m] and rates (steps + 1, 3) [rad/s] of the brick in the engine."""
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.integrator = ENGINE_STEP, INTEGRATORS[integrator]
    spec.option.gravity = [0, 0, -gravity]
    body = spec.worldbody.add_body(name="brick", pos=[0, 0, HEIGHT])
    body.add_freejoint()
    body.explicitinertial = True
    body.mass, body.ipos, body.inertia = MASS, [0, 0, 0], INERTIA
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel[3:] = RATES
    heights, rates = [HEIGHT], [RATES]
    for step in range(round(DURATION / ENGINE_STEP)):
        if damped:
            model.dof_damping[3:] = damping((step + 0.5) * ENGINE_STEP, gravity)
        mujoco.mj_step(model, data)
        heights.append(float(data.qpos[2]))
        rates.append(data.qvel[3:].copy())
    return np.array(heights), np.array(rates)


@functools.cache
def exact(gravity: float, damped: bool) -> np.ndarray:
    """Return the rates (steps + 1, 3) [rad/s] by Euler's equations."""
    from scipy.integrate import solve_ivp  # here, as it takes half a second while others are measured

    def change(time, w):
        torque = -damping(time, gravity) * w if damped else 0.0
        return (torque - np.cross(w, INERTIA * w)) / INERTIA

    times = np.arange(round(DURATION / ENGINE_STEP) + 1) * ENGINE_STEP
    return solve_ivp(change, (0.0, times[-1]), RATES, "DOP853", times, rtol=1e-12, atol=1e-14).y.T


def errors(integrator: str, gravity: float) -> dict[str, float]:
    """Return the largest errors: of the sphere's height [m], of the rates of the bricks [deg/s]."""
    times = np.arange(round(DURATION / ENGINE_STEP) + 1) * ENGINE_STEP
    heights, free = simulate(integrator, gravity, False)
    _, damped = simulate(integrator, gravity, True)
    return {
        "sphere": float(np.abs(heights - HEIGHT + 0.5 * gravity * times**2).max()),
        "brick": float(np.degrees(np.abs(free - exact(gravity, False)).max())),
        "damped": float(np.degrees(np.abs(damped - exact(gravity, True)).max())),
    }


def section(vehicle: Vehicle) -> Section:
    """Return the section on a rigid body in the engine."""
    found = {name: errors(name, vehicle.environment_gravity) for name in INTEGRATORS}
    heads = ("integrator", "sphere, height [m]", "brick, rates [deg/s]", "damped brick, rates [deg/s]")
    rows: list[tuple] = [(name, *error.values()) for name, error in found.items()]
    return WORDS.section("check_cases", found["RK4"], tables=[Table("", heads, rows)], data={"errors": found})
