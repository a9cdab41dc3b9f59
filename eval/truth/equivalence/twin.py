"""A planar twin from MuJoCo's own parts, without plugins: an independent check of the plugins.

Slides along x and z, a hinge about y, a site motor with a native `filter` for the lag, a motor for the
direct part of the thrust and an affine servo for the rate loop; no drag. It must fly like the vehicle
with its drag off, to rounding.
"""

from __future__ import annotations

import dataclasses

import mujoco
import mujoco.batch
import numpy as np

from inclined_landing.eval.base.claims import Section
from inclined_landing.eval.truth.equivalence import flying
from inclined_landing.eval.truth.equivalence.flying import WORDS
from inclined_landing.eval.truth.equivalence.isolated import NO_DRAG
from inclined_landing.models.attitude import PITCH, PITCH_COMMAND, PWM, X, Z
from inclined_landing.models.vehicle import Vehicle

LIMIT = WORDS.tables["twin"]["position"]["high"]  # m and rad


def build(v: Vehicle, timestep: float = 0.004) -> mujoco.MjModel:
    """Return the twin; controls are PWM, PWM and pitch command."""
    spec = mujoco.MjSpec()
    spec.option.timestep = timestep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    spec.option.gravity = [0, 0, -v.environment_gravity]
    body = spec.worldbody.add_body(name="twin", pos=[0, 0, flying.HEIGHT])
    body.explicitinertial = True
    body.mass, body.ipos, body.inertia = v.body_mass, [0, 0, 0], v.body_inertia
    for name, kind, axis in (
        ("x", mujoco.mjtJoint.mjJNT_SLIDE, [1, 0, 0]),
        ("z", mujoco.mjtJoint.mjJNT_SLIDE, [0, 0, 1]),
        ("pitch", mujoco.mjtJoint.mjJNT_HINGE, [0, 1, 0]),
    ):
        body.add_joint(name=name, type=kind, axis=axis)
    body.add_site(name="com")
    up = [0, 0, 1, 0, 0, 0]
    lag = _actuator(spec, "lag", mujoco.mjtTrn.mjTRN_SITE, "com", v.thrust_state_gain / v.thrust_lag_rate, up)
    lag.dyntype = mujoco.mjtDyn.mjDYN_FILTER
    lag.dynprm[0] = 1 / v.thrust_lag_rate
    _actuator(spec, "direct", mujoco.mjtTrn.mjTRN_SITE, "com", v.thrust_direct_gain, up)
    # J [B ((k c - angle)/tau - rate) - rate/tau], an affine servo in angle and rate
    inertia, b, tau = v.body_inertia[1], v.attitude_bandwidth, v.attitude_time_constant
    joint = mujoco.mjtTrn.mjTRN_JOINT
    servo = _actuator(spec, "servo", joint, "pitch", inertia * b * v.attitude_gain / tau, [1, 0, 0, 0, 0, 0])
    servo.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    servo.biasprm[:3] = [0, -inertia * b / tau, -inertia * (b + 1 / tau)]
    return spec.compile()


def _actuator(spec, name, kind, target, gain, gear):
    actuator = spec.add_actuator(name=name, trntype=kind, target=target, gear=gear)
    actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
    actuator.gainprm[0] = gain
    return actuator


def fly(v: Vehicle, commands: np.ndarray) -> np.ndarray:
    """Return (steps, n, 3) x, z [m] and pitch [rad] of the twin under commands (steps, n, 4), from hover."""
    model = build(v)
    substeps = round(v.command_control_period / model.opt.timestep)
    batch = mujoco.batch.Batch(model, commands.shape[1], 1)
    qpos, act, ctrl = batch.bind("qpos"), batch.bind("act"), batch.bind("ctrl")
    act[:] = v.hover_pwm  # the filtered PWM: Omega times the lag rate
    history = np.empty((*commands.shape[:2], 3))
    for row, command in zip(history, commands):
        ctrl[:] = command[:, [PWM, PWM, PITCH_COMMAND]]
        batch.step(nstep=substeps)
        row[:] = qpos
    return history + [0, flying.HEIGHT, 0]


def errors(v: Vehicle, commands: np.ndarray) -> tuple[float, float]:
    """Return (m, rad) largest differences between twin and vehicle under planar commands (steps, n, 4)."""
    plain = dataclasses.replace(v, drag_coefficients=NO_DRAG)
    flown = flying.fly(flying.engine(commands.shape[1], "rate_loop", plain), commands)
    gap = np.abs(flown[..., [X, Z, PITCH]] - fly(plain, commands))
    return float(gap[..., :2].max()), float(gap[..., 2].max())


def section(v: Vehicle, commands: np.ndarray) -> Section:
    """Return the section for planar commands (steps, n, 4)."""
    metres, radians = errors(v, commands)
    return WORDS.section("twin", {"position": metres, "pitch": radians}, {"count": commands.shape[1]})
