"""`flight-table`: the paper's three starts, or every fault, through the whole chain of a flight.

A flight is that of the pilot of `landing-eval fly` on a simulated Crazyflie, whose world knows what truly
happened. A fault begins at a moment drawn over the flight: do the motors stop, and where is the vehicle then?
"""

from __future__ import annotations

import copy
import dataclasses
import math
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from itertools import product
from typing import Annotated

import numpy as np
import tyro
from msgspec import Meta

from inclined_landing.envs.policy import Policy
from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.progress import stages
from inclined_landing.envs.shared.statistics import median, proportion
from inclined_landing.envs.tasks.landing import PAPER_RESULTS
from inclined_landing.eval.base.options import Flag, NewFolder, Seed
from inclined_landing.eval.flying import safety
from inclined_landing.eval.flying.fly import FlightOptions
from inclined_landing.eval.flying.pilot import Pilot
from inclined_landing.eval.flying.plan import FlightPlan
from inclined_landing.eval.flying.policies import PolicyLanding
from inclined_landing.eval.flying.report import FlightReport
from inclined_landing.eval.flying.simulated import firmware
from inclined_landing.eval.flying.simulated.body import named_vehicle
from inclined_landing.eval.flying.simulated.faults import DEAD_MAN_DELAY, FAULTS, Fault
from inclined_landing.eval.flying.simulated.world import URI, Setting, Trace, World
from inclined_landing.eval.flying.vehicle import Radio
from inclined_landing.models.attitude import PITCH, PWM, VX, VZ, X, Z, rotations
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError

from .shared import table_of

Names = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME [NAME ...]")]

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
    plans = {name: FlightOptions(name).plans() for name in policies}
    if faults:
        jobs = case_flights(plans[policies[0]], settings[vehicles[0]], flights, seed)
        groups = list(zip([partial(fault_row, case) for case in CASES], jobs))
    else:
        groups = [
            (partial(start_row, p, v), start_flights(plans[p], settings[v], flights, seed))
            for p, v in product(policies, vehicles)
        ]
    rows, every = [], []
    with stages(sum(len(jobs) for _, jobs in groups), "flights") as tick:
        for row_of, jobs in groups:
            flown = []
            for job in jobs:
                flown.append(fly_once(*job))
                tick()
            rows.append(row_of(flown))
            every += flown
    print(table_of(rows))
    if not faults:
        first, scattered = (100 * one["share"] for one in PAPER_RESULTS)
        print(f"The paper's, real: goal box in {first:.1f} %, from scattered starts {scattered:.1f} %.")
    if out is not None:
        asked = {"policies": policies, "vehicles": vehicles, "faults": faults, "seed": seed}
        each = [dataclasses.asdict(one) for one in every]
        with runs.staged_run(out) as folder:
            storage.write_json(folder / "results.json", asked | {"rows": rows, "flights": each})
        print(out)
    return 3 if faults and any(row["safe"]["count"] < row["safe"]["of"] for row in rows) else 0


def start_flights(plans: Sequence[FlightPlan], setting: Setting, flights: int, seed: int) -> list[tuple]:
    """Return the arguments of `fly_once`: so many flights from each start.

    The seeds are the same for every policy and vehicle, so that they meet the same noise.
    """
    seeds = seeds_of(seed, len(plans), flights)
    return [(plan, setting, int(number)) for plan, own in zip(plans, seeds) for number in own]


def case_flights(plans: Sequence[FlightPlan], setting: Setting, flights: int, seed: int) -> list[list[tuple]]:
    """Return the arguments of `fly_once` by case: so many flights, from the starts in turn.

    Seeds are even where the fault begins in the approach, odd where it begins in the landing.
    """
    return [
        [
            (plans[k // 2 % len(plans)], setting, int(number) // 2 * 2 + k % 2, case)
            for k, number in enumerate(own)
        ]
        for case, own in zip(CASES, seeds_of(seed, len(CASES), flights))
    ]


def seeds_of(seed: int, rows: int, flights: int) -> np.ndarray:
    """Return seeds (rows, flights)."""
    return np.random.SeedSequence(seed).generate_state(rows * flights).reshape(rows, flights)


def start_row(policy: str, vehicle: str, flown: Sequence[Flown]) -> dict:
    """Return a line of the table: proportions, times and speeds."""
    truths = [one.truth for one in flown]
    times = [one.report["landing_time"] for one in flown if one.report["landing_time"] is not None]
    return {
        "policy": policy,
        "vehicle": vehicle,
        "goal box, seen by the pilot": proportion(sum(one.report["landed"] for one in flown), len(flown)),
        "truly, before a touch": proportion(sum(t.strict for t in truths), len(flown)),
        "at rest on its feet": proportion(sum(t.landed for t in truths), len(flown)),
        "down, never outside": proportion(sum(bool(t.rests) and not t.outside for t in truths), len(flown)),
        "landing [s]": median(times),
        "speed in the box [m/s]": median([math.hypot(*t.speed) for t in truths if t.speed is not None]),
    }


def fault_row(case: Case, flown: Sequence[Flown]) -> dict:
    """Return a line of the table: how the flights ended in which the fault came to happen."""
    met = [one for one in flown if one.began is not None]
    outcomes = Counter(one.report["outcome"] for one in met)
    return {
        "fault": f"{case.what} ({case.name})",
        "how the flights ended": ", ".join(f"{name} {n}" for name, n in outcomes.most_common()),
        "safe": proportion(sum(is_safe(case, one) for one in met), len(met)),
        "motors off, worst [s]": max((max(0.0, one.truth.off - one.began) for one in met), default=None),
        "at most [s]": case.limit,
        "outside, worst [m]": max((one.truth.outside for one in met), default=None),
        "outside, at most [m]": case.outside,
        "the limit": case.why,
    }


# --- one flight, and what truly happened ---


@dataclasses.dataclass(frozen=True)
class Truth:
    """What the world knows of one flight; times [s] are the world's."""

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
        """Whether it was in the goal box before any touch of the platform."""
        return self.goal is not None and (self.touched is None or self.goal <= self.touched)

    @property
    def landed(self) -> bool:
        """Whether it is at rest on its feet on the platform."""
        return self.rests == "platform" and self.upright


@dataclasses.dataclass(frozen=True)
class Flown:
    """A flight as the pilot reports it, and as it was."""

    seed: int
    report: dict  # see `_plain`
    truth: Truth
    began: float | None  # s, when the fault did


def fly_once(plan: FlightPlan, setting: Setting, seed: int, case: Case | None = None) -> Flown:
    """Fly, with a fault that begins at a moment drawn from the seed, and let the world go on for a while.

    Raises UserError where the pilot's checks refuse to fly.
    """
    name = None if case is None else case.name
    in_landing = (seed % 2 == 1 and name != "setpoint-nan") or name == "policy-nan"
    after = float(np.random.default_rng((seed, 1)).uniform(*(LANDING if in_landing else APPROACH)))
    fault = Fault(name, "air", after) if name in FAULTS else None
    world = World(setting, seed=seed, faults=[fault] if fault and not in_landing else [])
    began = []

    def happen() -> None:
        began.append(world.now())

    def interrupt() -> None:
        """Interrupt the pilot as a signal would, whatever it waits in."""
        happen()
        raise KeyboardInterrupt

    def say(line: str) -> None:
        if line.startswith("hand-over") and fault and in_landing:
            world.schedule(world.time + after, lambda: world.begin(fault))

    calls = 1 + round(after / plan.final.policy.task.vehicle.command_control_period)
    if name == "policy-nan":
        final = PolicyLanding(_failing(plan.final.policy, calls, happen))
        plan = dataclasses.replace(plan, final=final)
    elif name == "setpoint-nan":
        plan = dataclasses.replace(plan, setpoint=_failing(plan.setpoint, calls, happen))
    radio = Radio(world, world, plan.final.policy.task.vehicle.command_angle_limit)
    try:
        radio.connect(URI)
        pilot = Pilot(radio, world, world.view, plan, say=say, hang_limit=_PATIENCE)
        for _ in range(_TRIES):
            failed = [f"{check.name}: {check.found}" for check in pilot.check() if not check.passed]
            if not failed:
                break
        else:
            raise UserError(f"not ready to fly: {'; '.join(failed)}")
        if name == "interrupt":
            world.schedule(world.time + 2.0 + after, interrupt)
        report = pilot.fly()
        if report.outcome == safety.INTERRUPTED.name and name != "interrupt":
            raise KeyboardInterrupt  # of this program itself, which the pilot turned into a report
    finally:
        radio.close()
    world.wait_until(world.time + AFTER)
    began += [moment for moment, _ in world.begun_faults]
    return Flown(seed, _plain(report), truth_of(world.trace, plan), began[0] if began else None)


def _plain(report: FlightReport) -> dict:
    """Return of the pilot's report what the tables count."""
    names = ("outcome", "error", "landed", "landing_time", "rests")
    retreat = report.retreat.name if report.retreat else None
    final = None if report.final is None else report.final.tolist()
    return {name: getattr(report, name) for name in names} | {"retreat": retreat, "final": final}


def truth_of(trace: Trace, plan: FlightPlan) -> Truth:
    """Return what happened, from every engine step."""
    task, v = plan.final.policy.task, plan.final.policy.task.vehicle
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
        goal=None if first is None else float(time[first]),
        speed=None if first is None else (float(state[first, VX]), float(state[first, VZ])),
        touched=float(time[np.argmax(on_platform)]) if on_platform.any() else None,
        off=float(time[running[-1]]) if len(running) else 0.0,
        rests=rests,
        upright=bool(up @ (normal if rests == "platform" else np.array([0.0, 0.0, 1.0])) > UPRIGHT),
        outside=float(max(0.0, (low - positions).max(), (positions - high).max())),
        last=tuple(positions[-1].tolist()),
    )


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
KILLED = DEAD_MAN_DELAY + firmware.PERIOD + REACTION
CASES = (
    _of("pilot-killed", KILLED, WITHIN, "a process outlives it, and sends a stop"),
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


def _failing(policy: Policy, calls: int, failed: Callable[[], None]) -> Policy:
    """Return the policy with actions that are NaN after so many calls."""
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


def is_safe(case: Case, flown: Flown) -> bool:
    """Return whether the motors went off in time, and it rests, not farther outside than stated."""
    late = flown.truth.off - flown.began
    return bool(late <= case.limit and flown.truth.rests and flown.truth.outside <= case.outside)
