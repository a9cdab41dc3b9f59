"""The landing task as users write a Python environment: the baseline of `landing-eval benchmark`.

One `MjModel`, one `MjData`, a loop over `mj_step`, observation, reward and starts in NumPy. The scene,
the task's numbers and the results are those of `envs`; only the way of computing is the plain one.

`python -m inclined_landing.eval.machine.plain_env STEPS SEED [VEHICLE]` trains SB3's PPO with its defaults on
it, and prints the steps per second.
"""

from __future__ import annotations

import sys
import time

import gymnasium as gym
import mujoco
import numpy as np

from inclined_landing.envs.tasks import landing
from inclined_landing.models.geometry import PLATFORM_GEOMS
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants.mujoco import contact_sensors
from inclined_landing.models.scene import compile_scene
from inclined_landing.models.vehicle import Vehicle


class PlainLandingEnv(gym.Env):
    """`InclinedLanding` for one vehicle in the MuJoCo plant, RK4 at 4 ms."""

    def __init__(self, pwm_centre: float | None = None, vehicle: Vehicle | None = None):
        self.vehicle = v = vehicle or load_vehicle()
        self.task = landing.InclinedLanding(v)  # for its start filter only
        self.model = compile_scene(v)
        self.data = mujoco.MjData(self.model)
        self.found = contact_sensors(self.model)[: len(PLATFORM_GEOMS)].ravel()  # contacts with slab and base
        self.substeps = round(v.command_control_period / self.model.opt.timestep)
        self.pwm_centre = v.command_pwm_centre if pwm_centre is None else pwm_centre
        self.observation_space = gym.spaces.Box(-np.inf, np.inf, (5,), np.float32)
        self.action_space = gym.spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.goal = np.array([*self.task.goal_position, 0.0, 0.0, v.platform_inclination])
        d = landing.GOAL_SIZE
        speed = min(10 * d, 1.5)
        self.tolerance = np.array([d, d, speed, speed, 0.25 * d])
        self.steps = 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        state = (options or {}).get("state")
        if state is None:
            state = self.task.sample(self.np_random, 1).state[0]
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:3] = state[:3]
        self.data.act[0] = state[12]
        self.steps = 0
        return self._observation(), {}

    def step(self, action):
        v, data = self.vehicle, self.data
        action = np.clip(np.asarray(action, float), -1.0, 1.0)
        pwm = np.clip(self.pwm_centre + v.command_pwm_span * action[0], *v.command_pwm_range)
        data.ctrl[:] = [pwm, 0.0, v.command_angle_limit * action[1], 0.0]
        touching = False
        for _ in range(self.substeps):
            mujoco.mj_step(self.model, data)
            touching |= bool((data.sensordata[self.found] > 0).any())
        self.steps += 1
        observation = self._observation()
        reached = bool((np.abs(observation - self.goal) < self.tolerance).all())
        x, z = observation[:2]
        (x0, x1), (z0, z1), m = v.arena_x, v.arena_z, landing.BOUND_MARGIN
        if reached:
            reward = 0.0
        elif touching:
            reward = -7.0
        elif x < x0 + m or x > x1 - m or z < z0 + m or z > z1 - m:
            reward = -2.0
        else:
            reward = -1.0
        truncated = self.steps >= self.task.max_steps and not reached
        return observation.astype(np.float32), reward, reached, truncated, {}

    def _observation(self):
        q, v = self.data.qpos, self.data.qvel
        w, x, y, z = q[3:7]
        pitch = np.arctan2(-2.0 * (x * z - w * y), 1.0 - 2.0 * (x * x + y * y))
        return np.array([q[0], q[2], v[0], v[2], pitch], np.float32)


def main(steps: str, seed: str, vehicle: str | None = None) -> None:
    """Train for so many steps (whole rollouts of 2048) and print steps per second."""
    from stable_baselines3 import PPO

    env = PlainLandingEnv(vehicle=load_vehicle(vehicle))
    env.reset(seed=int(seed))
    model = PPO("MlpPolicy", env, seed=int(seed), device="cpu")
    began = time.perf_counter()
    model.learn(int(steps))
    print(model.num_timesteps / (time.perf_counter() - began))


if __name__ == "__main__":
    main(*sys.argv[1:])
