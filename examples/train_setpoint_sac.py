"""Train the set-point with Stable-Baselines3's SAC.

To run it and evaluate the policy:

    python examples/train_setpoint_sac.py [SEED [STEPS [POLICY.zip]]]
    landing-eval success setpoint-sac-0.zip
"""

import sys

import torch
from stable_baselines3 import SAC

from inclined_landing.envs import BatchVecEnv, make_batch, save_policy
from inclined_landing.envs.tasks.setpoint import SetpointConditions
from inclined_landing.train import scaled_observation

seed, steps = (int(word) for word in (sys.argv[1:3] + ["0", "150_000"][len(sys.argv[1:3]) :]))
path = sys.argv[3] if len(sys.argv) > 3 else f"setpoint-sac-{seed}.zip"
torch.set_num_threads(1)

batch = make_batch("setpoint", 32, seed=seed, plant="analytic")
# Near the goal the task's penalty on effort punishes exploration a hundredfold: here it is limited.
batch.task.conditions = SetpointConditions(effort_floor=0.5, episode_limit=150)
env = BatchVecEnv(batch)

model = SAC(
    "MlpPolicy",
    env,
    seed=seed,
    device="cpu",
    learning_rate=1e-3,
    gamma=0.97,
    batch_size=256,
    learning_starts=5_000,
    train_freq=1,  # step of all vehicles
    gradient_steps=4,
    policy_kwargs={"net_arch": [64, 64], **scaled_observation(batch.task)},
)
model.learn(steps, progress_bar=sys.stdout.isatty())
save_policy(model, path)
print(f"after {model.num_timesteps} steps: {path}")
