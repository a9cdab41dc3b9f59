"""Touchdown training: what its actor begins as and what it is taught."""

import numpy as np
import pytest

from inclined_landing.envs.batch import BatchEnv
from inclined_landing.envs.policy import load_policy
from inclined_landing.envs.tasks import StepContext, hover_states, make_task
from inclined_landing.envs.tasks.touchdown import IDLE_ACTION
from inclined_landing.models.attitude import PITCH, VX, VZ
from inclined_landing.models.plants import make_plant
from inclined_landing.train import ppo, warm_start
from inclined_landing.train.config import TrainConfig
from inclined_landing.train.descent import Descent

TINY = {"environments": 8, "rollout": 16, "batch_size": 64, "epochs": 2, "threads": 1, "evaluate_every": 0}


def test_the_actor_begins_as_the_landing_policy():
    config = TrainConfig(task="touchdown", nominal=True, **TINY).resolved()
    env = ppo.training_environment(config)
    model = ppo.build_model(config, env)
    landing = load_policy("landing-nominal")
    warm_start.take_over(model, landing)
    observation = env.env.reset()
    mean, _ = model.predict(observation, deterministic=True)
    np.testing.assert_allclose(mean, landing.predict(observation), atol=1e-5)  # float32 against float64


def test_the_lesson_is_the_motor_cut():
    landing = load_policy("landing-nominal")
    task = landing.task
    over = hover_states(np.array([task.goal_position, (0.0, 1.20), (1.5, 1.8)]), task.vehicle)
    over[0, PITCH] = task.inclination
    context = StepContext(over, platform=task.start(over).platforms(task.vehicle))
    lesson = warm_start.lesson(context, landing)
    assert (lesson[:2, 0] < IDLE_ACTION).all() and lesson[2, 0] > IDLE_ACTION
    held = lesson[0, 1] * landing.task.vehicle.command_angle_limit * landing.task.vehicle.attitude_gain
    assert held == pytest.approx(task.inclination)


def test_the_law_comes_in_uphill():
    """So that slippery, springy contact does not begin to slide downhill; without `UPHILL` it is 0.19 m/s."""
    task = make_task("touchdown", dimensions=3)
    env = BatchEnv(task, make_plant("hybrid", 16, task.vehicle, threads=1, **task.plant_options), seed=0)
    law, speed = Descent(task), np.full(16, np.nan)
    env.reset()
    for _ in range(150):
        ahead, up = env.plant.state[:, VX], env.plant.state[:, VZ]
        before = ahead * np.cos(task.inclination) - up * np.sin(task.inclination)
        env.step(law(StepContext(env.plant.state, platform=env.plant.platform), -1.0), np.isnan(speed))
        speed = np.where(np.isnan(speed) & env.touched, before, speed)
    assert not np.isnan(speed).any() and np.median(speed) > 0.3
