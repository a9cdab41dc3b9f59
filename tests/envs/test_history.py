"""The task option `history`: what a policy is given besides the present observation."""

import numpy as np
import pytest

from inclined_landing.envs.batch import BatchEnv
from inclined_landing.envs.flights import record_flights
from inclined_landing.envs.tasks import TASKS, make_task
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import make_plant
from tests.policy_files import pilot

K = 3


def build(name="landing", n=4, plant="analytic", vehicle=None, history=K, **options) -> BatchEnv:
    vehicle = vehicle or load_vehicle()
    task = make_task(name, vehicle, pwm_centre="hover", history=history)
    return BatchEnv(task, make_plant(plant, n, vehicle, **options), seed=0)


@pytest.mark.parametrize("name", TASKS)
def test_the_past_is_stacked_as_a_list_of_steps_is(name):
    """Against Python lists, one per vehicle; episodes begin at different times, the camera is late."""
    late = LIBRARY["mocap_delay"].apply(load_vehicle(), {"delay": 0.04})
    env = build(name, plant="mujoco", vehicle=late, threads=1)
    plain = build(name, plant="mujoco", vehicle=late, threads=1, history=0)
    rng = np.random.default_rng(1)
    first = plain.reset()
    idle = np.zeros(len(env.task.action_names))
    lists = [[(row, idle)] * K for row in first]
    given, seen = env.reset(), first
    for k in range(12):
        for i, row in enumerate(given):
            past = [part for pair in lists[i][:K] for part in pair]
            np.testing.assert_array_equal(row, np.concatenate([seen[i], *past]).astype(np.float32))
        actions = rng.uniform(-1.5, 1.5, (env.n, len(idle)))
        lists = [[(seen[i], np.clip(actions[i], -1, 1)), *lists[i]] for i in range(env.n)]
        given, seen = env.step(actions).observation, plain.step(actions).observation
        if k == 5:
            ids = np.array([0, 2])
            given[ids], seen[ids] = env.reset(ids), plain.reset(ids)
            for i in ids:
                lists[i] = [(seen[i], idle)] * K
        np.testing.assert_array_equal(env.observe(), given)


def test_a_recorded_flight_gives_the_policy_its_history():
    env = build(n=3)
    policy = pilot(env.task)
    states = env.task.sample(np.random.default_rng(2), 3).state
    flights = record_flights(policy, make_plant("analytic", 3), states, steps=30)
    observation = env.reset(state=states)
    for k in range(30):
        actions = policy.predict(observation)
        for i, flight in enumerate(flights):
            np.testing.assert_array_equal(flight.actions[k], actions[i])
        observation = env.step(actions).observation
    without = record_flights(
        pilot(make_task("landing", history=0)), make_plant("analytic", 3), states, steps=2
    )
    assert not np.array_equal(without[0].actions, flights[0].actions[:3])
