"""The interfaces of the environment: Gymnasium, its vector environment, and Stable-Baselines3."""

import contextlib
import sys
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env as gymnasium_check
from stable_baselines3.common.env_checker import check_env as sb3_check

from inclined_landing.envs import gym_env, ids
from inclined_landing.envs.batch import BatchEnv
from inclined_landing.envs.gym_env import InclinedLandingEnv, InclinedLandingVectorEnv, TaskEnv, TaskVectorEnv
from inclined_landing.envs.sb3 import BatchVecEnv
from inclined_landing.envs.tasks import TASKS, StepContext, make_task
from inclined_landing.envs.tasks.base import hover_states
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import make_plant

V = load_vehicle()
IDS = {"landing": "inclined_landing.envs:InclinedLanding-v0", "setpoint": "inclined_landing.envs:Setpoint-v0"}
PICTURE = {"render_mode": "rgb_array", "width": 64, "height": 48, "render_backend": "ray"}


@pytest.fixture(params=["landing", "setpoint"])
def task(request):
    return request.param


def hovering(*positions):
    return hover_states(np.array(positions, float), V)


def goal_state():
    """At the centre of the landing's goal box: the next step ends the episode with success."""
    state = hovering((0, 0, 1.25))
    state[0, 7] = V.platform_inclination
    return state


def vec_env(n=3, task="landing", plant="analytic", seed=0, **options) -> BatchVecEnv:
    return BatchVecEnv(BatchEnv(make_task(task, pwm_centre="hover"), make_plant(plant, n), seed), **options)


# --- Gymnasium, one vehicle --------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [getattr(gym_env, f"{task.__name__}Env") for task in TASKS.values()])
def test_both_checkers_pass_with_rendering(kind):
    env = kind(**PICTURE)
    assert env.metadata["render_modes"] == ["rgb_array"]  # the checker tries them all
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*(infinity|alternative render modes)")
        gymnasium_check(env)
        warnings.simplefilter("ignore")
        sb3_check(env)
    env.reset(seed=0)
    frame = env.render()
    assert frame.shape == (48, 64, 3) and frame.dtype == np.uint8 and frame.std() > 5
    env.close()
    env.close()


@pytest.mark.parametrize("name", ids.IDS)
def test_an_environment_is_made_again_from_its_specification_and_in_vectors(name):
    env = gym.make(name)
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    np.testing.assert_array_equal(*(e.reset(seed=3)[0] for e in (env, again)))
    for mode in (None, "sync"):
        with contextlib.closing(gym.make_vec(name, num_envs=2, vectorization_mode=mode)) as vector:
            vector.reset(seed=0)
            assert vector.step(vector.action_space.sample())[1].shape == (2,)


def test_every_task_has_its_environments_and_its_manual():
    for task in TASKS.values():
        spec = gym.spec(f"{task.__name__}-v0")
        for point, kind in ((spec.entry_point, TaskEnv), (spec.vector_entry_point, TaskVectorEnv)):
            face = gym.envs.registration.load_env_creator(point)
            assert issubclass(face, kind) and face.task_name == task.name
            assert face.__doc__.startswith(sys.modules[task.__module__].__doc__)


def test_other_render_modes_are_refused():
    with pytest.raises(UserError, match="render_mode must be 'rgb_array' or None, not 'ansi'"):
        InclinedLandingEnv(render_mode="ansi")
    with pytest.raises(UserError, match="the vector environment does not render"):
        gym.make_vec(IDS["landing"], num_envs=2, render_mode="rgb_array")


@pytest.mark.parametrize("plant", ["mujoco", "analytic"])
def test_seeds_and_given_states(task, plant):
    env = gym.make(IDS[task], plant=plant)
    first, _ = env.reset(seed=3)
    second, _ = env.reset()
    np.testing.assert_array_equal(env.reset(seed=3)[0], first)
    np.testing.assert_array_equal(env.reset()[0], second)
    assert not np.array_equal(first, second)
    state = hovering((1.0, 0, 1.8))[0]
    observation, _ = env.reset(options={"state": state})
    assert observation[0] == 1.0 and observation.dtype == np.float32


def test_options_reach_task_and_plant():
    env = InclinedLandingEnv(
        inclination=-0.2, pwm_centre="hover", plant_options={"integrator": "implicitfast", "keep_out": 0.02}
    )
    assert env.task.inclination == -0.2 and env.task.pwm_centre == V.hover_pwm
    assert env.batch.plant.keep_out == 0.02


WRONG_OPTIONS = [
    (InclinedLandingEnv, {"plant_options": {"wings": 2}}, "the mujoco plant has no option 'wings'"),
    (InclinedLandingVectorEnv, {"n": 3, "name": "x"}, "the task landing has no option 'n'"),
    (InclinedLandingEnv, PICTURE | {"width": 1e9}, "width must be a whole number from 16 to 4096"),
    (InclinedLandingVectorEnv, {"num_envs": 0}, "num_envs must be an integer from 1 to 100000, not 0"),
]


@pytest.mark.parametrize("kind, options, sentence", WRONG_OPTIONS)
def test_wrong_options_are_one_sentence(kind, options, sentence):
    with pytest.raises(UserError, match=sentence):
        kind(**options)


def test_wrong_resets_and_actions_are_one_sentence(task):
    single, vector = gym.make(IDS[task], plant="analytic").unwrapped, make_vec(task=task)
    state = hovering((1, 0, 1.8))[0]
    for env, given, sentence in (
        (single, {"options": {"state": state[:12]}}, r"\(1, 13\), not \(1, 12\)"),
        (single, {"options": {"start": state}}, "unknown option 'start' of reset; choose from state"),
        (single, {"seed": -1}, "a seed must be a non-negative integer, not -1"),
        (vector, {"options": {"state": state}}, r"\(3, 13\), not \(13,\)"),
    ):
        with pytest.raises(UserError, match=sentence):
            env.reset(**given)
    for seed in (2**70, np.int64(3)):
        single.reset(seed=seed)
        vector.reset(seed=seed)
    with pytest.raises(UserError, match=r"the action must have shape \(.,\), not \(1,\)"):
        single.step([0.0])
    with pytest.raises(UserError, match="reward_scale must be a positive number"):
        vec_env(task=task, reward_scale=float("inf"))


# --- Gymnasium, many vehicles ------------------------------------------------------------------------


def make_vec(n=3, task="landing", **options):
    return gym.make_vec(
        IDS[task], num_envs=n, vectorization_mode="vector_entry_point",
        **({"plant": "analytic", "pwm_centre": "hover"} | options),
    )  # fmt: skip


def test_finished_episodes_restart_in_the_same_step():
    env = make_vec()
    env.reset(seed=0, options={"state": np.concatenate([hovering((2, 0, 1.8)), goal_state(), goal_state()])})
    tilt = V.platform_inclination / V.attitude_gain / V.command_angle_limit
    observation, reward, terminated, truncated, info = env.step([[0, 0], [0, tilt], [0, tilt]])
    assert terminated.tolist() == [False, True, True] and not truncated.any()
    assert reward.tolist() == [-1, 0, 0]
    assert info["_final_obs"].tolist() == info["_final_info"].tolist() == [False, True, True]
    assert info["final_obs"][0] is None
    final = info["final_obs"][1]
    # One step at the goal's attitude moves it by g sin(25.7 deg) (0.02 s)^2 / 2 = 0.9 mm.
    np.testing.assert_allclose(final, [0, 1.25, 0, 0, V.platform_inclination], atol=0.1)
    assert np.abs(final[:2] - [0, 1.25]).max() < 1e-3
    assert info["final_info"]["is_success"].tolist() == [False, True, True]
    assert info["final_info"]["episode_length"].tolist() == [0, 1, 1]
    # Returned are the new episodes, at rest somewhere else.
    assert not np.array_equal(observation[1], final) and not observation[1:, 2:].any()
    np.testing.assert_array_equal(
        observation, env.unwrapped.task.observe(StepContext(env.unwrapped.batch.plant.state))
    )
    assert env.unwrapped.batch.length.tolist() == [1, 0, 0]
    assert "final_obs" not in env.step(np.zeros((3, 2)))[-1]


# --- Stable-Baselines3 -------------------------------------------------------------------------------


@pytest.mark.parametrize("plant", ["mujoco", "analytic"])
def test_terminal_observation_and_time_limit(plant):
    """Vehicle 0 runs out of time, 1 reaches the goal in that very step, 2 goes on."""
    env = vec_env(plant=plant)
    env.reset()
    env.env.reset(state=np.concatenate([hovering((2, 0, 1.8)), goal_state(), hovering((-2, 0, 1.8))]))
    env.env.length[:] = [299, 299, 298]
    tilt = V.platform_inclination / V.attitude_gain / V.command_angle_limit
    observation, reward, done, infos = env.step(np.array([[0, 0], [0, tilt], [0, 0]], np.float32))
    assert done.tolist() == [True, True, False] and reward.tolist() == [-1, 0, -1]
    assert infos[0]["TimeLimit.truncated"] is True and infos[0]["is_success"] is False
    assert infos[1]["TimeLimit.truncated"] is False and infos[1]["is_success"] is True
    assert infos[2] == {}
    np.testing.assert_allclose(infos[0]["terminal_observation"][:2], [2, 1.8], atol=1e-3)
    np.testing.assert_allclose(infos[1]["terminal_observation"][:2], [0, 1.25], atol=1e-3)
    assert not observation[:2, 2:].any()  # new episodes begin at rest
    assert not np.shares_memory(observation, infos[0]["terminal_observation"])
    assert [infos[i]["episode"]["l"] for i in (0, 1)] == [300, 300]
    assert env.env.length.tolist() == [0, 0, 299]


def test_episode_statistics_are_unscaled():
    env = vec_env(2, reward_scale=0.1)
    env.reset()
    env.env.reset(state=hovering((2, 0, 1.8), (-2, 0, 1.8)))
    for _ in range(300):
        _, reward, done, infos = env.step(np.zeros((2, 2)))
        assert reward.dtype == np.float32 and np.allclose(reward, -0.1)
    assert done.all() and infos[0]["episode"]["r"] == -300 and infos[0]["episode"]["l"] == 300


def test_vecenv_seeds(task):
    a, b = (vec_env(4, task, seed=k) for k in (1, 2))
    assert not np.array_equal(a.reset(), b.reset())
    for env in (a, b):
        env.seed(11)
    first = a.reset()
    np.testing.assert_array_equal(first, b.reset())
    assert not np.array_equal(a.reset(), first)  # one seed serves one reset


def test_vecenv_attributes():
    """Seed, attributes and methods are of all vehicles together: none is set for one."""
    env = vec_env(3)
    for act in (
        lambda: env.env_method("seed", 1, indices=0),
        lambda: env.set_attr("reward_scale", 7.0, [0]),
        lambda: env.env_method("set_conditions", None, indices=[1, 2]),
    ):
        with pytest.raises(UserError, match="omit indices"):
            act()
    with pytest.raises(UserError, match="call reset directly"):
        env.env_method("reset")
    with pytest.raises(UserError, match=r"start from states with env\.env\.reset"):
        env.set_options({"state": np.zeros(13)})
    env.env_method("seed", 1, indices=range(3))
    assert env.get_attr("num_envs") == [3, 3, 3] and len(env.get_attr("env", [0, 2])) == 2
    assert env.env_is_wrapped(gym.Wrapper) == [False] * 3
    env.set_attr("reward_scale", 0.5)
    assert env.reward_scale == 0.5
    env.close()
