"""Contact forces on the vehicle at touchdown, at every step of the engine.

A recorded flight holds states at the control rate; contact comes and goes within it. So the flight's
commands are flown again, one engine step at a time (the states come out the same, bit for bit), and a
forward pass on the state after every step gives its contacts and their forces. A landing ends in the
goal box before anything touches: there its motors are cut and the vehicle falls on.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from inclined_landing.envs.flights import Flight, resimulate
from inclined_landing.eval.pictures.labels import MOTORS_CUT, Label, outcome_label
from inclined_landing.models import surface
from inclined_landing.models.attitude import PWM
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.plants.recorder import REST_SPEED, STEP
from inclined_landing.models.vehicle import Vehicle

CUT_TIME = 1.0  # s that a landing is watched after its motors are cut
LEAD = 0.1  # s before the first touch that belong to it
STILL_TIME = 0.04  # s that it goes on once the vehicle is still


@dataclasses.dataclass
class Touchdown:
    """A touchdown at the engine's steps, from shortly before first contact until still; T steps."""

    t: np.ndarray  # (T,) s since the flight's start
    state: np.ndarray  # (T, 13), columns of `models.attitude`
    commands: np.ndarray  # (T, 4) PWM, rad, rad, rad/s, that led to the state
    platform: np.ndarray  # (T, 12), of the platform, see `Plant.platform`
    vehicle: Vehicle
    points: Sequence[np.ndarray]  # T arrays (k, 3) m, contacts that carry force
    forces: Sequence[np.ndarray]  # T arrays (k, 3) N, on the vehicle
    settled: int  # step from which it does not move any more; T where it still does

    @property
    def net_forces(self) -> np.ndarray:
        """Net normal force and size of the net tangential force (T, 2) on the vehicle [N]."""
        # F_n = F . n, F_t = |F - F_n n|
        total, normal = np.array([force.sum(axis=0) for force in self.forces]), surface.normals(self.platform)
        away = (total * normal).sum(axis=1)
        return np.stack([away, np.linalg.norm(total - away[:, None] * normal, axis=1)], axis=1)

    def labels(self, k: int) -> list[Label]:
        """Return the label of step k: motors cut, or at rest."""
        if k >= self.settled:
            return [outcome_label("at rest", True)]
        return [] if self.commands[k:, PWM].any() else [MOTORS_CUT]

    @property
    def weight(self) -> float:
        """Weight of the vehicle [N]."""
        return self.vehicle.body_mass * self.vehicle.environment_gravity

    @property
    def largest_force(self) -> float:
        """Largest contact force at one point [N]."""
        return max(float(np.linalg.norm(force, axis=1).max()) for force in self.forces if len(force))


def record_touchdown(flight: Flight) -> Touchdown:
    """Return the touchdown of a flight, simulated again in the MuJoCo plant from its commands.

    flight: one of the landing or the touchdown task, nominal physics. Raises UserError for one without a
    platform, and where nothing touches it.
    """
    if flight.platform is None:
        raise UserError("--forces needs a task with a platform")
    vehicle = flight.task.vehicle
    steps = resimulate(flight, CUT_TIME if flight.task.cut_at_success else 0.0)
    assert steps.platform is not None
    states, commands = steps.state[1:], steps.commands[:-1]
    points, forces = steps.points[1:], steps.forces[1:]
    touching = [k for k, force in enumerate(forces) if len(force)]
    if not touching:
        x, z = flight.state[0, [0, 2]]
        raise UserError(
            f"there is no contact in the flight from x {x:g}, z {z:g} m, so no contact force can be drawn"
        )
    platform = steps.platform[1:]
    _, velocity, _ = surface.relative(states, platform)
    moving = np.flatnonzero(np.linalg.norm(velocity, axis=1) > REST_SPEED)
    begin, settled = max(touching[0] - round(LEAD / STEP), 0), moving[-1] + 1
    part = slice(begin, settled + round(STILL_TIME / STEP))
    return Touchdown(
        steps.t[1:][part],
        states[part],
        commands[part],
        platform[part],
        vehicle,
        points[part],
        forces[part],
        settled - begin,
    )
