"""SB3 PPO with its default settings on one plain environment; prints its speed as JSON.

Run by `landing-eval benchmark` in a process of its own: python -m inclined_landing.eval.machine.baseline
"""

from __future__ import annotations

import argparse
import json
import time

from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from inclined_landing.eval.machine.plain_env import PlainLandingEnv
from inclined_landing.models.parameters import load_vehicle


class _Timer(BaseCallback):
    """Seconds from the first environment step on, so that no start-up counts."""

    def _on_training_start(self) -> None:
        self.began = time.perf_counter()

    def _on_step(self) -> bool:
        return True


def main() -> None:
    """Train for --steps (whole rollouts of 2048) and print steps, seconds and steps per second."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, required=True)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--vehicle")
    arguments = parser.parse_args()
    env = PlainLandingEnv(vehicle=load_vehicle(arguments.vehicle))
    env.reset(seed=arguments.seed)
    model = PPO("MlpPolicy", env, seed=arguments.seed, device="cpu")
    timer = _Timer()
    model.learn(arguments.steps, timer)
    seconds = time.perf_counter() - timer.began
    steps = int(model.num_timesteps)
    print(json.dumps({"steps": steps, "seconds": seconds, "steps_per_second": steps / seconds}))


if __name__ == "__main__":
    main()
