"""Every cause that ends a flight: it is asked for, reacts as the page says, and nothing else does."""

import bisect
import math

import numpy as np
import pytest

from inclined_landing.envs import load_policy
from inclined_landing.envs.tasks import hover_states
from inclined_landing.eval.flying import safety
from inclined_landing.eval.flying.estimate import StateEstimate
from inclined_landing.eval.flying.fence import stopping_distance
from inclined_landing.eval.flying.policies import SetpointFollower
from inclined_landing.eval.flying.safety import FlightStatus, Phase, Reaction, SafetyMonitor
from inclined_landing.eval.flying.surroundings import CLEAR, MovingTarget, Surroundings
from inclined_landing.models.attitude import PITCH, VX, VZ, X, Y, Z
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import make_plant
from tests import ROOT

VEHICLE = load_vehicle()


def now(phase=Phase.LANDING, time=10.0, state=None, **changes) -> FlightStatus:
    """A flight in which nothing is wrong, but for the changes."""
    estimate = {"pose_age": 0.01, "attitude_age": 0.01, "attitude_mismatch": 0.02}
    estimate |= {key: changes.pop(key) for key in list(changes) if key in estimate}
    values = np.zeros(13)
    values[[X, Z]] = 1.0, 1.6
    for column, value in (state or {}).items():
        values[column] = value
    fine = {"since": 1.0, "airborne": True, "linked": True, "locked": False, "voltage": 3.6}
    fine |= {"heading_error": 0.0, "velocity_mismatch": 0.1, "resting_time": 0.0, "landing_limit": 6.0}
    return FlightStatus(phase=phase, estimate=StateEstimate(time, values, **estimate), **(fine | changes))


CASES = {
    "link lost": {"linked": False},
    "no attitude": {"attitude_age": 0.3},
    "no position": {"pose_age": 0.21},
    "bad state": {"state": {VX: math.nan}},
    "supervisor": {"locked": True},
    "tilt": {"state": {PITCH: 1.1}},
    "disagreement": {"attitude_mismatch": 0.4},
    "collision or wrong position": {"velocity_mismatch": 2.1, "near": True},
    "wrong position": {"velocity_mismatch": 2.1},
    "outside": {"state": {Y: -1.41}},
    "no room": {"state": {Z: 2.1, VZ: 1.5}},
    "fence": {"state": {Z: 2.1, VZ: 1.0}},
    "poor link": {"attitude_age": 0.11},
    "speed": {"state": {VX: -4.1}},
    "heading": {"heading_error": -0.6},
    "astray": {"phase": Phase.PLAN, "astray": 0.51},
    "battery": {"voltage": 2.95},
    "touched": {"resting_time": 0.5},
    "approach takes too long": {"phase": Phase.APPROACH, "since": 25.1},
    "landing takes too long": {"since": 6.02},
    "retreat takes too long": {"phase": Phase.RETREAT, "since": 20.1},
}


def asked(case: dict, seconds: float = 0.6):
    """The first cause within some seconds of it."""
    monitor = SafetyMonitor(VEHICLE)
    for k in range(int(seconds / 0.02)):
        cause = monitor.cause(now(time=10.0 + 0.02 * k, **case))
        if cause is not None:
            return cause, 0.02 * k
    return None, seconds


@pytest.mark.parametrize("name", CASES)
def test_each_cause_is_met(name):
    cause, after = asked(CASES[name])
    assert cause is not None and cause.name == name
    assert cause.lasting - 1e-6 <= after <= cause.lasting + 0.021


def test_nothing_is_met_by_a_flight_that_is_well():
    for phase in Phase:
        assert asked({"phase": phase}) == (None, 0.6)
    assert asked({"voltage": math.nan}) == (None, 0.6), "before the first status"
    assert asked({"phase": Phase.APPROACH, "state": {Z: 0.03, VZ: -0.1}, "airborne": False}) == (None, 0.6)


@pytest.mark.parametrize("name", CASES)
def test_a_retreat_ends_by_what_switches_off_alone(name):
    case = CASES[name] | {"phase": Phase.RETREAT}
    cause, _ = asked(case)
    assert cause is None or cause.reaction is Reaction.OFF


def test_every_cause_of_the_module_is_in_the_table_and_the_page():
    checked = [name for name, _ in SafetyMonitor(VEHICLE).conditions(now(), 0.0)]
    assert [cause.name for cause in safety.CAUSES][5:] == checked and sorted(checked) == sorted(CASES)
    page = (ROOT / "docs" / "guides" / "fly.md").read_text("utf-8")
    found = [f"| {cause.name} | {cause.when} | {cause.reaction.value} |" for cause in safety.CAUSES]
    rows = [
        line
        for line in page.splitlines()
        if "| motors off |" in line or "| lands next to the platform |" in line
    ]
    assert [row.rpartition("|")[0].rpartition("|")[0] + "|" for row in rows] == found
    for name, when in (safety.LATE, safety.SILENT):
        assert f"**{name}**: {when}" in page


@pytest.mark.parametrize("speed", [0.5, 1.0, 2.0, 3.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_retreat_begins_while_there_is_room(axis, speed):
    """Coming nearer in steps of 5 mm: the fence is first, by its margin of 5 cm and more."""
    end = np.array([VEHICLE.arena_x[1], VEHICLE.arena_y[1], VEHICLE.arena_z[1]])[axis]
    met: dict[str, float] = {}
    for distance in np.arange(2.4, 0.0, -0.005):
        state = {X: 0.0, Y: 0.0, Z: 1.2, X + axis: end - distance, VX + axis: speed}
        for phase in (Phase.LANDING, Phase.RETREAT):
            cause = SafetyMonitor(VEHICLE).cause(now(phase, state=state))
            if cause is not None:
                met.setdefault(cause.name, distance)
    assert set(met) == {"fence", "no room"} and met["fence"] > met["no room"] + 0.044
    falling = {X: 0.0, Z: 0.4, VZ: -3.0}
    assert SafetyMonitor(VEHICLE).cause(now(Phase.RETREAT, state=falling)) is None, "the floor is inside"


def first_off(silences, acceleration=0.0):
    """The height [m], by 2 mm, at which a climb at 1 m/s has no room after these silences [s]."""

    def no_room(z):
        monitor = SafetyMonitor(VEHICLE)
        for k, silence in enumerate(silences):
            flight = now(Phase.RETREAT, 10.0 + 0.02 * k, {X: 0.0, Z: z, VZ: 1.0}, attitude_age=silence)
            flight.estimate.acceleration[2] = acceleration
            cause = monitor.cause(flight)
        return cause is not None and cause.name in ("no room", "poor link")

    heights = np.arange(1.0, 2.4, 0.002)
    return float(heights[bisect.bisect_left(heights, True, key=no_room)])


def test_a_silent_link_takes_the_way_of_its_silence():
    usual = first_off([0.01])
    assert first_off([0.013, 0.003]) == usual, "as every link is"
    silent = safety.LOG_PERIOD + 0.2
    assert usual - first_off([silent]) == pytest.approx(0.2, abs=0.004), "at 1 m/s"
    later = np.exp(-25 * 0.02 / safety.SILENCE_MEMORY)
    assert usual - first_off([silent] + [0.01] * 25) == pytest.approx(0.2 * later, abs=0.004)
    faster = 1.0 + 0.2 * 5.0
    more = stopping_distance(np.array([0, 0, faster]), VEHICLE, 1.0)[2]
    more += 0.2 + 0.5 * 5.0 * 0.2**2 - stopping_distance(np.array([0, 0, 1.0]), VEHICLE, 1.0)[2]
    assert usual - first_off([silent], 5.0) == pytest.approx(more, abs=0.004)


SLOW = {"since": 1.0, "state": {X: 0.0, Z: 1.85, VZ: 1.0}}  # 0.2 s at 1 m/s more, and it is beyond the fence


@pytest.mark.parametrize(
    ("case", "late", "name"),
    [
        (SLOW, 0.0, "poor link"),
        (SLOW, 0.2, "late"),
        ({"state": {Z: 2.1, VZ: 1.0}, "attitude_age": 0.03}, 0.01, "fence"),  # without them, too
        ({"state": {X: 0.0}}, 0.0, "poor link"),
        ({"state": {X: 0.0}}, 0.2, "late"),
        ({"pose_age": 0.25}, 0.2, "late"),
        ({"pose_age": 0.25}, 0.02, "no position"),
    ],
)
def test_a_late_computer_and_a_silent_link_are_called_so(case, late, name):
    """What holds only by the age of what is known is not the vehicle's; the reaction stays."""
    age = {"attitude_age": 0.01 if "pose_age" in case else safety.LOG_PERIOD + 0.2}
    flight = now(late=late, **(age | case))
    cause = SafetyMonitor(VEHICLE).cause(flight)
    assert cause.name == name
    if name == "late":
        assert cause.reaction is SafetyMonitor(VEHICLE).cause(now(**(age | case))).reaction


@pytest.mark.parametrize(("axis", "speed"), [(0, 2.5), (0, -1.5), (1, 1.5), (2, 1.2), (2, -1.2)])
def test_the_set_point_policy_stops_within_the_stated_distance(axis, speed):
    """A retreat from full speed: the target stands where it began; how far does the vehicle go on?"""
    hover, plant = SetpointFollower(load_policy("setpoint")), make_plant("hybrid", 1, VEHICLE)
    state = hover_states([(0.0, 0.0, 1.3)], hover.actor.task.vehicle)
    state[0, VX + axis] = speed
    plant.reset([0], state)
    here, farthest, late = state[0, :3].copy(), 0.0, [np.array([VEHICLE.hover_pwm, 0, 0, 0])] * 2
    for _ in range(100):
        late.append(hover.command_towards(plant.state[0], here, 0.02))
        plant.step(late.pop(0)[None])  # 40 ms late: position, radio, one control step
        farthest = max(farthest, math.copysign(1.0, speed) * (plant.state[0, axis] - here[axis]))
    velocity = np.zeros(3)
    velocity[axis] = speed
    assert 0.0 < farthest < stopping_distance(velocity, VEHICLE)[axis]


@pytest.mark.parametrize("inclination", [-0.449, 0.449, 0.0, -0.87])
def test_ways_keep_clear_of_the_platform(inclination):
    around = Surroundings(VEHICLE, inclination)
    home = np.array([1.0, 0.0, 0.02])
    for x, z in ((0.0, 2.0), (-1.5, 1.6), (1.5, 1.8)):
        assert_clear(around, home, around.path_to(home, np.array([x, 0.0, z])), 0.0)
    for here in ((0.0, 0.0, 2.0), (0.1, 0.05, 1.35), (1.5, 0.0, 0.6), (-0.6, 0.3, 1.5)):
        way = around.path_down(np.array(here))
        assert way[-1][2] < 0.0 and abs(way[-1][0]) > VEHICLE.slab_half_length
        if not math.isclose(inclination, 0.0, abs_tol=0.5):
            continue
        assert_clear(around, np.array(here), way, 0.3)


def assert_clear(around, begin, way, leaving):
    target, gone, states = MovingTarget(begin, list(way), 1.0), 0.0, []
    while not target.arrived:
        before = target.position
        gone += float(np.linalg.norm(target.advance(0.02, before) - before))
        if gone > leaving and target.position[2] > 0.05:
            states.append(np.r_[target.position, np.zeros(10)])
    assert around.distances(np.array(states))[:, 0].min() > CLEAR - 0.02


def test_a_target_waits_for_its_vehicle():
    target = MovingTarget(np.zeros(3), [np.array([0.0, 0.0, 5.0])], 1.0)
    for _ in range(500):
        target.advance(0.02, np.zeros(3))
    assert 0.4 <= target.position[2] <= 0.43 and not target.arrived
