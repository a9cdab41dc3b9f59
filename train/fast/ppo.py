"""`FastPPO`: Stable-Baselines3's PPO with compiled rollouts and updates.

Networks, optimizer, buffer, schedules, callbacks, logged values and files are those of SB3, and so is the
loss: with the same rollout and the same order of samples, an update gives the same weights to rounding. A run
can start with one implementation and continue with the other.
"""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.utils import explained_variance

from inclined_landing.envs.features import ScaledObservation
from inclined_landing.models.base.errors import UserError
from inclined_landing.train.fast import kernels, layers

_BUFFERED = ("observations", "actions", "values", "log_probs", "advantages", "returns")


class _FlatNetwork:
    """One of the policy's networks with its weights in one vector; the tensors remain those of torch."""

    def __init__(self, layers: list[torch.nn.Linear], log_std: torch.Tensor | None = None):
        self.tensors = [tensor for layer in layers for tensor in (layer.weight, layer.bias)]
        self.tensors += [] if log_std is None else [log_std]
        self.widths = np.array([layers[0].in_features, *(layer.out_features for layer in layers)], np.uint64)
        self.learns = any(tensor.requires_grad for tensor in self.tensors)
        if self.learns != all(tensor.requires_grad for tensor in self.tensors):
            raise UserError("the fast update cannot freeze single layers of a network")
        self.weights = gather(self.tensors)

    def activations(self) -> np.ndarray:
        """Return a buffer for one block of all layers' activations."""
        return np.empty(int(self.widths.sum()) * layers.BLOCK, np.float32)

    def forward(self) -> kernels.FixedNetwork:
        """Return the network for evaluation, with its own buffers."""
        return kernels.FixedNetwork(self.weights, self.widths, self.activations())

    def learner(self, optimizer: torch.optim.Adam) -> kernels.LearningNetwork:
        """Return the network for training, with the optimizer's moments and its own buffers."""
        memory = self.activations(), self.activations(), np.empty_like(self.weights)
        return kernels.LearningNetwork(self.weights, self.widths, *self.moments(optimizer), *memory)

    def moments(self, optimizer: torch.optim.Adam) -> tuple[np.ndarray, np.ndarray]:
        """Return Adam's two moments (2, w) and its number of steps (1,) so far."""
        states = [optimizer.state.get(tensor) for tensor in self.tensors]
        if not all(states):  # no gradient until now
            return np.zeros((2, len(self.weights)), np.float32), np.zeros(1)
        both = [gather([state[name] for state in states]) for name in ("exp_avg", "exp_avg_sq")]
        return np.stack(both), np.array([float(states[0]["step"])])

    def store(self, optimizer: torch.optim.Adam, moments: np.ndarray, steps: np.ndarray) -> None:
        """Write weights, moments and steps back to torch's tensors."""
        scatter(self.weights, self.tensors)
        for tensor in self.tensors:
            state = optimizer.state[tensor]
            if not state:
                state["step"] = torch.zeros((), dtype=torch.float32)
                state["exp_avg"], state["exp_avg_sq"] = torch.zeros_like(tensor), torch.zeros_like(tensor)
            state["step"].fill_(steps[0])
        for name, vector in zip(("exp_avg", "exp_avg_sq"), moments):
            scatter(vector, [optimizer.state[tensor][name] for tensor in self.tensors])


class Adam(torch.optim.Adam):
    """torch's Adam without the two seconds in which its methods load a compiler only to disable it."""

    add_param_group = inspect.unwrap(torch.optim.Optimizer.add_param_group)
    state_dict = inspect.unwrap(torch.optim.Optimizer.state_dict)
    load_state_dict = inspect.unwrap(torch.optim.Optimizer.load_state_dict)


def gather(tensors: list[torch.Tensor]) -> np.ndarray:
    """Return all numbers in one new vector."""
    return np.concatenate([tensor.detach().numpy().ravel() for tensor in tensors])


def scatter(vector: np.ndarray, tensors: list[torch.Tensor]) -> None:
    """Copy a vector's numbers to the tensors in place."""
    first = 0
    for tensor in tensors:
        tensor.detach().numpy()[...] = vector[first : first + tensor.numel()].reshape(tensor.shape)
        first += tensor.numel()


class FastPPO(PPO):
    """PPO for two separate tanh networks, a normal distribution of actions and a CPU.

    Raises UserError if the options ask for anything else.
    """

    policy_kwargs: dict[str, Any]
    _last_obs: np.ndarray
    _last_episode_starts: np.ndarray

    def _setup_model(self) -> None:
        asked = self.policy_kwargs
        default = {"optimizer_class": Adam, "optimizer_kwargs": {"eps": 1e-5}}  # SB3's default epsilon
        self.policy_kwargs = {**default, **asked}
        super()._setup_model()
        self.policy_kwargs = asked  # SB3 writes them to files, which must not name this module's Adam
        self._check()

    def _check(self) -> None:
        group = self.policy.optimizer.param_groups[0]
        mlp = self.policy.mlp_extractor
        chains = [list(net) for net in (mlp.policy_net, mlp.value_net)]
        linear = all(isinstance(m, torch.nn.Linear) for chain in chains for m in chain[::2])
        tanh = all(isinstance(m, torch.nn.Tanh) for chain in chains for m in chain[1::2])
        adam = type(self.policy.optimizer) in (Adam, torch.optim.Adam)
        extractor = type(self.policy.features_extractor) in (ScaledObservation, FlattenExtractor)
        conditions = {
            "two tanh networks": linear and tanh and all(chain and len(chain) % 2 == 0 for chain in chains),
            "a Gaussian policy over a Box of actions": isinstance(self.action_space, spaces.Box)
            and not self.use_sde
            and not self.policy.squash_output,
            "scaled or plain observations in float32": extractor
            and len(self.observation_space.shape) == 1
            and self.policy.share_features_extractor
            and self.observation_space.dtype == np.float32,
            "plain Adam": adam and not (group["weight_decay"] or group["amsgrad"]),
            "normalised advantages": self.normalize_advantage,
            "clip_range_vf=None": self.clip_range_vf is None,
            "target_kl=None": self.target_kl is None,
            "device='cpu'": self.device.type == "cpu",
            "a last minibatch of two samples or more": self.n_steps * self.n_envs % self.batch_size != 1,
        }
        for what, found in conditions.items():
            if not found:
                raise UserError(f"the fast update needs {what}; use stock PPO instead (--update stock)")

    def _networks(self) -> tuple[_FlatNetwork, _FlatNetwork]:
        """Return actor and critic."""
        policy, mlp = self.policy, self.policy.mlp_extractor
        actor = _FlatNetwork([*list(mlp.policy_net)[::2], policy.action_net], policy.log_std)
        return actor, _FlatNetwork([*list(mlp.value_net)[::2], policy.value_net])

    def _scaling(self) -> layers.Scaling:
        """Return the policy's scaling of observations."""
        extractor = self.policy.features_extractor
        if isinstance(extractor, ScaledObservation):
            limit = np.float32(ScaledObservation.LIMIT)
            return layers.Scaling(extractor.centre.numpy(), extractor.scale.numpy(), limit)
        o = extractor.features_dim
        return layers.Scaling(np.zeros(o, np.float32), np.ones(o, np.float32), np.float32(np.inf))

    def collect_rollouts(self, env, callback, rollout_buffer, n_rollout_steps) -> bool:
        """Fill the buffer with `n_rollout_steps` of every environment; False if the callback stopped it.

        As in SB3, except that the values, which are only needed at the end, are computed all at once.
        """
        self.policy.set_training_mode(False)
        buffer, n = rollout_buffer, env.num_envs
        buffer.reset()
        callback.on_rollout_start()
        actor, critic = self._networks()
        scaling, network = self._scaling(), actor.forward()
        bounds = kernels.Bounds(self.action_space.low, self.action_space.high)
        noise = torch.randn((n_rollout_steps, n, len(bounds.low))).numpy()
        cut, cut_at = [], []  # observations at which time ran out, and when and where
        dones = self._last_episode_starts
        n_steps = 0
        while n_steps < n_rollout_steps:
            t = n_steps
            buffer.observations[t] = self._last_obs.reshape(n, -1)
            buffer.episode_starts[t] = self._last_episode_starts
            clipped_actions = np.empty_like(buffer.actions[t])
            drawn = kernels.Drawn(buffer.actions[t], clipped_actions, buffer.log_probs[t])
            kernels.act(network, scaling, buffer.observations[t], noise[t], bounds, drawn)
            new_obs, rewards, dones, infos = env.step(clipped_actions)
            self.num_timesteps += n
            callback.update_locals({"infos": infos, "dones": dones, "rewards": rewards, "new_obs": new_obs})
            if not callback.on_step():
                return False
            ended = np.flatnonzero(dones)
            if len(ended):
                self._update_info_buffer([infos[i] for i in ended], dones[ended])
            for i in ended:
                if infos[i].get("TimeLimit.truncated", False) and "terminal_observation" in infos[i]:
                    cut.append(infos[i]["terminal_observation"])
                    cut_at.append((t, i))
            buffer.rewards[t] = rewards
            self._last_obs, self._last_episode_starts = new_obs, dones
            n_steps += 1
        buffer.pos, buffer.full = n_steps, True

        last_values = np.empty(n, np.float32)
        self._evaluate(critic, buffer.observations.reshape(n_steps * n, -1), buffer.values.reshape(-1))
        self._evaluate(critic, self._last_obs.reshape(n, -1), last_values)
        if cut:
            values = np.empty(len(cut), np.float32)
            self._evaluate(critic, np.array(cut, np.float32).reshape(len(cut), -1), values)
            buffer.rewards[tuple(np.transpose(cut_at))] += np.float32(self.gamma) * values
        kernels.advantages(
            buffer.rewards, buffer.values, buffer.episode_starts, last_values, dones,
            buffer.gamma, buffer.gae_lambda, buffer.advantages,
        )  # fmt: skip
        buffer.returns = buffer.advantages + buffer.values
        callback.update_locals(locals())
        callback.on_rollout_end()
        return True

    def _evaluate(self, critic: _FlatNetwork, observations: np.ndarray, values: np.ndarray) -> None:
        """Write the critic's values (n,) of observations (n, o)."""
        kernels.evaluate(critic.forward(), self._scaling(), np.ascontiguousarray(observations), values)

    def train(self) -> None:
        """Run SB3's update on the rollout in the buffer."""
        self.policy.set_training_mode(True)
        optimizer, buffer = self.policy.optimizer, self.rollout_buffer
        self._update_learning_rate(optimizer)
        clip_range = self.clip_range(self._current_progress_remaining)
        group = optimizer.param_groups[0]
        actor, critic = self._networks()
        if not critic.learns:
            raise UserError("the fast update cannot freeze the critic; use stock PPO instead")
        if not buffer.generator_ready:
            for name in _BUFFERED:
                setattr(buffer, name, buffer.swap_and_flatten(getattr(buffer, name)))
            buffer.generator_ready = True
        samples = len(buffer.values)
        rollout = kernels.Rollout(
            observations=buffer.observations.reshape(samples, -1),
            actions=buffer.actions.reshape(samples, -1),
            log_probs=buffer.log_probs.reshape(-1),
            advantages=buffer.advantages.reshape(-1),
            returns=buffer.returns.reshape(-1),
        )
        order = [np.random.permutation(samples) for _ in range(self.n_epochs)]  # noqa: NPY002 (as SB3 does)
        batches = -(-samples // self.batch_size)
        statistics = np.zeros((self.n_epochs * batches, len(kernels.STATISTICS)))
        learners = actor.learner(optimizer), critic.learner(optimizer)
        beta1, beta2 = group["betas"]
        settings = kernels.Settings(
            batch=np.uint64(self.batch_size),
            actor_learns=actor.learns,
            clip=clip_range,
            entropy=float(self.ent_coef),
            values=float(self.vf_coef),
            largest_norm=float(self.max_grad_norm),
            rate=float(group["lr"]),
            beta1=float(beta1),
            beta2=float(beta2),
            epsilon=float(group["eps"]),
        )
        kernels.update(*learners, rollout, np.array(order, np.uint64), self._scaling(), settings, statistics)
        for network, learner in zip((actor, critic), learners):
            if network.learns:
                network.store(optimizer, learner.moments, learner.steps)
        self._n_updates += self.n_epochs
        self._record(statistics, batches, clip_range)

    def _record(self, statistics: np.ndarray, batches: int, clip_range: float) -> None:
        """Log the same values as SB3."""
        policy_loss, value_loss, entropy, kl, clipped = statistics.T
        loss = policy_loss[-1] + self.ent_coef * entropy[-1] + self.vf_coef * value_loss[-1]
        buffer = self.rollout_buffer
        record = self.logger.record
        record("train/entropy_loss", np.mean(entropy))
        record("train/policy_gradient_loss", np.mean(policy_loss))
        record("train/value_loss", np.mean(value_loss))
        record("train/approx_kl", np.mean(kl[-batches:]))
        record("train/clip_fraction", np.mean(clipped))
        record("train/loss", loss)
        record("train/explained_variance", explained_variance(buffer.values.ravel(), buffer.returns.ravel()))
        record("train/std", self.policy.log_std.detach().exp().mean().item())
        record("train/n_updates", self._n_updates, exclude="tensorboard")
        record("train/clip_range", clip_range)
