"""`flight-table`: the paper's three starts, or every fault, through the whole chain of a flight.

A flight is that of the pilot of `landing-eval fly` on a simulated Crazyflie, whose world knows what truly
happened. A fault begins at a moment drawn over the flight: do the motors stop, and where is the vehicle then?
"""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Annotated, TypeAlias

import numpy as np
import tyro
from msgspec import Meta

from inclined_landing.envs.policy import Policy
from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.statistics import proportion, spread
from inclined_landing.envs.shared.tables import share_cell, spread_cell
from inclined_landing.envs.tasks.landing import PAPER_RESULTS
from inclined_landing.eval.base.options import Flag, NewFolder, Seed
from inclined_landing.eval.flying import safety
from inclined_landing.eval.flying.fly import FlightOptions
from inclined_landing.eval.flying.interfaces import FlightClock
from inclined_landing.eval.flying.pilot import Pilot
from inclined_landing.eval.flying.plan import FlightPlan
from inclined_landing.eval.flying.report import FlightReport
from inclined_landing.eval.flying.simulated import firmware
from inclined_landing.eval.flying.simulated.body import named_vehicle
from inclined_landing.eval.flying.simulated.faults import DEAD_MAN_DELAY, FAULTS, Fault
from inclined_landing.eval.flying.simulated.flight import SimulatedFlight, fly_simulated
from inclined_landing.eval.flying.simulated.world import Setting, Trace
from inclined_landing.eval.flying.vehicle import Radio
from inclined_landing.models.attitude import PITCH, PWM, VX, VZ, X, Z, rotations
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError

from .shared import progress, table_of

Names = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME [NAME ...]")]
# The landing policy, the set-point policy, the starts x, z [m].
Loaded: TypeAlias = tuple[Policy, Policy, list[tuple[float, float]]]


AFTER = 6.0  # s that the world goes on after the pilot: what is in the air comes down
REST_SPEED = 0.03  # m/s over the last quarter of a second
UPRIGHT = 0.9  # cosine of the angle between the vehicle's z and the surface's normal
_TRIES = 5  # of the checks before a flight, which a hole in the motion capture fails: one looks again
_PATIENCE = 60.0  # s of real time that the pilot's watchdog gives a control step: the time is simulated
APPROACH, LANDING = (1.0, 7.0), (0.0, 1.0)  # s after lift-off, and after the hand-over, that faults begin in
# s on top of every limit: a control period, the radio, the supervisor's period, and the pilot's own steps.
REACTION = 0.15
WATCHDOG = firmware.EMERGENCY_WATCHDOG + firmware.PERIOD + REACTION
DOWN = safety.RETREAT_LIMIT + REACTION
FLIGHT = safety.APPROACH_LIMIT + 6.0 + DOWN  # the longest that a flight goes on


def command(
    policies: Names = ("landing-nominal", "landing"),
    vehicles: Names = ("nominal", "hidden"),
    flights: Annotated[int, Meta(ge=1, le=1000)] = 10,
    faults: Flag = False,
    seed: Seed = 0,
    out: NewFolder = None,
) -> int:
    """Flights of the simulated Crazyflie as they truly went: the paper's starts or every fault (minutes).

    A flight is the whole of `landing-eval fly`: radio, motion capture, Kalman filter, 50 Hz of commands. With
    faults the exit code is 3 where any of them was not met by motors off in the stated time and place.

    Args:
        policies: for the task landing.
        vehicles: nominal, hidden (gaps that no policy was told), or vehicle files.
        flights: from each start; with --faults, of each fault.
        faults: instead of the table, every fault with the first policy on the first vehicle.
        seed: of everything drawn.
        out: new folder for results.json.
    """
    if out is not None:
        runs.check_new_run(out)
    if not policies or not vehicles:
        raise UserError("name at least one policy and one vehicle")
    settings = {name: Setting(named_vehicle(name)) for name in vehicles}
    loaded = {name: FlightOptions(name).load() for name in policies}
    count = flights * (len(CASES) if faults else len(policies) * len(vehicles) * 3)
    with progress() as bar:
        task = bar.add_task("flights", total=count)

        def done() -> None:
            bar.advance(task)

        if faults:
            first = loaded[policies[0]], settings[vehicles[0]]
            records = fly_cases(*first, flights, seed, done)
        else:
            records = fly_table(loaded, settings, flights, seed, done)
    print(table_of([(fault_cells if faults else start_cells)(record) for record in records]))
    if not faults:
        first, scattered = (100 * one["share"] for one in PAPER_RESULTS)
        print(f"The paper's, real: goal box in {first:.1f} %, from scattered starts {scattered:.1f} %.")
    if out is not None:
        with runs.staged_run(out) as folder:
            kind = "faults" if faults else "starts"
            asked = {"kind": kind, "policies": list(policies), "vehicles": list(vehicles), "seed": seed}
            storage.write_json(folder / "results.json", asked | {"flights": flights, "rows": records})
        print(out)
    return 3 if faults and any(row["safe"] < row["met"] for row in records) else 0


def fly_table(
    policies: Mapping[str, Loaded],
    vehicles: Mapping[str, Setting],
    flights: int,
    seed: int,
    done: Callable[[], None],
) -> list[dict]:
    """Return a row for every policy on every vehicle: `flights` from each of the paper's starts.

    done: called after each flight. The seeds are the same for every policy and vehicle, so that they meet the
    same noise.
    """
    rows = []
    for policy, (landing, hover, starts) in policies.items():
        for vehicle, setting in vehicles.items():
            flown = []
            for start, own in zip(starts, seeds_of(seed, len(starts), flights)):
                for number in own:
                    flown.append(fly_once(FlightPlan(landing, hover, start), setting, int(number)))
                    done()
            rows.append({"policy": policy, "vehicle": vehicle} | counted(flown))
    return rows


def counted(flown: list[Flown]) -> dict:
    """Return shares, times and every flight as plain values."""
    landing = [f.report.landing_time for f in flown if f.report.landing_time is not None]
    speeds = [math.hypot(*f.truth.speed) for f in flown if f.truth.speed is not None]
    down = [bool(f.truth.rests) and f.truth.outside == 0.0 for f in flown]
    return {
        "reported": proportion(sum(f.report.landed for f in flown), len(flown)),
        "strict": proportion(sum(f.truth.strict for f in flown), len(flown)),
        "rests": proportion(sum(f.truth.landed for f in flown), len(flown)),
        "safe": proportion(sum(down), len(flown)),
        "landing_time": spread(landing),
        "goal_speed": spread(speeds),
        "flights": [flight_record(one) for one in flown],
    }


def start_cells(row: dict) -> dict:
    """Return a line of the table: shares in percent with Wilson's 95 % interval, medians with quantiles."""
    return {
        "policy": row["policy"],
        "vehicle": row["vehicle"],
        "goal box, seen by the pilot": share_cell(row["reported"]),
        "truly, before a touch": share_cell(row["strict"]),
        "at rest on its feet": share_cell(row["rests"]),
        "down, never outside": share_cell(row["safe"]),
        "landing [s]": spread_cell(row["landing_time"]),
        "speed in the box [m/s]": spread_cell(row["goal_speed"]),
    }


# --- one flight, and what truly happened ---


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


# --- faults ---


@dataclasses.dataclass(frozen=True)
class Case:
    """What goes wrong, within what time the motors are off for good, and how far outside it may get."""

    name: str
    what: str
    limit: float  # s
    outside: float  # m beyond walls or ceiling
    why: str  # the limit is what it is


def _of(name: str, limit: float, outside: float, why: str) -> Case:
    return Case(name, FAULTS[name], limit, outside, why)


_BY_ITSELF = "the firmware: level after 0.5 s with the last thrust, off after 1 s without notice"
_DEAF = f"no attitude for {safety.ATTITUDE_LIMIT:g} s"
_SOON = f"no credible position for {safety.POSE_LIMIT:g} s"
ALONE = 8.0  # m: a vehicle that hovers at a start, and is left alone with the most thrust and lean
STUCK, LATE = 4.0, 2.0  # s and m: a fault that shows only when the vehicle accelerates
WITHIN = 0.0
CASES = (
    _of(
        "pilot-killed",
        DEAD_MAN_DELAY + firmware.PERIOD + REACTION,
        WITHIN,
        "a process outlives it, and sends a stop",
    ),
    _of("link-lost", WATCHDOG, ALONE, _BY_ITSELF),
    _of("uplink-lost", WATCHDOG, ALONE, _BY_ITSELF),
    _of("downlink-lost", safety.ATTITUDE_LIMIT + REACTION, WITHIN, _DEAF),
    _of("packet-storm", FLIGHT, WITHIN, "flies on, or the limits for positions and attitudes"),
    _of("reboot", REACTION, WITHIN, "motors are off in a vehicle that starts"),
    _of("mocap-lost", safety.POSE_LIMIT + REACTION, WITHIN, _SOON),
    _of("mocap-frozen", safety.POSE_LIMIT + REACTION, WITHIN, _SOON + "; equal positions count as none"),
    _of("mocap-stuck", STUCK, LATE, "positions do not fit the accelerometer, once it has moved"),
    _of("marker-swap", safety.POSE_LIMIT + REACTION, WITHIN, _SOON + "; the filter believes no jumps"),
    _of("attitude-turned", FLIGHT, WITHIN, "log and motion capture disagree, or it lands"),
    _of("attitude-wrong", FLIGHT, WITHIN, "log and motion capture disagree, or it lands"),
    _of("low-battery", FLIGHT, WITHIN, f"lands below {safety.LOWEST_VOLTAGE:g} V"),
    Case("policy-nan", "the landing policy returns NaN", DOWN, WITHIN, "set down by the set-point policy"),
    Case("setpoint-nan", "the set-point policy returns NaN", REACTION, WITHIN, "nothing to fly by: off"),
    Case("interrupt", "Ctrl-C", REACTION, WITHIN, "off"),
)


def fly_case(case: Case, plan: FlightPlan, setting: Setting, seed: int) -> Flown:
    """One flight with it, at a drawn moment: in the approach for even seeds, else the landing."""
    random = np.random.default_rng((seed, 1))
    in_landing = (seed % 2 == 1 and case.name != "setpoint-nan") or case.name == "policy-nan"
    after = float(random.uniform(*(LANDING if in_landing else APPROACH)))
    if case.name in FAULTS:
        fault = Fault(case.name, "air", after)
        which = {"in_landing": (fault,)} if in_landing else {"faults": (fault,)}
        return fly_once(plan, setting, seed, **which)
    moments: list[float] = []
    clocks: list[FlightClock] = []

    def happen() -> None:
        moments.append(clocks[0].now())

    def prepare(flight: SimulatedFlight, pilot: Pilot) -> None:
        clocks.append(flight.clock)
        if case.name == "interrupt":
            flight.world.schedule(flight.world.time + 2.0 + after, interrupt)

    def interrupt() -> None:
        """As a signal would, out of whatever the pilot waits in."""
        happen()
        raise KeyboardInterrupt

    calls = 1 + round(after / plan.landing.task.vehicle.command_control_period)
    if case.name == "policy-nan":
        plan = dataclasses.replace(plan, landing=_failing(plan.landing, calls, happen))
    elif case.name == "setpoint-nan":
        plan = dataclasses.replace(plan, setpoint=_failing(plan.setpoint, calls, happen))
    flown = fly_once(plan, setting, seed, prepare=prepare, interrupted=case.name == "interrupt")
    return dataclasses.replace(flown, faults=tuple((moment, case.name) for moment in moments[:1]))


def _failing(policy: Policy, calls: int, failed: Callable[[], None]) -> Policy:
    """The policy, whose actions are NaN after so many."""
    broken, count = copy.copy(policy), 0

    def predict(observation: np.ndarray) -> np.ndarray:
        nonlocal count
        count += 1
        if count <= calls:
            return policy.predict(observation)
        failed()
        return np.full((len(observation), len(policy.task.action_names)), np.nan)

    object.__setattr__(broken, "predict", predict)
    return broken


def fly_cases(
    policy: Loaded, setting: Setting, flights: int, seed: int, done: Callable[[], None]
) -> list[dict]:
    """Every case, so many flights each, from the paper's starts in turn; see `record`."""
    landing, hover, starts = policy
    records = []
    for case, own in zip(CASES, seeds_of(seed, len(CASES), flights)):
        flown = []
        for k, number in enumerate(own):
            plan = FlightPlan(landing, hover, starts[k // 2 % len(starts)])
            flown.append(fly_case(case, plan, setting, int(number) // 2 * 2 + k % 2))
            done()
        records.append(record(case, flown))
    return records


def record(case: Case, flown: list[Flown]) -> dict:
    """How a case went: `safe` of `met`, those in which it came to happen."""
    met = [f for f in flown if f.faults]
    late = [max(0.0, f.truth.off - f.faults[0][0]) for f in met]
    outcomes: dict[str, int] = {}
    for f in met:
        outcomes[f.report.outcome] = outcomes.get(f.report.outcome, 0) + 1
    return {
        "case": case.name,
        "what": case.what,
        "why": case.why,
        "limit": case.limit,
        "outside_limit": case.outside,
        "flights": len(flown),
        "met": len(met),
        "safe": sum(is_safe(case, f) for f in met),
        "off": max(late, default=None),
        "outside": max((f.truth.outside for f in met), default=None),
        "outcomes": outcomes,
        "each": [flight_record(f) for f in flown],
    }


def is_safe(case: Case, flown: Flown) -> bool:
    """Motors off in time, at rest somewhere, and not farther outside than stated."""
    late = flown.truth.off - flown.faults[0][0]
    return bool(late <= case.limit and flown.truth.rests and flown.truth.outside <= case.outside)


def fault_cells(row: dict) -> dict:
    """Return a line of the table."""
    return {
        "fault": row["case"],
        "how it ended": ", ".join(f"{name} {count}" for name, count in sorted(row["outcomes"].items())),
        "safe": f"{row['safe']} of {row['met']}",
        "motors off after [s]": row["off"],
        "at most [s]": row["limit"],
        "outside [m]": row["outside"],
        "at most [m]": row["outside_limit"],
    }
