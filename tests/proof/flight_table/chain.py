"""One flight: the pilot of `landing-eval fly` on a simulated Crazyflie, and what truly happened."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from inclined_landing.envs.policy import Policy
from inclined_landing.eval.flying import safety
from inclined_landing.eval.flying.pilot import Pilot
from inclined_landing.eval.flying.plan import FlightPlan
from inclined_landing.eval.flying.report import FlightReport
from inclined_landing.eval.flying.simulated.faults import Fault
from inclined_landing.eval.flying.simulated.flight import SimulatedFlight, fly_simulated
from inclined_landing.eval.flying.simulated.world import Setting, Trace
from inclined_landing.eval.flying.vehicle import Radio
from inclined_landing.models.attitude import PITCH, PWM, VX, VZ, X, Z, rotations
from inclined_landing.models.errors import UserError

AFTER = 6.0  # s that the world goes on after the pilot: what is in the air comes down
REST_SPEED = 0.03  # m/s over the last quarter of a second
UPRIGHT = 0.9  # cosine of the angle between the vehicle's z and the surface's normal
_TRIES = 5  # of the checks before a flight, which a hole in the motion capture fails: one looks again
_PATIENCE = 60.0  # s of real time that the pilot's watchdog gives a control step: the time is simulated


# The landing policy, the set-point policy, the starts x, z [m].
Loaded: TypeAlias = tuple[Policy, Policy, list[tuple[float, float]]]


@dataclasses.dataclass(frozen=True)
class Truth:
    """What the world knows of one flight; times [s] are the world's."""

    flew: bool  # did it leave the floor
    goal: float | None  # when it was in the goal box first
    speed: tuple[float, float] | None  # vx, vz there, m/s
    touched: float | None  # when it touched the platform first
    off: float  # when its motors were on last
    rests: str  # "platform", "floor", "" while it moves
    upright: bool
    outside: float  # m, farthest beyond the walls or the ceiling of the arena; 0: never outside
    last: tuple[float, float, float]  # m

    @property
    def strict(self) -> bool:
        """In the goal box before any touch of the platform."""
        return self.goal is not None and (self.touched is None or self.goal <= self.touched)

    @property
    def landed(self) -> bool:
        """At rest on its feet on the platform."""
        return self.rests == "platform" and self.upright


@dataclasses.dataclass(frozen=True)
class Flown:
    """A flight as the pilot reports it, and as it was."""

    seed: int
    report: FlightReport
    truth: Truth
    faults: tuple[tuple[float, str], ...]  # when, which


def fly_once(
    plan: FlightPlan,
    setting: Setting,
    seed: int,
    *,
    faults: tuple[Fault, ...] = (),
    in_landing: tuple[Fault, ...] = (),
    prepare: Callable[[SimulatedFlight, Pilot], None] = lambda flight, pilot: None,
    interrupted: bool = False,
) -> Flown:
    """Fly, and let the world go on for a while.

    in_landing: faults that begin their `after` [s] after the hand-over to the landing policy. prepare: called
    before the flight, for faults of the pilot itself. interrupted: this flight is meant to be; else an
    interruption, which the pilot turns into a report, goes on to the caller.
    Raises UserError where the pilot's checks refuse to fly.
    """
    flight = fly_simulated(setting, seed=seed, faults=faults)
    world = flight.world

    def say(line: str) -> None:
        if line.startswith("hand-over"):
            for fault in in_landing:
                world.schedule(world.time + fault.after, lambda f=fault: world.begin(f))

    radio = Radio(flight.link, flight.clock, plan.landing.task.vehicle.command_angle_limit)
    try:
        radio.connect(flight.uri)
        pilot = Pilot(radio, flight.clock, flight.motion_capture, plan, say=say, hang_limit=_PATIENCE)
        for _ in range(_TRIES):
            failed = [f"{check.name}: {check.found}" for check in pilot.check() if not check.passed]
            if not failed:
                break
        else:
            raise UserError(f"not ready to fly: {'; '.join(failed)}")
        prepare(flight, pilot)
        report = pilot.fly()
        if report.outcome == safety.INTERRUPTED.name and not interrupted:
            raise KeyboardInterrupt
    finally:
        radio.close()
    world.advance(world.time + AFTER)
    return Flown(seed, report, truth_of(world.trace, plan), tuple(world.begun_faults))


def truth_of(trace: Trace, plan: FlightPlan) -> Truth:
    """What happened, from every engine step."""
    task, v = plan.landing.task, plan.landing.task.vehicle
    state, time = trace.state, trace.time
    size = task.goal_size if task.goal_size is not None else 0.0
    inside = np.flatnonzero(task.in_goal(state, size)) if size else []
    on_platform = trace.touching[:, :2].any(axis=1)
    running = np.flatnonzero(trace.command[:, PWM] > 0.0)
    positions = state[:, X : Z + 1]
    low = np.array([v.arena_x[0], v.arena_y[0], -np.inf])
    high = np.array([v.arena_x[1], v.arena_y[1], v.arena_z[1]])
    late = time > time[-1] - 0.25
    still = np.linalg.norm(state[late, VX : VZ + 1], axis=1).max() < REST_SPEED
    touching = trace.touching[late].any(axis=0)
    rests = ("platform" if touching[:2].any() else "floor" if touching[2] else "") if still else ""
    normal = np.array([np.sin(task.inclination), 0.0, np.cos(task.inclination)])
    up = rotations(np.ascontiguousarray(state[-1:, PITCH - 1 : PITCH + 2]))[0][:, 2]
    first = int(inside[0]) if len(inside) else None
    return Truth(
        flew=bool(len(running)) and not trace.touching[:, 2].all(),
        goal=None if first is None else float(time[first]),
        speed=None if first is None else (float(state[first, VX]), float(state[first, VZ])),
        touched=float(time[np.argmax(on_platform)]) if on_platform.any() else None,
        off=float(time[running[-1]]) if len(running) else 0.0,
        rests=rests,
        upright=bool(up @ (normal if rests == "platform" else np.array([0.0, 0.0, 1.0])) > UPRIGHT),
        outside=float(max(0.0, (low - positions).max(), (positions - high).max())),
        last=tuple(positions[-1].tolist()),
    )


def flight_record(flown: Flown) -> dict:
    """Return one flight in plain values."""
    report = flown.report
    return {
        "seed": flown.seed,
        "outcome": report.outcome,
        "retreat": report.retreat.name if report.retreat else None,
        "error": report.error,
        "landing_time": report.landing_time,
        "faults": [list(fault) for fault in flown.faults],
        "truth": dataclasses.asdict(flown.truth),
    }


def seeds_of(seed: int, starts: int, flights: int) -> np.ndarray:
    """Return seeds (starts, flights)."""
    return np.random.SeedSequence(seed).generate_state(starts * flights).reshape(starts, flights)
