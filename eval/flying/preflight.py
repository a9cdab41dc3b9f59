"""The checks that must pass before the motors turn."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from inclined_landing.eval.flying.estimate import StateEstimate
from inclined_landing.eval.flying.interfaces import MeasuredPose
from inclined_landing.eval.flying.surroundings import CLEAR, Surroundings
from inclined_landing.eval.flying.vehicle import Status

RECORDING_TIME = 1.0  # s that is listened to the vehicle and the motion capture
LEAST_VOLTAGE = 3.7  # V at rest: about half full; hovering takes half a volt off
POSE_RATE, ATTITUDE_RATE = 50.0, 40.0  # least per second
LONGEST_GAP = 0.1  # s
LARGEST_SPREAD = 0.005  # m, largest standard deviation of a position at rest
LEVEL = math.radians(10.0)  # of the place that it stands on, and between the two attitudes
HEIGHT = 0.03  # m by which the standing height may differ
ROOM = 0.2  # m to the arena's walls


@dataclasses.dataclass(frozen=True)
class Check:
    """The result of one preflight check."""

    name: str
    passed: bool
    found: str


def preflight_checks(
    source: str,
    poses: list[MeasuredPose],
    attitudes: int,
    status: Status,
    estimate: StateEstimate,
    surroundings: Surroundings,
    stand: float,
) -> list[Check]:
    """Return all preflight checks from RECORDING_TIME seconds of measurements at rest.

    source: name of the source of the poses; attitudes: number received; status: with a voltage of NaN if none
    was received; stand: height of the vehicle's stand [m].
    """
    voltage, v = status.voltage, surroundings.vehicle
    positions = np.array([pose.position for pose in poses]).reshape(-1, 3)
    times = np.array([pose.time for pose in poses])
    gap = float(np.diff(times).max()) if len(times) > 1 else math.inf
    spread = float(positions.std(axis=0).max()) if len(positions) > 1 else math.inf
    moved = len(np.unique(positions, axis=0)) > 1
    state = estimate.state
    x, y, z = state[:3]
    inside = v.arena_x[0] + ROOM < x < v.arena_x[1] - ROOM and v.arena_y[0] + ROOM < y < v.arena_y[1] - ROOM
    expected = stand + surroundings.standing_height
    known = bool(np.isfinite(state).all())
    clearance = float(surroundings.distances(state[None])[0, 0]) if known else math.nan
    tilt = estimate.tilt if known else math.nan
    degrees, mismatch = math.degrees(tilt), math.degrees(estimate.attitude_mismatch)
    # Only motion capture shows an attitude that the vehicle's own can be held against.
    seen = any(pose.attitude is not None for pose in poses)
    other = f", {mismatch:.1f} deg from what motion capture shows" if seen else ""
    frozen = "" if moved or len(times) < 2 else ", all identical: frozen"
    checks = {
        "battery": (voltage >= LEAST_VOLTAGE, f"{voltage:.2f} V; at least {LEAST_VOLTAGE:g} V at rest"),
        "supervisor": (
            not status.locked,
            "locked, crashed or tumbled: switch it off and on" if status.locked else "not locked",
        ),
        source: (
            len(times) >= POSE_RATE * RECORDING_TIME and gap <= LONGEST_GAP and moved,
            f"{len(times) / RECORDING_TIME:.0f} poses per second, longest gap {1e3 * gap:.0f} ms{frozen}"
            f"; at least {POSE_RATE:g}, at most {1e3 * LONGEST_GAP:g} ms",
        ),
        "at rest": (
            spread <= LARGEST_SPREAD,
            f"position varies by {1e3 * spread:.1f} mm; at most {1e3 * LARGEST_SPREAD:g} mm",
        ),
        "attitude log": (
            attitudes >= ATTITUDE_RATE * RECORDING_TIME,
            f"{attitudes / RECORDING_TIME:.0f} per second; at least {ATTITUDE_RATE:g}",
        ),
        "level": (
            tilt <= LEVEL and estimate.attitude_mismatch <= LEVEL,
            f"tilted by {degrees:.1f} deg{other}; at most {math.degrees(LEVEL):.0f} deg",
        ),
        "inside the arena": (inside, f"x {x:z.2f}, y {y:z.2f} m; at least {ROOM:g} m from the walls"),
        "height": (
            abs(z - expected) <= HEIGHT,
            f"stands at z {z:.3f} m, expected {expected:.3f}: stand {stand:g} m, centre of mass "
            f"{surroundings.standing_height:.3f} m above its feet",
        ),
        "clear of the platform": (
            clearance > CLEAR,
            f"{clearance:.2f} m; more than {CLEAR:g} m" if surroundings.present else "no platform",
        ),
    }
    return [Check(name, bool(passed), found) for name, (passed, found) in checks.items()]
