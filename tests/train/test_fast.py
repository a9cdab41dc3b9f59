"""The fast update and rollout against Stable-Baselines3's own."""

import copy
import subprocess
import sys

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger

from inclined_landing.envs.batch import BatchEnv
from inclined_landing.envs.features import ScaledObservation
from inclined_landing.envs.sb3 import BatchVecEnv
from inclined_landing.envs.tasks import make_task
from inclined_landing.envs.tasks.landing import LandingConditions
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.plants import make_plant
from inclined_landing.train.fast import layers
from inclined_landing.train.fast.ppo import FastPPO

N, STEPS = 8, 100


def environment(n=N, seed=0) -> BatchVecEnv:
    task = make_task("landing")
    return BatchVecEnv(BatchEnv(task, make_plant("analytic", n, task.vehicle), seed), reward_scale=0.1)


def model(kind, net_arch=None, n=N, scaled=True, **options) -> PPO:
    env = environment(n)
    task = env.env.task
    extractor = {
        "features_extractor_class": ScaledObservation,
        "features_extractor_kwargs": {
            "centre": task.observation_centre.tolist(),
            "scale": task.observation_scale.tolist(),
        },
    }
    options = {"n_steps": STEPS, "batch_size": 256, "n_epochs": 3, "learning_rate": 1e-3, "seed": 1} | options
    made = kind(
        "MlpPolicy", env, device="cpu",
        policy_kwargs={
            "net_arch": net_arch or [64, 64], "log_std_init": -0.4, "optimizer_kwargs": {"fused": True},
            **(extractor if scaled else {}),
        },
        **options,
    )  # fmt: skip
    made.set_logger(Logger(None, []))
    return made


class Keep(BaseCallback):
    """Counts steps, and finished episodes as the curriculum does."""

    def __init__(self):
        super().__init__()
        self.ended = self.truncated = 0

    def _on_step(self) -> bool:
        assert len(self.locals["infos"]) == len(self.locals["dones"])
        for info in self.locals["infos"]:
            self.ended += "episode" in info
            self.truncated += info.get("TimeLimit.truncated", False)
        return True


def rollout(fast: FastPPO) -> Keep:
    """One rollout into the model's own buffer."""
    keep = Keep()
    _, callback = fast._setup_learn(10**6, keep)
    assert fast.collect_rollouts(fast.env, callback, fast.rollout_buffer, fast.n_steps)
    return keep


def twin(fast: FastPPO, kind, **options) -> PPO:
    """A model of the other kind with the same weights and the same rollout."""
    other = model(kind, **options)
    other.policy.load_state_dict(fast.policy.state_dict())
    other.rollout_buffer = copy.deepcopy(fast.rollout_buffer)
    return other


def weights(made: PPO) -> dict[str, np.ndarray]:
    return {name: tensor.numpy() for name, tensor in made.policy.state_dict().items()}


def update(made: PPO, shuffling=5) -> dict:
    """One whole update with minibatches of the given shuffling; what was logged."""
    np.random.seed(shuffling)  # noqa: NPY002 (SB3 shuffles with it)
    made.train()
    return dict(made.logger.name_to_value)


CASES = {
    "as trained": {},
    "last minibatch smaller": {"batch_size": 300},
    "one minibatch": {"batch_size": N * STEPS},
    "tiny minibatches": {"batch_size": 7 * N, "n_epochs": 1},
    "one layer, entropy bonus": {"net_arch": [33], "ent_coef": 0.01},
    "three layers of odd widths": {"net_arch": [17, 64, 5]},
    "unlike networks": {"net_arch": {"pi": [16, 8], "vf": [40]}},
    "plain observations": {"scaled": False},
}


@pytest.mark.parametrize("frozen", [False, True], ids=["", "actor frozen"])
@pytest.mark.parametrize("case", CASES)
def test_an_update_is_that_of_sb3(case, frozen):
    """Weights after all epochs within 1e-5, what is logged within 1e-4 of its size.

    A step of Adam is about the learning rate, 1e-3, whatever the gradient's size, and float32 gives the
    gradient to some 1e-6 of it: some 1e-9 a step. Gradients that nearly cancel are worse, and steps add up.
    """
    options = CASES[case]
    fast = model(FastPPO, **options)
    rollout(fast)
    stock = twin(fast, PPO, **options)
    for made in (fast, stock):
        for name, parameter in made.policy.named_parameters():
            if any(part in name for part in ("policy_net", "action_net", "log_std")):
                parameter.requires_grad_(not frozen)
    for lap in range(2):  # the second with a ratio that is not one, and with moments
        said, expected = update(fast, lap), update(stock, lap)
        for name, tensor in weights(stock).items():
            np.testing.assert_allclose(weights(fast)[name], tensor, rtol=0, atol=1e-5, err_msg=name)
        assert set(said) == set(expected)
        for name, value in expected.items():
            assert said[name] == pytest.approx(value, rel=1e-4, abs=1e-5), name


class Stop(BaseCallback):
    def _on_step(self) -> bool:
        return self.num_timesteps < 5 * N


def easy(task) -> None:
    """Episodes that end within a hundred steps, some of them in a large goal box."""
    task.conditions = LandingConditions(start_reach=0.6, tilt=0.0, goal_size=0.3, platform=0.0)
    task.max_steps = 40


def test_a_rollout_is_that_of_sb3(monkeypatch):
    """SB3's own `collect_rollouts`, made to take the same actions, fills the same buffer.

    Values, log-probabilities and what is made of them to 1e-5: networks of this size in float32 are exact to
    about 1e-6. What comes from the environment is equal.
    """
    fast = model(FastPPO, n=32)
    easy(fast.env.env.task)
    keep = rollout(fast)
    assert keep.ended > keep.truncated > 0
    own = fast.rollout_buffer
    stock = model(PPO, n=32)
    easy(stock.env.env.task)
    stock.policy.load_state_dict(fast.policy.state_dict())
    taken = iter(own.actions)

    def forward(observation):
        actions = torch.as_tensor(next(taken))
        values, log_prob, _ = stock.policy.evaluate_actions(observation, actions)
        return actions, values, log_prob

    monkeypatch.setattr(stock.policy, "forward", forward)
    again = rollout(stock)
    expected = stock.rollout_buffer
    assert own.full and own.pos == expected.pos
    for name in ("observations", "actions", "episode_starts"):
        np.testing.assert_array_equal(getattr(own, name), getattr(expected, name), err_msg=name)
    for name in ("values", "log_probs", "rewards", "advantages", "returns"):
        np.testing.assert_allclose(getattr(own, name), getattr(expected, name), rtol=1e-5, atol=1e-5)
    assert (keep.ended, keep.truncated) == (again.ended, again.truncated)
    assert [(e["r"], e["l"]) for e in fast.ep_info_buffer] == [(e["r"], e["l"]) for e in stock.ep_info_buffer]
    assert fast.ep_success_buffer == stock.ep_success_buffer
    np.testing.assert_array_equal(fast._last_obs, stock._last_obs)
    np.testing.assert_array_equal(fast._last_episode_starts, stock._last_episode_starts)


def test_actions_are_drawn_around_the_actors_mean():
    """Means and standard deviations of 51 200 draws within 5 standard errors of what torch says."""
    fast = model(FastPPO, n=512)
    rollout(fast)
    buffer = fast.rollout_buffer
    with torch.no_grad():
        observations = torch.as_tensor(buffer.observations.reshape(-1, buffer.observations.shape[-1]))
        mean = fast.policy.get_distribution(observations).distribution.mean.numpy()
        std = fast.policy.log_std.exp().numpy()
    noise = (buffer.actions.reshape(mean.shape) - mean) / std
    error = 5 / np.sqrt(len(noise))
    np.testing.assert_allclose(noise.mean(axis=0), 0, atol=error)
    np.testing.assert_allclose(noise.std(axis=0), 1, atol=error)
    assert abs(np.corrcoef(noise.T)[0, 1]) < error


def test_a_callback_stops_a_rollout():
    fast = model(FastPPO)
    _, callback = fast._setup_learn(10**6, Stop())
    assert not fast.collect_rollouts(fast.env, callback, fast.rollout_buffer, fast.n_steps)
    assert fast.num_timesteps == 5 * N


def test_files_go_from_one_to_the_other(tmp_path):
    """What one has saved the other goes on with, moments of the optimizer included."""
    fast = model(FastPPO)
    fast.learn(2 * N * STEPS)
    fast.save(tmp_path / "fast", exclude=("lr_schedule",))
    stock = PPO.load(tmp_path / "fast", environment(), device="cpu")
    for a, b in zip(fast.policy.optimizer.state.values(), stock.policy.optimizer.state.values()):
        assert all(torch.equal(a[name], b[name]) for name in ("step", "exp_avg", "exp_avg_sq"))
        assert a["step"] == 2 * 3 * 4
    stock.learn(N * STEPS, reset_num_timesteps=False)
    stock.save(tmp_path / "stock")
    again = FastPPO.load(tmp_path / "stock", environment(), device="cpu")
    again.learn(N * STEPS, reset_num_timesteps=False)
    assert all(np.isfinite(tensor).all() for tensor in weights(again).values())
    assert all(state["step"] == 4 * 3 * 4 for state in again.policy.optimizer.state.values())


def test_a_network_that_diverges_is_not_hidden():
    """What is not finite stays so: nothing limits it back to a number."""
    fast = model(FastPPO)
    rollout(fast)
    fast.rollout_buffer.returns[3, 3] = np.nan
    fast.rollout_buffer.advantages[3, 3] = np.nan
    update(fast)
    assert all(
        np.isnan(tensor).any() for name, tensor in weights(fast).items() if name[-4:] in ("ight", "bias")
    )


def test_making_saving_and_loading_one_loads_no_compiler(tmp_path):
    """torch._dynamo takes two seconds to import; the compiled update has no use for it."""
    code = """
import sys, gymnasium
from inclined_landing.train.fast.ppo import FastPPO
made = FastPPO("MlpPolicy", gymnasium.make("MountainCarContinuous-v0"), n_steps=64, device="cpu")
made.learn(64)
made.save(sys.argv[1])
FastPPO.load(sys.argv[1], device="cpu").policy.optimizer.param_groups[0]["eps"] == 1e-5 or sys.exit("epsilon")
sys.exit("torch._dynamo" in sys.modules)
"""
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "policy")], check=True)


REFUSED = {
    "tanh": {"activation_fn": torch.nn.ReLU},
    "clip_range_vf=None": {"clip_range_vf": 0.2},
    "target_kl=None": {"target_kl": 0.01},
    "Gaussian": {"use_sde": True},
    "two samples": {"batch_size": 3, "n_steps": 2},
}


@pytest.mark.parametrize("what", REFUSED)
def test_unsupported_options_of_the_fast_update_are_refused(what):
    options = dict(REFUSED[what])
    kwargs = {"activation_fn": options.pop("activation_fn")} if "activation_fn" in options else None
    with pytest.raises(UserError, match=what):
        FastPPO("MlpPolicy", environment(), device="cpu", policy_kwargs=kwargs, **options)


def test_tanh_is_exact_to_float32():
    """Relative error at most 4e-7, some units in the last place, and not a number stays none."""
    x = np.concatenate([np.linspace(-12, 12, 100_001), 10.0 ** -np.arange(1, 30)]).astype(np.float32)
    found = np.append(x, [np.nan, np.inf, -np.inf]).astype(np.float32)
    layers.tanh(found, np.uint64(0), np.uint64(len(found)))
    np.testing.assert_allclose(found[: len(x)], np.tanh(x.astype(float)), rtol=4e-7, atol=1e-37)
    assert np.isnan(found[-3]) and found[-2] == -found[-1] == pytest.approx(1, abs=4e-7)
    assert np.abs(found[: len(x)]).max() <= 1
