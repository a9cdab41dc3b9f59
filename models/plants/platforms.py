"""The platforms of a moving plant in the engine: bodies with joints that follow a prescribed motion.

Between two control ticks the engine moves a platform itself, under the acceleration that its motion has in
the middle of each time step h; at the ticks its exact pose is set. Until the next tick, T later, the error of
RK4 is at most J T h^2 / 12, where J is the largest third derivative of the motion, which is micrometres. The
error of its speed is J h^2 / 8 within a time step, and T h^2 / 24 times the fourth derivative at the end of a
step. Single-step integrators move bodies with the speed at the end of a step; the platform's speeds are then
taken half a step earlier and its accelerations at the beginnings of the steps, which is as accurate and
consistent with the motion of bodies that rest on it.

The joints' inertia is practically infinite, so that contacts do not move a platform.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import mujoco
import numpy as np

from inclined_landing.models import motion
from inclined_landing.models.attitude import ROLL, Z, sine_cosine
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.compiled import inlined, inner, kernel, unlocked
from inclined_landing.models.geometry import PARKED, platform_reach
from inclined_landing.models.motion import Motion
from inclined_landing.models.vehicle import Vehicle

_JOINTS = ("x", "y", "z", "roll", "pitch", "yaw")  # of models/scene.py, in the order of motion.MODES


class _Clock(NamedTuple):
    """Times of the platforms' motions, and the times at which the engine evaluates them."""

    time: np.ndarray  # (n,) s since the vehicles' reset
    begun: np.ndarray  # (n,) s, time of the motions at the vehicles' reset
    step: float  # s, of the engine
    late: float  # s, time offset of velocities and accelerations before positions


class _Joints(NamedTuple):
    """The platforms' joints in the engine's arrays, in the order of motion.MODES."""

    qpos: np.ndarray  # (n, nq)
    qvel: np.ndarray  # (n, nv)
    force: np.ndarray  # (n, nv)
    positions: np.ndarray  # (6,) columns of qpos
    dofs: np.ndarray  # (6,) columns of qvel and force
    inertia: float  # kg, kg m2


class Moving(NamedTuple):
    """The data of n moving platforms that kernels read; n is 0 in a plant without moving platforms."""

    courses: np.ndarray  # (n, c) what every control period reads of a motion, see `_write_course`
    waves: motion.Waves
    late: float  # s, as in _Clock
    period: float  # s
    reach: float  # m, of the slab from its centre


# Columns of a course: time of the motion at the vehicle's reset [s], bound of `strays` for all times [m/s],
# number of waves, place at rest (6,), velocity (3,); then mode, amplitude, frequency and phase of each wave.
BEGUN, MOST = 0, 1
_TOGETHER = 64  # platforms whose sines are computed together: they fit into the first-level cache
_COUNT, _PLACE, _VELOCITY, _WAVES = 2, 3, 9, 12
# So that one compiled kernel serves both.
STILL = Moving(np.empty((0, _WAVES)), Motion.still(0).arrays, 0.0, 0.0, 0.0)


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
        self._forces = np.zeros((n, substeps, model.nv))
        self._reach = platform_reach(vehicle)
        self._moved()

    def bind(self, batch) -> None:
        """Use the arrays of a copy of the engine."""
        qpos, qvel, force = batch.bind("qpos"), batch.bind("qvel"), batch.bind("qfrc_applied")
        self._joints = self._joints._replace(qpos=qpos, qvel=qvel, force=force)
        self._clock = self._clock._replace(time=batch.bind("time"))

    def _moved(self) -> None:
        """Use the present arrays of the motion, which are replaced when it gets more waves."""
        self._waves = self.motion.arrays
        courses = np.zeros((len(self.rest), _WAVES + 4 * self.motion.amplitude[0].size))
        self.moving = Moving(courses, self._waves, self._clock.late, self._period, self._reach)
        self.renew()

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays that a snapshot of the plant needs."""
        names = ("deck_velocity", "deck_amplitude", "deck_frequency", "deck_phase")
        return {"deck_rest": self.rest, "deck_begun": self.begun, **dict(zip(names, self.motion.arrays))}

    def make_room(self, arrays: dict[str, np.ndarray]) -> None:
        """Allocate space for as many waves as a snapshot's arrays have."""
        self.motion = Motion.still(len(self.rest), arrays["deck_amplitude"].shape[2])
        self._moved()

    def stop(self, ids, rest: np.ndarray) -> None:
        """Stop the platforms `ids` at `rest` (k, 12)."""
        _stop(self._everyone[ids], rest, self.rest, self.begun, self.moving)

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
        self.renew(ids)

    def renew(self, ids=slice(None)) -> None:
        """Write the courses of the platforms `ids` after a change of their motions."""
        _renew(self._everyone[ids], self.rest, self.begun, self.moving)

    def at(self, times) -> np.ndarray:
        """Return states (n, 12) of the platforms at times (n,) or a number [s] since the vehicles' reset."""
        return self.motion.platforms(times + self.begun, self.rest)

    def place(self, ids: np.ndarray, present: np.ndarray) -> None:
        """Set the present poses of the platforms `ids`, in the engine and in `platform`."""
        _place(ids, self._clock, present, self.moving, self._platform, self._joints)

    def follow(self, ids: np.ndarray) -> None:
        """Write the present poses of the platforms `ids` to `platform` only."""
        _follow(ids, self._clock.time, self.moving, self._platform)

    def forces(self, ids: np.ndarray, present: np.ndarray) -> np.ndarray:
        """Return the forces (k, substeps, nv) that move the platforms `ids` during the coming period."""
        out = self._forces[: len(ids)]
        _forces(ids, self._clock, present, self._waves, self._joints, out)
        return out


@inner
def strays(i, time, present, moving, rates):
    """Return a bound of the speed [m/s] at which any point of platform i leaves the path of a steady
    platform.

    The steady platform keeps the velocity that the platform's centre has at the beginning of the period,
    `time` [s]. After t [s] of the period, the distance of any point from its steady path is at most t times
    the bound. rates (6,): for intermediate results.
    """
    if present:
        motion.rate(i, time + moving.courses[i, BEGUN] - moving.late, moving.waves, rates)
    else:
        rates[:] = 0.0
    return _bound(i, moving, rates)


@inlined
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
            frequency = waves.frequency[i, mode, k]
            gained += abs(waves.amplitude[i, mode, k]) * (frequency * frequency)
        gained *= 0.5 * moving.period + 2.0 * moving.late
        if mode < 3:
            square += gained * gained
        else:
            turning += abs(rates[mode]) + gained
    return math.sqrt(square) + moving.reach * turning


@kernel
def _stop(ids, places, rest, begun, moving):
    """Stop the platforms `ids` (k,) in the states `places` (k, 12)."""
    waves = moving.waves
    for row in range(len(ids)):
        i = ids[row]
        rest[i], begun[i], waves.velocity[i] = places[row], 0.0, 0.0
        waves.amplitude[i] = waves.frequency[i] = waves.phase[i] = 0.0
        _write_course(i, rest, begun, moving)


@kernel
def _renew(ids, rest, begun, moving):
    for i in ids:
        _write_course(i, rest, begun, moving)


@inner
def _write_course(i, rest, begun, moving):
    """Write the course of platform i: all parameters of its motion, without waves of zero amplitude.

    The bound of `strays` for all times assumes that all waves have their largest rates at once.
    """
    course, waves, count, rates = moving.courses[i], moving.waves, 0, np.zeros(6)
    for mode in range(6):
        for k in range(waves.amplitude.shape[2]):
            size, omega = waves.amplitude[i, mode, k], waves.frequency[i, mode, k]
            if size != 0.0:
                at = _WAVES + 4 * count
                course[at], course[at + 1], course[at + 2] = mode, size, omega
                course[at + 3] = waves.phase[i, mode, k]
                count += 1
                rates[mode] += abs(size * omega)
    course[BEGUN], course[MOST], course[_COUNT] = begun[i], _bound(i, moving, rates) * (1.0 + 1e-9), count
    for k in range(3):
        course[_PLACE + k], course[_PLACE + 3 + k] = rest[i, k], rest[i, ROLL + k]
        course[_VELOCITY + k] = waves.velocity[i, k]


@unlocked
def _follow(ids, time, moving, platform):
    """Write the states of the platforms `ids` at a time (n,) [s] after the vehicles' reset to `platform`."""
    courses, now, most = moving.courses, np.empty((3, 6)), _TOGETHER * moving.courses.shape[1]
    # Three arrays, because only of these SIMD knows that they do not overlap.
    angle, sine, cosine = np.empty(most), np.empty(most), np.empty(most)
    for first in range(0, len(ids), _TOGETHER):
        some, count = ids[first : first + _TOGETHER], 0
        for i in some:
            course, t = courses[i], courses[i, BEGUN] + time[i]
            for wave in range(_WAVES, _WAVES + 4 * int(course[_COUNT]), 4):
                angle[count] = course[wave + 2] * t + course[wave + 3]
                count += 1
        for k in range(count):
            sine[k], cosine[k] = sine_cosine(angle[k])
        count = 0
        for i in some:
            course, t = courses[i], courses[i, BEGUN] + time[i]
            for k in range(3):
                v = course[_VELOCITY + k]
                now[0, k], now[1, k], now[0, 3 + k], now[1, 3 + k] = v * t, v, 0.0, 0.0
            for wave in range(_WAVES, _WAVES + 4 * int(course[_COUNT]), 4):
                mode, amplitude, frequency = int(course[wave]), course[wave + 1], course[wave + 2]
                now[0, mode] += amplitude * sine[count]
                now[1, mode] += amplitude * frequency * cosine[count]
                count += 1
            motion.write_state(now, course[_PLACE : _PLACE + 6], platform[i])


@kernel
def _place(ids, clock, present, moving, platform, joints):
    """Write the platforms' states into `platform`, and positions, speeds and forces into the engine's
    arrays.
    """
    qpos, qvel, force, positions, dofs, inertia = joints
    now, speed, gain, waves = np.empty((3, 6)), np.empty(6), np.empty(6), moving.waves
    for i in ids:
        t, place = clock.time[i] + clock.begun[i], moving.courses[i, _PLACE : _PLACE + 6]
        motion.displacement(i, t, waves, now)
        motion.write_state(now, place, platform[i])
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
            qpos[i, positions[k]] = place[k] + now[0, k]
            qvel[i, dofs[k]] = speed[k]
            force[i, dofs[k]] = inertia * gain[k]  # F = I a


@kernel
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
