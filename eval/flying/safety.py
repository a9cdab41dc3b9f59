"""Causes that end a flight early: each with its reaction, its limit, and the reason for the limit.

docs/guides/fly.md has the causes as a table, with the reason for each reaction.
"""

from __future__ import annotations

import dataclasses
import enum
import math
from collections.abc import Iterator

import numpy as np

from inclined_landing.envs.tasks.landing import BOUND_MARGIN
from inclined_landing.eval.flying.estimate import StateEstimate
from inclined_landing.eval.flying.fence import FLOOR, beyond_fence
from inclined_landing.eval.flying.surroundings import IMPACT_DISTANCE
from inclined_landing.models.attitude import VX, VZ, X, Z
from inclined_landing.models.vehicle import Vehicle


class Phase(enum.Enum):
    """The phase of a flight."""

    APPROACH = "approach"  # take-off and flight to the start, by the set-point policy
    LANDING = "landing"  # by the landing policy
    PLAN = "plan"  # a planned flight, by the controller of `tracking`
    RETREAT = "retreat"  # to a free place and down, by the set-point policy
    OVER = "over"  # motors off


class Reaction(enum.Enum):
    """The pilot's reaction to a cause."""

    OFF = "motors off"
    LAND = "lands next to the platform"


POSE_LIMIT = 0.2  # s without a believed position: the filter is then 6 cm unsure, a goal box has 10
ATTITUDE_LIMIT = 0.25  # s without an attitude: a quarter of a second of lost packets is no link
TILT_LIMIT = math.radians(60.0)  # the firmware calls a vehicle tumbled there; commands end at 30 deg
MISMATCH_LIMIT = 2.0  # m/s between what forces add up to and the measured velocity, see `ConsistencyMonitor`
DISAGREEMENT_LIMIT = math.radians(20.0)  # between the attitudes of log and motion capture
HEADING_LIMIT = math.radians(30.0)  # off the heading held, while it is not being turned to it
ASTRAY_LIMIT = 0.5  # m off a planned flight
SPEED_LIMIT = 4.0  # m/s: shipped landings stay below 2.8
LOWEST_VOLTAGE = 3.0  # V under load: the firmware's critical level of one cell
LOG_PERIOD = 0.02  # s, two periods of the attitude's log: a silence that every link has
SILENCE_MEMORY = 0.5  # s
SILENCE_LIMIT = 0.1  # s
DISAGREEMENT_TIME, BATTERY_TIME = 0.1, 0.5  # s that these must last
RESTING_LIMIT = 0.5  # s of lying still in a landing or a planned flight
APPROACH_LIMIT = 25.0  # s
RETREAT_LIMIT = 20.0  # s
HANG_LIMIT = 0.25  # s without a sign of the control loop


@dataclasses.dataclass(frozen=True)
class FlightStatus:
    """The quantities that the safety monitor checks."""

    phase: Phase
    since: float  # s since the phase began
    estimate: StateEstimate
    airborne: bool  # has it left the place it stood on
    linked: bool
    locked: bool  # by the vehicle's own supervisor
    voltage: float  # V; NaN where not known
    heading_error: float  # rad
    velocity_mismatch: float  # m/s, see `ConsistencyMonitor`
    resting_time: float  # s that it has touched something without moving
    landing_limit: float  # s that the landing may take
    astray: float = 0.0  # m off a planned flight
    near: bool = False  # to platform or floor, so that it may have touched them
    late: float = 0.0  # s by which this computer is late with the control step


@dataclasses.dataclass(frozen=True)
class Cause:
    """A cause that ends a flight early; `SafetyMonitor.conditions` defines all but the pilot's own."""

    name: str
    when: str
    reaction: Reaction
    lasting: float = 0.0  # s that it must last


_OFF, _LAND = Reaction.OFF, Reaction.LAND
INTERRUPTED = Cause("interrupted", "Ctrl-C, Ctrl-Z, `kill`, or the terminal is closed", _OFF)
ERROR = Cause("error", "any exception, also while printing or writing the log", _OFF)
HANG = Cause("hang", f"the control loop does not respond for {HANG_LIMIT:g} s", _OFF)
BAD_SETPOINT = Cause("bad set-point action", "the set-point policy returns NaN or infinity", _OFF)
BAD_ACTION = Cause("bad action", "the landing policy returns NaN or infinity", _LAND)
CAUSES = (  # in the order in which they are asked
    *(INTERRUPTED, ERROR, HANG, BAD_SETPOINT, BAD_ACTION),
    Cause("link lost", "cflib reports the connection lost", _OFF),
    Cause("no attitude", f"no attitude from the vehicle for {ATTITUDE_LIMIT:g} s", _OFF),
    Cause("no position", f"no credible position for {POSE_LIMIT:g} s: lost, frozen or jumped", _OFF),
    Cause("bad state", "position, velocity or attitude is NaN or infinite", _OFF),
    Cause("supervisor", "the vehicle reports that it is tumbled, locked or crashed", _OFF),
    Cause("tilt", f"tilted by more than {math.degrees(TILT_LIMIT):.0f} deg", _OFF),
    Cause(
        "disagreement",
        f"log and motion capture show attitudes {math.degrees(DISAGREEMENT_LIMIT):.0f} deg apart for "
        f"{DISAGREEMENT_TIME:g} s",
        _OFF,
        DISAGREEMENT_TIME,
    ),
    Cause(
        "collision or wrong position",
        f"as the next one, within {100 * IMPACT_DISTANCE:g} cm of platform or floor: it may have hit them",
        _OFF,
    ),
    Cause(
        "wrong position",
        f"the measured velocity differs by {MISMATCH_LIMIT:g} m/s from that integrated from accelerometer "
        "and tilt",
        _OFF,
    ),
    Cause("outside", "outside the arena", _OFF),
    Cause(
        "no room",
        "closer to a wall or the ceiling than the distance it needs to stop with the largest commands",
        _OFF,
    ),
    Cause(
        "touched",
        "touches the platform or the floor in the landing or a planned flight and stays there for 0.5 s",
        _OFF,
    ),
    Cause("retreat takes too long", f"not down {RETREAT_LIMIT:g} s after it began", _OFF),
    Cause(
        "fence",
        "closer to a wall or the ceiling than the distance it needs to stop, plus "
        f"{100 * BOUND_MARGIN:g} cm; the same for the floor, from {FLOOR:g} m up",
        _LAND,
    ),
    Cause(
        "poor link",
        f"no attitude from the vehicle for {SILENCE_LIMIT:g} s in the landing or a planned flight",
        _LAND,
    ),
    Cause("speed", f"faster than {SPEED_LIMIT:g} m/s", _LAND),
    Cause(
        "heading",
        f"{math.degrees(HEADING_LIMIT):.0f} deg off the heading held, in the landing or a planned flight",
        _LAND,
    ),
    Cause("astray", f"more than {ASTRAY_LIMIT:g} m off a planned flight", _LAND),
    Cause("battery", f"below {LOWEST_VOLTAGE:g} V for {BATTERY_TIME:g} s", _LAND, BATTERY_TIME),
    Cause("approach takes too long", f"the start is not reached after {APPROACH_LIMIT:g} s", _LAND),
    Cause("landing takes too long", "longer than an episode of the task (6 s)", _LAND),
)
# Name and description of a cause that would not be met without the delay of a control step or of the link.
LATE = ("late", "this computer was late with a control step; otherwise no limit would have been exceeded")
SILENT = ("poor link", "another gap in the link as long as the last one would leave no room to stop")


class SafetyMonitor:
    """Checks all causes in every control step, and tracks how long some of them have lasted."""

    def __init__(self, vehicle: Vehicle):
        self.vehicle = vehicle
        self._began: dict[str, float] = {}
        self._silence = self._late = 0.0  # s
        self._time = -math.inf  # of the last check, s
        v = vehicle
        self._low = np.array([v.arena_x[0], v.arena_y[0], -np.inf])  # markers may be below the floor
        self._high = np.array([v.arena_x[1], v.arena_y[1], v.arena_z[1]])

    def cause(self, now: FlightStatus) -> Cause | None:
        """Return the first cause whose condition is met; in a retreat only one that stops the motors."""
        self._listen(now)
        named = {cause.name: cause for cause in CAUSES}
        for name, holds in self.conditions(now, self._silence):
            cause = named[name]
            if not self._lasts(cause, holds, now.estimate.time):
                continue
            if cause.reaction is Reaction.LAND and now.phase is Phase.RETREAT:
                continue
            return self._told(cause, now)
        return None

    def _told(self, cause: Cause, now: FlightStatus) -> Cause:
        """Return the reason of a cause: the cause itself, a late control step or a silent link."""
        e = now.estimate
        ages = {"pose_age": e.pose_age - now.late, "attitude_age": e.attitude_age - now.late}
        punctual = dataclasses.replace(now, estimate=dataclasses.replace(e, **ages))
        silence = max(0.0, self._silence - self._late)
        if not dict(self.conditions(punctual, silence))[cause.name]:
            return Cause(*LATE, cause.reaction)
        return cause if dict(self.conditions(now, 0.0))[cause.name] else Cause(*SILENT, cause.reaction)

    def conditions(self, now: FlightStatus, silence: float) -> Iterator[tuple[str, bool]]:
        """Yield the causes that are checked, in the order of CAUSES, and whether they are met now.

        silence [s]: time for which the next command may not arrive.
        """
        e, strict = now.estimate, now.phase in (Phase.LANDING, Phase.PLAN)
        yield "link lost", not now.linked
        yield "no attitude", e.attitude_age > ATTITUDE_LIMIT
        yield "no position", e.pose_age > POSE_LIMIT
        yield "bad state", not np.isfinite(e.state).all()
        yield "supervisor", now.locked
        yield "tilt", e.tilt > TILT_LIMIT
        yield "disagreement", e.attitude_mismatch > DISAGREEMENT_LIMIT
        yield "collision or wrong position", now.near and now.velocity_mismatch > MISMATCH_LIMIT
        yield "wrong position", not now.near and now.velocity_mismatch > MISMATCH_LIMIT
        position = e.state[X : Z + 1]
        yield "outside", bool((position < self._low).any() or (position > self._high).any())
        yield "no room", self._cannot_stop(now, silence)
        yield "touched", strict and now.resting_time >= RESTING_LIMIT
        yield "retreat takes too long", now.phase is Phase.RETREAT and now.since > RETREAT_LIMIT
        yield "fence", self._is_beyond_fence(now, silence)
        yield "poor link", strict and e.attitude_age > SILENCE_LIMIT
        yield "speed", e.speed > SPEED_LIMIT
        yield "heading", strict and abs(now.heading_error) > HEADING_LIMIT
        yield "astray", now.phase is Phase.PLAN and now.astray > ASTRAY_LIMIT
        yield "battery", now.voltage < LOWEST_VOLTAGE
        yield "approach takes too long", now.phase is Phase.APPROACH and now.since > APPROACH_LIMIT
        yield "landing takes too long", now.phase is Phase.LANDING and now.since > now.landing_limit

    def _lasts(self, cause: Cause, holds: bool, time: float) -> bool:
        if not holds:
            self._began.pop(cause.name, None)
            return False
        return time - self._began.setdefault(cause.name, time) >= cause.lasting

    def _listen(self, now: FlightStatus) -> None:
        """Track the longest silence of the link, and the longest delay, forgotten in SILENCE_MEMORY."""
        e = now.estimate
        keep = math.exp((self._time - e.time) / SILENCE_MEMORY)
        self._silence = max(keep * self._silence, e.attitude_age - LOG_PERIOD, 0.0)
        self._late, self._time = max(keep * self._late, now.late), e.time

    @staticmethod
    def _next_command(now: FlightStatus, silence: float) -> tuple[np.ndarray, np.ndarray]:
        """Return position and velocity (3,) at which the next command may arrive.

        A link that was silent for some time may be silent again; meanwhile the vehicle continues with its
        last command and the present acceleration.
        """
        e, t = now.estimate, silence
        position, velocity = e.state[X : Z + 1], e.state[VX : VZ + 1]
        return position + velocity * t + 0.5 * e.acceleration * t**2, velocity + e.acceleration * t

    def _is_beyond_fence(self, now: FlightStatus, silence: float) -> bool:
        """Return whether the remaining distance is less than the braking distance plus the margin."""
        position, velocity = self._next_command(now, silence)
        if not now.airborne:
            velocity[2] = max(0.0, velocity[2])  # on what it stands
        return bool(beyond_fence(position, velocity, self.vehicle))

    def _cannot_stop(self, now: FlightStatus, silence: float) -> bool:
        """Return whether a wall or the ceiling is nearer than the shortest way to stop."""
        position, velocity = self._next_command(now, silence)
        velocity[2] = max(0.0, velocity[2])  # the floor is inside
        return now.airborne and bool(beyond_fence(position, velocity, self.vehicle, 0.0, 1.0))
