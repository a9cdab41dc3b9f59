"""Train the landing with Stable-Baselines3's PPO.

To run it and evaluate the policy:

    python examples/train_landing.py [SEED [STEPS [POLICY.zip]]]
    landing-eval success landing-ppo-0.zip
"""

import sys

import torch
from stable_baselines3 import PPO

from inclined_landing.envs import BatchVecEnv, make_batch, make_task, save_policy
from inclined_landing.train import AdaptiveCurriculum, CurriculumCallback, ppo_kwargs

seed, steps = (int(word) for word in (sys.argv[1:3] + ["0", "500_000"][len(sys.argv[1:3]) :]))
path = sys.argv[3] if len(sys.argv) > 3 else f"landing-ppo-{seed}.zip"
torch.set_num_threads(1)  # small networks: one thread is faster than two

# The settings of landing-train: a fast integrator, and a zone of some centimetres around the platform that
# counts as contact. Evaluation uses the plain plant.
task = make_task("landing")
engine = {"integrator": task.training.integrator, "keep_out": task.training.keep_out}
batch = make_batch("landing", 64, seed=seed, plant="hybrid", plant_options=engine)
env = BatchVecEnv(batch, reward_scale=0.1)

# Every argument is Stable-Baselines3's own and may be changed.
arguments = ppo_kwargs(task)
model = PPO("MlpPolicy", env, seed=seed, **arguments)

# One difficulty that follows the measured success; at its end the learning rate falls.
curriculum = AdaptiveCurriculum(arguments["gamma"])
callback = CurriculumCallback(curriculum, steps, arguments["learning_rate"])

model.learn(steps, callback, progress_bar=sys.stdout.isatty())
save_policy(model, path)
print(f"level {curriculum.level:.2f} of the curriculum after {model.num_timesteps} steps: {path}")
