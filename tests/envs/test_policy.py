"""Policy files: what is read is what SB3 would do, and what is wrong is said in one sentence."""

import dataclasses
import json
import zipfile

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    SubprocVecEnv,
    VecFrameStack,
    VecMonitor,
    VecNormalize,
)

from inclined_landing.envs import BatchVecEnv, load_policy, make_batch, policy, save_policy, weights
from inclined_landing.envs.features import ScaledObservation
from inclined_landing.envs.make import make_for
from inclined_landing.envs.tasks import make_task
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import load_vehicle

NAME = "inclined_landing.envs:InclinedLanding-v0"  # imported in other processes too
METADATA = {"task": "landing", "task_options": {"pwm_centre": "hover"}, "seed": 3}


class Spaces(gym.Env):
    """An environment of given shapes, for building networks only."""

    def __init__(self, observations: int, actions: int):
        self.observation_space = gym.spaces.Box(-np.inf, np.inf, (observations,), np.float32)
        self.action_space = gym.spaces.Box(-1.0, 1.0, (actions,), np.float32)


def model(observations=5, actions=2, **policy_kwargs) -> PPO:
    env = Spaces(observations, actions)
    return PPO("MlpPolicy", env, seed=0, device="cpu", policy_kwargs=policy_kwargs)


def saved(path, network: PPO, metadata=METADATA):
    network.save(path)
    if metadata is not None:
        policy.write_metadata(path, metadata)
    return path


SCALED = {
    "features_extractor_class": ScaledObservation,
    "features_extractor_kwargs": {"centre": [0, 1.25, 0, 0, 0], "scale": [1, 1, 2, 2, 0.5]},
}


@pytest.mark.parametrize(
    "options",
    [
        {},
        SCALED,
        {"net_arch": [32], "activation_fn": torch.nn.ReLU},
        {"net_arch": {"pi": [], "vf": [8]}},
    ],
    ids=["default", "scaled", "relu", "linear"],
)
def test_predict_is_sb3s(tmp_path, options):
    network = model(**options)
    with torch.no_grad():  # actions beyond the bounds too
        network.policy.action_net.weight.mul_(300.0)
    loaded = policy.load_policy(saved(tmp_path / "p.zip", network))
    rows = np.random.default_rng(1).normal(scale=4.0, size=(500, 5)).astype(np.float32)
    wanted, _ = network.predict(rows, deterministic=True)
    assert np.abs(wanted).max() == 1.0
    # SB3 sums in float32: 64 terms of size 1 at 6e-8 each, before a gain of about 3
    np.testing.assert_allclose(loaded.predict(rows), wanted, atol=3e-5)


@pytest.mark.parametrize("kind", [SAC, TD3])
@pytest.mark.parametrize(
    "options", [{}, SCALED, {"activation_fn": torch.nn.Tanh}], ids=["plain", "scaled", "tanh"]
)
def test_predict_is_that_of_sac_and_td3(tmp_path, kind, options):
    network = kind("MlpPolicy", Spaces(5, 2), seed=0, device="cpu", buffer_size=1,
                   policy_kwargs={"net_arch": [32, 16], **options})  # fmt: skip
    assert_same_actions(network, saved(tmp_path / "p.zip", network))


def test_predict_is_that_of_sac_with_state_dependent_exploration(tmp_path):
    network = SAC("MlpPolicy", Spaces(5, 2), seed=0, device="cpu", buffer_size=1, use_sde=True)
    with torch.no_grad():  # means beyond the hard limit of 2
        network.actor.mu[0].weight.mul_(100.0)
    actions = assert_same_actions(network, saved(tmp_path / "p.zip", network))
    assert abs(actions).max() == pytest.approx(np.tanh(2.0))


def assert_same_actions(network, path):
    """float32 sums: 256 terms at 6e-8, before a gain below 10."""
    rows = np.random.default_rng(1).normal(scale=3.0, size=(300, 5)).astype(np.float32)
    wanted, _ = network.predict(rows, deterministic=True)
    np.testing.assert_allclose(policy.load_policy(path).predict(rows), wanted, atol=1e-4)
    return wanted


def test_an_action_does_not_depend_on_its_neighbours(tmp_path):
    loaded = policy.load_policy(saved(tmp_path / "p.zip", model(**SCALED)))
    rows = np.random.default_rng(1).normal(size=(37, 5))
    together = loaded.predict(rows)
    assert together.dtype == np.float32
    np.testing.assert_array_equal(together, [loaded.predict(row) for row in rows])


def test_hand_made_network(tmp_path):
    network = model(**SCALED)
    with torch.no_grad():
        for parameter in network.policy.parameters():
            parameter.zero_()
        network.policy.action_net.bias.copy_(torch.tensor([0.25, 3.0]))
    loaded = policy.load_policy(saved(tmp_path / "p.zip", network))
    np.testing.assert_array_equal(loaded.predict(np.ones((2, 5))), [[0.25, 1.0]] * 2)


def test_the_metadata_builds_the_task(tmp_path):
    path = saved(tmp_path / "p.zip", model())
    loaded = policy.load_policy(path)
    assert loaded.metadata == METADATA and loaded.name == "p"
    assert loaded.task.name == "landing"
    assert loaded.task.pwm_centre == load_vehicle().hover_pwm
    tilted = policy.load_policy(path, inclination=-0.2)
    assert tilted.task.inclination == -0.2


def test_another_vehicle_keeps_the_action_map_of_training(tmp_path):
    path = saved(tmp_path / "p.zip", model())
    heavy = dataclasses.replace(load_vehicle(), body_mass=0.04)
    loaded = policy.load_policy(path, vehicle=heavy)
    assert loaded.task.vehicle is heavy
    assert loaded.task.pwm_centre == load_vehicle().hover_pwm


def test_a_stamped_file_is_still_sb3s_and_can_be_stamped_again(tmp_path):
    path = saved(tmp_path / "p.zip", model())
    policy.write_metadata(path, METADATA | {"seed": 4})
    with zipfile.ZipFile(path) as archive:
        assert archive.namelist().count(policy.METADATA) == 1
        assert json.loads(archive.read(policy.METADATA))["seed"] == 4
    assert PPO.load(path, device="cpu").observation_space.shape == (5,)
    assert [p.name for p in tmp_path.iterdir()] == ["p.zip"]


def test_metadata_must_name_its_task(tmp_path):
    model().save(tmp_path / "p.zip")
    with pytest.raises(UserError, match="lacks task_options"):
        policy.write_metadata(tmp_path / "p.zip", {"task": "landing"})


def test_a_plain_sb3_file_needs_the_task(tmp_path):
    path = saved(tmp_path / "p.zip", model(), metadata=None)
    with pytest.raises(UserError, match="does not say which task"):
        policy.load_policy(path)
    assert policy.load_policy(path, "landing").metadata == {}
    task = make_task("landing", pwm_centre="hover")
    assert policy.load_policy(path, task).task is task


def test_a_policy_fits_the_default_environment_and_refuses_another_action_map_or_slope():
    env = gym.make("inclined_landing.envs:InclinedLanding-v0", plant="analytic")
    assert policy.load_policy("landing-nominal", env.unwrapped.task).task is env.unwrapped.task
    for options, said in (
        ({"pwm_centre": "paper"}, r"with pwm_centre=34098\.\d+, and .* has pwm_centre=42000; .*make_for"),
        (
            {"pwm_span": 20_000, "history": 2},
            r"with history=0, pwm_span=16500, and .* history=2, pwm_span=20000",
        ),
    ):
        with pytest.raises(UserError, match=said):
            policy.load_policy("landing-nominal", make_task("landing", **options))
    sloped = make_task("landing", inclination=-0.2)
    with pytest.raises(
        UserError, match=r"inclination=-0\.44\d+, and .* inclination=-0\.2; .*say inclination too"
    ):
        policy.load_policy("landing-nominal", sloped)
    assert policy.load_policy("landing-nominal", sloped, inclination=-0.2).task is sloped
    heavy = dataclasses.replace(load_vehicle(), body_mass=0.04, command_pwm_span=9_000.0)
    loaded = policy.load_policy("landing-nominal", vehicle=heavy).task
    same = make_task("landing", heavy, **loaded.options)
    assert policy.load_policy("landing-nominal", same).task.pwm_span == 16_500
    with pytest.raises(UserError, match="pwm_span=16500"):
        policy.load_policy("landing-nominal", make_task("landing", heavy))


def not_a_zip(path):
    path.write_text("nothing")


def another_zip(path):
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("data", "{}")


def setpoint_shape(path):
    saved(path, model(8, 3))


def setpoint_policy(path):
    saved(path, model(8, 3), {"task": "setpoint", "task_options": {}})


def nan_weights(path):
    network = model()
    with torch.no_grad():
        network.policy.action_net.bias[0] = float("nan")
    saved(path, network)


def cut_short(path):
    saved(path, model())
    path.write_bytes(path.read_bytes()[:-2000])


def damaged(path):
    saved(path, model())
    with zipfile.ZipFile(path) as source:
        entries = {name: source.read(name) for name in source.namelist()}
    entries["policy.pth"] = entries["policy.pth"][:500]
    with zipfile.ZipFile(path, "w") as target:
        for name, content in entries.items():
            target.writestr(name, content)


def discrete_actions(path):
    env = Spaces(5, 2)
    env.action_space = gym.spaces.Discrete(4)
    PPO("MlpPolicy", env, device="cpu").save(path)


def other_activation(path):
    saved(path, model(activation_fn=torch.nn.SiLU))


def damaged_metadata(path):
    saved(path, model(), metadata=None)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(policy.METADATA, "{")


def unknown_option(path):
    saved(path, model(), {"task": "landing", "task_options": {"colour": 3}})


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda path: None, "does not exist"),
        (lambda path: path.mkdir(), "is a folder"),
        (not_a_zip, "is not a zip file"),
        (another_zip, "lacks policy.pth"),
        (setpoint_shape, "takes 8 observations and gives 3 actions, but the task landing has 5 and 2"),
        (setpoint_policy, "was trained for the task setpoint, not for landing"),
        (nan_weights, "NaN or infinite"),
        (cut_short, "is not a "),
        (damaged, "policy.pth in it is not a zip file"),
        (discrete_actions, "not a PPO, SAC or TD3 policy"),
        (other_activation, "SiLU"),
        (damaged_metadata, "inclined_landing.json in it is not JSON"),
        (unknown_option, "colour"),
    ],
)
def test_wrong_files_are_one_sentence(tmp_path, make, sentence):
    path = tmp_path / "p.zip"
    make(path)
    with pytest.raises(UserError, match=sentence) as error:
        policy.load_policy(path, "landing")
    assert "\n" not in str(error.value)


def test_wrong_observations_and_tasks(tmp_path):
    path = saved(tmp_path / "p.zip", model())
    with pytest.raises(UserError, match="of 5 numbers"):
        policy.load_policy(path).predict(np.zeros((3, 4)))
    with pytest.raises(UserError, match="unknown task 'hover'"):
        policy.load_policy(path, "hover")
    with pytest.raises(UserError, match="outside the supported range"):
        policy.load_policy(path, inclination=1.4)
    other = saved(tmp_path / "s.zip", model(8, 3), {"task": "setpoint", "task_options": {}})
    with pytest.raises(UserError, match="no inclined platform"):
        policy.load_policy(other, inclination=-0.2)


def test_make_for_gives_a_policy_the_environment_it_was_trained_for():
    """Of one vehicle or many, and with another slope or plant where that is asked for."""
    env, one = make_for("landing", plant="analytic")
    assert one.task is env.unwrapped.task and one.task.history == 3 and one.task.pwm_span == 25_000
    seen, _ = env.reset(seed=1)
    assert env.step(one.predict(seen))[0].shape == seen.shape == (26,)
    envs, many = make_for("landing-3d", 3, plant="analytic")
    seen, _ = envs.reset(seed=1)
    assert many.task is envs.unwrapped.task and many.predict(seen).shape == (3, 3)
    assert make_for("landing", inclination=-0.2, plant="analytic")[1].task.inclination == -0.2
    with pytest.raises(UserError, match="has no option 'slope'"):
        make_for("landing", slope=-0.2)
    with pytest.raises(UserError, match=r"policy nothing\.zip does not exist"):
        make_for("nothing.zip")


class Doubled(BaseFeaturesExtractor):
    """An extractor without parameters."""

    def __init__(self, space):
        super().__init__(space, space.shape[0])

    def forward(self, observations):
        return 2.0 * observations


class OwnPolicy(ActorCriticPolicy):
    """A policy of one's own, which could compute anything."""


class Told(gym.ObservationWrapper):
    """A wrapper of one's own."""

    def observation(self, observation):
        return -observation


def vehicles(count=4):
    return BatchVecEnv(make_batch("landing", count, plant="analytic", seed=0))


def learner(env) -> PPO:
    return PPO("MlpPolicy", env, n_steps=16, batch_size=16, n_epochs=1, seed=0, device="cpu")


@pytest.mark.parametrize("options", [{}, {"clip_obs": 0.7, "epsilon": 0.1}, {"norm_obs": False}])
def test_a_policy_behind_vecnormalize_takes_its_statistics_along(tmp_path, options):
    env = VecNormalize(VecMonitor(vehicles()), **options)
    network = learner(env).learn(64)
    env.training = False  # or the next reset moves the statistics
    save_policy(network, tmp_path / "mine")
    raw = env.unnormalize_obs(env.reset()) if options.get("norm_obs", True) else env.reset()
    raw = np.random.default_rng(0).normal(raw, 1.0).astype(np.float32)
    expected = network.predict(env.normalize_obs(raw), deterministic=True)[0]
    loaded = load_policy(tmp_path / "mine.zip")
    assert np.abs(loaded.predict(raw) - expected).max() < 1e-5  # float32 of the network
    network.save(tmp_path / "plain.zip")
    with pytest.raises(UserError, match=r"trained behind VecNormalize .* save_policy\(model, path\)"):
        load_policy(tmp_path / "plain.zip", "landing")


@pytest.mark.parametrize("kind", [DummyVecEnv, SubprocVecEnv])
def test_models_of_single_environments_are_saved(tmp_path, kind):
    env = kind([lambda: Monitor(gym.make(NAME, inclination=-0.3)) for _ in range(2)])
    save_policy(learner(env), tmp_path / "mine.zip")
    env.close()
    assert load_policy(tmp_path / "mine.zip").task.options["inclination"] == pytest.approx(-0.3)


@pytest.mark.parametrize(
    "make, name",
    [
        (lambda: VecFrameStack(vehicles(), 2), "VecFrameStack"),
        (lambda: VecNormalize(VecNormalize(vehicles())), "VecNormalize"),
        (lambda: Told(gym.make("InclinedLanding-v0")), "Told"),
        (lambda: gym.wrappers.RescaleAction(gym.make("InclinedLanding-v0"), -2, 2), "RescaleAction"),
        (lambda: Spaces(5, 2), "not trained on an environment of this package"),
    ],
)
def test_wrappers_that_a_policy_file_cannot_hold_are_named(tmp_path, make, name):
    with pytest.raises(UserError, match=name):
        save_policy(learner(make()), tmp_path / "mine.zip")
    assert not list(tmp_path.iterdir())


def test_a_model_that_is_none_is_refused(tmp_path):
    with pytest.raises(UserError, match="takes a Stable-Baselines3 model, not None"):
        save_policy(None, tmp_path / "mine.zip")


@pytest.mark.parametrize(
    "kind, name", [("extractor", "extractor .*Doubled"), ("class", "class in .*test_policy")]
)
def test_networks_that_the_tensors_do_not_tell_are_refused_by_name(tmp_path, kind, name):
    if kind == "class":
        network = PPO(OwnPolicy, Spaces(5, 2), device="cpu")
    else:
        network = model(features_extractor_class=Doubled)
    with pytest.raises(UserError, match=name):
        load_policy(saved(tmp_path / "mine.zip", network))


def test_actions_of_other_bounds_are_refused(tmp_path):
    env = Spaces(5, 2)
    env.action_space = gym.spaces.Box(-2.0, 2.0, (2,), np.float32)
    with pytest.raises(UserError, match="other bounds than -1 to 1"):
        load_policy(saved(tmp_path / "mine.zip", PPO("MlpPolicy", env, device="cpu")))


def test_start_states_of_a_vector_environment():
    """As `reset(options={"state": ...})` of a single environment; later resets are random again."""
    env, other = vehicles(3), make_batch("landing", 3, plant="analytic", seed=9)
    expected = other.reset()
    states = other.plant.state.copy()
    for options in ({"state": states}, [{"state": state} for state in states]):
        env.set_options(options)
        assert np.array_equal(env.reset(), expected)
    env.set_options([{"state": states[0]}, {}, {}])
    mixed = env.reset()
    assert np.array_equal(mixed[0], expected[0]) and not np.array_equal(mixed[1], expected[1])
    assert not np.array_equal(env.reset()[0], expected[0])
    for wrong in ({"start": states}, {"state": states[:2]}, [{}] * 2, 3):
        with pytest.raises(UserError):
            env.set_options(wrong)


def test_what_all_vehicles_share_is_not_set_for_one():
    env = vehicles(3)
    env.set_attr("reward_scale", 2.0)
    assert env.get_attr("reward_scale") == [2.0] * 3
    for act in (lambda: env.set_attr("reward_scale", 7.0, [0]), lambda: env.env_method("reset", indices=1)):
        with pytest.raises(UserError, match="leave indices out"):
            act()
    with pytest.raises(AttributeError):
        env.set_attr("gravity", 3.0)
    assert env.get_attr("reward_scale") == [2.0] * 3


@pytest.mark.parametrize("size, stride", [((1, 5), (2**62, 1)), ((2**62,), (0,)), ((2,), (2**80,))])
def test_tensors_larger_than_any_file_are_refused(size, stride):
    tensor = weights._Tensor(weights._Storage("torch FloatStorage", "0", 8), 0, size, stride)
    with pytest.raises(UserError, match=r"a shape that is none|beyond its numbers"):
        weights._array(tensor, np.zeros(8, np.float32), "its tensor w")
