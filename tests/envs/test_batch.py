"""`BatchEnv`: what it refuses, what is reproducible, and how episodes are counted."""

import numpy as np
import pytest

from inclined_landing.envs.batch import BatchEnv
from inclined_landing.envs.tasks import make_task
from inclined_landing.envs.tasks.base import hover_states
from inclined_landing.envs.tasks.landing import LandingConditions
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import make_plant

V = load_vehicle()


def build(n=4, task="landing", plant="analytic", seed=0, **options) -> BatchEnv:
    env = BatchEnv(make_task(task, pwm_centre="hover"), make_plant(plant, n, **options), seed)
    return env


def hovering(*positions):
    return hover_states(np.array(positions, float), V)


@pytest.fixture(
    params=[(task, plant) for task in ("landing", "setpoint") for plant in ("mujoco", "analytic")]
)
def kind(request):
    return dict(zip(("task", "plant"), request.param))


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
def test_actions_that_are_no_numbers_are_refused_before_anything_moves(kind, wrong):
    env = build(2, **kind)
    env.reset()
    before = env.plant.state.copy()
    actions = np.zeros((2, len(env.task.action_names)))
    actions[1, 0] = wrong
    with pytest.raises(UserError, match="an action is NaN or infinite"):
        env.step(actions)
    np.testing.assert_array_equal(env.plant.state, before)
    assert not env.length.any()


def test_actions_are_clipped():
    env = build(2, "setpoint")
    env.reset()
    env.step(np.array([[5.0, -7.0, 0.0], [1.0, -1.0, 0.0]]))
    np.testing.assert_array_equal(env.commands[0], env.commands[1])


def trajectory(env, steps=60, seed=1):
    """Observations, rewards and ends of an episode with random actions and automatic resets."""
    rng = np.random.default_rng(seed)
    rows = [env.reset()]
    for _ in range(steps):
        step = env.step(rng.uniform(-1, 1, (env.n, len(env.task.action_names))))
        rows += [step.observation, step.reward, step.terminated, step.truncated]
        done = np.flatnonzero(step.terminated | step.truncated)
        if len(done):
            rows.append(env.reset(done))
    return rows


def test_same_seed_same_trajectory(kind):
    """Given at first or later, through the automatic resets; another seed begins elsewhere."""
    env = build(**kind, seed=0)
    first = trajectory(build(**kind, seed=5))
    assert not np.array_equal(first[0], trajectory(env)[0])
    env.seed(5)
    for again in (trajectory(build(**kind, seed=5)), trajectory(env)):
        for x, y in zip(first, again, strict=True):
            np.testing.assert_array_equal(x, y)


def test_n_vehicles_equal_n_single_ones(kind):
    """From the same starts under the same actions, bit for bit, contacts and records included."""
    n, steps = 5, 80
    task = make_task(kind["task"])
    starts = task.sample(np.random.default_rng(3), n).state
    starts[0, :3], starts[1, :3] = (0, 0, 1.3), (0.1, 0, 1.4)  # these two fall onto the slab
    actions = np.random.default_rng(4).uniform(-1, 0.2, (steps, n, len(task.action_names)))

    def fly(ids):
        env = build(len(ids), **kind)
        rows = [env.reset(state=starts[ids])]
        for row in actions[:, ids]:
            step = env.step(row)
            rows += [step.observation, step.reward, step.terminated, step.truncated, step.success]
        return [*rows, env.touched, env.contact_steps, env.length, env.total]

    together = fly(np.arange(n))
    for i in range(n):
        for x, y in zip(together, fly(np.array([i])), strict=True):
            np.testing.assert_array_equal(x[i : i + 1], y)
    if kind["task"] == "landing":
        assert together[-4].any() and not together[-4].all()


def test_episodes_are_truncated_after_300_steps(kind):
    env = build(2, **kind)
    env.reset(state=hovering((2, 0, 1.8), (-2, 0, 1.8)))
    hover = np.zeros((2, len(env.task.action_names)))
    for k in range(1, 301):
        step = env.step(hover)
        assert step.truncated.tolist() == [k == 300] * 2 and not step.terminated.any()
        if k == 150:
            env.reset([1], hovering((-2, 0, 1.8)))  # the other's episode starts anew
            env.length[1] = k  # and is put level again for the loop's sake
    assert env.length.tolist() == [300, 300]


@pytest.mark.parametrize("plant", ["mujoco", "analytic"])
def test_records_of_an_episode(plant):
    env = build(2, plant=plant)
    env.reset(state=hovering((0, 0, 1.4), (2, 0, 1.8)))
    rewards = np.zeros(2)
    for _ in range(40):
        step = env.step(np.array([[-1.0, 0], [0, 0]]))
        rewards += step.reward
        np.testing.assert_array_equal(sum(step.terms.values()), step.reward)
    assert env.touched.tolist() == [True, False]
    assert env.contact_steps[0] > 3 and env.contact_steps[1] == 0
    np.testing.assert_array_equal(env.total, rewards)
    env.reset([0], hovering((0, 0, 1.9)))
    assert not env.touched[0] and env.contact_steps[0] == env.total[0] == env.length[0] == 0
    assert env.length[1] == 40


def test_conditions_of_running_episodes_do_not_change():
    """A curriculum that moves on in the middle leaves platform and goal of begun episodes alone."""
    env = build(2)
    env.task.conditions = LandingConditions(platform=False, goal_size=0.25, tilt=0.0)
    env.reset(state=hovering((0, 0, 1.25), (0, 0, 1.25)))
    env.task.conditions = LandingConditions()
    env.reset([1], hovering((0, 0, 1.3)))
    assert env.plant.present.tolist() == [False, True]
    assert env.plant.inclination.tolist() == [0.0, V.platform_inclination]
    step = env.step(np.zeros((2, 2)))
    assert step.success.tolist() == [True, False]


def test_an_episode_taken_over_begins_where_the_vehicle_is():
    env = build(2, "touchdown", "mujoco")
    env.reset()
    for _ in range(3):
        env.step(np.zeros((2, 2)))
    before = env.plant.save()
    observation = env.begin_in_place([1])
    for name, array in env.plant.save().items():
        np.testing.assert_array_equal(array, before[name])
    np.testing.assert_array_equal(observation, env.observe([1]))
    assert env.length.tolist() == [3, 0] and env.touched.tolist() == [False, False]


@pytest.mark.parametrize("ids", [2, [4], [-5], [0.5], [True, False], "0", [[0, 1]]])
def test_unknown_vehicle_numbers_are_refused(ids):
    env = build(4)
    for call in (env.reset, env.observe, env.begin_in_place):
        with pytest.raises(
            UserError, match=r"ids must be vehicle numbers from 0 to 3, or a boolean mask of shape \(4,\)"
        ):
            call(ids)


def test_what_episodes_have_so_far_is_restored():
    """In another batch, also what only some tasks count."""
    env, other = build(3), build(3, seed=9)
    counted = ("length", "total", "contact_steps", "touched", "held_steps")
    for name in counted:
        getattr(env, name)[:] = 1
    other.restore_episodes(env.episode_state())
    assert all((getattr(other, name) == 1).all() for name in counted)
