"""The examples run, shortened, and the policies they leave are read and flown."""

import re
import runpy
import sys

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.wrappers import TransformReward
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from inclined_landing import envs, train
from inclined_landing.train import zoo
from tests import ROOT

EXAMPLES = ROOT / "examples"


@pytest.mark.parametrize(
    ("name", "task", "steps"), [("train_landing", "landing", 8192), ("train_setpoint_sac", "setpoint", 5100)]
)
def test_example(name, task, steps, tmp_path, monkeypatch, capsys):
    threads = torch.get_num_threads()
    path = tmp_path / "policy.zip"
    monkeypatch.setattr(sys, "argv", [name, "3", str(steps), str(path)])
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    torch.set_num_threads(threads)
    policy = envs.load_policy(path)
    assert policy.task.name == task and policy.metadata["seed"] == 3 and policy.metadata["steps"] >= steps
    start = policy.task.sample(np.random.default_rng(0), 3).state
    assert len(envs.record_flights(policy, "analytic", start, steps=5)) == 3
    assert str(path) in capsys.readouterr().out


@pytest.mark.slow
def test_ppo_in_one_file_learns_and_judges_itself(monkeypatch, capsys):
    threads = torch.get_num_threads()
    monkeypatch.setattr(sys, "argv", ["cleanrl_ppo", "3", "300000"])
    runpy.run_path(str(EXAMPLES / "cleanrl_ppo.py"), run_name="__main__")
    torch.set_num_threads(threads)
    found = re.search(r"seed 3, 300000 steps: (\d+) of 251 starts", capsys.readouterr().out)
    assert int(found[1]) > 125  # an untrained one: none


def test_the_zoos_parameters_train_plain_environments(tmp_path):
    """As rl-baselines3-zoo does it: single environments under a monitor, rewards by a wrapper, a callback."""
    parameters = zoo.hyperparams["InclinedLanding-v0"] | {"n_steps": 64, "batch_size": 64, "n_epochs": 1}
    options, own = (
        parameters["env_kwargs"],
        ("n_timesteps", "n_envs", "env_kwargs", "env_wrapper", "callback"),
    )
    ((_, scaling),) = parameters["env_wrapper"][0].items()

    def one():
        return TransformReward(Monitor(gymnasium.make("InclinedLanding-v0", **options)), **scaling)

    env = DummyVecEnv([one, one])
    callback = zoo.TaskCurriculum("landing")
    model = PPO(env=env, seed=0, **{key: value for key, value in parameters.items() if key not in own})
    model.learn(128, callback)
    assert all(task.conditions == callback.curriculum.conditions() != task.__class__().conditions
               for task in env.get_attr("task"))  # fmt: skip
    assert callback.total == 128 and callback.rate == parameters["learning_rate"]
    model.save(tmp_path / "zoo.zip", exclude=["lr_schedule"])
    policy = envs.load_policy(tmp_path / "zoo.zip", "landing")
    observation = np.array([[0.4, 1.5, 0.1, -0.2, 0.05]], np.float32)
    expected, _ = model.predict(observation, deterministic=True)
    np.testing.assert_allclose(policy.predict(observation), expected, atol=1e-6)


def test_every_public_name_is_there():
    for package in (envs, train):
        assert all(getattr(package, name).__doc__ for name in package.__all__)
        with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
            package.nothing  # noqa: B018
