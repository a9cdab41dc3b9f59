"""`Setpoint`: observation, action map, reward and starts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from inclined_landing.envs.tasks import Setpoint, StepContext, setpoint
from inclined_landing.models.attitude import LAG, PITCH, ROLL, VX, VZ
from inclined_landing.models.parameters import load_vehicle

V = load_vehicle()
TASK = Setpoint()


def judge(state, action, task=TASK, length=1):
    state, action = np.asarray(state, float)[None], np.asarray(action, float)[None]
    return task.evaluate(
        StepContext(state, actions=action, start=task.start(state), length=np.array([length]))
    )


def state(position=setpoint.GOAL, velocity=(0, 0, 0), roll=0.0, pitch=0.0):
    result = np.zeros(13)
    result[:3], result[VX : VZ + 1], result[ROLL], result[PITCH] = position, velocity, roll, pitch
    return result


def test_reward_by_hand():
    """e_p = 0.5, e_v = 2, e_att = 0.5, a_att^2 = 0.5; thrust costs nothing."""
    verdict = judge(state((0.3, 0, 1.6), (0, 2, 0), 0.3, -0.4), [1.0, 0.5, -0.5])
    assert verdict.reward[0] == pytest.approx(-0.5 - 0.2 * 2 - 0.1 * 0.5 - 0.1 * 0.5 / 0.5, rel=1e-14)


def test_at_the_goal_effort_is_divided_by_a_millimetre_at_least():
    assert judge(state(), [0.3, 0, 0]).reward[0] == 0
    assert judge(state(), [0, 1, 0]).reward[0] == pytest.approx(-0.1 / 0.001)
    nearly = state((0.002, 0, 1.2))
    assert judge(nearly, [0, 0, 1]).terms["effort"][0] == pytest.approx(-0.1 / 0.002)


number = st.floats(-5, 5)
share = st.floats(-1, 1)


@given(st.tuples(*[number] * 6), st.tuples(number, number), st.tuples(*[share] * 3))
def test_terms_sum_to_the_reward_and_none_is_positive(motion, angles, action):
    verdict = judge(state(motion[:3], motion[3:], *angles), action)
    assert verdict.reward[0] == sum(term[0] for term in verdict.terms.values())
    assert all(term[0] <= 0 for term in verdict.terms.values())
    assert set(verdict.terms) == {"position", "velocity", "attitude", "effort"}
    assert not verdict.terminated.any() and not verdict.truncated.any()


@pytest.mark.parametrize("distance, success", [(0.0, True), (0.0499, True), (0.0501, False)])
def test_success_is_within_five_centimetres(distance, success):
    for axis in np.eye(3):
        assert judge(state(setpoint.GOAL + distance * axis), [0, 0, 0]).success.tolist() == [success]


def test_conditions_ease_the_effort_and_shorten_episodes():
    task = Setpoint()
    assert task.conditions == setpoint.SetpointConditions(setpoint.EFFORT_FLOOR, Setpoint.max_steps)
    task.conditions = setpoint.SetpointConditions(effort_floor=0.5, episode_limit=150)
    assert judge(state(), [0, 1, 0], task).reward[0] == pytest.approx(-0.1 / 0.5)
    cuts = [judge(state(), [0, 0, 0], task, length).truncated[0] for length in (149, 150, 151)]
    assert cuts == [False, True, True]


def test_starts_fill_their_box_at_rest_without_a_platform():
    start = TASK.sample(np.random.default_rng(0), 2000)
    low, high = np.array(setpoint.START_BOX).T
    position = start.state[:, :3]
    assert (position >= low).all() and (position <= high).all()
    assert (np.ptp(position, axis=0) > 0.95 * (high - low)).all()
    for (inner_low, inner_high), (outer_low, outer_high) in zip(
        setpoint.START_BOX, (V.arena_x, V.arena_y, V.arena_z)
    ):
        assert outer_low < inner_low and inner_high < outer_high
    assert not start.state[:, 3:LAG].any() and (start.state[:, LAG] == V.hover_lag).all()
    assert not start.present.any() and np.isnan(start.goal_size).all()


def test_any_goal_is_the_own_one_seen_from_elsewhere():
    rng = np.random.default_rng(3)
    start = TASK.sample(rng, 20).state
    goal = rng.uniform(-1.0, 1.0, (20, 3))
    moved = start.copy()
    moved[:, :3] += goal - setpoint.GOAL
    np.testing.assert_allclose(TASK.shifted(moved, goal), start, atol=1e-15)  # rounding of numbers of 1
    far = state((7.0, 0.0, 1.2))[None]
    assert TASK.shifted(far, np.array(setpoint.GOAL))[0, 0] == setpoint.START_BOX[0][1]


def test_across_shows_what_moves_along_y_and_the_goal_otherwise():
    states = np.random.default_rng(4).uniform(-1.0, 1.0, (5, 13))
    shown = TASK.across(states, 0.25)
    np.testing.assert_allclose(shown[:, 1], states[:, 1] - 0.25, atol=1e-15)
    np.testing.assert_array_equal(shown[:, [4, ROLL, LAG]], states[:, [4, ROLL, LAG]])
    seen = TASK.observe(StepContext(shown))[:, [0, 2, 3, 5, 7]]
    np.testing.assert_array_equal(seen, np.tile(TASK.goal[[0, 2, 3, 5, 7]].astype(np.float32), (5, 1)))
