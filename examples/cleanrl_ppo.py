"""PPO in one file, in the style of CleanRL, on `gymnasium.make_vec`; evaluated on the frozen grid at the end.

python examples/cleanrl_ppo.py [SEED [STEPS]]
"""

import sys

import gymnasium
import numpy as np
import torch

from inclined_landing.envs.tasks import frozen as starts
from inclined_landing.envs.tasks import hover_states
from inclined_landing.train import AdaptiveCurriculum, scaled_observation

seed, steps = (int(word) for word in (sys.argv[1:3] + ["0", "300_000"][len(sys.argv[1:3]) :]))
N, T, EPOCHS, BATCH = (
    64,
    64,
    5,
    256,
)  # vehicles, steps of each in a rollout, passes over it, samples a minibatch
GAMMA, LAMBDA, RATE, CLIP, REWARD_SCALE = 0.98, 0.95, 2e-3, 0.2, 0.1
torch.manual_seed(seed)
torch.set_num_threads(1)  # small networks: one thread is faster than two

engine = {"integrator": "implicitfast", "keep_out": 0.04}
env = gymnasium.make_vec(
    "inclined_landing:InclinedLanding-v0", num_envs=N, plant="hybrid", plant_options=engine
)
centre, scale = (torch.tensor(x) for x in scaled_observation(env.task)["features_extractor_kwargs"].values())
sizes, actions = env.single_observation_space.shape[0], env.single_action_space.shape[0]


def network(outputs: int, gain: float) -> torch.nn.Sequential:
    """Return a network with two hidden layers of 64."""
    layers = [torch.nn.Linear(sizes, 64), torch.nn.Linear(64, 64), torch.nn.Linear(64, outputs)]
    for layer, g in zip(layers, (2**0.5, 2**0.5, gain), strict=True):
        torch.nn.init.orthogonal_(layer.weight, g)
        torch.nn.init.zeros_(layer.bias)
    return torch.nn.Sequential(layers[0], torch.nn.Tanh(), layers[1], torch.nn.Tanh(), layers[2])


def seen(observation: np.ndarray) -> torch.Tensor:
    """Return observations as inputs of the networks."""
    return (torch.as_tensor(observation, dtype=torch.float32) - centre) / scale


actor, critic = network(actions, 0.01), network(1, 1.0)
log_std = torch.nn.Parameter(torch.full((actions,), -0.4))
weights = [*actor.parameters(), *critic.parameters(), log_std]
optimizer = torch.optim.Adam(weights, lr=RATE, eps=1e-5)
curriculum = AdaptiveCurriculum(GAMMA)  # without one, no landing is learned
env.set_conditions(curriculum.conditions())
x = seen(env.reset(seed=seed)[0])
rewards, values, ends, length = np.zeros((T, N)), np.zeros((T + 1, N)), np.zeros((T, N)), np.zeros(N, int)

for done in range(N * T, steps + 1, N * T):
    xs, us, logs = [], [], []
    for t in range(T):
        with torch.no_grad():
            policy = torch.distributions.Normal(actor(x), log_std.exp())
            u, values[t] = policy.sample(), critic(x)[:, 0].numpy()
        xs, us, logs = [*xs, x], [*us, u], [*logs, policy.log_prob(u).sum(1)]
        observation, reward, terminated, truncated, info = env.step(u.clamp(-1, 1).numpy())
        rewards[t], ends[t], length = REWARD_SCALE * reward, terminated | truncated, length + 1
        for i in np.flatnonzero(ends[t]):
            curriculum.episode(info["is_success"][i], length[i])
            if truncated[i]:  # the episode would have gone on
                rewards[t, i] += GAMMA * critic(seen(info["final_obs"][i])).item()
            length[i] = 0
        x = seen(observation)
    values[T] = critic(x)[:, 0].detach().numpy()
    advantage = np.zeros((T + 1, N))
    for t in reversed(range(T)):
        delta = rewards[t] + GAMMA * values[t + 1] * (1 - ends[t]) - values[t]
        advantage[t] = delta + GAMMA * LAMBDA * (1 - ends[t]) * advantage[t + 1]
    targets = torch.as_tensor((advantage + values)[:T].ravel(), dtype=torch.float32)
    gains = torch.as_tensor(advantage[:T].ravel(), dtype=torch.float32)
    xs, us, logs = torch.cat(xs), torch.cat(us), torch.cat(logs)
    for batch in (b for _ in range(EPOCHS) for b in torch.randperm(N * T).split(BATCH)):
        policy, gain = torch.distributions.Normal(actor(xs[batch]), log_std.exp()), gains[batch]
        ratio = (policy.log_prob(us[batch]).sum(1) - logs[batch]).exp()
        gain = (gain - gain.mean()) / (gain.std() + 1e-8)
        surrogate = torch.min(ratio * gain, ratio.clamp(1 - CLIP, 1 + CLIP) * gain).mean()
        loss = 0.5 * (critic(xs[batch])[:, 0] - targets[batch]).pow(2).mean() - surrogate
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(weights, 0.5)
        optimizer.step()
    curriculum.advance(done)
    env.set_conditions(curriculum.conditions())
    optimizer.param_groups[0]["lr"] = max(RATE * curriculum.learning_rate_share(done, steps), 1e-3 * RATE)

judge = gymnasium.make_vec(
    "InclinedLanding-v0", num_envs=len(starts.grid())
)  # the plain plant, no training aids
observation, _ = judge.reset(options={"state": hover_states(starts.grid(), judge.task.vehicle)})
flying, strict = np.ones(judge.num_envs, bool), 0
for _ in range(judge.task.max_steps):
    with torch.no_grad():
        action = actor(seen(observation)).clamp(-1, 1).numpy()
    observation, _, terminated, truncated, info = judge.step(action)
    strict += int((flying & info["is_success"] & ~info["touched"]).sum())
    flying &= ~(terminated | truncated)
print(f"seed {seed}, {steps} steps: {strict} of {judge.num_envs} starts of the frozen grid, strict")
