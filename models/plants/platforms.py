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

from typing import NamedTuple

import mujoco
import numpy as np

from inclined_landing.models import motion
from inclined_landing.models.attitude import ROLL, Z
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.compiled import kernel, unlocked
from inclined_landing.models.geometry import PARKED, platform_reach
from inclined_landing.models.motion import Motion
from inclined_landing.models.vehicle import Vehicle

_JOINTS = ("x", "y", "z", "roll", "pitch", "yaw")  # of models/scene.py, in the order of motion.MODES


class _Clock(NamedTuple):
    """Times of the platforms' motions, and the times at which the engine evaluates them."""

    time: np.ndarray  # (n,) s since the vehicles' reset
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

    rest: np.ndarray  # (n, 12) states in which they would be at rest
    begun: np.ndarray  # (n,) s, time of the motions at the vehicles' reset
    most: np.ndarray  # (n,) m/s, see `Platforms.renew`
    waves: motion.Waves


STILL = Moving(np.empty((0, 12)), np.empty(0), np.empty(0), Motion.still(0).waves)  # one kernel serves both


class Platforms:
    """Platforms of n simulations of a scene that was built with `moving`.

    platform (n, 12): the plant's array of their states, kept up to date here.
    """

    def __init__(self, model: mujoco.MjModel, batch, vehicle: Vehicle, platform: np.ndarray, substeps: int):
        n = len(platform)
        self.motion = Motion.still(n)
        self.moving = Moving(platform.copy(), np.zeros(n), np.zeros(n), self.motion.waves)
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
        self._clock = _Clock(batch.bind("time"), step, late)
        self._period = substeps * step
        self._forces = np.zeros((n, substeps, model.nv))
        self._reach = platform_reach(vehicle)

    def bind(self, batch) -> None:
        """Use the arrays of a copy of the engine."""
        qpos, qvel, force = batch.bind("qpos"), batch.bind("qvel"), batch.bind("qfrc_applied")
        self._joints = self._joints._replace(qpos=qpos, qvel=qvel, force=force)
        self._clock = self._clock._replace(time=batch.bind("time"))

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays that a snapshot of the plant needs."""
        arrays = self.motion.waves._asdict() | {"rest": self.moving.rest, "begun": self.moving.begun}
        return {f"platform_{name}": array for name, array in arrays.items()}

    def make_room(self, arrays: dict[str, np.ndarray]) -> None:
        """Allocate space for as many waves as a snapshot's arrays have."""
        self.motion = Motion.still(len(self._platform), arrays["platform_amplitude"].shape[2])

    def stop(self, ids, rest: np.ndarray) -> None:
        """Stop the platforms `ids` at `rest` (k, 12)."""
        moving = self.moving
        moving.rest[ids], moving.begun[ids], moving.most[ids] = rest, 0.0, 0.0
        for parameters in moving.waves:
            parameters[ids] = 0.0

    def set(self, ids, moves: Motion, time=0.0) -> None:
        """See `Plant.set_motion`; raises UserError for another number of motions."""
        if len(moves) != (count := len(self.moving.begun[ids])):
            raise UserError(f"{count} platforms need {count} motions, not {len(moves)}")
        self.motion[ids], self.moving.begun[ids] = moves, time
        self.renew(ids)

    def renew(self, ids=slice(None)) -> None:
        """Use the present motions, of which those of the platforms `ids` are new.

        `moving.most` is a bound of the speed [m/s] at which any point of a platform leaves the path of a
        steady platform, which keeps the velocity that the platform's centre has at the beginning of a control
        period: after t [s], the distance of the point from its steady path is at most t times the bound.
        """
        self.moving = self.moving._replace(waves=self.motion.waves)
        _, amplitude, frequency, _ = (parameters[ids] for parameters in self.motion.waves)
        size, turn = np.abs(amplitude), np.abs(frequency)
        # The centre strays by a t^2/2 <= t (a T/2), a the largest acceleration of its motion, T the period.
        # Each angle turns the platform by up to |rate| t + a t^2/2, and moves its points by as much times the
        # reach of the slab. In a single-step integrator speeds lag by half a step, and grow by whole ones.
        rate, gained = (size * turn).sum(axis=2), (size * turn**2).sum(axis=2)
        gained *= 0.5 * self._period + 2.0 * self._clock.late
        most = np.linalg.norm(gained[:, :3], axis=1) + self._reach * (rate + gained)[:, 3:].sum(axis=1)
        self.moving.most[ids] = most * (1.0 + 1e-9)  # more than rounding

    def at(self, times) -> np.ndarray:
        """Return states (n, 12) of the platforms at times (n,) or a number [s] since the vehicles' reset."""
        return self.motion.platforms(times + self.moving.begun, self.moving.rest)

    def place(self, ids: np.ndarray, present: np.ndarray) -> None:
        """Set the present poses of the platforms `ids`, in the engine and in `platform`."""
        _place(ids, self._clock, present, self.moving, self._platform, self._joints)

    def follow(self, ids: np.ndarray) -> None:
        """Write the present poses of the platforms `ids` to `platform` only."""
        _follow(ids, self._clock.time, self.moving, self._platform)

    def forces(self, ids: np.ndarray, present: np.ndarray) -> np.ndarray:
        """Return the forces (k, substeps, nv) that move the platforms `ids` during the coming period."""
        out = self._forces[: len(ids)]
        _forces(ids, self._clock, present, self.moving, self._joints, out)
        return out


@unlocked
def _follow(ids, time, moving, platform):
    """Write the states of the platforms `ids` at a time (n,) [s] after the vehicles' reset to `platform`."""
    now = np.empty((3, 6))
    for i in ids:
        motion.displacement(i, moving.begun[i] + time[i], moving.waves, now)
        motion.write_state(now, moving.rest[i], platform[i])


@kernel
def _place(ids, clock, present, moving, platform, joints):
    """Write the platforms' states into `platform`, and positions, speeds and forces into the engine's
    arrays.
    """
    qpos, qvel, force, positions, dofs, inertia = joints
    now, other, waves = np.empty((3, 6)), np.empty((3, 6)), moving.waves
    late = clock.late > 0.0
    for i in ids:
        t, rest = clock.time[i] + moving.begun[i], moving.rest[i]
        motion.displacement(i, t, waves, now)
        motion.write_state(now, rest, platform[i])
        if not present[i]:
            for k in range(6):
                qpos[i, positions[k]] = qvel[i, dofs[k]] = force[i, dofs[k]] = 0.0
            qpos[i, positions[Z]] = PARKED
            continue
        motion.displacement(i, t - clock.late if late else t + 0.5 * clock.step, waves, other)
        speed, gain = (other[1], now[2]) if late else (now[1], other[2])
        for k in range(6):
            qpos[i, positions[k]] = rest[k if k < 3 else ROLL + k - 3] + now[0, k]
            qvel[i, dofs[k]] = speed[k]
            force[i, dofs[k]] = inertia * gain[k]  # F = I a


@kernel
def _forces(ids, clock, present, moving, joints, out):
    """Write the forces of every time step, from the accelerations in its middle, into `out`."""
    now = np.empty((3, 6))
    for row in range(len(ids)):
        i = ids[row]
        for s in range(out.shape[1]):
            t = clock.time[i] + moving.begun[i] + (s + 0.5) * clock.step - clock.late
            motion.displacement(i, t, moving.waves, now)
            for k in range(6):
                out[row, s, joints.dofs[k]] = joints.inertia * now[2, k] if present[i] else 0.0
