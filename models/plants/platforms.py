"""The platforms of a moving plant in the engine: bodies with joints, which follow a motion.

Between two control ticks the engine moves a platform itself, under the acceleration that its motion has in
the middle of each time step of h; at the ticks it is put where it should be. From there to the next tick, T
later, RK4 is off by at most J T h^2 / 12, J the largest third derivative of the motion: by micrometres. Its
speed is off by J h^2 / 8 within a time step, and at a step's end by T h^2 / 24 of the fourth derivative.
Single-step integrators move with the speed of a step's end; the platform is then given speeds that belong
half a step earlier and accelerations of the steps' beginnings, which is as exact, and is how they move what
stands on it.

The joints' inertia is practically infinite, so that contacts do not move a platform.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import mujoco
import numba
import numpy as np

from inclined_landing.models import motion
from inclined_landing.models.attitude import ROLL, Z
from inclined_landing.models.errors import UserError
from inclined_landing.models.geometry import PARKED, platform_reach
from inclined_landing.models.motion import Motion
from inclined_landing.models.plants.base import PLATFORM_SIZE
from inclined_landing.models.vehicle import Vehicle

_JOINTS = ("x", "y", "z", "roll", "pitch", "yaw")  # of models/scene.py, in the order of motion.MODES


class _Clock(NamedTuple):
    """Times of the platforms' motions, and when the engine asks for them."""

    time: np.ndarray  # (n,) s since the vehicles' reset
    begun: np.ndarray  # (n,) s, time of the motions at the vehicles' reset
    step: float  # s, of the engine
    late: float  # s by which the engine's speeds and accelerations belong earlier than its positions


class _Joints(NamedTuple):
    """The platforms' joints in the engine's arrays, in the order of motion.MODES."""

    qpos: np.ndarray  # (n, nq)
    qvel: np.ndarray  # (n, nv)
    force: np.ndarray  # (n, nv)
    positions: np.ndarray  # (6,) columns of qpos
    dofs: np.ndarray  # (6,) columns of qvel and force
    inertia: float  # kg, kg m2


class Moving(NamedTuple):
    """What kernels need to know of n moving platforms; of none in a plant whose platforms stand still."""

    most: np.ndarray  # (n,) m/s, a bound for all times, see `_most`
    begun: np.ndarray  # (n,) s, time of the motions at the vehicles' reset
    waves: motion.Waves
    rest: np.ndarray  # (n, 12) their states where they do not move
    late: float  # s, as in _Clock
    period: float  # s
    reach: float  # m, of the slab from its centre


_NONE = Motion.still(0).arrays
# So that one compiled kernel serves both.
STILL = Moving(np.empty(0), np.empty(0), _NONE, np.empty((0, PLATFORM_SIZE)), 0.0, 0.0, 0.0)


class Platforms:
    """Platforms of n simulations of a scene that was built with `moving`.

    platform (n, 12): the plant's array of their states, kept up to date here.
    """

    def __init__(self, model: mujoco.MjModel, batch, vehicle: Vehicle, platform: np.ndarray, substeps: int):
        n = len(platform)
        self.motion = Motion.still(n)
        self.rest = platform.copy()
        self.begun = np.zeros(n)  # s, time of the motions at the vehicles' reset
        self._everyone = np.arange(n)
        self._platform = platform
        joints = [model.joint(f"platform_{name}") for name in _JOINTS]
        dofs = np.array([int(joint.dofadr[0]) for joint in joints])
        self._joints = _Joints(
            *(batch.bind("qpos"), batch.bind("qvel"), batch.bind("qfrc_applied")),
            np.array([int(joint.qposadr[0]) for joint in joints]),
            dofs,
            float(model.dof_armature[dofs[0]]),
        )
        step = model.opt.timestep
        late = 0.0 if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4 else 0.5 * step
        self._clock = _Clock(batch.bind("time"), self.begun, step, late)
        self._period = substeps * step
        self._most = np.zeros(n)
        self._forces = np.zeros((n, substeps, model.nv))
        self._reach = platform_reach(vehicle)
        self._moved()

    def bind(self, batch) -> None:
        """Take the arrays of a copy of the engine."""
        qpos, qvel, force = batch.bind("qpos"), batch.bind("qvel"), batch.bind("qfrc_applied")
        self._joints = self._joints._replace(qpos=qpos, qvel=qvel, force=force)
        self._clock = self._clock._replace(time=batch.bind("time"))

    def _moved(self) -> None:
        """Take the arrays of the motion, which may be others after more waves were given."""
        self._waves = self.motion.arrays
        lengths = self._clock.late, self._period, self._reach
        self.moving = Moving(self._most, self.begun, self._waves, self.rest, *lengths)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return what a snapshot of the plant needs of them."""
        names = ("deck_velocity", "deck_amplitude", "deck_frequency", "deck_phase")
        return {"deck_rest": self.rest, "deck_begun": self.begun, **dict(zip(names, self.motion.arrays))}

    def make_room(self, arrays: dict[str, np.ndarray]) -> None:
        """Make room for as many waves as a snapshot's arrays have."""
        self.motion = Motion.still(len(self.rest), arrays["deck_amplitude"].shape[2])
        self._moved()

    def stop(self, ids, rest: np.ndarray) -> None:
        """Stop the platforms `ids` at `rest` (k, 12)."""
        _stop(self._everyone[ids], rest, self.moving)

    def set(self, ids, moves: Motion, time=0.0) -> None:
        """See `Plant.set_motion`; raises UserError for another number of motions."""
        if len(moves) != len(self.rest[ids]):
            raise UserError(
                f"{len(self.rest[ids])} platforms need {len(self.rest[ids])} motions, not {len(moves)}"
            )
        before = self.motion.amplitude
        self.motion[ids], self.begun[ids] = moves, time
        if self.motion.amplitude is not before:
            self._moved()
        self.bound(ids)

    def bound(self, ids=slice(None)) -> None:
        """Update the bounds of the speeds of the platforms `ids` after a change of their motions."""
        _most(self._everyone[ids], self.moving, self._most)

    def at(self, times) -> np.ndarray:
        """Return states (n, 12) of the platforms at times (n,) or a number [s] since the vehicles' reset."""
        return self.motion.platforms(times + self.begun, self.rest)

    def place(self, ids: np.ndarray, present: np.ndarray) -> None:
        """Put the platforms `ids` where their motions have them now, in the engine and in `platform`."""
        _place(ids, self._clock, present, self._waves, self.rest, self._platform, self._joints)

    def follow(self, ids: np.ndarray) -> None:
        """Write where the motions have the platforms `ids` now into `platform` alone."""
        _follow(ids, self._clock, self._waves, self.rest, self._platform)

    def forces(self, ids: np.ndarray, present: np.ndarray) -> np.ndarray:
        """Return forces (k, substeps, nv) that move the platforms `ids` through the period that begins."""
        out = self._forces[: len(ids)]
        _forces(ids, self._clock, present, self._waves, self._joints, out)
        return out


@numba.njit(cache=True)
def strays(i, time, present, moving, rates):
    """Return a bound [m/s] of how quickly any point of platform i leaves the path of a steady platform.

    That has, from the period's beginning at `time` [s] on, the velocity that the platform's centre has then.
    After t [s] of the period no point is farther than t times the bound from where it would be there. rates
    (6,): for intermediate results.
    """
    if present:
        motion.rate(i, time + moving.begun[i] - moving.late, moving.waves, rates)
    else:
        rates[:] = 0.0
    return _bound(i, moving, rates)


@numba.njit(cache=True, inline="always")
def _bound(i, moving, rates):
    """Return the bound of `strays` from the rates (6,) at the period's beginning.

    The centre strays by a t^2/2 <= t (a T/2), a the largest acceleration of its motion and T the period. Each
    angle turns the platform about an axis by up to |rate| t + a t^2/2, and moves its points by as much times
    the reach of the slab. In a single-step integrator speeds lag by half a step, and grow by whole ones.
    """
    waves, square, turning = moving.waves, 0.0, 0.0
    for mode in range(6):
        gained = 0.0
        for k in range(waves.amplitude.shape[2]):
            gained += abs(waves.amplitude[i, mode, k]) * waves.frequency[i, mode, k] ** 2
        gained *= 0.5 * moving.period + 2.0 * moving.late
        if mode < 3:
            square += gained**2
        else:
            turning += abs(rates[mode]) + gained
    return math.sqrt(square) + moving.reach * turning


@numba.njit(cache=True)
def _stop(ids, rest, moving):
    """Stop the platforms `ids` (k,) at `rest` (k, 12)."""
    waves = moving.waves
    for row in range(len(ids)):
        i = ids[row]
        moving.rest[i], moving.begun[i], moving.most[i] = rest[row], 0.0, 0.0
        waves.velocity[i] = 0.0
        waves.amplitude[i] = waves.frequency[i] = waves.phase[i] = 0.0


@numba.njit(cache=True)
def _most(ids, moving, out):
    """Write the bound of `strays` for all times into `out` (n,): with all waves at their fastest at once."""
    waves, rates = moving.waves, np.zeros(6)
    for i in ids:
        for mode in range(3, 6):
            rates[mode] = 0.0
            for k in range(waves.amplitude.shape[2]):
                rates[mode] += abs(waves.amplitude[i, mode, k] * waves.frequency[i, mode, k])
        out[i] = _bound(i, moving, rates) * (1.0 + 1e-9)  # rounding


@numba.njit(cache=True)
def _follow(ids, clock, waves, rest, platform):
    now = np.empty((3, 6))
    for i in ids:
        follow(i, clock.time[i] + clock.begun[i], waves, rest, platform, now)


@numba.njit(cache=True, inline="always")
def follow(i, t, waves, rest, platform, now):
    """Write where its motion has platform i at t [s] into `platform` (n, 12), by way of `now` (3, 6)."""
    motion.displacement(i, t, waves, now)
    motion.write_state(i, now, rest, platform)


@numba.njit(cache=True)
def _place(ids, clock, present, waves, rest, platform, joints):
    """Write the platforms' states into `platform`, and positions, speeds and forces into the engine's
    arrays.
    """
    qpos, qvel, force, positions, dofs, inertia = joints
    now, speed, gain = np.empty((3, 6)), np.empty(6), np.empty(6)
    for i in ids:
        t = clock.time[i] + clock.begun[i]
        motion.displacement(i, t, waves, now)
        motion.write_state(i, now, rest, platform)
        if not present[i]:
            for k in range(6):
                qpos[i, positions[k]] = qvel[i, dofs[k]] = force[i, dofs[k]] = 0.0
            qpos[i, positions[Z]] = PARKED
            continue
        speed[:], gain[:] = now[1], now[2]
        if clock.late > 0.0:
            motion.rate(i, t - clock.late, waves, speed)
        else:
            motion.acceleration(i, t + 0.5 * clock.step, waves, gain)
        for k in range(6):
            qpos[i, positions[k]] = rest[i, k if k < 3 else ROLL + k - 3] + now[0, k]
            qvel[i, dofs[k]] = speed[k]
            force[i, dofs[k]] = inertia * gain[k]  # F = I a


@numba.njit(cache=True)
def _forces(ids, clock, present, waves, joints, out):
    """Write the forces of every time step, from the accelerations in its middle, into `out`."""
    now = np.empty(6)
    for row in range(len(ids)):
        i = ids[row]
        for s in range(out.shape[1]):
            t = clock.time[i] + clock.begun[i] + (s + 0.5) * clock.step - clock.late
            motion.acceleration(i, t, waves, now)
            for k in range(6):
                out[row, s, joints.dofs[k]] = joints.inertia * now[k] if present[i] else 0.0
