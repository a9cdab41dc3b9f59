"""The MuJoCo vehicle as a plant that uses the equations for vehicles while no surface is within reach.

In the air, `equations.py` with the rate loop agrees with the engine to 3.4e-5 m over 6 s
(`landing-eval equivalence`) and costs a fraction of it. Each control period is therefore first flown by the
equations. The result is accepted if the vehicle was out of reach of slab, base and floor all the time;
otherwise the engine flies the period from its beginning. If `held.py` can solve the equations for the whole
period and there is room for it, the period is one step; otherwise RK4 integrates it in the engine's time
steps.

A vehicle is out of reach during a step if the distance between the sphere around its shapes and every surface
exceeds the distance that its centre can move, by `_MARGIN`; slab and base include the keep-out zone. The
engine detects contacts at the four stages of RK4. Their positions differ by less than one time step times a
bound of the speed: the larger speed of the step's two ends plus the change of velocity between them.

The distance to a moving platform is computed in a frame that moves with the velocity of the platform's centre
at the beginning of the period. It is reduced by a bound on the displacement of any point of the platform in
that frame since then (`Platforms.renew`). If that leaves no room, the sphere is replaced by a disc that
contains all parts, and the disc's rotation is bounded too. No contact that the engine would detect is
missed, and contacts, forces and the keep-out zone are always the engine's. A platform is moved to its pose in
the engine when the engine flies the vehicle or the plant is saved.

The equations fly only attitudes and rates for which they are as accurate as the engine: roll and pitch away
from the Euler angles' singularity at 90 deg, and rotations of less than `_TURN` in a time step. They contain
torque limits, clamped commands, motors that are off, scaled thrust, disturbance and all effects; delayed
commands are written to the engine's history in the engine's format. The engine flies vehicles with kinematic
attitude, the mode for exact comparison, and while its steps are recorded (`advance(record=...)`). It also
flies vehicles over platforms that can move if their forces may depend on the platform's position, as the
ground effect does, because the equations assume a platform at rest.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np

from inclined_landing.models import equations, forces, geometry, held, threads
from inclined_landing.models.attitude import (
    PITCH,
    PWM,
    ROLL,
    VX,
    VY,
    VZ,
    YAW,
    X,
    Y,
    Z,
    rotation_entries,
    sine_cosine,
)
from inclined_landing.models.compiled import inlined, unlocked
from inclined_landing.models.plants.engine import Columns
from inclined_landing.models.plants.mujoco import MujocoPlant, write_pose
from inclined_landing.models.plants.platforms import STILL, Moving

# Distance that must remain besides the vehicle's motion. It covers 0.03 mm between the paths of engine and
# equations, and the displacement dt^2/8 da by a change da of the acceleration, which the speeds at both ends
# do not show: 25 m/s2 rotated by _TURN in 4 ms give 0.04 mm, rotated by 5 _TURN in 20 ms 0.6 mm.
_MARGIN = 1e-3  # m
_SHARE = 1024  # least number of vehicles for which starting another thread saves time
_LARGEST_ANGLE = 1.2  # rad, of roll and pitch: cos(roll) is far from 0
# Largest rotation in a time step: RK4 is then within _TURN^5/120 = 1e-7 rad of the true attitude.
_TURN = 0.1  # rad
# Columns of a vehicle's numbers that are 0 if no force depends on the platform's position.
_OF_THE_PLACE = forces.columns_besides(
    (
        *held.SOLVED,
        *("effects_estimator_lean", "effects_attitude_integral", "effects_attitude_hold"),
        *("effects_attitude_saturation", "effects_load_mass"),
    )
)


class _Period(NamedTuple):
    """The conditions of one control period."""

    commands: np.ndarray  # (substeps, n, 4) that act in each time step, or (1, n, 4) in all of them
    push: np.ndarray  # (n, 6) or STILL, see `equations.Conditions`
    torque_needs_motors: bool
    moving: Moving  # platforms, or STILL


class _Vehicles(NamedTuple):
    """The n vehicles of a plant."""

    constants: np.ndarray  # (n,) or (1,) from `forces.pack`
    thrust_scale: np.ndarray  # (n,)
    size: np.ndarray  # (n,) index in `shapes`
    shapes: geometry.Shapes
    contact: np.ndarray  # (n, 4), the last the feet's reach below the centre of mass [m]
    foot_height: float  # m, without the effect of that name
    keep_out: float  # m
    command_range: np.ndarray  # (4, 2)
    timestep: float  # s
    substeps: int


class _Platforms(NamedTuple):
    """The n platforms."""

    platform: np.ndarray  # (n, 12)
    present: np.ndarray  # (n,) bool
    bodies: np.ndarray  # (4,) which of the engine's mocap bodies are geometry.PLATFORM_BODIES


class _Engine(NamedTuple):
    """The engine."""

    state: np.ndarray  # (n, s), which a control period changes
    at: Columns
    samples: np.ndarray  # (actuators,) length of each one's history
    addresses: np.ndarray  # (actuators,) where it begins


class _Results(NamedTuple):
    """Arrays of the plant that a control period changes."""

    state: np.ndarray  # (n, 13)
    near: np.ndarray  # (n, 3, 3) bool, see `Contacts`
    touch: np.ndarray  # (n, 3, 3) bool
    force: np.ndarray  # (n, 3, 3) N
    load: np.ndarray  # (n, 6) or UNLOADED, see `Plant.load`
    in_engine: np.ndarray  # (n,) bool


class _ToSurfaces(NamedTuple):
    """Distances [m] to the platform and to the floor: a vehicle's, or by how much its motion reduces them."""

    platform: float
    floor: float


class HybridPlant(MujocoPlant):
    """A `MujocoPlant` in which vehicles out of reach of every surface fly by the equations.

    Options as there. With a single-step integrator the engine's vehicles fly by that, the others by RK4.
    in_engine (n,) bool: which vehicles the engine flew in the last control period.
    """

    kind = "hybrid"

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self.in_engine = np.ones(self.n, bool)
        c, model = self.contacts, self.model
        self._results = _Results(self.state, c.near, c.touch, c.force, self.load, self.in_engine)
        self._kernel_vehicles = _Vehicles(
            constants=self._constants,
            thrust_scale=self.thrust_scale,
            size=self.size,
            shapes=self.shapes,
            contact=self._contact,
            foot_height=self.foot_height - self.vehicle.effects_foot_height,
            keep_out=float(self.keep_out),
            command_range=model.actuator_ctrlrange,
            timestep=model.opt.timestep,
            substeps=self.substeps,
        )

    def _bind(self, batch):
        super()._bind(batch)
        histories = self.model.actuator_history[:, 0], self.model.actuator_historyadr
        self._engine = _Engine(batch.state, self._columns, *histories)
        self._platforms = _Platforms(self.platform, self.present, self._mocap)

    def advance(self, commands, ids=None, record=()):
        """`step` without its check, for the vehicles `ids` (k,) alone; see `MujocoPlant.advance`."""
        chosen = self._everyone if ids is None else np.asarray(ids)
        if record or self.attitude != "rate_loop":
            self.in_engine[chosen] = True
            return super().advance(commands, ids, record)
        push = self._set_inputs(np.asarray(commands, float), chosen)
        moving = self.platforms.moving if self.platforms else STILL
        near = self._fly(chosen, _Period(self.acting_commands(), push, self.torque_needs_motors, moving))
        if len(near):
            self._step_engine(None if len(near) == self.n else near)
            if self.platforms:
                self.platforms.follow(near)
        self.delays.push_state(self.state, chosen)
        return {}

    def _fly(self, ids: np.ndarray, period: _Period) -> np.ndarray:
        """Fly the vehicles `ids` (k,) by the equations if possible, in threads; return the other ones."""
        numbers = forces.numbers(self._constants)  # here, as copies of a plant share no memory of views
        of_all = numbers, period, self._kernel_vehicles, self._platforms, self._engine, self._results

        def fly(part: tuple[int, int]) -> None:
            _fly(ids, *part, *of_all)
            if self.platforms:  # those in the engine follow again, after its steps
                self.platforms.follow(ids[slice(*part)])

        threads.in_threads(fly, threads.shares(len(ids), min(self.batch.nthread, len(ids) // _SHARE)))
        if len(self.load):
            self._write_loads(ids[~self.in_engine[ids]])
        return ids[self.in_engine[ids]]

    def _step_engine(self, ids, record=()):
        if self.platforms:  # in the engine they are still where its last step of a vehicle left them
            self.platforms.place(self._everyone if ids is None else ids, self.present)
        return super()._step_engine(ids, record)

    def _place_platforms(self, ids):
        if self.platforms:  # those in the engine wait until it needs them
            self.platforms.follow(self._everyone[ids])

    def save(self):
        """Return everything that a later bit-for-bit replay needs."""
        super()._place_platforms(self._everyone)
        return super().save()


functools.update_wrapper(HybridPlant.__init__, MujocoPlant.__init__)  # with its options by name


@unlocked
def _fly(ids, first, last, numbers, period, vehicles, platforms, engine, results):
    """Fly the vehicles among `ids[first:last]` that stay out of reach by the equations.

    numbers: from `vehicles.constants`, see `forces.numbers`. The engine has to fly the other vehicles; they
    are marked in `results.in_engine`. Its arrays of those that flew are set to the values that it would have
    computed, without a warm start of its solver, which had no contact.
    """
    dt, substeps, constant = vehicles.timestep, vehicles.substeps, len(period.commands) == 1
    motions, steps, length = period.moving, np.zeros(1, equations.STEP), substeps * dt
    at, moving = engine.at, len(motions.most) > 0
    boxes, sizes = vehicles.shapes.box_centres, vehicles.shapes.box_sizes
    integral = engine.state[:, at.act + 1 : at.act + 3]
    poses, platform, state = np.empty((len(platforms.bodies), 3)), platforms.platform, results.state
    for row in range(first, last):
        i = ids[row]
        present, flown = platforms.present[i], engine.state[i]
        time = flown[at.time]
        record = i if len(vehicles.constants) > 1 else 0
        v = vehicles.constants[record]
        s = steps[0]
        y, u, ambient = s.y, s.command, s.ambient
        s.rate_loop = s.limited = True
        equations.disturb(s, vehicles.thrust_scale, period.push, i)
        for k in range(3):
            s.torque_limits[k] = v.attitude.yaw_torque_limit if k == 2 else v.attitude.torque_limit
            if period.torque_needs_motors and not flown[at.ctrl + PWM] > 0.0:
                s.torque_limits[k] = 0.0
        for k in range(3):
            poses[0, k] = platform[i, k]
            for b in range(1, len(poses)):
                poses[b, k] = flown[at.mocap_pos + 3 * platforms.bodies[b] + k]
        if not present:
            poses[0, Z] = geometry.PARKED
        turns = geometry.platform_turns(platform[i, ROLL], platform[i, PITCH], platform[i, YAW])
        carrier, approach = (0.0, 0.0, 0.0), 0.0  # velocity of the platform [m/s]; m by which it strays in dt
        if moving and present:
            carrier, approach = (platform[i, VX], platform[i, VY], platform[i, VZ]), dt * motions.most[i]
        ambient[forces.TIME], ambient[forces.VOLTAGE] = time, math.nan
        ambient[forces.INCLINATION], ambient[forces.PRESENT] = platform[i, PITCH], present
        ambient[forces.AZIMUTH] = platform[i, YAW]
        lowered = max(0.0, vehicles.contact[i, 3] - vehicles.foot_height - v.effects.foot_height)
        radius = vehicles.shapes.reach[vehicles.size[i]] + lowered
        equations.pack_state(state, i, y)
        equations.take_states(s, results.load, integral, i, v)
        known_there = not (moving and present) or forces.neutral(record, numbers, _OF_THE_PLACE)
        step, solvable = 0, held.solvable(s, v, record, numbers)
        if known_there and solvable and (constant or _is_held(period.commands, i)):
            # All of the period at once, where there is room for that.
            _take_command(u, period.commands, step, i, vehicles.command_range)
            velocity = y[VX], y[VY], y[VZ]
            distance = geometry.platform_distance(y[X], y[Y], y[Z], turns, poses, boxes, sizes)
            strayed = substeps * approach
            gaps = _ToSurfaces(distance - vehicles.keep_out - strayed - radius, y[Z] - radius)
            if _has_room(gaps, _ways(velocity, carrier, length)) and held.fly(
                s, v, length, _LARGEST_ANGLE, _TURN / dt
            ):
                if _has_room(gaps, _moved(velocity, y, carrier, length)):
                    step = substeps
                else:
                    equations.pack_state(state, i, y)
                    ambient[forces.TIME] = time
        while known_there and step < substeps:
            if step == 0 or not constant:
                _take_command(u, period.commands, step, i, vehicles.command_range)
            # Distance to spare > dt |w| before the step, and > dt (max(|w|, |w'|) + |w' - w|) after it, w the
            # velocity relative to the platform's centre, or to the floor.
            t, velocity = step * dt, (y[VX], y[VY], y[VZ])
            px, py, pz = y[X] - t * carrier[0], y[Y] - t * carrier[1], y[Z] - t * carrier[2]
            distance = geometry.platform_distance(px, py, pz, turns, poses, boxes, sizes)
            beyond = vehicles.keep_out + (step + 1) * approach
            gaps, ways = _ToSurfaces(distance - beyond - radius, y[Z] - radius), _ways(velocity, carrier, dt)
            flat = moving and not _has_room(gaps, _ToSurfaces(1.5 * ways.platform, 1.5 * ways.floor))
            if flat:  # how flat the vehicle is counts, and then how it turns
                r = rotation_entries(sine_cosine(y[ROLL]), sine_cosine(y[PITCH]), sine_cosine(y[YAW]))
                axis, member = (r[2], r[5], r[8]), vehicles.size[i]
                hull = turns, poses, vehicles.shapes, member, lowered
                distance = geometry.hull_distance((px, py, pz), axis, *hull)
                below = geometry.reach_against(axis[2], vehicles.shapes.hulls[member], lowered)
                gaps = _ToSurfaces(distance - beyond, y[Z] - below)
            if not (_has_room(gaps, ways) and _as_exact(y, dt)):
                break
            rate = y[equations.RATES], y[equations.RATES + 1], y[equations.RATES + 2]
            if not (solvable and held.fly(s, v, dt, _LARGEST_ANGLE, _TURN / dt)):
                equations.rk4(s, v, dt)
            ways = _moved(velocity, y, carrier, dt)
            if flat:
                turned = radius * _turned(rate, y, dt)
                ways = _ToSurfaces(ways.platform + turned, ways.floor + turned)
            if not _has_room(gaps, ways):
                break
            step += 1
        if step < substeps or not _as_exact(y, dt):
            results.in_engine[i] = True
            continue
        if abs(y[YAW]) > math.pi:
            y[YAW] -= 2.0 * math.pi * round(y[YAW] / (2.0 * math.pi))
        equations.unpack_state(y, state, i)
        equations.give_states(s, results.load, integral, i)
        results.in_engine[i] = False
        for surface in range(3):
            for part in range(3):
                results.near[i, surface, part] = results.touch[i, surface, part] = False
                results.force[i, surface, part] = 0.0
        _write(flown, state[i], substeps, dt, engine)


@inlined
def _take_command(u, commands, step, i, limits):
    """Write the command of vehicle i in a time step, of commands (substeps, n, 4), within limits (4, 2)."""
    for k in range(4):
        u[k] = min(limits[k, 1], max(limits[k, 0], commands[step, i, k]))


@inlined
def _is_held(commands, i):
    """Return whether the commands (substeps, n, 4) of vehicle i are the same in all time steps."""
    for step in range(1, len(commands)):
        for k in range(4):
            if commands[step, i, k] != commands[0, i, k]:
                return False
    return True


@inlined
def _size(x, y, z):
    return math.sqrt(x * x + y * y + z * z)


@inlined
def _ways(velocity, carrier, dt):
    """Return how much nearer a velocity leads to the surfaces in `dt` [s]; carrier: that of the platform."""
    x, y, z = velocity
    return _ToSurfaces(dt * _size(x - carrier[0], y - carrier[1], z - carrier[2]), dt * _size(x, y, z))


@inlined
def _moved(velocity, y, carrier, dt):
    """Return bounds of the `_ways` in `dt` [s], from the velocity before and that of y after."""
    before, after = _ways(velocity, carrier, 1.0), _ways((y[VX], y[VY], y[VZ]), carrier, 1.0)
    change = _size(y[VX] - velocity[0], y[VY] - velocity[1], y[VZ] - velocity[2])
    platform, floor = max(before.platform, after.platform), max(before.floor, after.floor)
    return _ToSurfaces(dt * (platform + change), dt * (floor + change))


@inlined
def _turned(rate, y, dt):
    """Return a bound of the angle [rad] by which a vehicle turns in `dt` [s], as in `_moved`.

    rate: the three angular rates before.
    """
    before = after = change = 0.0
    for k in range(3):
        now = y[equations.RATES + k]
        before, after, change = before + abs(rate[k]), after + abs(now), change + abs(now - rate[k])
    return dt * (max(before, after) + change)


@inlined
def _has_room(gaps, ways):
    """Return whether a vehicle with these distances stays clear of all surfaces in a motion by `ways`."""
    return gaps.platform - _MARGIN > ways.platform and gaps.floor - _MARGIN > ways.floor


@inlined
def _write(row, state, substeps, dt, engine):
    """Write a vehicle's state (13,), after some time steps of `dt` [s], into its row (s,) of the engine."""
    at = engine.at
    write_pose(row, state, at)
    for _ in range(substeps):
        for k in range(len(engine.samples)):
            begin = at.history + engine.addresses[k]
            _note(row, begin, engine.samples[k], row[at.ctrl + k], row[at.time])
        row[at.time] += dt
    for k in range(at.nv):
        row[at.warmstart + k] = 0.0


@inlined
def _note(row, begin, count, command, time):
    """Append a timestamped command [s] to the history buffer of an actuator, which begins there in the row.

    The layout is: a user's number, index of the newest sample, times, values of `count` samples. An actuator
    without delay has none.
    """
    if count > 0:
        newest = (int(row[begin + 1]) + 1) % count
        row[begin + 1] = newest
        row[begin + 2 + newest] = time
        row[begin + 2 + count + newest] = command


@inlined
def _as_exact(y, dt):
    """Return whether the equations are as exact as the engine at attitude and rates of y; False for NaN."""
    rates = max(abs(y[equations.RATES]), abs(y[equations.RATES + 1]), abs(y[equations.RATES + 2]))
    return max(abs(y[ROLL]), abs(y[PITCH])) < _LARGEST_ANGLE and rates * dt < _TURN
