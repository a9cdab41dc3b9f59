"""Touchdown training: what it goes on from, what it is taught, its curriculum."""

from pathlib import Path

import numpy as np
import pytest

from inclined_landing.envs.batch import BatchEnv
from inclined_landing.envs.policy import load_policy
from inclined_landing.envs.tasks import TASKS, StepContext, hover_states, make_task
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


def test_in_space_it_begins_with_the_law_and_in_the_plane_with_a_landing():
    def begins(**options):
        return TrainConfig("touchdown", **options).resolved().start_from

    assert begins() == begins(dimensions=3) == begins(fastest=1.0) == "descent"
    assert begins(nominal=True) == begins(dimensions=2) == "landing-nominal"
    for name, dimensions in (("touchdown", 3), ("touchdown-nominal", None), ("landing-nominal", None)):
        resolved = TrainConfig("touchdown", start_from=name).resolved()
        assert (resolved.start_from, resolved.dimensions) == (name, dimensions)
    settings = [TrainConfig("touchdown", **o).resolved().log_std_init for o in ({}, {"nominal": True})]
    assert settings == [-2.2, -1.2]


def test_its_training_values_are_its_own():
    """The landing in the plane on drawn vehicles has others."""
    names = "environments", "rollout", "gae_lambda"
    of_class, touchdown = TASKS["touchdown"].training, TrainConfig("touchdown").resolved()
    landing = TrainConfig("landing").resolved()
    assert [getattr(touchdown, name) for name in names] == [getattr(of_class, name) for name in names]
    assert [getattr(touchdown, name) for name in names] != [getattr(landing, name) for name in names]


def test_in_space_it_draws_vehicles_unless_platforms_move():
    def drawn(**options):
        resolved = TrainConfig("touchdown", **options).resolved()
        return [getattr(resolved, name) for name in ("randomise", "history", "pwm_span")]

    assert drawn() == drawn(dimensions=3) == [Path("robust"), 3, 25_000.0]
    assert drawn(fastest=1.0) == [None, 3, 25_000.0]
    assert drawn(nominal=True) == drawn(dimensions=3, nominal=True) == [None, 0, 16_500.0]
