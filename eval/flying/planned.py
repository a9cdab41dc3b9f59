"""A planned flight as the pilot flies it: the reference, and what stands where it leads."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from inclined_landing.envs.hover import HAND_OVER_SPEED
from inclined_landing.eval.base.fence import beyond_fence
from inclined_landing.eval.base.tracking import Trajectory, read_trajectory
from inclined_landing.eval.flying.surroundings import Surroundings
from inclined_landing.models.attitude import ROLL, STATE_SIZE, VX, YAW, X, Z
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
        raise UserError(f"{where} passes the fence of the arena after {r.t[np.argmax(beyond)]:.1f} s")
    states = np.zeros((len(r.t), STATE_SIZE))
    states[:, X : Z + 1], states[:, ROLL : YAW + 1], states[:, VX : VX + 3] = (
        r.position,
        r.attitude,
        r.velocity,
    )
    states = states[::_CHECKED]
    distances = Surroundings(vehicle, inclination, present).distances(states).min(axis=1)
    if distances.min() < LEAST_CLEARANCE:
        k = int(np.argmax(distances < LEAST_CLEARANCE))
        hint = "; with no platform there, say --no-platform" if present else ""
        raise UserError(
            f"{where} comes closer than {100 * LEAST_CLEARANCE:g} cm to platform or floor after "
            f"{r.t[_CHECKED * k]:.1f} s{hint}"
        )
    return flight
