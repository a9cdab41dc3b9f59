"""The whole chain of a flight, every fault in it, and how what happened is judged.

A flight is that of the pilot of `landing-eval fly` on a simulated Crazyflie, whose world knows what truly
happened. A fault begins at a moment drawn over the flight: do the motors stop, and where is the vehicle then?
"""

import copy
import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest

from inclined_landing.envs.policy import Policy
from inclined_landing.envs.tasks.base import hover_states
from inclined_landing.eval.flying import safety
from inclined_landing.eval.flying.fly import FlightOptions
from inclined_landing.eval.flying.pilot import Pilot
from inclined_landing.eval.flying.plan import FlightPlan
from inclined_landing.eval.flying.policies import PolicyLanding
from inclined_landing.eval.flying.report import FlightReport
from inclined_landing.eval.flying.simulated import firmware
from inclined_landing.eval.flying.simulated.faults import DEAD_MAN_DELAY, FAULTS, Fault
from inclined_landing.eval.flying.simulated.firmware import State
from inclined_landing.eval.flying.simulated.world import URI, Setting, Trace, World
from inclined_landing.eval.flying.vehicle import Radio
from inclined_landing.models.attitude import PITCH, PITCH_COMMAND, PWM, VX, VZ, X, Z, rotations
from inclined_landing.models.plants import make_plant

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


# --- faults ---


@dataclasses.dataclass(frozen=True)
class Case:
    """A fault, within what time the motors are off for good, and how far outside it may get."""

    name: str
    limit: float  # s
    outside: float = 0.0  # m beyond walls or ceiling


ALONE = 8.0  # m: a vehicle that hovers at a start, and is left alone with the most thrust and lean
BLIND = safety.POSE_LIMIT + REACTION
CASES = (
    Case("pilot-killed", DEAD_MAN_DELAY + firmware.PERIOD + REACTION),  # another process sends a stop
    # The firmware: level after 0.5 s with the last thrust, off after 1 s without notice.
    Case("link-lost", WATCHDOG, ALONE),
    Case("uplink-lost", WATCHDOG, ALONE),
    Case("downlink-lost", safety.ATTITUDE_LIMIT + REACTION),
    Case("packet-storm", FLIGHT),  # flies on, or the limits for positions and attitudes
    Case("reboot", REACTION),  # motors are off in a vehicle that starts
    Case("mocap-lost", BLIND),
    Case("mocap-frozen", BLIND),  # equal positions count as none
    # Positions do not fit the accelerometer, once the vehicle has moved.
    Case("mocap-stuck", limit=4.0, outside=2.0),
    Case("marker-swap", BLIND),  # the filter believes no jumps
    # Log and motion capture disagree, or it lands.
    Case("attitude-turned", FLIGHT),
    Case("attitude-wrong", FLIGHT),
    Case("low-battery", FLIGHT),  # lands below `safety.LOWEST_VOLTAGE`
    Case("policy-nan", DOWN),  # set down by the set-point policy
    Case("setpoint-nan", REACTION),  # nothing to fly by
    Case("interrupt", REACTION),
)


# --- one flight, and what truly happened ---


@dataclasses.dataclass(frozen=True)
class Truth:
    """Record what the world knows of one flight; times [s] are the world's."""

    goal: float | None  # when it was in the goal box first
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

    report: FlightReport
    truth: Truth
    began: float | None  # s, when the fault did


def fly_once(plan: FlightPlan, setting: Setting, seed: int, case: Case | None = None) -> Flown:
    """Fly, with a fault that begins at a moment drawn from the seed, and let the world go on for a while."""
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
            pytest.fail(f"not ready to fly: {'; '.join(failed)}")
        if name == "interrupt":
            world.schedule(world.time + 2.0 + after, interrupt)
        report = pilot.fly()
        if report.outcome == safety.INTERRUPTED.name and name != "interrupt":
            raise KeyboardInterrupt  # of this program itself, which the pilot turned into a report
    finally:
        radio.close()
    world.wait_until(world.time + AFTER)
    began += [moment for moment, _ in world.begun_faults]
    return Flown(report, truth_of(world.trace, plan), began[0] if began else None)


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
        touched=float(time[np.argmax(on_platform)]) if on_platform.any() else None,
        off=float(time[running[-1]]) if len(running) else 0.0,
        rests=rests,
        upright=bool(up @ (normal if rests == "platform" else np.array([0.0, 0.0, 1.0])) > UPRIGHT),
        outside=float(max(0.0, (low - positions).max(), (positions - high).max())),
        last=tuple(positions[-1].tolist()),
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


@pytest.fixture(scope="module")
def plan():
    return FlightOptions("landing").plans()[2]


def trace(states, touching, running):
    """A trace at 100 Hz from states {column: (m,)}, touched surfaces (m, 3), and motors on or off (m,)."""
    m = len(running)
    state = np.zeros((m, 13))
    for column, values in states.items():
        state[:, column] = values
    command = np.zeros((m, 4))
    command[:, 0] = 40000.0 * np.asarray(running)
    time = 0.01 * np.arange(m)
    return Trace(time, state, np.asarray(touching, bool), command, np.full(m, State.FLYING))


def touched(m, surface=None, since=0):
    result = np.zeros((m, 3), bool)
    if surface is not None:
        result[since:, surface] = True
    return result


# --- how it is judged ---


def test_a_landing_is_seen_as_it_was(plan):
    task, m = plan.final.policy.task, 200
    x, z = task.goal_position
    way = np.linspace(1.0, 0.0, 100)
    states = {
        X: np.r_[x + way, np.full(100, x)],
        Z: np.r_[z + way, np.full(100, z)],
        PITCH: np.full(m, task.inclination),
    }
    there = int(np.argmax(way < task.goal_size))
    truth = truth_of(trace(states, touched(m, 0, 120), np.arange(m) < 110), plan)
    assert truth.goal == pytest.approx(0.01 * there) and truth.touched == pytest.approx(1.2)
    assert truth.off == pytest.approx(1.09) and truth.outside == 0.0
    assert truth.strict and truth.landed and truth.rests == "platform"
    early = truth_of(trace(states, touched(m, 0, there - 1), np.arange(m) < 110), plan)
    assert not early.strict and early.landed
    upside_down = truth_of(trace({**states, PITCH: np.full(m, math.pi)}, touched(m, 0, 50), np.ones(m)), plan)
    assert upside_down.rests == "platform" and not upside_down.landed


def test_moving_flying_and_being_outside_are_seen(plan):
    m, v = 100, plan.final.policy.task.vehicle
    moving = truth_of(trace({VX: np.full(m, 0.1), Z: 0.02}, touched(m, 2), np.zeros(m)), plan)
    assert moving.rests == ""
    hovering = truth_of(trace({Z: 1.0}, touched(m), np.ones(m)), plan)
    assert hovering.rests == ""
    far = truth_of(
        trace({X: np.linspace(0, v.arena_x[1] + 0.7, m), Z: 0.02}, touched(m, 2), np.zeros(m)), plan
    )
    assert far.outside == pytest.approx(0.7) and far.rests == "floor"


def test_a_fault_is_safe_in_time_at_rest_and_inside(plan):
    m = 500
    truth = truth_of(trace({Z: 0.02}, touched(m, 2), np.arange(m) < 300), plan)
    flown = Flown(None, truth, 2.0)
    case = Case("link-lost", 1.0, 0.0)
    assert truth.off == pytest.approx(2.99) and is_safe(case, flown)
    assert not is_safe(dataclasses.replace(case, limit=0.9), flown)
    for worse in ({"rests": ""}, {"outside": 0.1}):
        other = dataclasses.replace(flown, truth=dataclasses.replace(truth, **worse))
        assert not is_safe(case, other)


def test_the_limit_of_a_vehicle_left_alone_is_what_commands_can_do(plan):
    """From hover at each of the starts: 0.5 s of full thrust and lean, then full thrust, then none."""
    v = plan.final.policy.task.vehicle
    starts = [plan.start_point for plan in FlightOptions("landing").plans()]
    plant, farthest = make_plant("mujoco", 2 * len(starts), v, threads=1), 0.0
    plant.set_platform(np.arange(plant.n), 0.0, False)
    plant.reset(np.arange(plant.n), hover_states(np.array(starts * 2), v))
    lean = np.repeat([v.command_angle_limit, -v.command_angle_limit], len(starts))
    for k in range(300):
        time, command = k * v.command_control_period, np.zeros((plant.n, 4))
        command[:, PITCH_COMMAND] = lean * (time < firmware.WATCHDOG_LEVELS + firmware.PERIOD)
        command[:, PWM] = v.command_pwm_range[1] * (time < firmware.EMERGENCY_WATCHDOG + firmware.PERIOD)
        plant.step(command)
        farthest = max(farthest, np.abs(plant.state[:, X]).max() - v.arena_x[1])
    assert plant.contacts.touch[:, 2].any(axis=1).all(), "all are down"
    assert 0.95 * ALONE < farthest < ALONE


# --- flights ---


def test_every_fault_has_its_limits():
    known = set(FAULTS) - {"deck-blind"}  # of Lighthouse
    assert {case.name for case in CASES} == known | {"policy-nan", "setpoint-nan", "interrupt"}


@pytest.mark.slow
def test_a_landing_through_the_whole_chain_is_what_the_pilot_reports(plan):
    flown = fly_once(plan, Setting(), 11)
    assert flown.report.outcome == "goal box" and flown.truth.strict
    assert flown.truth.landed and flown.report.rests and flown.truth.outside == 0.0
    assert flown.report.final == pytest.approx(flown.truth.last, abs=0.005)  # noise of 0.5 mm, at rest
    assert flown.began is None


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=[case.name for case in CASES])
@pytest.mark.parametrize("seed", range(101, 105))
def test_every_fault_ends_in_motors_off_in_time(plan, case, seed):
    flown = fly_once(plan, Setting(), seed, case)
    assert flown.began is None or is_safe(case, flown), flown
