"""The purpose of one flight: a landing by a policy, or a planned flight with its obstacles."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from inclined_landing.envs.hover import HAND_OVER_SPEED
from inclined_landing.envs.policy import Policy
from inclined_landing.eval.flying.fence import beyond_fence
from inclined_landing.eval.flying.safety import SPEED_LIMIT, Phase
from inclined_landing.eval.flying.surroundings import Surroundings
from inclined_landing.eval.flying.tracking import Tracker, Trajectory, read_trajectory, thrust_and_angles
from inclined_landing.models.attitude import ROLL, STATE_SIZE, VX, VZ, YAW, X, Z
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.vehicle import Vehicle

LEAST_CLEARANCE = 0.03  # m between the planned vehicle and platform or floor
ROUNDING = 1e-5  # of the numbers in a file, which have six digits
MISFIT = 0.1  # m/s2 between acceleration and change of velocity; planned flights have up to 0.03
LEAN_MISFIT = 0.02  # rad between the lean and that of the acceleration, which planned flights have exactly
_CHECKED = 5  # every so many rows: 0.15 m at the largest speed


@dataclasses.dataclass(frozen=True)
class PlannedFlight:
    """A planned flight in a room; present: whether the platform is there."""

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
        """The obstacles in the room."""
        if isinstance(self.landing, PlannedFlight):
            return Surroundings(self.landing.vehicle, self.landing.inclination, self.landing.present)
        task = self.landing.task
        # In space a slope that rises along x is one that faces -x: inclination > 0, azimuth pi.
        return Surroundings(task.vehicle, task.inclination * math.cos(task.azimuth))


def read_planned(path: Path, vehicle: Vehicle, inclination: float, present: bool = True) -> PlannedFlight:
    """Return the planned flight in a file of `landing-eval plan`.

    Raises UserError for one that does not begin and end at rest, that no vehicle can fly, whose columns
    contradict each other, that leaves the fence or touches something.
    """
    flight = PlannedFlight(read_trajectory(path), vehicle, inclination, present)
    r, where = flight.reference, f"planned flight {path}"
    if np.linalg.norm(r.velocity[[0, -1]], axis=1).max() > HAND_OVER_SPEED or abs(r.attitude[0, 2]) > 0.1:
        raise UserError(f"{where} must begin and end at rest, and begin at heading 0")
    for wrong, beyond in _impossible(r, vehicle):
        if beyond.any():
            raise UserError(f"{where} {wrong} after {r.t[np.argmax(beyond)]:.1f} s")
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


def _impossible(r: Trajectory, v: Vehicle) -> Iterator[tuple[str, np.ndarray]]:
    """Yield each violation of the vehicle's limits, with the rows (m,) in which it occurs."""
    low, high = v.command_pwm_range
    yield f"commands a PWM outside {low:g} to {high:g}", _outside(r.command[:, 0], low, high)
    tilt = np.hstack([r.command[:, 1:3], r.attitude[:, :2]])
    limit = v.command_angle_limit
    yield f"leans beyond {math.degrees(limit):.0f} deg", _outside(tilt, -limit, limit)
    limit, dt = v.command_yaw_rate_limit, np.diff(r.t, prepend=-1.0)
    turning = np.column_stack([r.command[:, 3], np.gradient(r.attitude[:, 2], r.t)])
    yield f"turns faster than {math.degrees(limit):.0f} deg/s", _outside(turning, -limit, limit)
    speed = np.linalg.norm(r.velocity, axis=1)
    yield f"is faster than {SPEED_LIMIT:g} m/s", speed > SPEED_LIMIT
    # Trapezoidal rule: v_k+1 - v_k = (a_k + a_k+1) dt / 2
    gained = np.diff(r.velocity, axis=0, prepend=r.velocity[:1])
    mean = 0.5 * (r.acceleration + np.vstack([r.acceleration[:1], r.acceleration[:-1]]))
    off = np.abs(gained[1:] / dt[1:, None] - mean[1:]).max(axis=1)
    yield "has accelerations that are not the change of its velocity", np.append(False, off > MISFIT)
    _, leaning = thrust_and_angles(r.acceleration, r.attitude[:, 2], v.environment_gravity)
    off = np.abs(leaning - r.attitude[:, :2]).max(axis=1)
    yield "leans otherwise than its acceleration needs", off > LEAN_MISFIT
    yield "leaves the fence of the arena", beyond_fence(r.position, r.velocity, v)


def _outside(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return (m,) bool: whether values (m, ...) are outside their range by more than the file rounds."""
    beyond = (values < low - ROUNDING) | (values > high + ROUNDING)
    return beyond.reshape(len(values), -1).any(axis=1)


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
        """Return the angle by which a heading [rad] lags behind the plan's."""
        return float(self._tracker.heading_error(since, np.array([yaw]))[0])
