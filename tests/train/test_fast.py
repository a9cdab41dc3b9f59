"""The fast update and rollout against Stable-Baselines3's own."""

import copy

import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger

from inclined_landing.envs.batch import BatchEnv
from inclined_landing.envs.features import ScaledObservation
from inclined_landing.envs.sb3 import BatchVecEnv
from inclined_landing.envs.tasks import make_task
from inclined_landing.models.plants import make_plant
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
    gradient to some 1e-6 of it: some 1e-9 a step, grown by what the steps do to each other. Gradients that
    cancel are worse, but Adam's epsilon, 1e-5, keeps the smallest still.
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
