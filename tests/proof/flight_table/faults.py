"""What can go wrong, one at a time, at moments drawn over the flight: do the motors stop, and where is it?"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable

import numpy as np

from inclined_landing.envs.policy import Policy
from inclined_landing.eval.flying import safety
from inclined_landing.eval.flying.interfaces import FlightClock
from inclined_landing.eval.flying.pilot import Pilot
from inclined_landing.eval.flying.plan import FlightPlan
from inclined_landing.eval.flying.simulated import firmware
from inclined_landing.eval.flying.simulated.faults import DEAD_MAN_DELAY, FAULTS, Fault
from inclined_landing.eval.flying.simulated.flight import SimulatedFlight
from inclined_landing.eval.flying.simulated.world import Setting
from tests.proof.flight_table.chain import Flown, Loaded, flight_record, fly_once, seeds_of

APPROACH, LANDING = (1.0, 7.0), (0.0, 1.0)  # s after lift-off, and after the hand-over, that faults begin in
# s on top of every limit: a control period, the radio, the supervisor's period, and the pilot's own steps.
REACTION = 0.15
WATCHDOG = firmware.EMERGENCY_WATCHDOG + firmware.PERIOD + REACTION
DOWN = safety.RETREAT_LIMIT + REACTION
FLIGHT = safety.APPROACH_LIMIT + 6.0 + DOWN  # the longest that a flight goes on


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


def shown(row: dict) -> dict:
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
