"""`InclinedLanding`: observation, action map, reward, goal box and starts."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from inclined_landing.envs.tasks import InclinedLanding, StepContext, landing, make_task
from inclined_landing.envs.tasks.base import Start, hover_states
from inclined_landing.envs.tasks.landing import AIDED, LandingConditions
from inclined_landing.models.attitude import LAG, PITCH, VX, VZ, X, Z
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import Contacts, make_plant

V = load_vehicle()
TASK = InclinedLanding()
GOAL = np.zeros(13)
GOAL[Z], GOAL[PITCH] = 1.25, -math.pi / 7  # the paper's s_g


def contacts(near, touch=None, surface=0) -> Contacts:
    """Contacts (n, 3, 3) of any part with one surface where `near` (n,) says so."""
    near = np.asarray(near, bool)
    touch = near if touch is None else np.asarray(touch, bool)
    result = Contacts(np.zeros((len(near), 3, 3), bool), np.zeros((len(near), 3, 3), bool), None)
    result.near[near, surface, 1] = True
    result.touch[touch, surface, 1] = True
    return result


def judge(*states, near=False, touch=None, surface=0, conditions=None, in_contact=0):
    """The task's judgement of some states (13,)."""
    task = InclinedLanding()
    task.conditions = conditions or LandingConditions()
    state = np.array(states)
    n = len(state)
    met = contacts(np.full(n, near), None if touch is None else np.full(n, touch), surface)
    return task.evaluate(
        StepContext(
            state,
            met,
            np.zeros((n, 2)),
            task.start(state),
            length=np.ones(n, int),
            in_contact=np.full(n, in_contact),
        )
    )


def at(x, z, **columns):
    state = GOAL.copy()
    state[X], state[Z] = x, z
    for name, value in columns.items():
        state[{"vx": VX, "vz": VZ, "pitch": PITCH}[name]] = value
    return state


def test_reward_values_are_the_papers():
    away, near_bounds = at(1.0, 1.8), at(3.36, 1.8)
    assert judge(GOAL, away, near_bounds).reward.tolist() == [0, -1, -2]
    assert judge(away, near_bounds, near=True).reward.tolist() == [-7, -7]  # the obstacle goes first
    assert judge(GOAL, near=True).reward.tolist() == [0]  # the goal box before everything
    assert judge(away, near=True, touch=False).reward.tolist() == [-7]  # the keep-out zone as the platform
    for surface, reward in ((0, -7), (1, -7), (2, -1)):  # slab and base are the obstacle, the floor is not
        assert judge(at(1.0, 1.0), near=True, surface=surface).reward.tolist() == [reward]


def test_the_goal_ends_the_episode_with_success_and_nothing_else_does():
    verdict = judge(GOAL, at(1, 1.8), at(3.5, 2.5))
    assert verdict.success.tolist() == verdict.terminated.tolist() == [True, False, False]
    assert not verdict.truncated.any()
    assert not judge(at(1, 1), near=True, in_contact=500).truncated.any()  # the task itself never cuts


@pytest.mark.parametrize("d", [0.10, 0.25])
@pytest.mark.parametrize("column, width", [
    (X, lambda d: d), (Z, lambda d: d),
    (VX, lambda d: min(10 * d, 1.5)), (VZ, lambda d: min(10 * d, 1.5)),
    (PITCH, lambda d: 0.25 * d),
])  # fmt: skip
def test_goal_box_edges(d, column, width):
    """Inside just before each edge on both sides, outside just after."""
    for sign in (1, -1):
        for share, inside in ((1 - 1e-9, True), (1 + 1e-9, False)):
            state = GOAL.copy()
            state[column] += sign * width(d) * share
            found = TASK.in_goal(state[None], d)
            assert found.tolist() == [inside], (column, sign, share)


def test_the_goal_tilts_with_the_platform():
    level = at(0, 1.25, pitch=0.0)
    assert TASK.in_goal(level[None], 0.1, inclination=0.0)[0]
    assert not TASK.in_goal(level[None], 0.1)[0]
    task = InclinedLanding(inclination=0.3)
    assert task.start(GOAL[None]).inclination.tolist() == [0.3]


@pytest.mark.parametrize("x, z, near", [
    (0, 1.2, False), (3.34, 1.2, False), (3.36, 1.2, True), (-3.34, 1.2, False), (-3.36, 1.2, True),
    (0, 2.34, False), (0, 2.36, True), (0, 0.06, False), (0, 0.04, True), (9, 9, True),
])  # fmt: skip
def test_near_the_bounds_is_within_five_centimetres(x, z, near):
    assert TASK.near_bounds(StepContext(at(x, z)[None])).tolist() == [near]


coordinate = st.floats(-4, 4)


@given(
    st.lists(
        st.tuples(coordinate, st.floats(0, 3), coordinate, coordinate, st.floats(-1.5, 1.5)),
        min_size=1,
        max_size=5,
    ),
    st.booleans(),
    st.booleans(),
)
@settings(max_examples=100)
def test_terms_sum_to_the_reward_and_take_the_papers_values(rows, near, touching_counts):
    states = [at(x, z, vx=vx, vz=vz, pitch=p) for x, z, vx, vz, p in rows]
    verdict = judge(*states, near=near, conditions=LandingConditions(goal_while_touching=touching_counts))
    np.testing.assert_array_equal(sum(verdict.terms.values()), verdict.reward)
    assert set(verdict.terms) == {"time", "bounds", "obstacle"}
    assert set(verdict.reward.tolist()) <= {0.0, -1.0, -2.0, -7.0}
    np.testing.assert_array_equal(verdict.success, verdict.reward == 0)


@pytest.mark.parametrize("centre, at_zero", [
    ("paper", V.command_pwm_centre), ("hover", V.hover_pwm), (40_000, 40_000.0), (60_000.0, 60_000.0),
])  # fmt: skip
def test_action_map_centres(centre, at_zero):
    task = make_task("landing", pwm_centre=centre)
    u = task.commands(np.array([[0, 0], [0.2, 1], [-0.2, -1]]))
    np.testing.assert_allclose(u[:, 0], np.minimum(at_zero + np.array([0, 3300, -3300]), 60_000))
    np.testing.assert_allclose(u[:, 2], np.radians([0, 30, -30]))
    assert not u[:, [1, 3]].any()
    assert task.options["pwm_centre"] == centre  # as given, so that the task can be built again


@pytest.mark.parametrize("effects", [
    {"effects_thrust_bias": -0.03}, {"effects_battery_sag": 0.15, "effects_battery_reference": 20_000.0},
    {"effects_voltage_sensitivity": 0.5, "effects_voltage_reference": 4.0}, {"effects_wind": (1.0, 0.0)},
])  # fmt: skip
def test_hover_holds_a_vehicle_whose_thrust_has_effects(effects):
    vehicle = V.changed(**effects)
    task = make_task("landing", vehicle, pwm_centre="hover")
    state = hover_states(np.array([[0.0, 0.0, 2.0]]), vehicle)
    state[:, LAG] = task.pwm_centre / vehicle.thrust_lag_rate
    plant = make_plant("analytic", 1, vehicle)
    plant.reset(np.arange(1), state)
    for _ in range(10):
        plant.step(task.commands(np.zeros((1, 2))))
    # The voltage falls by 0.003 V/s: g 0.5/V 0.003 V/s t^2/2 / 0.76 = 3.9e-4 m/s after 0.2 s.
    assert abs(plant.state[0, VZ]) < 5e-4


def test_action_map_span():
    task = make_task("landing", pwm_span=20_000)
    assert task.commands(np.array([[0.5, 0]]))[0, 0] == V.hover_pwm + 10_000
    assert make_task("landing", **task.options).pwm_span == 20_000
    assert make_task("landing").pwm_span == V.command_pwm_span


# --- starts ------------------------------------------------------------------------------------------


def samples(k=2000, inclination=None, **conditions) -> tuple[InclinedLanding, Start]:
    task = InclinedLanding(inclination=inclination)
    task.conditions = dataclasses.replace(task.conditions, **conditions)
    return task, task.sample(np.random.default_rng(0), k)


@pytest.mark.parametrize("inclination", np.radians([-50, -25.7, 0, 50]))
def test_starts_keep_clear_of_platform_and_bounds(inclination):
    task, start = samples(inclination=float(inclination))
    x, z = start.state[:, X], start.state[:, Z]
    assert task.start_clearance(start).min() >= landing.START_CLEARANCE
    assert x.min() >= -3.3 and x.max() <= 3.3 and z.min() >= landing.LOWEST_START and z.max() <= 2.3
    assert not task.near_bounds(StepContext(start.state)).any()
    # Uniform over the box: 2000 draws come within a few centimetres of each side.
    assert x.min() < -3.2 and x.max() > 3.2 and z.max() > 2.25 and z.min() < 1.25


def test_starts_are_at_rest_level_and_with_settled_thrust():
    _, start = samples(50)
    moving = [k for k in range(13) if k not in (X, Z, LAG)]
    assert not start.state[:, moving].any()
    assert (start.state[:, LAG] == V.hover_lag).all()
    assert start.present.all() and (start.goal_size == 0.10).all()
    assert (start.inclination == V.platform_inclination).all()


def test_start_reach_is_kept_in_both_directions():
    _, start = samples(start_reach=0.5)
    assert np.abs(start.state[:, X]).max() <= 0.5 and start.state[:, Z].max() <= 1.75
    _, start = samples(start_reach=2.0, start_reach_z=0.3, lowest_start=1.0)
    assert np.abs(start.state[:, X]).max() > 1.9
    assert np.abs(start.state[:, Z] - 1.25).max() <= 0.3 and 1.0 <= start.state[:, Z].min() < 1.05


def test_starts_that_cannot_be_found_are_an_error():
    with pytest.raises(UserError, match=r"no start clear of the platform was found within 0\.01 m"):
        task = InclinedLanding(inclination=math.radians(50))  # 6 cm from the goal to the slope
        task.conditions = LandingConditions(start_reach=0.01, start_reach_z=0.01, lowest_start=0.0)
        task.sample(np.random.default_rng(0), 5)


# --- training aids -----------------------------------------------------------------------------------


def test_a_penalty_ends_episodes_out_of_bounds_and_costs_their_return():
    far, fallen = at(3.8, 1.5), at(1.0, 0.03)
    kept = judge(fallen, far, conditions=LandingConditions(leave_limit=0.3))
    assert kept.truncated.tolist() == [False, True] and not kept.terminated.any()
    priced = judge(far, GOAL, at(1, 1.8), conditions=AIDED)
    assert priced.terminated.tolist() == [True, True, False] and not priced.truncated.any()
    assert priced.success.tolist() == [False, True, False]
    assert priced.terms["out_of_bounds"].tolist() == [-AIDED.out_of_bounds_penalty, 0, 0]
    assert judge(fallen, near=True, surface=2, conditions=AIDED).terminated.all()  # on the floor
    # as much as staying there costs at the discount of training
    assert (
        pytest.approx(-judge(far).reward[0] / (1 - InclinedLanding.training.gamma))
        == AIDED.out_of_bounds_penalty
    )


def test_contact_limit_cuts_but_never_a_success():
    aid = LandingConditions(contact_limit=8)
    away = at(1.0, 1.2)
    assert not judge(away, near=True, conditions=aid, in_contact=7).truncated.any()
    verdict = judge(away, GOAL, near=True, conditions=aid, in_contact=8)
    assert verdict.truncated.tolist() == [True, False]
    assert verdict.terminated.tolist() == [False, True]


def test_goal_entries_while_touching_can_be_refused():
    aid = LandingConditions(goal_while_touching=False)
    verdict = judge(GOAL, near=True, conditions=aid)
    assert not verdict.success.any() and verdict.reward.tolist() == [-7]
    assert judge(GOAL, conditions=aid).success.all()
