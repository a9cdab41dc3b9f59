"""The task option `observe_vehicle`, and an action 0 that is the hover of each vehicle."""

import shutil

import numpy as np
import pytest

from inclined_landing.envs.batch import BatchEnv
from inclined_landing.envs.flights import record_flights
from inclined_landing.envs.history import input_centre, input_names, input_scale
from inclined_landing.envs.policy import load_policy, locate, trained_options
from inclined_landing.envs.tasks import TASKS, make_task
from inclined_landing.envs.vehicle_parameters import NAMES, UNITS, vehicle_parameters
from inclined_landing.models.attitude import LAG, VZ
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import load_vehicle, vehicle_names
from inclined_landing.models.plants import make_plant
from tests.policy_files import pilot, restamp

V = load_vehicle()
# Those without effects: what is told is the linear drag, and their hover that of the transfer function.
FLEET = [
    vehicle
    for vehicle in map(load_vehicle, vehicle_names())
    if all(value == getattr(V, name) for name, value in vars(vehicle).items() if name.startswith("effects_"))
]


def told(task, observation):
    """The part of observations (n, i) that is the vehicles'."""
    return observation[:, len(input_names(task)) - len(NAMES) :]


def test_the_numbers_are_those_of_the_vehicle():
    numbers = dict(zip(NAMES, vehicle_parameters(V)))
    assert len(NAMES) == len(UNITS)
    assert numbers["thrust to weight"] == pytest.approx(60_000 / V.hover_pwm)
    assert numbers["thrust lag"] == pytest.approx(1 / 15.467)
    assert numbers["attitude lag"] == pytest.approx(0.183806 + 0.02)
    assert numbers["reach"] == pytest.approx(0.056)
    sagging = LIBRARY["thrust_bias"].apply(V, {"force": -0.02})
    assert vehicle_parameters(sagging)[0] < 0.96 * numbers["thrust to weight"]


def test_the_drag_rate_is_that_of_the_equations():
    """A vehicle that hovers level and drifts sideways slows down by this rate: e^(-rate t)."""
    for vehicle in FLEET:
        plant = make_plant("analytic", 1, vehicle)
        state = np.zeros((1, 13))
        state[0, [2, 3, LAG]] = 2.0, 0.5, vehicle.hover_lag
        plant.set_platform([0], 0.0, False)
        plant.reset([0], state)
        for _ in range(10):
            plant.step(np.array([[vehicle.hover_pwm, 0.0, 0.0, 0.0]]))
        rate = -np.log(plant.state[0, 3] / 0.5) / 0.2
        assert rate == pytest.approx(vehicle_parameters(vehicle)[4], rel=1e-3)


@pytest.mark.parametrize("name", TASKS)
def test_every_task_tells_each_vehicle_behind_its_history(name):
    task = make_task(name, observe_vehicle=True, history=2)
    assert task.options["observe_vehicle"] is True and input_names(task)[-len(NAMES) :] == NAMES
    assert len(input_centre(task)) == len(input_scale(task)) == len(input_names(task))
    env = BatchEnv(task, make_plant("hybrid", 8, pool=FLEET, threads=1), 0, nominal=0.3)
    plain = BatchEnv(make_task(name, history=2), make_plant("hybrid", 8, pool=FLEET, threads=1), 0, 0.3)
    seen = env.reset()
    table = np.array([vehicle_parameters(v) for v in (V, *FLEET)])
    np.testing.assert_array_equal(told(task, seen), table[env.plant.choice])
    np.testing.assert_array_equal(seen[:, : -len(NAMES)], plain.reset())
    before = env.plant.choice.copy()
    action = np.full((8, len(task.action_names)), 0.1)
    np.testing.assert_array_equal(told(task, env.step(action).observation), table[before])
    np.testing.assert_array_equal(told(task, env.reset(np.array([5, 1]))), table[env.plant.choice[[5, 1]]])


def test_what_is_hidden_in_the_plant_is_not_told():
    hidden = LIBRARY["thrust_scale"].apply(V, {"scale": 0.8})
    env = BatchEnv(make_task("landing", observe_vehicle=True), make_plant("analytic", 1, hidden), 0)
    np.testing.assert_array_equal(told(env.task, env.reset())[0], vehicle_parameters(V))


def test_action_0_is_the_hover_of_each_vehicle():
    task = make_task("landing", pwm_centre="own")
    env = BatchEnv(task, make_plant("hybrid", len(FLEET), pool=FLEET, threads=1), 0, nominal=0.0)
    env.reset()
    env.plant.assign(np.arange(len(FLEET)), 1 + np.arange(len(FLEET)))
    start = task.sample(np.random.default_rng(0), len(FLEET)).state
    start[:, 2] = 2.0
    start[:, LAG] = [v.hover_lag for v in FLEET]
    env.reset(state=start)
    for _ in range(10):
        env.step(np.zeros((len(FLEET), 2)))
    np.testing.assert_allclose(env.commands[:, 0], [v.hover_pwm for v in FLEET], rtol=1e-12)
    assert np.abs(env.plant.state[:, VZ]).max() < 1e-9
    fixed = BatchEnv(make_task("landing"), make_plant("hybrid", len(FLEET), pool=FLEET, threads=1), 0, 0.0)
    fixed.reset()
    fixed.step(np.zeros((len(FLEET), 2)))
    np.testing.assert_array_equal(fixed.commands[:, 0], V.hover_pwm)


def stamped(folder, **options):
    path = shutil.copy(locate("landing-nominal"), folder / "policy.zip")
    restamp(path, {"task": "landing", "task_options": options})
    return path


def test_a_policy_flies_each_vehicle_by_its_per_vehicle_hover_where_it_was_trained_so(tmp_path):
    path, big = stamped(tmp_path, pwm_centre="own"), load_vehicle("hummingbird")
    assert load_policy(path, vehicle=big).task.pwm_centre == big.hover_pwm
    assert load_policy(path).task.pwm_centre == V.hover_pwm
    assert load_policy(path, make_task("landing", big, pwm_centre="own")).task.per_vehicle_hover
    with pytest.raises(UserError, match=r"with pwm_centre='own', and .* pwm_centre=40000"):
        load_policy(path, make_task("landing", pwm_centre=40_000.0))
    path = stamped(tmp_path, pwm_centre=34_000.0)
    assert load_policy(path, vehicle=big).task.pwm_centre == 34_000.0
    with pytest.raises(UserError, match=r"with pwm_centre=34000, and .* pwm_centre='own'"):
        load_policy(path, make_task("landing", pwm_centre="own"))


def test_a_policy_is_not_flown_without_what_it_is_told(tmp_path):
    path = stamped(tmp_path, pwm_centre="hover", observe_vehicle=True)
    assert trained_options(path)["observe_vehicle"] and "observe_vehicle" not in trained_options("landing")
    with pytest.raises(UserError, match=r"trained with observe_vehicle=True, and .* observe_vehicle=False"):
        load_policy(path, make_task("landing"))
    with pytest.raises(UserError, match=r"takes 5 observations and returns 2 actions, but .* 11 and 2"):
        load_policy(path)
    with pytest.raises(UserError, match=r"trained with observe_vehicle=False, and .* observe_vehicle=True"):
        load_policy("landing-nominal", make_task("landing", observe_vehicle=True))


@pytest.mark.parametrize("history", [0, 2])
def test_a_policy_for_its_vehicle_alone_flies_the_same(history):
    """What it is told has become part of the first layer; to rounding, 1e-12 a step."""
    for vehicle in FLEET:
        task = make_task("landing", vehicle, observe_vehicle=True, pwm_centre="own", history=history)
        policy = pilot(task)
        alone = policy.with_fixed_vehicle()
        assert len(alone.centre) == len(policy.centre) - len(NAMES)
        assert alone.task.pwm_centre == task.pwm_centre and not alone.task.per_vehicle_hover
        states = task.sample(np.random.default_rng(2), 3).state
        flights = [record_flights(p, "analytic", states, steps=30) for p in (policy, alone)]
        for one, other in zip(*flights):
            np.testing.assert_allclose(one.actions, other.actions, rtol=0.0, atol=1e-6)
    plain = load_policy("landing-nominal")
    assert plain.with_fixed_vehicle() is plain
