"""Recording of landings at every engine step, the basis of all criteria on contact with a surface.

A `Recorder` flies a `MujocoPlant` and records each vehicle's first touch of the slab and the largest force on
its feet. `Steps` contains the engine steps of the last control period, from which studies compute other
quantities. `contact_forces` and `impulses` evaluate the individual contacts.

The force sensors of an engine step report only the first of its four stages, and a touch lasts only a few
steps: the sum of the sensor values misses up to a fifth of its impulse. `Steps.force` is the mean force over
each step instead, from the change of momentum, and agrees with the contact forces of all stages (`impulses`).

The sensors belong to the state at the beginning of a step. They detect a touch there, but the stages of the
previous step may already have met the surface: the last state without contact is one step older, and speeds
and attitudes of a touch are taken from it.
"""

from __future__ import annotations

import copy
import math
from typing import NamedTuple

import mujoco
import numpy as np

from inclined_landing.models import forces, surface
from inclined_landing.models.attitude import (
    PITCH,
    PWM,
    VX,
    VZ,
    WZ,
    YAW,
    euler_angles,
    rotation_entries,
    sine_cosine,
    to_world,
)
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.compiled import kernel
from inclined_landing.models.geometry import CONTACT_GEOMS, PARTS
from inclined_landing.models.plants.mujoco import MujocoPlant
from inclined_landing.models.plausible import ENGINE_STEP

_COLUMNS = {"qpos": 7, "qvel": 6, "act": 1}  # the vehicle's; those of a moving platform follow
STEP = ENGINE_STEP  # s, where nothing else is asked for
# Limits at one moment, below which a vehicle lies still. The touchdown task's are wider: they must hold for a
# while, and a vehicle on springy contact trembles.
STILL_SPEED = 0.02  # m/s
STILL_RATE = 0.2  # rad/s
SLAB = CONTACT_GEOMS.index("slab")  # row of `MujocoPlant.contact_sensors`
FEET = PARTS.index("feet")
# The classical fourth-order method as in the engine's mj_RungeKutta: every stage starts at the state of the
# step, moved by this share of the step with the rates of the stage before.
_MOVED = (0.5, 0.5, 1.0)
_WEIGHTS = (1 / 6, 1 / 3, 1 / 3, 1 / 6)


class Steps(NamedTuple):
    """One control period of k vehicles in the engine's steps; numba accepts it.

    Step s leads from row s of poses, speeds and lags to row s + 1; its sensors belong to row s.
    """

    time: np.ndarray  # (steps,) s since the start, of the steps' beginnings
    sensors: np.ndarray  # (k, steps, ...), addressed by `MujocoPlant.contact_sensors`
    qpos: np.ndarray  # (k, steps + 1, 7)
    qvel: np.ndarray  # (k, steps + 1, 6)
    act: np.ndarray  # (k, steps + 1, 1)
    force: np.ndarray  # (k, steps, 3) N, mean force of all contacts over each step, and of a slung load


class Touch(NamedTuple):
    """First touch of the slab by any part of n vehicles; NaN if there was none."""

    time: np.ndarray  # (n,) s, beginning of the engine step in which it is seen
    qpos: np.ndarray  # (n, 7) last pose free of contact
    qvel: np.ndarray  # (n, 6) last speeds free of contact


class Recorder:
    """Flies a plant and records the landings of its vehicles.

    plant: with platforms and contact set; its torque should come from the motors (`torque_needs_motors`).
    states: (n, 13) starts.
    """

    def __init__(self, plant: MujocoPlant, states: np.ndarray):
        n = plant.n
        self.plant = plant
        self.touch = Touch(np.full(n, np.nan), np.full((n, 7), np.nan), np.full((n, 6), np.nan))
        # N, largest normal force while the feet touch, sampled at the engine's steps or the mean of one
        self.feet_force = np.zeros(n)
        plant.reset(np.arange(n), states)
        self._older = tuple(plant.batch.bind(name)[:, : _COLUMNS[name]].copy() for name in ("qpos", "qvel"))
        self._time = 0.0
        self._ambient = forces.free_air(n)

    def step(self, commands: np.ndarray, ids: np.ndarray | None = None) -> Steps:
        """Fly one control period under commands (n, 4), of only the vehicles `ids`; see
        `MujocoPlant.advance`.

        Raises FloatingPointError, naming the vehicles, when the engine diverges.
        """
        steps = self.advance(commands, ids)
        self.plant.check()
        return steps

    def advance(self, commands: np.ndarray, ids: np.ndarray | None = None) -> Steps:
        """Do a `step` without raising an error; see `plant.diverged`."""
        plant, flown = self.plant, np.arange(self.plant.n) if ids is None else ids
        begun = {name: plant.batch.bind(name)[flown, None] for name in _COLUMNS}
        seen = plant.advance(commands, ids, record=tuple(begun))
        both = {name: np.concatenate([begun[name], seen[name]], axis=1) for name in begun}
        qpos, qvel, act = (np.ascontiguousarray(field[..., : _COLUMNS[name]]) for name, field in both.items())
        mean = np.empty((len(flown), plant.substeps, 3))
        steps = Steps(self._clock(), seen["sensordata"], qpos, qvel, act, mean)
        self._fill_forces(steps, flown)
        slab = plant.contact_sensors[SLAB]
        _record(
            steps, flown, slab, surface.normals(plant.platform), self.touch, *self._older, self.feet_force
        )
        return steps

    def _fill_forces(self, steps: Steps, ids: np.ndarray) -> None:
        plant, ambient = self.plant, self._ambient
        ambient[:, forces.INCLINATION], ambient[:, forces.AZIMUTH] = plant.platform[:, [PITCH, YAW]].T
        ambient[:, forces.PRESENT] = plant.present
        flown = plant.constants, plant.thrust_scale, ambient, plant.acting_commands()
        _mean_forces(steps, ids, *flown, plant.masses, plant.pushes.copy(), plant.model.opt.timestep)

    def _clock(self) -> np.ndarray:
        times, step = np.empty(self.plant.substeps), self.plant.model.opt.timestep
        for k in range(len(times)):
            times[k] = self._time
            self._time += step
        return times

    @property
    def touched(self) -> np.ndarray:
        """(n,) bool: whether any part has touched the slab."""
        return ~np.isnan(self.touch.time)

    def touch_speeds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the speeds (n,) [m/s] of the centre of mass into and along the surface at the touch.

        The speed along it is unsigned. On moving platforms both are relative to the point at the vehicle.
        """
        platform = self.plant.platform_at(self.touch.time - self.plant.model.opt.timestep)
        seen = np.zeros((self.plant.n, WZ + 1))
        seen[:, :VX], seen[:, VX : VZ + 1] = self.touch.qpos[:, :3], self.touch.qvel[:, :3]
        _, velocity, _ = surface.relative(seen, platform)
        normal = surface.normals(platform)
        away = (velocity * normal).sum(axis=1)
        return -away, np.linalg.norm(velocity - away[:, None] * normal, axis=1)

    def at_rest(self) -> np.ndarray:
        """(n,) bool: nearly motionless, with only the feet on the slab during the last control period."""
        touch = self.plant.contacts.touch
        on_feet = touch[:, 0, FEET] & (touch.sum(axis=(1, 2)) == 1)
        return still(self.plant.state, self.plant.platform) & on_feet


def still(state: np.ndarray, platform: np.ndarray | None) -> np.ndarray:
    """Return (n,) bool: whether states (n, 13) are nearly motionless relative to platforms (n, 12)."""
    around = np.zeros((len(state), WZ + 1)) if platform is None else platform
    _, velocity, rate = surface.relative(state, around)
    return (np.linalg.norm(velocity, axis=1) < STILL_SPEED) & (np.linalg.norm(rate, axis=1) < STILL_RATE)


def fly(plant: MujocoPlant, commands: np.ndarray) -> np.ndarray:
    """Return states (steps + 1, n, 13): the present ones, and those after each of commands (steps, n, 4)."""
    states = np.empty((len(commands) + 1, *plant.state.shape))
    states[0] = plant.state
    for row, command in zip(states[1:], commands):
        plant.step(command)
        row[:] = plant.state
    return states


@kernel
def _mean_forces(steps, ids, vehicles, thrust_scale, ambient, commands, masses, pushes, dt):
    """Write `Steps.force`: the change of a vehicle's momentum that neither air nor rotors cause."""
    position, velocity = np.empty(3), np.empty(3)
    for place in range(len(ids)):
        i = ids[place]
        v, scale, mass = vehicles[i if len(vehicles) > 1 else 0], thrust_scale[i], masses[i]
        for k in range(len(steps.time)):
            pwm = commands[k if len(commands) > 1 else 0, i, PWM]
            pwm = min(v.command.pwm_range[1], max(0.0, pwm))
            # F = m ((v' - v)/dt - g) - push - R f, the last as the mean of both ends
            force = steps.force[place, k]
            for j in range(3):
                change = steps.qvel[place, k + 1, j] - steps.qvel[place, k, j]
                force[j] = mass * change / dt - pushes[i, j]
            force[2] += mass * v.environment.gravity
            for end in range(2):
                ambient[i, forces.TIME] = steps.time[k] + end * dt
                q, lag = steps.qpos[place, k + end], steps.act[place, k + end, 0]
                position[:], velocity[:] = q[:3], steps.qvel[place, k + end, :3]
                roll, pitch, yaw = euler_angles(q[3], q[4], q[5], q[6])
                r = rotation_entries(sine_cosine(roll), sine_cosine(pitch), sine_cosine(yaw))
                x, y, z, _, _ = forces.wrench(position, velocity, r, lag, pwm, ambient[i], scale, v)
                x, y, z = to_world(r, x, y, z)
                force[0], force[1], force[2] = force[0] - 0.5 * x, force[1] - 0.5 * y, force[2] - 0.5 * z


@kernel
def _record(steps, ids, slab, normals, touch, older_qpos, older_qvel, feet_force):
    """Add a control period of the vehicles `ids` to their records."""
    feet = slab[0]
    for place in range(len(ids)):
        i = ids[place]
        x, y, z = normals[i]
        for k in range(len(steps.time)):
            row = steps.sensors[place, k]
            if row[feet] > 0.0:
                push = abs(x * row[feet + 1] + y * row[feet + 2] + z * row[feet + 3])
                mean = steps.force[place, k]
                feet_force[i] = max(feet_force[i], push, x * mean[0] + y * mean[1] + z * mean[2])
            touching = row[slab[0]] > 0.0 or row[slab[1]] > 0.0 or row[slab[2]] > 0.0
            if touching and math.isnan(touch.time[i]):
                touch.time[i] = steps.time[k]
                touch.qpos[i] = older_qpos[i]
                touch.qvel[i] = older_qvel[i]
            older_qpos[i] = steps.qpos[place, k]
            older_qvel[i] = steps.qvel[place, k]


def contact_forces(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
    """Return points (k, 3) [m] and forces (k, 3) [N] of the vehicle's contacts after a forward pass in
    `data`.

    Forces are those of the world on the vehicle. Contacts without force are omitted.
    """
    points, found = [], []
    of_vehicle = model.body_rootid[model.geom_bodyid] == model.body("crazyflie").id
    wrench = np.zeros(6)
    for k in range(data.ncon):
        contact = data.contact[k]
        mujoco.mj_contactForce(model, data, k, wrench)
        force = contact.frame.reshape(3, 3).T @ wrench[:3]  # on the second geom
        if of_vehicle[contact.geom1]:
            force = -force
        if np.linalg.norm(force) > 1e-6:
            points.append(contact.pos.copy())
            found.append(force)
    return np.reshape(points, (-1, 3)), np.reshape(found, (-1, 3))


def present_forces(plant: MujocoPlant, vehicle: int) -> tuple[np.ndarray, np.ndarray]:
    """Return `contact_forces` of one vehicle in its present state, which the sensors do not contain yet."""
    model, data = plant.batch.get_model(vehicle), plant.batch.get_data(vehicle)
    mujoco.mj_forward(model, data)
    return contact_forces(model, data)


def impulses(plant: MujocoPlant, commands: np.ndarray, ids: np.ndarray | None = None) -> np.ndarray:
    """Return the contact impulses (n, 3) [N s] on every vehicle in the engine step under `commands` (n, 4).

    ids: vehicles to compute (default: all); the others' impulses are 0.

    A Runge-Kutta step evaluates the contact forces four times, at its beginning, twice in its middle and at
    its end, and moves the vehicle by their average with the weights 1, 2, 2, 1. The force sensors report only
    the first of the four, so that the summed impulse of a touch of a few steps is wrong by up to a fifth.
    Here the stages are repeated and their contact forces are weighted as the engine weights them: the result
    is the impulse of the contacts, computed independently of the motion and consistent with it to rounding
    errors.

    Call this before the plant is stepped; the plant is not changed. Vehicles are computed one by one.
    Raises UserError for integrators other than RK4.
    """
    found, model = np.zeros((plant.n, 3)), copy.copy(plant.model)
    data = mujoco.MjData(model)
    plant.allow_torque(commands)
    for k in range(plant.n) if ids is None else ids:
        plant.batch.get_data(k, data)
        data.ctrl[:] = commands[k]
        found[k] = _step_impulse(plant.batch.get_model(k, model), data)
    return found


def _step_impulse(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return the impulse (3,) of the step from state, control and platform pose in `data`."""
    if model.opt.integrator != mujoco.mjtIntegrator.mjINT_RK4:
        raise UserError("impulses of engine steps need the integrator RK4")
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
