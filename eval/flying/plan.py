"""Define what one flight does: it lands by a policy, or follows a planned flight that was checked before."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from inclined_landing.envs.hover import HAND_OVER_SPEED
from inclined_landing.envs.policy import Policy
from inclined_landing.eval.flying.fence import beyond_fence
from inclined_landing.eval.flying.policies import PlanTracking, PolicyLanding
from inclined_landing.eval.flying.safety import SPEED_LIMIT
from inclined_landing.eval.flying.surroundings import Surroundings
from inclined_landing.eval.flying.tracking import Trajectory, read_trajectory, thrust_and_angles
from inclined_landing.models.attitude import ROLL, STATE_SIZE, VX, VZ, YAW, X, Z
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.vehicle import Vehicle

LEAST_CLEARANCE = 0.03  # m between the planned vehicle and platform or floor
ROUNDING = 1e-5  # of the numbers in a file, which have six digits
MISFIT = 0.05  # m between positions and the integral of the velocity from row to row
CHANGE_MISFIT = 0.1  # m/s2 between acceleration and change of velocity; planned flights have up to 0.03
LEAN_MISFIT = 0.02  # rad between the lean and that of the acceleration, which planned flights have exactly
_CHECKED = 5  # every so many rows: 0.15 m at the largest speed


@dataclasses.dataclass(frozen=True)
class FlightPlan:
    """One flight: a policy flies to the start point, from which a landing or a planned flight begins."""

    setpoint: Policy
    final: PolicyLanding | PlanTracking
    start_point: np.ndarray  # (3,) m
    surroundings: Surroundings  # the vehicle and the obstacles in the room
    stand: float = 0.0  # height of what the vehicle stands on, m
    heading: float = 0.0  # of the standing vehicle where motion capture does not show it, rad

    @classmethod
    def landing(cls, policy: Policy, setpoint: Policy, start: tuple[float, float], **stands) -> FlightPlan:
        """Return the plan of a landing that begins at x, z [m], by a policy for landing or touchdown."""
        task, (x, z) = policy.task, start
        # In space a slope that rises along x is one that faces -x: inclination > 0, azimuth pi.
        around = Surroundings(task.vehicle, task.inclination * math.cos(task.azimuth))
        return cls(setpoint, PolicyLanding(policy), np.array([x, 0.0, z]), around, **stands)

    @classmethod
    def along(cls, reference: Trajectory, setpoint: Policy, around: Surroundings, **stands) -> FlightPlan:
        """Return the plan of a flight along a reference."""
        final = PlanTracking(reference, around.vehicle)
        return cls(setpoint, final, reference.position[0], around, **stands)


def read_planned(path: Path, around: Surroundings) -> Trajectory:
    """Return the planned flight in a file of `landing-eval plan`.

    Raises UserError for a file of another kind, and for a flight that does not begin and end at rest, that no
    vehicle can fly, whose columns contradict each other, that leaves the fence or touches something.
    """
    r, where = read_trajectory(path), f"planned flight {path}"
    if np.linalg.norm(r.velocity[[0, -1]], axis=1).max() > HAND_OVER_SPEED or abs(r.attitude[0, 2]) > 0.1:
        raise UserError(f"{where} must begin and end at rest, and begin at heading 0")
    for wrong, beyond in _impossible(r, around.vehicle):
        if beyond.any():
            raise UserError(f"{where} {wrong} after {r.t[np.argmax(beyond)]:.1f} s")
    states = np.zeros((len(r.t), STATE_SIZE))
    states[:, X : Z + 1], states[:, ROLL : YAW + 1] = r.position, r.attitude
    states[:, VX : VZ + 1] = r.velocity
    distances = around.distances(states[::_CHECKED]).min(axis=1)
    if distances.min() < LEAST_CLEARANCE:
        k = int(np.argmax(distances < LEAST_CLEARANCE))
        hint = "; without a platform, add --no-platform" if around.present else ""
        raise UserError(
            f"{where} comes closer than {100 * LEAST_CLEARANCE:g} cm to the platform or floor after "
            f"{r.t[_CHECKED * k]:.1f} s{hint}"
        )
    return r


def _impossible(r: Trajectory, v: Vehicle) -> Iterator[tuple[str, np.ndarray]]:
    """Yield each violation of the vehicle's limits, with the rows (m,) in which it occurs."""
    # Trapezoidal rule: x_k+1 - x_k = (v_k + v_k+1) dt / 2, and the same of v and a
    dt = np.diff(r.t)[:, None]
    moved, gained = np.diff(r.position, axis=0), np.diff(r.velocity, axis=0)
    off = np.abs(moved - 0.5 * dt * (r.velocity[1:] + r.velocity[:-1])).max(axis=1)
    yield "has a velocity and a position that disagree", np.append(off > MISFIT, False)
    low, high = v.command_pwm_range
    yield f"commands a PWM outside {low:g} to {high:g}", _outside(r.command[:, 0], low, high)
    tilt = np.hstack([r.command[:, 1:3], r.attitude[:, :2]])
    limit = v.command_angle_limit
    yield f"leans beyond {math.degrees(limit):.0f} deg", _outside(tilt, -limit, limit)
    limit = v.command_yaw_rate_limit
    turning = np.column_stack([r.command[:, 3], np.gradient(r.attitude[:, 2], r.t)])
    yield f"turns faster than {math.degrees(limit):.0f} deg/s", _outside(turning, -limit, limit)
    speed = np.linalg.norm(r.velocity, axis=1)
    yield f"is faster than {SPEED_LIMIT:g} m/s", speed > SPEED_LIMIT
    off = np.abs(gained / dt - 0.5 * (r.acceleration[1:] + r.acceleration[:-1])).max(axis=1)
    yield "has accelerations that are not the change of its velocity", np.append(False, off > CHANGE_MISFIT)
    _, leaning = thrust_and_angles(r.acceleration, r.attitude[:, 2], v.environment_gravity)
    off = np.abs(leaning - r.attitude[:, :2]).max(axis=1)
    yield "leans otherwise than its acceleration needs", off > LEAN_MISFIT
    yield "leaves the fence of the arena", beyond_fence(r.position, r.velocity, v)


def _outside(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return (m,) bool: whether values (m, ...) are outside their range by more than the file rounds."""
    beyond = (values < low - ROUNDING) | (values > high + ROUNDING)
    return beyond.reshape(len(values), -1).any(axis=1)
