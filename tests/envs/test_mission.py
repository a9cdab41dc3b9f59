"""Missions: legs that only go on, each vehicle by itself, the shipped policies from anywhere in the room."""

import dataclasses

import numpy as np
import pytest

from inclined_landing.envs import hover
from inclined_landing.envs.hover import HAND_OVER_SPEED, HAND_OVER_TIME, Trim
from inclined_landing.envs.mission import APPROACH, CLIMB, LANDING, LEGS, MissionPlan, fly_missions
from inclined_landing.envs.policy import load_policy
from inclined_landing.envs.tasks import make_task
from inclined_landing.models.attitude import VX, VZ, YAW, Y
from inclined_landing.models.base.errors import UserError

POLICIES = [load_policy(name) for name in ("setpoint", "landing", "touchdown-nominal")]
PLAN = MissionPlan(*POLICIES)
N = 20


@pytest.fixture(scope="module")
def flown():
    return fly_missions(PLAN, PLAN.sample(np.random.default_rng(11), N))


def test_the_shipped_policies_bring_missions_to_rest(flown):
    """At most one of 20 is lost; of missions that succeed in 97 %, more are in one sample of nine."""
    assert sum(mission.success for mission in flown) >= N - 1
    vehicle = PLAN.vehicle
    for mission in flown:
        if mission.success:
            assert mission.end == "at rest" and mission.legs[-1].touched == ("slab",)
            assert abs(mission.state[-1, Y]) < vehicle.platform_depth / 2
            assert (mission.commands[-10:, 0] == 0.0).all()  # by the policy's own command


def test_legs_only_go_on_and_fill_the_time(flown):
    for mission in flown:
        assert (np.diff(mission.leg) >= 0).all() and mission.leg[0] in (CLIMB, APPROACH)
        assert len(mission.t) == len(mission.state) == len(mission.commands) == len(mission.leg)
        ends = np.cumsum([leg.duration for leg in mission.legs])
        np.testing.assert_allclose([leg.began for leg in mission.legs], [0.0, *ends[:-1]], atol=1e-9)
        assert mission.t[-1] == pytest.approx(ends[-1])
        assert all(leg.done for leg in mission.legs[:-1])
        assert [LEGS.index(leg.name) for leg in mission.legs] == np.unique(mission.leg).tolist()


def test_landings_begin_in_the_box(flown):
    for mission in flown:
        first = np.argmax(mission.leg >= LANDING)
        dwell = mission.state[first - round(HAND_OVER_TIME / 0.02) + 1 : first + 1]
        assert PLAN.in_box(dwell).all() and len(dwell) == 20
        assert np.linalg.norm(mission.find_leg("approach").state[VX : VZ + 1]) < HAND_OVER_SPEED


def test_a_mission_does_not_depend_on_the_others(flown):
    starts = np.array([mission.state[0, :3] for mission in flown])
    some = fly_missions(PLAN, starts[[5, 2]])
    for mission, other in zip(some, (flown[5], flown[2])):
        np.testing.assert_array_equal(mission.state, other.state)
        np.testing.assert_array_equal(mission.commands, other.commands)
        assert mission.end == other.end


def test_roll_holds_the_plane(flown):
    """The set-point policy's roll and the yaw command, in all legs."""
    held = fly_missions(PLAN, np.array([[-1.0, 1.2, 1.8], [-1.0, -1.2, 1.8]]))
    for mission in held:
        assert abs(mission.state[-1, Y]) < 0.05 and np.abs(mission.state[:, YAW]).max() < 0.1


class Leaning:
    """A landing policy in three dimensions that leans and turns, come what may."""

    name = "leaning"

    def __init__(self):
        self.task = make_task("landing", dimensions=3)

    def predict(self, observation):
        names = self.task.action_names
        action = {"thrust": 0.0, "roll": 0.2, "pitch": 0.0, "yaw rate": 0.1}
        return np.tile([action[name] for name in names], (len(observation), 1))


def test_a_landing_in_three_dimensions_commands_its_own_roll():
    leaning = Leaning()
    mission = fly_missions(MissionPlan(POLICIES[0], leaning, POLICIES[2]), PLAN.point)[0]
    assert mission.legs[0].name == "landing" and not mission.success
    own = mission.commands[mission.leg == LANDING]
    for channel in leaning.task.channels:
        action = leaning.predict([0])[0][leaning.task.action_names.index(channel.name)]
        np.testing.assert_allclose(own[:, channel.column], channel.centre + channel.span * action)


def test_trim_holds_what_sinks():
    """A vehicle that hangs 4 cm below where it is told to be gets there; far away nothing is learnt."""
    trim = Trim(2)
    for _ in range(2000):
        hangs = trim.offset[0] - (0.0, 0.0, 0.04)
        trim.integrate(np.array([-hangs, (1.0, 0.0, 0.0)]), 0.02)
    np.testing.assert_allclose(trim.offset, [[0.0, 0.0, 0.04], [0.0, 0.0, 0.0]], atol=1e-6)
    for _ in range(200):
        trim.integrate(np.full((2, 3), 0.15), 0.02, np.array([False, True]))
    np.testing.assert_allclose(trim.offset, [[0.0, 0.0, 0.04], [hover.TRIM_LIMIT] * 3], atol=1e-6)


def test_time_runs_out():
    """A vehicle too heavy for its policies never gets to the hand-over point."""
    heavy = dataclasses.replace(PLAN.vehicle, body_mass=1.6 * PLAN.vehicle.body_mass)
    plan = MissionPlan(*(load_policy(name, vehicle=heavy) for name in ("setpoint", "landing", "touchdown")))
    mission = fly_missions(plan, np.array([[-1.0, 0.0, 1.5]]))[0]
    assert not mission.success and mission.end in ("time limit", "fell to the floor")
    assert mission.legs[-1].name in ("climb", "approach") and not mission.legs[-1].done


@pytest.mark.parametrize(
    "start", [(0.0, 0.0, 1.2), (0.0, 0.0, 0.4), (0.3, 0.1, 0.9), (3.0, 0.0, 1.0), (0.0, 0.0, np.nan)]
)
def test_no_mission_begins_in_the_platform_under_it_or_outside(start):
    with pytest.raises(UserError, match="start {:g},{:g},{:g} lies within 0.25 m of the plat".format(*start)):
        fly_missions(PLAN, np.array([[-1.0, 0.0, 1.8], start]))


def test_policies_must_go_together():
    setpoint, landing, touchdown = POLICIES
    with pytest.raises(UserError, match="the setpoint policy landing is for the task landing"):
        MissionPlan(landing, landing, touchdown)
    with pytest.raises(UserError, match="the touchdown policy landing is for the task landing"):
        MissionPlan(setpoint, landing, landing)
    with pytest.raises(UserError, match=r"landing policy for one of 20\.0 deg, touchdown policy for 25\.7"):
        MissionPlan(setpoint, load_policy("landing-nominal", inclination=np.radians(-20.0)), touchdown)
    heavy = PLAN.vehicle.changed(body_mass=0.04)
    with pytest.raises(
        UserError, match="landing policy landing-nominal is for a different vehicle than the previous"
    ):
        MissionPlan(setpoint, load_policy("landing-nominal", vehicle=heavy), touchdown)
    turned = Leaning()
    turned.task = make_task("landing", dimensions=3, azimuth=1.0)
    with pytest.raises(UserError, match="for different slopes"):
        MissionPlan(setpoint, turned, touchdown)
    for point in ((0.0, 1.4), (5.0, 1.8), (0.0, 2.3)):
        with pytest.raises(UserError, match="hand-over point must lie above the platform"):
            MissionPlan(*POLICIES, hand_over=point)
