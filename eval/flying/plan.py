"""The purpose of one flight: a landing by its policy, or a planned flight with its obstacles."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np

from inclined_landing.envs.hover import HAND_OVER_SPEED
from inclined_landing.envs.policy import Policy
from inclined_landing.eval.base.fence import beyond_fence
from inclined_landing.eval.base.tracking import Tracker, Trajectory, read_trajectory
from inclined_landing.eval.flying.safety import Phase
from inclined_landing.eval.flying.surroundings import Surroundings
from inclined_landing.models.attitude import ROLL, STATE_SIZE, VX, VZ, YAW, X, Z
from inclined_landing.models.errors import UserError
from inclined_landing.models.vehicle import Vehicle

LEAST_CLEARANCE = 0.03  # m between the planned vehicle and platform or floor
_CHECKED = 5  # every so many rows: 0.15 m at the largest speed


@dataclasses.dataclass(frozen=True)
class PlannedFlight:
    """A planned flight in a room; present: whether the platform stands there."""

    reference: Trajectory
    vehicle: Vehicle
    inclination: float  # of the platform, rad
    present: bool = True


@dataclasses.dataclass(frozen=True)
class FlightPlan:
    """Policies, start and standing height of one flight; or a planned flight instead of a landing."""

    landing: Policy | PlannedFlight  # a policy for the task landing or touchdown
    setpoint: Policy
    start: tuple[float, float]  # x, z where the landing begins, m
    stand: float = 0.0  # height of what the vehicle stands on, m
    heading: float = 0.0  # of the standing vehicle where motion capture does not show it, rad

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle, with its room."""
        return self.landing.vehicle if isinstance(self.landing, PlannedFlight) else self.landing.task.vehicle

    @property
    def start_point(self) -> np.ndarray:
        """The point (3,) [m] that the set-point policy flies to."""
        if isinstance(self.landing, PlannedFlight):
            return self.landing.reference.position[0]
        return np.array([self.start[0], 0.0, self.start[1]])

    @property
    def surroundings(self) -> Surroundings:
        """What stands in the room."""
        if isinstance(self.landing, PlannedFlight):
            return Surroundings(self.landing.vehicle, self.landing.inclination, self.landing.present)
        task = self.landing.task
        # In space a slope that rises along x is one that faces -x: inclination > 0, azimuth pi.
        return Surroundings(task.vehicle, task.inclination * math.cos(task.azimuth))


def read_planned(path: Path, vehicle: Vehicle, inclination: float, present: bool = True) -> PlannedFlight:
    """Return the planned flight of a file of `landing-eval plan`.

    Raises UserError for one that does not begin and end at rest, leaves the fence or touches something.
    """
    flight = PlannedFlight(read_trajectory(path), vehicle, inclination, present)
    r, where = flight.reference, f"planned flight {path}"
    if np.linalg.norm(r.velocity[[0, -1]], axis=1).max() > HAND_OVER_SPEED or abs(r.attitude[0, 2]) > 0.1:
        raise UserError(f"{where} must begin and end at rest, and begin at heading 0")
    beyond = beyond_fence(r.position, r.velocity, vehicle)
    if beyond.any():
        raise UserError(f"{where} leaves the fence of the arena after {r.t[np.argmax(beyond)]:.1f} s")
    states = np.zeros((len(r.t), STATE_SIZE))
    states[:, X : Z + 1], states[:, ROLL : YAW + 1] = r.position, r.attitude
    states[:, VX : VZ + 1] = r.velocity
    distances = Surroundings(vehicle, inclination, present).distances(states[::_CHECKED]).min(axis=1)
    if distances.min() < LEAST_CLEARANCE:
        k = int(np.argmax(distances < LEAST_CLEARANCE))
        hint = "; if there is no platform, add --no-platform" if present else ""
        raise UserError(
            f"{where} comes closer than {100 * LEAST_CLEARANCE:g} cm to the platform or floor after "
            f"{r.t[_CHECKED * k]:.1f} s{hint}"
        )
    return flight


class PlanTracking:
    """A planned flight, tracked by the controller that the plan was simulated with.

    Its interface is that of `policies.PolicyLanding`.
    """

    phase = Phase.PLAN
    turns = True
    limit = math.inf  # it ends by itself
    policy = None

    def __init__(self, flight: PlannedFlight):
        self._flight = flight
        self.astray = 0.0  # m off the reference now
        self.reset()

    def reset(self) -> None:
        """Reset the tracker."""
        self._tracker, self._before = Tracker(self._flight.reference, self._flight.vehicle), 0.0

    def step(self, since: float, state: np.ndarray, resting: bool) -> np.ndarray | str:
        """Return the command (4,), in the vehicle's heading, at a state (13,); the outcome at the end."""
        reference = self._flight.reference
        if since > reference.seconds:
            return "plan flown"
        self.astray = float(np.linalg.norm(state[X : Z + 1] - reference.position[reference.row(since)]))
        command = self._tracker.command(since, state[None], since - self._before)[0]
        self._before = since
        return command

    def heading_error(self, since: float, yaw: float) -> float:
        """Return by how much a heading [rad] is behind the plan's."""
        return float(self._tracker.heading_error(since, np.array([yaw]))[0])
