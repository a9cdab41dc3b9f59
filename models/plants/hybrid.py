"""The MuJoCo vehicle as a plant whose vehicles fly by the equations while nothing is within their reach.

In the air an engine's step is the equations of `equations.py` with the rate loop, which agree with it to
3.4e-5 m over 6 s (`landing-eval validate equivalence`) and cost a fraction of it. So each control period is first
flown by the equations, RK4 in the engine's time steps, and accepted if the vehicle was out of reach of slab,
base and floor at every one of them; otherwise the engine flies it from its beginning.

A vehicle is out of reach in a time step when the sphere around its shapes is farther from every surface
than its centre can move in this step, by `_MARGIN`; slab and base count with the keep-out zone. The engine
sees contacts at the beginning of a time step and at the three other stages of RK4, whose positions are
within one step of the speeds of that step: the speeds at its two ends, plus their difference for what the
acceleration does between. A moving deck is taken where it was at the period's beginning, and nearer by what
any of its points can have moved since (`Decks.fastest`). So no contact that the engine would see is missed,
and contacts, forces and the zone are always the engine's own.

By the equations fly attitudes and rates only for which they are as exact as the engine: roll short of the
Euler angles' singular 90 deg, turns in a time step of less than `_TURN`. Torque limits, clamped commands,
motors that are off, perturbations, unrest and all effects are in the equations; delayed commands are written
into the engine's history as it would write them. The engine flies everything with kinematic attitude, the
mode for exact comparison, while its steps are recorded (`advance(record=...)`), and vehicles with a ground
effect over decks that can move, which the equations know standing still only. Its own delayed motion
capture sensors, which nothing reads, are as old as its last step.
"""

from __future__ import annotations

import functools
import math

import numba
import numpy as np

from inclined_landing.models import equations, geometry
from inclined_landing.models.attitude import PITCH, PWM, ROLL, VX, VZ, YAW, X, Y, Z, quaternion
from inclined_landing.models.plants.mujoco import MujocoPlant

# Beyond what the vehicle moves: 0.03 mm by which the plants' paths differ, and the change of acceleration
# within a time step, of 4 ms, where speeds at both ends are equal: at 25 m/s2 turned by _TURN 0.04 mm.
_MARGIN = 1e-3  # m
_LARGEST_ANGLE = 1.2  # rad, of roll and pitch: cos(roll) is far from 0
# In a time step; RK4 is then within _TURN^5/120 = 1e-7 rad of the true attitude.
_TURN = 0.1  # rad
# Decks that stand, and an engine without delays: the same types as those of others, so one compiled kernel.
_STANDING, _NO_HISTORY = np.empty(0), np.empty((0, 0))
_FIRST_RATE = 10  # entry of the integrated vector of `equations.take`


class HybridPlant(MujocoPlant):
    """A `MujocoPlant` in which vehicles out of reach of every surface fly by the equations.

    Options as there. With a single-step integrator the engine's vehicles fly by that, the others by RK4.
    in_engine (n,) bool: which vehicles the engine flew in the last control period.
    """

    kind = "hybrid"

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self.in_engine = np.ones(self.n, bool)
        self._near = np.empty(self.n, int)
        self._limited = bool(self.model.actuator_forcelimited[self._loops].all())
        self._acting = np.empty((self.substeps, self.n, 4))
        self._boxes = self.shapes.box_centres, self.shapes.box_sizes, np.array(self._mocap)

    def advance(self, commands, ids=None, record=()):
        """`step` without its check, for the vehicles `ids` (k,) alone; see `MujocoPlant.advance`."""
        own = self._everyone if ids is None else np.asarray(ids)
        if record or self.attitude != "rate_loop":
            self.in_engine[own] = True
            return super().advance(commands, ids, record)
        push = self._give(np.asarray(commands, float), own)
        acting, step = self._acting[:1], self.control_period / self.substeps
        if self.delays.of_commands:
            acting = self._acting
            for k in range(self.substeps):
                acting[k] = self.delays.acting(k * step, step)
        else:
            acting[0] = self._ctrl
        fastest = self.decks.fastest(own) if self.decks else _STANDING
        c, model = self.contacts, self.model
        near = self._near[: _fly(
            own, acting, model.actuator_ctrlrange, push, self._limited, self.torque_needs_motors,
            self._constants, self.perturbation, model.opt.timestep, self.substeps,
            self.deck, fastest, self.present, self._mocap_pos, *self._boxes,
            self.fleet.reach, self.size, self.foot_height, self._contact, self.keep_out,
            self.state, self._qpos, self._qvel, self._act, self._ctrl, self._time, self._warmstart,
            _NO_HISTORY if self._history is None else self._history,
            model.actuator_history[:, 0], model.actuator_historyadr,
            c.near, c.touch, c.force, self.in_engine, self._near,
        )]  # fmt: skip
        if len(near):
            self._roll(None if len(near) == self.n else near)
        self._place_decks(own)
        self.delays.push_state(self.state, own)
        return {}


functools.update_wrapper(HybridPlant.__init__, MujocoPlant.__init__)  # with its options by name


@numba.njit(cache=True)
def _fly(
    ids, acting, ranges, push, limited, needs_motors, vehicle, p, dt, substeps,
    deck, fastest, present, mocap, boxes, sizes, bodies, reach, size, nominal, contact, zone,
    state, qpos, qvel, act, ctrl, time, warmstart, history, samples, addresses,
    near, touch, force, in_engine, left,
):  # fmt: skip
    """Fly those of the vehicles `ids` by the equations that stay out of reach.

    Returns how many are left to the engine; their numbers are put into `left`. The engine's arrays of the
    others are what it would have made of them, without a warm start of its solver, which had no contact.
    """
    each, held, work = len(vehicle) > 1, len(acting) == 1, equations.scratch()
    moving, remembered = len(fastest) > 0, len(history) > 0
    y, u, around = np.zeros(13), np.empty(4), np.empty(equations.AMBIENT_SIZE)
    own_limits, poses = np.empty(3), np.empty((len(bodies), 3))
    count = 0
    for row in range(len(ids)):
        i = ids[row]
        d = deck[i]
        v = vehicle[i if each else 0]
        for k in range(3):
            own_limits[k] = v.attitude.yaw_torque_limit if k == 2 else v.attitude.torque_limit
            if not limited:
                own_limits[k] = math.inf
            elif needs_motors and not ctrl[i, PWM] > 0.0:
                own_limits[k] = 0.0
        for b in range(len(bodies)):
            for k in range(3):
                poses[b, k] = mocap[i, bodies[b], k]
        comes = 0.0  # what the slab can have come nearer in a time step
        if moving:
            poses[0, X], poses[0, Y], poses[0, Z] = d[X], d[Y], d[Z]
            if not present[i]:
                poses[0, Z] = geometry.PARKED
            comes = dt * fastest[row]
        around[equations.TIME], around[equations.VOLTAGE] = time[i], math.nan
        around[equations.INCLINATION], around[equations.PRESENT] = d[PITCH], present[i]
        around[equations.AZIMUTH] = d[YAW]
        radius = reach[size[i]] + max(0.0, contact[i, 3] - nominal)
        equations.take(state[i], y)
        out_of_reach = not (moving and present[i] and v.effects.ground_effect != 0.0)
        for step in range(substeps if out_of_reach else 0):
            if step == 0 or not held:
                for k in range(4):
                    u[k] = min(ranges[k, 1], max(ranges[k, 0], acting[step, i, k]))
            platform = geometry.platform_distance(y, d[ROLL], d[PITCH], d[YAW], poses, boxes, sizes) - zone
            free = min(platform - (step + 1) * comes, y[Z]) - radius - _MARGIN
            vx, vy, vz = y[VX], y[VX + 1], y[VZ]
            begun = math.sqrt(vx * vx + vy * vy + vz * vz)
            out_of_reach = free > dt * begun and _tame(y, dt)
            if not out_of_reach:
                break
            equations.rk4(y, u, around, push, i, own_limits, v, p[i], True, dt, work)
            ended = math.sqrt(y[VX] ** 2 + y[VX + 1] ** 2 + y[VZ] ** 2)
            gained = math.sqrt((y[VX] - vx) ** 2 + (y[VX + 1] - vy) ** 2 + (y[VZ] - vz) ** 2)
            out_of_reach = free > dt * (max(begun, ended) + gained)
            if not out_of_reach:
                break
        in_engine[i] = not (out_of_reach and _tame(y, dt))
        if in_engine[i]:
            left[count] = i
            count += 1
            continue
        if abs(y[YAW]) > math.pi:
            y[YAW] -= 2.0 * math.pi * round(y[YAW] / (2.0 * math.pi))
        s = state[i]
        equations.give(y, s)
        qpos[i, 0], qpos[i, 1], qpos[i, 2] = s[X], s[Y], s[Z]
        qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6] = quaternion(s[ROLL], s[PITCH], s[YAW])
        for k in range(3):
            qvel[i, k], qvel[i, 3 + k] = s[VX + k], s[9 + k]
        act[i, 0] = s[12]
        for _ in range(substeps):
            if remembered:
                _note(history[i], samples, addresses, ctrl[i], time[i])
            time[i] += dt
        warmstart[i] = 0.0
        near[i], touch[i], force[i] = False, False, 0.0
    return count


@numba.njit(cache=True)
def _note(history, samples, addresses, ctrl, time):
    """Commands ctrl (4,) at a time [s] into the engine's history (h,) of those actuators that have one.

    It is, from an actuator's address on: a user's number, which sample is the newest, times, values.
    """
    for k in range(len(samples)):
        count, at = samples[k], addresses[k]
        if count > 0:
            newest = (int(history[at + 1]) + 1) % count
            history[at + 1] = newest
            history[at + 2 + newest] = time
            history[at + 2 + count + newest] = ctrl[k]


@numba.njit(cache=True, inline="always")
def _tame(y, dt):
    """Are attitude and rates those that the equations know as well as the engine? False for NaN."""
    rates = max(abs(y[_FIRST_RATE]), abs(y[_FIRST_RATE + 1]), abs(y[_FIRST_RATE + 2]))
    return max(abs(y[ROLL]), abs(y[PITCH])) < _LARGEST_ANGLE and rates * dt < _TURN
