"""Policy files: what is read is what SB3 would do, and what is wrong is said in one sentence."""

import dataclasses
import subprocess
import sys
import zipfile

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3 import A2C, DDPG, PPO, SAC, TD3
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

from inclined_landing.envs import BatchVecEnv, load_policy, make_batch, policy, save_policy
from inclined_landing.envs.features import ScaledObservation
from inclined_landing.envs.gym_env import InclinedLandingEnv  # type: ignore
from inclined_landing.envs.make import make_for
from inclined_landing.envs.policy_file import METADATA as METADATA_FILE
from inclined_landing.envs.save import actor_of
from inclined_landing.envs.tasks import make_task
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from tests.policy_files import Spaces, restamp

NAME = "inclined_landing.envs:InclinedLanding-v0"  # imported in other processes too
SETPOINT = {"task": "setpoint", "task_options": {}}
METADATA = {"task": "landing", "task_options": {"pwm_centre": "hover"}, "seed": 3}


def model(observations=5, actions=2, **policy_kwargs) -> PPO:
    env = Spaces(observations, actions)
    return PPO("MlpPolicy", env, seed=0, device="cpu", policy_kwargs=policy_kwargs)


def saved(path, network: PPO, metadata=METADATA):
    """Write Stable-Baselines3's own file, with metadata that tell its task."""
    network.save(path)
    if metadata is not None:
        restamp(path, metadata)
    return path


SCALED = {
    "features_extractor_class": ScaledObservation,
    "features_extractor_kwargs": {"centre": [0, 1.25, 0, 0, 0], "scale": [1, 1, 2, 2, 0.5]},
}


def assert_same_actions(network, path, task=None):
    """float32 sums: 256 terms at 6e-8, before a gain below 10."""
    rows = np.random.default_rng(1).normal(scale=3.0, size=(300, 5)).astype(np.float32)
    wanted, _ = network.predict(rows, deterministic=True)
    np.testing.assert_allclose(policy.load_policy(path, task).predict(rows), wanted, atol=1e-4)
    return wanted


def test_an_action_does_not_depend_on_its_neighbours(tmp_path):
    loaded = policy.load_policy(saved(tmp_path / "p.zip", model(**SCALED)))
    rows = np.random.default_rng(1).normal(size=(37, 5))
    together = loaded.predict(rows)
    assert together.dtype == np.float32
    np.testing.assert_array_equal(together, [loaded.predict(row) for row in rows])


def test_a_policy_file_is_sb3s_too_and_is_read_without_torch(tmp_path):
    network = learner(vehicles())
    save_policy(network, tmp_path / "p.zip")
    assert_same_actions(PPO.load(tmp_path / "p.zip", device="cpu"), tmp_path / "p.zip")
    assert [p.name for p in tmp_path.iterdir()] == ["p.zip"]
    with np.load(tmp_path / "p.zip") as arrays:
        assert arrays["network/weights_0"].shape == (5, 64) and arrays["network/biases_2"].shape == (2,)
    code = (
        "import sys; sys.modules.update(dict.fromkeys(('torch', 'stable_baselines3')))\n"
        f"from inclined_landing.envs import load_policy; load_policy({str(tmp_path / 'p.zip')!r})"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_a_plain_sb3_file_needs_the_task(tmp_path):
    path = saved(tmp_path / "p.zip", model(), metadata=None)
    with pytest.raises(UserError, match="does not state its task"):
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
        UserError, match=r"inclination=-0\.44\d+, and .* inclination=-0\.2; .*give inclination as well"
    ):
        policy.load_policy("landing-nominal", sloped)
    assert policy.load_policy("landing-nominal", sloped, inclination=-0.2).task is sloped
    heavy = dataclasses.replace(load_vehicle(), body_mass=0.04, command_pwm_span=9_000.0)
    loaded = policy.load_policy("landing-nominal", vehicle=heavy).task
    assert loaded.vehicle is heavy and loaded.pwm_centre == load_vehicle().hover_pwm
    same = make_task("landing", heavy, **loaded.options)
    assert policy.load_policy("landing-nominal", same).task.pwm_span == 16_500
    with pytest.raises(UserError, match="pwm_span=16500"):
        policy.load_policy("landing-nominal", make_task("landing", heavy))


def another_zip(path):
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("data", "{}")


def nan_weights(path):
    network = model()
    with torch.no_grad():
        network.policy.action_net.bias[0] = float("nan")
    saved(path, network)


def other_spaces(policy="MlpPolicy", **spaces) -> PPO:
    env = Spaces(5, 2)
    vars(env).update(spaces)
    return PPO(policy, env, device="cpu")


def damaged_metadata(path):
    saved(path, model(), metadata=None)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(METADATA_FILE, "{")


@pytest.mark.parametrize(("make", "sentence"), [
    (lambda path: None, "does not exist"),
    (lambda path: path.mkdir(), "is a folder"),
    (lambda path: path.write_text("nothing"), "is not a zip file"),
    (another_zip, "is damaged, or not a policy file; .* with save_policy"),
    (lambda path: saved(path, model(8, 3)),
     "takes 8 observations and returns 3 actions, but the task landing has 5 and 2"),
    (lambda path: saved(path, model(8, 3), SETPOINT), "was trained for the task setpoint, not for landing"),
    (nan_weights, "NaN or infinite"),
    (lambda path: other_spaces(action_space=gym.spaces.Discrete(4)).save(path),
     "in an action space other than the task's .*save_policy"),
    (lambda path: learner(Spaces(5, 2), SAC).save(path), "neither a file of this package nor .*save_policy"),
    (lambda path: saved(path, model(activation_fn=torch.nn.SiLU)), "SiLU"),
    (damaged_metadata, "inclined_landing.json in it is not JSON"),
    (lambda path: saved(path, model(), METADATA | {"task_options": {"colour": 3}}), "colour"),
])  # fmt: skip
def test_wrong_files_are_one_sentence(tmp_path, make, sentence):
    path = tmp_path / "p.zip"
    make(path)
    with pytest.raises(UserError, match=sentence) as error:
        policy.load_policy(path, "landing")
    assert "\n" not in str(error.value)


def test_wrong_observations_and_tasks(tmp_path):
    path = saved(tmp_path / "p.zip", model())
    for wrong, said in ((np.zeros((3, 4)), "of 5 numbers"), ("fast", "must be an array of real numbers")):
        with pytest.raises(UserError, match=said):
            policy.load_policy(path).predict(wrong)
    with pytest.raises(UserError, match="unknown task 'hover'"):
        policy.load_policy(path, "hover")
    with pytest.raises(UserError, match="outside the supported range"):
        policy.load_policy(path, inclination=1.4)
    other = saved(tmp_path / "s.zip", model(8, 3), SETPOINT)
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


class Mirrored(gym.ObservationWrapper):
    """Changes what a policy observes, not its space."""

    def observation(self, observation):
        return -observation


class Own(InclinedLandingEnv):
    """An environment of this package that somebody changed."""


def vehicles(count=4):
    return BatchVecEnv(make_batch("landing", count, plant="analytic", seed=0))


def single(**options):
    return gym.make(NAME, plant="analytic", **options)


def learner(env, kind=PPO, **options):
    usual = {PPO: {"n_steps": 16, "batch_size": 16, "n_epochs": 1}, A2C: {}}.get(kind, {"buffer_size": 99})
    return kind("MlpPolicy", env, seed=0, device="cpu", **usual, **options)


@pytest.mark.parametrize("kind", [PPO, SAC])
@pytest.mark.parametrize(
    "options", [{}, {"clip_obs": 0.7, "epsilon": 0.1}, {"clip_obs": np.inf}, {"norm_obs": False}]
)
def test_a_policy_behind_vecnormalize_takes_its_statistics_along(tmp_path, kind, options):
    env = VecNormalize(VecMonitor(vehicles()), **options)
    network = learner(env, kind).learn(64)
    save_policy(network, tmp_path / "mine")
    raw = np.random.default_rng(0).normal(size=(50, 5)).astype(np.float32)
    expected = network.predict(env.normalize_obs(raw), deterministic=True)[0]
    # float32 sums of 256 terms at most
    np.testing.assert_allclose(load_policy(tmp_path / "mine.zip").predict(raw), expected, atol=1e-5)
    assert load_policy(tmp_path / "mine.zip").metadata["steps"] == 64


def test_a_file_that_lacks_the_statistics_of_vecnormalize_is_refused(tmp_path):
    """Stable-Baselines3's own, and one of a model that was given another environment; the remedy works."""
    env = VecNormalize(vehicles())
    network = learner(env).learn(64)
    network.save(tmp_path / "plain.zip")
    env.save(tmp_path / "statistics.pkl")
    with pytest.raises(UserError, match=r"with VecNormalize, whose statistics.*save_policy"):
        load_policy(tmp_path / "plain.zip", "landing")
    with pytest.raises(UserError, match=r"with VecNormalize.*VecNormalize\.load"):
        save_policy(PPO.load(tmp_path / "plain.zip", env=vehicles()), tmp_path / "bare.zip")
    with pytest.raises(UserError, match=r"has no statistics; use VecNormalize\.load"):
        save_policy(PPO.load(tmp_path / "plain.zip", env=VecNormalize(vehicles())), tmp_path / "bare.zip")
    again = VecNormalize.load(tmp_path / "statistics.pkl", vehicles())
    save_policy(PPO.load(tmp_path / "plain.zip", env=again), tmp_path / "mine.zip")
    np.testing.assert_array_equal(load_policy(tmp_path / "mine.zip").centre, env.obs_rms.mean)


@pytest.mark.parametrize("kind", [SAC, TD3])
def test_a_model_with_a_replay_buffer_tells_by_it_that_there_was_no_vecnormalize(tmp_path, kind):
    """Also with another environment, and after loading with the buffer; the actions are the model's."""
    network = learner(vehicles(), kind, learning_starts=4).learn(16)
    network.set_env(vehicles())
    save_policy(network, tmp_path / "mine.zip")
    assert_same_actions(network, tmp_path / "mine.zip")
    network.save_replay_buffer(tmp_path / "buffer.pkl")
    again = kind.load(tmp_path / "mine.zip", env=vehicles(), device="cpu")
    with pytest.raises(UserError, match=f"this {kind.__name__} was trained with VecNormalize.*replay buffer"):
        save_policy(again, tmp_path / "again.zip")
    again.load_replay_buffer(tmp_path / "buffer.pkl")
    save_policy(again, tmp_path / "again.zip")
    hidden = learner(VecNormalize(vehicles()), kind, learning_starts=4).learn(16)
    hidden.set_env(vehicles())
    with pytest.raises(UserError, match="was trained with VecNormalize"):
        save_policy(hidden, tmp_path / "hidden.zip")


@pytest.mark.parametrize("kind", [DummyVecEnv, pytest.param(SubprocVecEnv, marks=pytest.mark.slow)])
def test_models_of_single_environments_are_saved(tmp_path, kind):
    env = kind([lambda: Monitor(single(inclination=-0.3)) for _ in range(2)])
    save_policy(learner(env), tmp_path / "mine.zip")
    env.close()
    assert load_policy(tmp_path / "mine.zip").task.options["inclination"] == pytest.approx(-0.3)


@pytest.mark.parametrize(
    "wrap",
    [
        lambda env: gym.wrappers.TransformReward(env, lambda reward: 0.1 * reward),
        lambda env: gym.wrappers.TimeLimit(gym.wrappers.FlattenObservation(env), 50),
        lambda env: gym.wrappers.RescaleAction(env, -1.0, 1.0),
    ],
)
def test_wrappers_that_leave_observations_and_actions_alone_are_no_hindrance(tmp_path, wrap):
    save_policy(learner(wrap(single())), tmp_path / "mine.zip")
    assert load_policy(tmp_path / "mine.zip").task.name == "landing"


def without_environment():
    network = model()
    network.env = None
    return network


def by_hand(change):
    """Return a model whose policy was changed after it was made."""
    network = learner(vehicles())
    change(network.policy)
    return network


def hooked(policy):
    policy.action_net.register_forward_hook(lambda module, given, result: 0.9 * result)


@pytest.mark.parametrize(("make", "said"), [
    (lambda: learner(VecFrameStack(vehicles(), 2)), "wrapper VecFrameStack, .*option history"),
    (lambda: learner(VecNormalize(VecNormalize(vehicles()))), "wrapper VecNormalize"),
    (lambda: learner(VecNormalize(vehicles()), policy_kwargs=SCALED), "norm_obs=False"),
    (lambda: learner(Mirrored(single())), r"wrapper Mirrored, .*model\.set_env"),
    (lambda: learner(Monitor(Own(plant="analytic"))), "wrapper in <Monitor<Own"),
    (lambda: learner(gym.wrappers.RescaleAction(single(), -2, 2)), "RescaleAction"),
    (lambda: learner(DummyVecEnv([lambda a=a: single(inclination=a) for a in (-0.2, -0.3)])),
     "different options"),
    (lambda: learner(Spaces(5, 2)), "not trained on an environment of this package"),
    (without_environment, "has no environment"),
    (lambda: None, "takes a Stable-Baselines3 model, not None"),
    (lambda: by_hand(lambda p: p.mlp_extractor.policy_net.insert(2, torch.nn.Dropout())),
     "PPO, which has Dropout in"),
    (lambda: by_hand(lambda p: setattr(p.mlp_extractor.policy_net, "3", torch.nn.ReLU())),
     "with one activation"),
    (lambda: by_hand(hooked), "PPO, which commands otherwise than its dense layers"),
])  # fmt: skip
def test_what_a_policy_file_cannot_hold_is_named(tmp_path, make, said):
    with pytest.raises(UserError, match=said):
        save_policy(make(), tmp_path / "mine.zip")
    assert not list(tmp_path.iterdir())


def test_arguments_that_are_no_path_of_a_file_are_refused(tmp_path):
    (tmp_path / "p.zip").touch()
    for path, said in (
        (None, "takes the path of a file, not None"),
        (tmp_path / "p.zip" / "mine.zip", "is not a folder"),
    ):
        with pytest.raises(UserError, match=said):
            save_policy(learner(vehicles()), path)
    assert [path.name for path in tmp_path.iterdir()] == ["p.zip"]


BOUNDS = gym.spaces.Box(-2.0, 2.0, (2,), np.float32)
SEVERAL = gym.spaces.Dict({"a": gym.spaces.Box(-np.inf, np.inf, (5,), np.float32)})


def more_tensors():
    network = model()
    network.policy.lstm_actor = torch.nn.LSTM(5, 5)
    return network


@pytest.mark.parametrize(
    "make, foreign, own",
    [
        (lambda: model(features_extractor_class=Doubled), "features extractor .*Doubled", "PPO, .* Doubled"),
        (lambda: PPO(OwnPolicy, Spaces(5, 2), device="cpu"), "nor one of .*with a standard policy", None),
        (lambda: model(activation_fn=torch.nn.ELU), "activation .*ELU", "PPO, .* has ELU in"),
        (lambda: other_spaces(action_space=BOUNDS), "action space other than", None),
        (
            lambda: other_spaces("MultiInputPolicy", observation_space=SEVERAL),
            "standard policy|observation space other",
            "CombinedExtractor",
        ),
        (more_tensors, "lstm_actor", None),
    ],
)
def test_networks_that_are_more_than_dense_layers_are_refused_by_name(tmp_path, make, foreign, own):
    """In files of Stable-Baselines3 alone, and by what writes policy files."""
    network = make()
    with pytest.raises(UserError, match=f"{foreign}.*save_policy"):
        load_policy(saved(tmp_path / "mine.zip", network))
    if own is not None:
        with pytest.raises(UserError, match=own):
            actor_of(network)


@pytest.mark.parametrize("kind, options", [
    (PPO, {}),
    (PPO, {"policy_kwargs": {"net_arch": {"pi": [], "vf": [8]}}}),
    (PPO, {"policy_kwargs": {"net_arch": [32], "activation_fn": torch.nn.ReLU, **SCALED}}),
    (PPO, {"use_sde": True}),
    (PPO, {"use_sde": True, "policy_kwargs": {"squash_output": True}}),
    (PPO, {"policy_kwargs": {"share_features_extractor": False, **SCALED}}),
    (A2C, {"policy_kwargs": {"net_arch": {"pi": [16], "vf": []}, "activation_fn": torch.nn.ReLU}}),
    (SAC, {"use_sde": True, "policy_kwargs": {"clip_mean": 0.05}}),
    (SAC, {"use_sde": True, "policy_kwargs": {"net_arch": []}}),
    (SAC, {"policy_kwargs": {"net_arch": []}}),
    (SAC, {"policy_kwargs": {"net_arch": [32, 16], **SCALED}}),
    (TD3, {"policy_kwargs": {"net_arch": [32, 16], **SCALED}}),
    (DDPG, {"policy_kwargs": {"activation_fn": torch.nn.Tanh}}),
])  # fmt: skip
def test_predict_is_sb3s_whatever_the_algorithm(tmp_path, kind, options):
    network = learner(vehicles(), kind, **options)
    beyond = kind is PPO and "use_sde" not in options  # the bounds of actions, too
    if beyond:
        with torch.no_grad():
            network.policy.action_net.weight.mul_(300.0)
    save_policy(network, tmp_path / "p.zip")
    wanted = assert_same_actions(network, tmp_path / "p.zip")
    assert not beyond or np.abs(wanted).max() == 1.0
    if kind is PPO:  # its own file alone says the same
        network.save(tmp_path / "p.zip")
        assert_same_actions(network, tmp_path / "p.zip", "landing")
