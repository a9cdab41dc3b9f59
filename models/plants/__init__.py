"""One interface, two plants: the paper's equations and the MuJoCo vehicle, n vehicles each.

Everything above this module is written once against it. A plant is stepped with the paper's commands
u = [PWM, roll, pitch, yaw rate] (n, 4) held for one control period, and shows

- `state` (n, 13): columns of `attitude.py`, a copy refreshed by every call;
- `measurement` (n, 13): the state as motion capture reports it, which is late with that effect;
- `contacts`: what the vehicles' parts touched during the last control step;
- `reset(ids, state)`: full state, lag included; `save()` / `restore()`: everything that a replay needs;
- `set_platform(ids, inclination, present)` and `perturb(**changes)`, per vehicle, no recompiling.

The MuJoCo plant also has `set_contact(ids, ...)`: friction, restitution and contact time, foot height;
and `torque_needs_motors`: with it, a vehicle under PWM 0 has no attitude torque, as motors make it.
"""

from __future__ import annotations

import dataclasses
import math
import os
from typing import Literal

import mujoco
import mujoco.batch
import numba
import numpy as np

from inclined_landing.models import contact, equations, geometry, perturbation
from inclined_landing.models.attitude import (
    LAG,
    PITCH,
    PWM,
    ROLL,
    STATE_SIZE,
    VX,
    WX,
    WZ,
    YAW,
    body_rates,
    euler_angles,
    quaternion,
)
from inclined_landing.models.delays import Delays
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import Vehicle, check_vehicle, load_vehicle
from inclined_landing.models.scene import compile_scene

Attitude = Literal["rate_loop", "kinematic"]
PLANTS = ("mujoco", "analytic")
# The engine's warnings on which it silently resets a simulation.
_DIVERGED = slice(int(mujoco.mjtWarning.mjWARN_BADQPOS), int(mujoco.mjtWarning.mjWARN_BADQACC) + 1)


@dataclasses.dataclass
class Contacts:
    """Contacts of the last control step; axes are vehicle, surface (slab, base, floor), part.

    Parts are feet, body, rotors. `near` includes a keep-out zone if the plant has one, `touch` does
    not. `force` is the largest net force on the part during the step [N]; NaN in the analytic plant,
    whose vehicles pass through surfaces.
    """

    near: np.ndarray  # (n, 3, 3) bool
    touch: np.ndarray  # (n, 3, 3) bool
    force: np.ndarray  # (n, 3, 3) N

    @property
    def platform(self) -> np.ndarray:
        """(n,) bool: any part touches slab or base."""
        return self.touch[:, :2].any(axis=(1, 2))

    @property
    def platform_near(self) -> np.ndarray:
        """(n,) bool: any part within the keep-out zone of slab or base, or touching."""
        return self.near[:, :2].any(axis=(1, 2))


@dataclasses.dataclass
class Snapshot:
    """Everything `Plant.restore` needs; opaque to the caller."""

    arrays: dict[str, np.ndarray]


class _Plant:
    """What both plants share: platform poses, perturbations, snapshots."""

    def __init__(self, n: int, vehicle: Vehicle | None, attitude: Attitude, keep_out: float):
        if attitude not in ("rate_loop", "kinematic"):
            raise UserError(f"attitude must be 'rate_loop' or 'kinematic', not {attitude!r}")
        if n < 1:
            raise UserError(f"a plant needs at least one vehicle, not {n}")
        if not (math.isfinite(keep_out) and keep_out >= 0):
            raise UserError(f"keep_out must not be negative, it is {keep_out!r}")
        self.n = n
        self.vehicle = vehicle or load_vehicle()
        check_vehicle(self.vehicle)
        self.attitude = attitude
        self.keep_out = keep_out
        self.control_period = self.vehicle.command_control_period
        self.state = np.zeros((n, STATE_SIZE))
        self.contacts = Contacts(np.zeros((n, 3, 3), bool), np.zeros((n, 3, 3), bool), np.zeros((n, 3, 3)))
        self.inclination = np.full(n, self.vehicle.platform_inclination)
        self.present = np.ones(n, bool)
        self.perturbation = perturbation.neutral(n)
        self.delays = Delays(n, self.vehicle)
        self._constants = equations.pack(self.vehicle)

    def _arrays(self) -> dict[str, np.ndarray]:
        c = self.contacts
        return {
            "state": self.state,
            "near": c.near,
            "touch": c.touch,
            "force": c.force,
            "inclination": self.inclination,
            "present": self.present,
            "perturbation": self.perturbation,
        } | self.delays.arrays()

    @property
    def measurement(self) -> np.ndarray:
        """(n, 13): `state`, or what it was one motion capture delay ago; not to be changed."""
        return self.delays.measurement(self.state)

    def save(self) -> Snapshot:
        """Everything a later bit-for-bit replay needs."""
        return Snapshot({name: array.copy() for name, array in self._arrays().items()})

    def restore(self, snapshot: Snapshot) -> None:
        """Return to a snapshot of a plant of the same kind and size."""
        own = self._arrays()
        if set(own) != set(snapshot.arrays) or self.n != len(snapshot.arrays["state"]):
            raise UserError("the snapshot belongs to a plant of another kind or size")
        for name, array in own.items():
            array[:] = snapshot.arrays[name]
        self._apply_perturbation()

    def perturb(self, **changes) -> None:
        """Set named deviations (see `perturbation.NAMES`) to a number or an (n,) array."""
        self.perturbation[:] = perturbation.perturb(self.perturbation, **changes)
        self._apply_perturbation()

    def _apply_perturbation(self) -> None:
        """Hook for plants that keep the perturbation elsewhere too."""

    def _clear_contacts(self, ids) -> None:
        self.contacts.near[ids] = False
        self.contacts.touch[ids] = False
        self.contacts.force[ids] = 0.0


class AnalyticPlant(_Plant):
    """The equations of `equations.py`; obstacles are detected geometrically, never felt.

    substeps: RK4 steps per control period. The default of one is the paper's 0.02 s.
    """

    kind = "analytic"

    def __init__(
        self,
        n: int,
        vehicle: Vehicle | None = None,
        *,
        attitude: Attitude = "kinematic",
        keep_out: float = 0.0,
        substeps: int = 1,
    ):
        super().__init__(n, vehicle, attitude, keep_out)
        if substeps < 1:
            raise UserError(f"substeps must be at least 1, not {substeps}")
        self.substeps = substeps
        self.shapes = geometry.shapes_of(compile_scene(self.vehicle))
        self._position, _ = geometry.platform_poses(self.inclination, self.present, self.vehicle)
        self._distance = np.empty((n, 3, 3))
        self._ambient = np.zeros((n, equations.AMBIENT_SIZE))
        self._ambient[:, equations.VOLTAGE] = np.nan
        self._ambient[:, equations.INCLINATION], self._ambient[:, equations.PRESENT] = self.inclination, True
        self.contacts.force[:] = np.nan

    def _arrays(self):
        return super()._arrays() | {"position": self._position, "ambient": self._ambient}

    def _clear_contacts(self, ids) -> None:
        super()._clear_contacts(ids)
        self.contacts.force[ids] = np.nan

    def set_platform(self, ids, inclination, present=True) -> None:
        """Platform inclination [rad] and presence of the vehicles `ids`."""
        self.inclination[ids] = inclination
        self.present[ids] = present
        self._position[ids] = geometry.platform_poses(self.inclination[ids], self.present[ids], self.vehicle)[
            0
        ]
        self._ambient[ids, equations.INCLINATION], self._ambient[ids, equations.PRESENT] = (
            inclination,
            present,
        )

    def reset(self, ids, state: np.ndarray) -> None:
        """Put the vehicles `ids` into `state` (k, 13) at time 0; contacts and past commands cleared."""
        self.state[ids] = state
        self._ambient[ids, equations.TIME] = 0.0
        self.delays.reset(ids, state)
        self._clear_contacts(ids)

    def step(self, commands: np.ndarray) -> None:
        """Advance every vehicle by one control period under commands (n, 4)."""
        commands = np.ascontiguousarray(commands, dtype=float)
        dt = self.control_period / self.substeps
        self.delays.push_commands(commands)
        if self.delays.of_commands:
            for k in range(self.substeps):
                self._advance(self.delays.acting(k * dt, dt), dt, 1)
        else:
            self._advance(commands, dt, self.substeps)
        self.delays.push_state(self.state)
        geometry.clearances(self.state, self.inclination, self._position, self.shapes, self._distance)
        np.less(self._distance, self.keep_out, out=self.contacts.near)
        np.less(self._distance, 0.0, out=self.contacts.touch)

    def _advance(self, commands: np.ndarray, dt: float, substeps: int) -> None:
        rate_loop = self.attitude == "rate_loop"
        equations.advance(
            self.state, commands, self._ambient, self._constants, self.perturbation, rate_loop, dt, substeps
        )


class MujocoPlant(_Plant):
    """The MJCF vehicle on `mujoco.batch`: real bodies, native actuator plugins, real contact.

    attitude: "rate_loop" is the physical vehicle; "kinematic" sets the body rates to the paper's
    first-order loops at every control tick (free flight only: a vehicle that touched something
    keeps its physical rates), the mode for exact comparison. A delayed attitude command that changes
    between two ticks is followed by the rate loop until the next one.
    integrator, timestep: of the engine; the control period must be a whole number of time steps.
    keep_out: sensor-only zone around the platform [m] in which contacts count as `near`.
    threads: 0 takes all cores.
    """

    kind = "mujoco"

    def __init__(
        self,
        n: int,
        vehicle: Vehicle | None = None,
        *,
        attitude: Attitude = "rate_loop",
        keep_out: float = 0.0,
        integrator: str = "RK4",
        timestep: float = 0.004,
        threads: int = 0,
        torque_limit: bool = True,
    ):
        super().__init__(n, vehicle, attitude, keep_out)
        if not (math.isfinite(timestep) and timestep > 0):
            raise UserError(f"timestep must be positive, not {timestep!r}")
        self.substeps = round(self.control_period / timestep)
        if self.substeps < 1 or abs(self.substeps * timestep - self.control_period) > 1e-12:
            raise UserError(
                f"the control period {self.control_period:g} s is not a whole number of "
                f"time steps of {timestep:g} s"
            )
        self.model = compile_scene(
            self.vehicle,
            integrator=integrator,
            timestep=timestep,
            keep_out=keep_out,
            torque_limit=torque_limit,
        )
        self.shapes = geometry.shapes_of(self.model)
        threads = min(threads or len(os.sched_getaffinity(0)), n)
        self.batch = mujoco.batch.Batch(self.model, n, threads)
        bind = self.batch.bind
        self._qpos, self._qvel, self._act = bind("qpos"), bind("qvel"), bind("act")
        self._ctrl, self._warmstart, self._time = bind("ctrl"), bind("qacc_warmstart"), bind("time")
        self._mocap_pos, self._mocap_quat = bind("mocap_pos"), bind("mocap_quat")
        self._mocap = [int(self.model.body(b).mocapid[0]) for b in geometry.PLATFORM_BODIES]
        self._warning = self.batch.warning
        self._history = bind("history") if self.model.nhistory else None
        self._held = _held_histories(self.model) if self.model.nhistory else None
        self._sensors = np.zeros((n, self.substeps, self.model.nsensordata))
        self._perturbed = self._contact_set = False
        self.torque_needs_motors = False
        self._loops = np.array([self.model.actuator(name).id for name in ("roll", "pitch", "yaw_rate")])
        v, feet = self.vehicle, self.shapes.parts == geometry.PARTS.index("feet")
        self.foot_height = float((self.shapes.radii - self.shapes.centres[:, 2])[feet].max())
        self._contact_default = np.array([v.contact_friction, *v.contact_solref, self.foot_height])
        self._contact = np.tile(self._contact_default, (n, 1))
        self.set_platform(np.arange(n), self.inclination)
        self.reset(np.arange(n), self.state)

    def _arrays(self):
        return super()._arrays() | {"engine": self.batch.state, "contact": self._contact}

    def restore(self, snapshot: Snapshot) -> None:
        """Return to a snapshot of a plant of the same kind and size."""
        super().restore(snapshot)
        self._apply_contact()
        self._warning[:] = 0

    def set_contact(
        self, ids, *, friction=None, restitution=None, contact_time=None, solref=None, foot_height=None
    ) -> None:
        """Contact parameters of the vehicles `ids`, numbers or (k,) arrays; None leaves them as they are.

        friction: sliding friction between the vehicle and every surface.
        restitution, contact_time [s]: see `contact.solref`; both or none.
        solref: instead of these, MuJoCo's own (2,) or (k, 2).
        foot_height: how far the feet reach below the centre of mass [m]; the plant's `foot_height` is
            the nominal one.

        Vehicle and surfaces get the same values, because the engine mixes those of both sides.
        Raises UserError, and changes nothing, for values that are out of range.
        """
        rows = self._contact[ids].copy()
        if friction is not None:
            rows[..., 0] = contact.check_friction(friction)
        if (restitution is None) != (contact_time is None):
            raise UserError("restitution and contact time belong together: give both or none")
        if restitution is not None:
            if solref is not None:
                raise UserError("give either restitution and contact time or solref, not all of them")
            solref = contact.solref(restitution, contact_time, self.vehicle.environment_gravity)
        if solref is not None:
            rows[..., 1:3] = contact.check_solref(solref)
        if foot_height is not None:
            rows[..., 3] = contact.check_foot_height(foot_height, self.foot_height)
        self._contact[ids] = rows
        self._apply_contact()

    def _apply_contact(self) -> None:
        if not self._contact_set and (self._contact == self._contact_default).all():
            return
        self._contact_set = True
        model, c, expand = self.model, self._contact, self.batch.expand
        geoms = np.flatnonzero(model.geom_contype)
        expand("geom_friction")[:, geoms, 0] = c[:, :1]
        expand("geom_solref")[:, geoms] = c[:, None, 1:3]
        if (c[:, 3] != self.foot_height).any() or self.batch.expanded("body_pos") is not None:
            feet = model.body("feet").id
            expand("body_pos")[:, feet, 2] = model.body_pos[feet, 2] + self.foot_height - c[:, 3]
            self.batch.set_const()

    def set_platform(self, ids, inclination, present=True) -> None:
        """Platform inclination [rad] and presence of the vehicles `ids`."""
        self.inclination[ids] = inclination
        self.present[ids] = present
        position, quat = geometry.platform_poses(self.inclination[ids], self.present[ids], self.vehicle)
        for k, mocap in enumerate(self._mocap):
            self._mocap_pos[ids, mocap] = position[:, k]
            self._mocap_quat[ids, mocap] = quat[:, k]

    def reset(self, ids, state: np.ndarray) -> None:
        """Put the vehicles `ids` into `state` (k, 13): pose, rates, lag; contacts, past commands cleared."""
        ids = np.asarray(ids)
        if ids.dtype == bool:
            ids = np.flatnonzero(ids)
        state = np.ascontiguousarray(state, dtype=float)
        _write_state(ids, state, self._qpos, self._qvel, self._act)
        self._ctrl[ids] = 0.0
        self._warmstart[ids] = 0.0
        self._time[ids] = 0.0
        self._warning[ids] = 0
        self.state[ids] = state
        self.delays.reset(ids, state)
        self._clear_contacts(ids)

    def step(self, commands: np.ndarray) -> None:
        """Advance every vehicle by one control period under commands (n, 4).

        Contacts are the maximum over the control step's substeps, each seen at its beginning.
        Raises FloatingPointError, naming the vehicles, when the engine diverges; reset them to go on.
        """
        commands = np.asarray(commands, float)
        self._ctrl[:] = commands
        fresh = np.flatnonzero(self.delays.fresh)
        if self._history is not None and len(fresh):
            empty, held = self._held
            self._history[fresh] = empty + commands[fresh] @ held
        self.delays.push_commands(commands)
        if self.torque_needs_motors:
            self._allow_torque(commands[:, PWM] > 0.0)
        if self.attitude == "kinematic":
            touched = self.contacts.touch.any(axis=(1, 2))
            wanted = self._ctrl
            if self.delays.of_commands:
                wanted = self.delays.acting(0.0, self.control_period / self.substeps)
            _synchronise_rates(self._qpos, self._qvel, wanted, self._constants, self.perturbation, touched)
        self.batch.rollout(self.substeps, record=("sensordata",), out={"sensordata": self._sensors})
        c = self.contacts
        _read_contacts(self._sensors, self.keep_out > 0.0, c.near, c.touch, c.force)
        _read_state(self._qpos, self._qvel, self._act, self.state)
        self.delays.push_state(self.state)
        if self._warning[:, _DIVERGED, 1].any() or not np.isfinite(self.state).all():
            bad = self._warning[:, _DIVERGED, 1].any(axis=1) | ~np.isfinite(self.state).all(axis=1)
            raise FloatingPointError(f"the engine diverged for vehicles {np.flatnonzero(bad)[:5].tolist()}")

    @property
    def feet_force(self) -> np.ndarray:
        """(n, 3) net force between slab and feet at the beginning of the last engine step [N]."""
        return self._sensors[:, -1, 1:4]

    def _allow_torque(self, running: np.ndarray) -> None:
        """Attitude torques within the vehicle's limits where the motors are `running` (n,), else none."""
        if running.all() and self.batch.expanded("actuator_forcerange") is None:
            return
        limits = self.model.actuator_forcerange[self._loops]
        self.batch.expand("actuator_forcerange")[:, self._loops] = running[:, None, None] * limits

    def _apply_perturbation(self) -> None:
        if not self._perturbed and (self.perturbation == perturbation.NEUTRAL).all():
            return
        self._perturbed = True
        p, expand = self.perturbation, self.batch.expand
        model = self.model
        thrust = model.actuator("thrust").id
        gain, dynamics, bias = (expand(f"actuator_{k}prm") for k in ("gain", "dyn", "bias"))
        gain[:, thrust, 0] = p[:, perturbation.THRUST_SCALE]
        dynamics[:, thrust, 0] = p[:, perturbation.LAG_SCALE]
        bias[:, thrust, 0] = p[:, perturbation.THRUST_BIAS]
        bias[:, thrust, 1] = p[:, perturbation.DRAG_CHANGE]
        for loop in (model.actuator(name).id for name in ("roll", "pitch")):
            gain[:, loop, 0] = p[:, perturbation.GAIN_SCALE]
            dynamics[:, loop, 0] = p[:, perturbation.TIME_CONSTANT_SCALE]
        if (p[:, perturbation.MASS_SCALE] != 1.0).any() or self.batch.expanded("body_mass") is not None:
            body = model.body("crazyflie").id
            mass = expand("body_mass")
            mass[:, body] = model.body_mass[body] * p[:, perturbation.MASS_SCALE]
            self.batch.set_const()


def make_plant(kind: str, n: int, vehicle: Vehicle | None = None, **options):
    """A plant by name: "mujoco" or "analytic"."""
    if kind == "mujoco":
        return MujocoPlant(n, vehicle, **options)
    if kind == "analytic":
        return AnalyticPlant(n, vehicle, **options)
    raise UserError(f"unknown plant {kind!r}; known are {' and '.join(PLANTS)}")


def _held_histories(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """The engine's history buffer at time 0: empty (h,), and per control what one unit held adds (nu, h)."""
    data = mujoco.MjData(model)
    empty, held = data.history.copy(), np.zeros((model.nu, model.nhistory))
    for actuator in range(model.nactuator):
        samples = model.actuator_history[actuator, 0]
        if samples:
            mujoco.mj_initCtrlHistory(model, data, actuator, None, np.ones(samples))
            held[model.actuator_ctrladr[actuator]] = data.history - empty
            data.history[:] = empty
    return empty, held


@numba.njit(cache=True)
def _write_state(ids, state, qpos, qvel, act):
    for k in range(len(ids)):
        i, s = ids[k], state[k]
        qpos[i, :3] = s[:3]
        qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6] = quaternion(s[ROLL], s[PITCH], s[YAW])
        qvel[i, :3] = s[VX : VX + 3]
        qvel[i, 3:6] = s[WX : WX + 3]
        act[i, 0] = s[LAG]


@numba.njit(cache=True)
def _read_state(qpos, qvel, act, state):
    for i in range(state.shape[0]):
        q, s = qpos[i], state[i]
        s[:3] = q[:3]
        s[VX : VX + 3] = qvel[i, :3]
        s[ROLL], s[PITCH], s[YAW] = euler_angles(q[3], q[4], q[5], q[6])
        s[WX : WZ + 1] = qvel[i, 3:6]
        s[LAG] = act[i, 0]


@numba.njit(cache=True)
def _synchronise_rates(qpos, qvel, ctrl, c, p, touched):
    for i in range(qpos.shape[0]):
        if touched[i]:
            continue
        roll, pitch, _ = euler_angles(qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6])
        a, b, d = equations.loop_rates(roll, pitch, ctrl[i], c, p[i])
        qvel[i, 3], qvel[i, 4], qvel[i, 5] = body_rates(roll, pitch, a, b, d)


@numba.njit(cache=True)
def _read_contacts(sensors, zone, near, touch, force):
    """Fold the (n, substeps, 60) contact sensors into (n, 3, 3) arrays, maximum over substeps.

    Sensors come in the order slab, three base geoms, floor, each feet, body, rotors, each found and
    net force. The forces on one part by the base's geoms are added as vectors.
    """
    net = np.empty(3)
    for i in range(sensors.shape[0]):
        near[i] = False
        touch[i] = False
        force[i] = 0.0
        for s in range(sensors.shape[1]):
            row = sensors[i, s]
            for surface in range(3):
                first = 0 if surface == 0 else (1 if surface == 1 else 4)
                last = 1 if surface == 0 else (4 if surface == 1 else 5)
                for part in range(3):
                    found = False
                    net[:] = 0.0
                    for geom in range(first, last):
                        k = 4 * (3 * geom + part)
                        if row[k] > 0.0:
                            found = True
                            net += row[k + 1 : k + 4]
                    if found:
                        near[i, surface, part] = True
                        size = np.sqrt(net[0] ** 2 + net[1] ** 2 + net[2] ** 2)
                        force[i, surface, part] = max(force[i, surface, part], size)
                        if size > 0.0 or not zone:
                            touch[i, surface, part] = True
