"""The MuJoCo vehicle as a plant."""

from __future__ import annotations

import copy
import os
from collections.abc import Sequence
from typing import Annotated, Any

import mujoco
import mujoco.batch
import numpy as np
from msgspec import Meta

from inclined_landing.models import attitude_loops, contact, equations, geometry
from inclined_landing.models.attitude import (
    COMMAND_SIZE,
    LAG,
    PITCH,
    PWM,
    ROLL,
    VX,
    WX,
    YAW,
    body_rates,
    euler_angles,
    quaternion,
)
from inclined_landing.models.base import schema
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.compiled import inlined, kernel
from inclined_landing.models.disturbance import Disturbance, Seed
from inclined_landing.models.motion import Motion
from inclined_landing.models.plants.base import Attitude, Plant, sizes_differ
from inclined_landing.models.plants.contacts import contact_sensors, read_contacts
from inclined_landing.models.plants.engine import Columns, Engine, differing_fields, held_histories
from inclined_landing.models.plants.platforms import Platforms
from inclined_landing.models.plants.slung_load import load_joint, read_loads, write_loads
from inclined_landing.models.plausible import ENGINE_STEP, check_solref
from inclined_landing.models.scene import Period, Zone, compile_scene
from inclined_landing.models.vehicle import Vehicle

# The engine's warnings on which it silently resets a simulation: first, and after the last.
_DIVERGED = int(mujoco.mjtWarning.mjWARN_BADQPOS), int(mujoco.mjtWarning.mjWARN_BADQACC) + 1
_PUSH = mujoco.mjtState.mjSTATE_QFRC_APPLIED


class MujocoPlant(Plant):
    """The MJCF vehicle on `mujoco.batch`: real bodies, native actuator plugins, real contact.

    attitude: "rate_loop" is the physical vehicle; "kinematic" sets the body rates to the paper's
    first-order loops at every control tick (free flight only: a vehicle that touched something
    keeps its physical rates), the mode for exact comparison. A delayed attitude command that changes
    between two ticks is followed by the rate loop until the next one.
    integrator, timestep: of the engine; the control period must be a whole number of time steps.
    keep_out: sensor-only zone around the platform [m] in which contacts count as `near`.
    threads: 0 uses all cores.
    torque_needs_motors: a vehicle under PWM 0 has no attitude torque, as motors make it.
    disturbance: seed of the vehicle's disturbance of the air (`xfrc_applied`); None for still air.
    pool: vehicles that `assign` chooses from; each is compiled once.
    moving: the platforms can move (`set_motion`); they have no base then, and steps take longer.
    contacts: False for flights far from every surface: without the search for contacts they take a quarter
        less time and have the same bits.
    """

    kind = "mujoco"

    def __init__(
        self,
        n: int,
        vehicle: Vehicle | None = None,
        *,
        attitude: Attitude = "rate_loop",
        keep_out: Zone = 0.0,
        control_period: Period | None = None,
        integrator: str = "RK4",
        timestep: Period = ENGINE_STEP,
        threads: Annotated[int, Meta(ge=0, le=1024)] = 0,
        torque_needs_motors: bool = False,
        disturbance: Seed | None = None,
        pool: Sequence[Vehicle] = (),
        moving: bool = False,
        contacts: bool = True,
    ):
        super().__init__(n, vehicle, attitude, keep_out, control_period, disturbance, pool)
        checked = {"timestep": timestep, "threads": threads, "moving": moving, "contacts": contacts}
        checked["torque_needs_motors"] = torque_needs_motors
        schema.check(checked, schema.kinds_of(MujocoPlant.__init__))
        self.substeps = round(self.control_period / timestep)
        if self.substeps < 1 or abs(self.substeps * timestep - self.control_period) > 1e-12:
            raise UserError(
                f"the control period {self.control_period:g} s is not a whole number of "
                f"time steps of {timestep:g} s"
            )
        options: Any = {
            "integrator": integrator,
            "timestep": timestep,
            "keep_out": keep_out,
            "moving": moving,
            "contacts": contacts,
            "loaded": len(self.load) > 0,
        }
        if self.pool:
            options["pooled"] = max(
                max(v.effects_thrust_delay, v.effects_attitude_delay) for v in self._vehicles
            )
        self.model = compile_scene(self.vehicle, **options)
        others = [compile_scene(v, **options) for v in self.pool]
        self._fields = differing_fields([self.model, *others])
        of_all = [self.model, *others] if sizes_differ(self._vehicles) else [self.model]
        self.shapes = geometry.Shapes.of([geometry.shapes_of(model) for model in of_all])
        self._load_joint = load_joint(self.model)
        self._mocap = np.array([int(self.model.body(b).mocapid[0]) for b in geometry.PLATFORM_BODIES])
        self.platforms: Platforms | None = None  # of a moving plant
        self._bind(Engine(self.model, n, min(threads or len(os.sched_getaffinity(0)), n)))
        if moving:
            self.platforms = Platforms(self.model, self.batch, self.vehicle, self.platform, self.substeps)
        self._history_of = held_histories(self.model) if self.model.nhistory else None
        self._seen = np.zeros((n, self.substeps, self.model.nsensordata))
        self.contact_sensors = contact_sensors(self.model)
        self._contact_set = False
        self.torque_needs_motors = torque_needs_motors
        self._loops = np.array([self.model.actuator(name).id for name in ("roll", "pitch", "yaw_rate")])
        self.foot_height = float(geometry.reach_below(self.shapes, part="feet"))
        level = self.foot_height - self.vehicle.effects_foot_height
        self._contact_of_each = np.array(
            [[v.contact_friction, *v.contact_solref, level + v.effects_foot_height] for v in self._vehicles]
        )
        self._contact = self._contact_of_each[self.choice]
        self.set_platform(np.arange(n), self.inclination)
        self.reset(np.arange(n), self.state)

    @property
    def batch(self) -> Engine:
        """The engine; in a forked process, which has lost its threads, a copy of it."""
        if self._batch.lost:
            self._bind(copy.copy(self._batch))
        return self._batch

    def _bind(self, batch: Engine) -> None:
        """Store an engine and its arrays that the plant reads and writes."""
        self._batch, bind = batch, batch.bind
        self._columns = Columns.of(self.model)
        self._ctrl = bind("ctrl")
        self.integral = bind("act")[:, 1:]
        self._mocap_pos, self._mocap_quat = bind("mocap_pos"), bind("mocap_quat")
        self._warning = batch.warning
        self._history = bind("history") if self.model.nhistory else None
        self._applied = bind("xfrc_applied")[:, self.model.body("crazyflie").id]
        self._of_pool = [(_as_bytes(rows), _as_bytes(batch.expand(k))) for k, rows in self._fields.items()]
        if self.platforms:
            self.platforms.bind(batch)

    def __setstate__(self, state: dict) -> None:
        """Restore a copied or pickled plant, with the arrays of the new engine."""
        self.__dict__.update(state)
        self._bind(self._batch)

    def _arrays(self):
        more = {"engine": self.batch.state, "contact": self._contact}
        return super()._arrays() | more | (self.platforms.arrays() if self.platforms else {})

    def _make_room(self, arrays):
        if self.platforms:
            self.platforms.make_room(arrays)

    def restore(self, snapshot: dict[str, np.ndarray]) -> None:
        """Return to a snapshot of a plant of the same kind and size."""
        super().restore(snapshot)
        if self.platforms:
            self.platforms.renew()
        self._apply_contact()
        self._warning[:] = 0

    def assign(self, ids, choice) -> None:
        """See `Plant.assign`; the contact parameters become those of the selected vehicles."""
        super().assign(ids, choice)
        self._contact[ids] = self._contact_of_each[choice]
        if self._contact_set:
            self._apply_contact()

    def _apply_choice(self, ids: np.ndarray) -> None:
        super()._apply_choice(ids)
        for rows, expanded in self._of_pool:
            _copy_rows(ids, self.choice, rows, expanded)

    def set_contact(
        self, ids, *, friction=None, restitution=None, contact_time=None, solref=None, foot_height=None
    ) -> None:
        """Set contact parameters of the vehicles `ids`, numbers or (k,) arrays; None leaves them unchanged.

        friction: sliding friction between the vehicle and every surface.
        restitution, contact_time [s]: see `contact.solref`; both or none.
        solref: instead of these, MuJoCo's own (2,) or (k, 2).
        foot_height: reach of the feet below the centre of mass [m]; the plant's `foot_height` is the nominal
            one.

        Vehicle and surfaces are set to the same values, because the engine mixes those of both sides.
        Raises UserError, and changes nothing, for values that are out of range.
        """
        rows = self._contact[ids].copy()
        if friction is not None:
            rows[..., 0] = contact.within(friction, *contact.FRICTION, "friction")
        if (restitution is None) != (contact_time is None):
            raise UserError("give both restitution and contact time, or neither")
        if restitution is not None:
            if solref is not None:
                raise UserError("give either restitution and contact time, or solref")
            solref = contact.solref(restitution, contact_time, self.vehicle.environment_gravity)
        if solref is not None:
            rows[..., 1:3] = check_solref(solref)
        if foot_height is not None:
            low, high = (share * self.foot_height for share in contact.FOOT_HEIGHT)
            rows[..., 3] = contact.within(foot_height, low, high, "foot height", " m")
        self._contact[ids] = rows
        self._apply_contact()

    def _apply_contact(self) -> None:
        if not self._contact_set and (self._contact == self._contact_of_each[self.choice]).all():
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

    def set_platform(self, ids, inclination, present=True, azimuth=0.0) -> None:
        """See `Plant.set_platform`."""
        super().set_platform(ids, inclination, present, azimuth)
        if self.platforms:
            self.platforms.stop(ids, self.platform[ids])
            self._place_platforms(ids)
            return
        position, quat = self._platform_poses(ids)
        rows = self._everyone[ids][:, None]
        self._mocap_pos[rows, self._mocap], self._mocap_quat[rows, self._mocap] = position, quat

    @property
    def motion(self) -> Motion | None:
        """See `Plant.motion`."""
        return self.platforms.motion if self.platforms else None

    def set_motion(self, ids, motion: Motion, time=0.0) -> None:
        """See `Plant.set_motion`."""
        if self.platforms is None:
            return super().set_motion(ids, motion, time)
        self.platforms.set(ids, motion, time)
        self._place_platforms(ids)

    def platform_at(self, times) -> np.ndarray:
        """See `Plant.platform_at`."""
        return self.platforms.at(times) if self.platforms else super().platform_at(times)

    def _place_platforms(self, ids) -> None:
        if self.platforms:
            self.platforms.place(self._everyone[ids], self.present)

    def reset(self, ids, state: np.ndarray) -> None:
        """Put the vehicles `ids` into `state` (k, 13): pose, rates, lag; contacts, past commands cleared."""
        ids = self._everyone[ids]
        state = np.ascontiguousarray(state, dtype=float)
        _write_state(ids, state, self.batch.state, self._columns)
        self._warning[ids] = 0
        self._place_platforms(ids)
        self._begin(ids, state)
        self._write_loads(ids)

    def set_load(self, ids, direction, rate=0.0) -> None:
        """See `Plant.set_load`."""
        super().set_load(ids, direction, rate)
        self._write_loads(self._everyone[ids])

    def _write_loads(self, ids) -> None:
        """Write `load` of the vehicles `ids` into the engine's joints, next to their attitudes and rates."""
        if len(self.load):
            write_loads(ids, self.load, self._load_joint, self.batch.state, self._columns)

    def step(self, commands: np.ndarray, wanted: np.ndarray | None = None) -> None:
        """Advance every vehicle by one control period under commands (n, 4).

        wanted: (n,) bool, vehicles whose result is used; the others do not move, unless there is a
        disturbance, which draws from one stream for all vehicles.

        Contacts are the maximum over the control step's substeps, each evaluated at its beginning.
        Raises FloatingPointError, naming the vehicles, when the engine diverges; reset them to continue.
        """
        some = wanted is not None and not self.disturbance and not wanted.all()
        self.advance(commands, np.flatnonzero(wanted) if some else None)
        self.check()

    @property
    def constants(self) -> np.ndarray:
        """The vehicles' constants from `forces.pack`, (n,) or (1,) for all of them."""
        return self._constants

    @property
    def masses(self) -> np.ndarray:
        """The vehicles' masses (n,) [kg] in the engine."""
        body, masses = self.model.body("crazyflie").id, self.batch.expanded("body_mass")
        return np.full(self.n, self.model.body_mass[body]) if masses is None else masses[:, body]

    @property
    def pushes(self) -> np.ndarray:
        """Return force [N] and torque [N m] (n, 6) of the disturbance in the last control period."""
        return self._applied

    def acting_commands(self) -> np.ndarray:
        """Return the last commands, delayed if there are delays: (1, n, 4), or (substeps, n, 4)."""
        if not self.delays.of_commands:
            return self._ctrl[None].copy()  # in C order, as kernels are compiled for
        return self.delays.acting(self.substeps)

    def check(self) -> None:
        """Raise FloatingPointError, naming the vehicles, if the engine has diverged since their reset."""
        diverged = self.diverged
        if diverged.any():
            numbers = np.flatnonzero(diverged)[:5].tolist()
            raise FloatingPointError(f"the engine diverged for vehicles {numbers}")

    @property
    def diverged(self) -> np.ndarray:
        """(n,) bool: whether the engine has diverged since the vehicle's reset."""
        return _diverged(self._warning, self.state)

    def advance(
        self, commands: np.ndarray, ids: np.ndarray | None = None, record: tuple[str, ...] = ()
    ) -> dict[str, np.ndarray]:
        """Do a `step` without its check, for only the vehicles `ids` (k,); the others do not move. ids:
        sorted, unique; None selects all. Commands are (n, 4) in any case.
        record: fields of the engine's data. They are returned after every engine step, (k, substeps, ...);
        "sensordata" belongs to the beginning of the step. Without fields, an empty result is returned.
        """
        commands = np.asarray(commands, float)
        chosen = self._everyone if ids is None else ids
        self._set_inputs(commands, chosen)
        if self.attitude == "kinematic":
            self._synchronise(chosen)
        seen = self._step_engine(ids, record)
        self._place_platforms(chosen)
        self.delays.push_state(self.state, chosen)
        return seen

    def _set_inputs(self, commands: np.ndarray, ids) -> np.ndarray:
        """Set commands (n, 4) and disturbance for the control period that begins for the vehicles `ids`.

        Returns the disturbance's push (n, 6), see `Disturbance.push`, or `equations.STILL`.
        """
        self._ctrl[:] = commands
        if self._history is not None and self._history_of is not None and self.delays.fresh.any():
            fresh = np.flatnonzero(self.delays.fresh)
            empty, per_unit = self._history_of
            self._history[fresh] = empty + commands[fresh] @ per_unit
        self.delays.push_commands(commands, ids)
        self.allow_torque(commands)
        return self._disturb(self.disturbance, ids) if self.disturbance else equations.STILL

    def _synchronise(self, ids) -> None:
        """Set the body rates of the vehicles `ids` that touch nothing to those of the first-order loops."""
        kept = np.ones(self.n, bool)
        kept[ids] = self.contacts.touch[ids].any(axis=(1, 2))
        rows = self.batch.state, self._columns
        _synchronise_rates(*rows, self.acting_commands()[0], self._constants, kept)
        self._write_loads(ids)  # whose joints turn with the vehicles

    def _step_engine(self, ids: np.ndarray | None, record: tuple[str, ...] = ()) -> dict[str, np.ndarray]:
        """Run one control period of the vehicles `ids` in the engine and read the results; see `advance`."""
        stepped = self._everyone if ids is None else ids
        seen = {"sensordata": self._seen[: len(stepped)]}
        push: Any = {}
        if self.platforms:
            push = {"control": self.platforms.forces(stepped, self.present), "control_spec": _PUSH}
        if record:
            seen = self.batch.rollout(self.substeps, record=("sensordata", *record), ids=ids, **push)
        else:
            self.batch.rollout(self.substeps, record=("sensordata",), ids=ids, out=seen, **push)
        c, zone = self.contacts, self.keep_out > 0.0
        read_contacts(seen["sensordata"], stepped, self.contact_sensors, zone, c.near, c.touch, c.force)
        _read_state(stepped, self.batch.state, self._columns, self.state)
        if len(self.load):
            read_loads(stepped, self.load, self._load_joint, self.batch.state, self._columns)
        return seen if record else {}

    def _disturb(self, disturbance: Disturbance, ids) -> np.ndarray:
        """Apply force and torque of the disturbance to the vehicles `ids`, and advance it by one period."""
        push = disturbance.push(self.state, self.attitude == "rate_loop")
        self._applied[ids, :3] = (push[:, :3] * self.masses[:, None])[ids]
        self._applied[ids, 3:] = push[ids, 3:]
        disturbance.step(ids)
        return push

    def allow_torque(self, commands: np.ndarray) -> None:
        """Enable the attitude torques that motors under commands (n, 4) can produce; `step` calls this."""
        if not self.torque_needs_motors:
            return
        running = commands[:, PWM] > 0.0
        if running.all() and self.batch.expanded("actuator_forcerange") is None:
            return
        differing = self._fields.get("actuator_forcerange")
        ranges = self.model.actuator_forcerange[None] if differing is None else differing[self.choice]
        limits = ranges[:, self._loops]
        self.batch.expand("actuator_forcerange")[:, self._loops] = running[:, None, None] * limits

    def _apply_thrust_scale(self) -> None:
        if (self.thrust_scale != 1.0).any() or self.batch.expanded("actuator_gainprm") is not None:
            thrust = self.model.actuator("thrust").id
            self.batch.expand("actuator_gainprm")[:, thrust, 0] = self.thrust_scale


@kernel
def _diverged(warning, state):
    """Return (n,) bool: whether the engine has warned or a number of the state is not finite."""
    out = np.empty(len(state), np.bool_)
    for i in range(len(state)):
        warned, sum_of_nothing = 0, 0.0
        for k in range(_DIVERGED[0], _DIVERGED[1]):
            warned |= warning[i, k, 1]
        for k in range(state.shape[1]):
            sum_of_nothing += 0.0 * state[i, k]  # NaN unless all are finite
        out[i] = warned != 0 or sum_of_nothing != 0.0
    return out


def _as_bytes(rows: np.ndarray) -> np.ndarray:
    """Return rows (n, ...) of any type as bytes (n, b) that share their memory."""
    return rows.reshape(len(rows), -1).view(np.uint8)


@kernel
def _copy_rows(ids, choice, rows, out):
    """Write those of the rows (m, b) that the vehicles `ids` have, by their choice (n,), into out (n, b)."""
    for i in ids:
        for k in range(rows.shape[1]):
            out[i, k] = rows[choice[i], k]


@inlined
def write_pose(row, state, at):
    """Write a vehicle's state (13,) into its row (s,) of the engine."""
    for k in range(3):
        row[at.qpos + k], row[at.qvel + k], row[at.qvel + 3 + k] = state[k], state[VX + k], state[WX + k]
    w, x, y, z = quaternion(state[ROLL], state[PITCH], state[YAW])
    row[at.qpos + 3], row[at.qpos + 4], row[at.qpos + 5], row[at.qpos + 6] = w, x, y, z
    row[at.act] = state[LAG]


@kernel
def _write_state(ids, state, engine, at):
    """Begin at the states (k, 13) of the vehicles `ids` in the engine's rows (n, s); at: `Columns`."""
    for k in range(len(ids)):
        row, s = engine[ids[k]], state[k]
        write_pose(row, s, at)
        row[at.time] = 0.0
        row[at.ctrl : at.ctrl + COMMAND_SIZE] = 0.0
        row[at.warmstart : at.warmstart + at.nv] = 0.0


@kernel
def _read_state(ids, engine, at, state):
    """Write the states of the vehicles `ids` in the engine's rows (n, s) into state (n, 13)."""
    for i in ids:
        row, s, qpos, qvel = engine[i], state[i], at.qpos, at.qvel
        for j in range(3):
            s[j], s[VX + j], s[WX + j] = row[qpos + j], row[qvel + j], row[qvel + 3 + j]
        q = row[qpos + 3 : qpos + 7]
        s[ROLL], s[PITCH], s[YAW] = euler_angles(q[0], q[1], q[2], q[3])
        s[LAG] = row[at.act]


@kernel
def _synchronise_rates(engine, at, commands, vehicle, kept):
    """Write the body rates of the first-order loops under commands (n, 4) into the engine's rows (n, s)."""
    for i in range(len(engine)):
        if kept[i]:
            continue
        row, v = engine[i], vehicle[i if len(vehicle) > 1 else 0]
        q = row[at.qpos + 3 : at.qpos + 7]
        roll, pitch, yaw = euler_angles(q[0], q[1], q[2], q[3])
        x, y, z = row[at.qvel], row[at.qvel + 1], row[at.qvel + 2]
        shown = attitude_loops.estimated_angles(roll, pitch, yaw, x, y, z, v)
        errors = attitude_loops.angle_errors(shown[0], shown[1], commands[i], v)
        integrals = row[at.act + 1], row[at.act + 2]
        rates = attitude_loops.loop_rates(shown, errors, integrals, commands[i], v)
        a, b, d = attitude_loops.saturated(rates, v)
        row[at.qvel + 3], row[at.qvel + 4], row[at.qvel + 5] = body_rates(roll, pitch, a, b, d)
