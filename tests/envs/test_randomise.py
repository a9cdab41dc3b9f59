"""Vehicles that are drawn for every episode: their file, their pool, and whom they reach."""

import dataclasses
import functools

import numpy as np
import pytest

from inclined_landing.envs import randomise
from inclined_landing.envs.batch import EASY, BatchEnv
from inclined_landing.envs.flights import record_flights
from inclined_landing.envs.policy import load_policy
from inclined_landing.envs.randomise import read_ranges
from inclined_landing.envs.tasks import hover_states, make_task
from inclined_landing.envs.tasks.landing import AIDED
from inclined_landing.models.attitude import LAG, PITCH, VX, X, Z
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import constants, load_vehicle
from inclined_landing.models.plants import make_plant

V = load_vehicle()
PLANTS = "mujoco", "analytic", "hybrid"
FILE = """
nominal = 0.25
probability = 0.5
[effects.thrust_scale]
scale = [0.8, 1.1]  # worn propellers
probability = 1
[effects.attitude_delay]
delay = [0.01, 0.03]
[effects.platform_tilt]
offset = [0.04, 0.05]
[effects]
wind = [[-1, 1], [0.5, 0.5]]
[body]
mass = [0.03, 0.04]
"""


def written(folder, text=FILE):
    path = folder / "ranges.toml"
    path.write_text(text, "utf-8")
    return read_ranges(path)


@functools.cache
def robust():
    return tuple(read_ranges("robust").draw(V, 0))


def environment(plant, n, pool=(), nominal=None, seed=0, **options):
    return BatchEnv(make_task("landing"), make_plant(plant, n, pool=pool), seed, nominal, **options)


def test_a_file_of_ranges(tmp_path):
    ranges = written(tmp_path)
    assert ranges.nominal == 0.25
    assert ranges.fields == {"effects_wind": ((-1.0, 1.0), (0.5, 0.5)), "body_mass": ((0.03, 0.04),)}
    assert ranges.effects == {
        "thrust_scale": {"scale": (0.8, 1.1)},
        "attitude_delay": {"delay": (0.01, 0.03)},
        "platform_tilt": {"offset": (0.04, 0.05)},
    }
    assert ranges.probability == {"thrust_scale": 1.0, "attitude_delay": 0.5, "platform_tilt": 0.5}


@pytest.mark.parametrize("text, sentence", [
    ("", r"contains no range, such as scale = \[0.8, 1.1\] in \[effects.thrust_scale\]"),
    ("nominal = 0.5", "contains no range"),
    ("thrust_scale = [0.8, 1.1]", "thrust_scale is outside any table"),
    ("[effects.thrust]\nscale = [1, 2]", f"unknown effect thrust; choose from {len(LIBRARY)} names, such"),
    ("[effects.mass]\nfactor = [1, 2]", "effect mass has no parameter factor; choose from scale"),
    ("[effects.mass]\nprobability = 1", "effect mass has no range; its parameters are scale"),
    ("[effects]\nthrust = [1, 2]", "effects.thrust is not an effect with parameters, .* or an entry"),
    ("[body]\nweight = [1, 2]", "body.weight is not an entry of the vehicle file"),
    ("[effects.mass]\nscale = [0, 1]", r"scale\[0\] must be a number from 0.6 to 1.8, not 0"),
    ("[effects.mass]\nscale = [1.1, 0.9]", "mass.scale has its lower end 1.1 above its upper"),
    ("[body]\ninertia = [1e-5, 2e-5]", "body.inertia must be 3 ranges"),
    ("[command]\npwm_centre = [1, 2]", "command.pwm_centre cannot vary between vehicles"),
    ("[rotor]\narm = [0.03, 0.04]", "rotor.arm cannot vary between vehicles"),
    ("[platform]\nwidth = [0.7, 0.8]", "platform.width cannot vary between vehicles"),
    ("vehicles = ['hummingbird', 'sparrow']", "vehicle file sparrow does not exist"),
])  # fmt: skip
def test_wrong_files_are_refused(text, sentence, tmp_path):
    with pytest.raises(UserError, match=sentence) as refused:
        written(tmp_path, text)
    assert str(refused.value).startswith(f"randomise file {tmp_path}")


def test_a_pool_fills_its_ranges(tmp_path):
    """Evenly: of 100 numbers one in every hundredth; and half of the vehicles have what half have."""
    ranges, count = written(tmp_path), 100
    pool = ranges.draw(V, 0, count)
    assert pool == ranges.draw(V, 0, count) and pool != ranges.draw(V, 1, count)
    mass = np.sort([v.body_mass for v in pool])
    scale = np.sort([v.thrust_state_gain / V.thrust_state_gain for v in pool])
    for found, (low, high) in ((mass, (0.03, 0.04)), (scale, (0.8, 1.1))):
        edges = np.linspace(low, high, count + 1)
        assert (edges[:-1] - 1e-12 <= found).all() and (found <= edges[1:] + 1e-12).all()
    delays = np.array([v.effects_attitude_delay for v in pool])
    assert (delays > 0).sum() == 50 and delays[delays > 0].min() >= 0.01 and delays.max() <= 0.03
    assert {v.effects_wind[1] for v in pool} == {0.5}
    assert all(v.changed(body_mass=V.body_mass) != v for v in pool)


def test_a_pool_may_be_denser_towards_the_ends(tmp_path):
    """Arcsine distribution: 2/pi asin(sqrt(u)) of the numbers lie below u of the range, to a hundredth."""
    pool = written(tmp_path).draw(V, 0, 100, to_the_ends=True)
    mass = np.array([v.body_mass for v in pool])
    for u in (0.05, 0.1, 0.3, 0.5, 0.9):
        assert abs((mass < 0.03 + 0.01 * u).mean() - 2.0 / np.pi * np.arcsin(np.sqrt(u))) <= 0.01


def test_some_vehicles_of_a_pool_have_one_effect(tmp_path):
    """The share `alone` has one besides what all have, each equally often; the others are as before."""
    ranges = written(tmp_path)
    usual, pool = (ranges.draw(V, 0, 100, to_the_ends=True, alone=share) for share in (0.0, 0.3))
    assert pool[30:] == usual[30:]
    fields = "thrust_state_gain", "effects_attitude_delay", "platform_inclination"
    changed = np.array([[getattr(v, name) != getattr(V, name) for name in fields] for v in pool[:30]])
    assert changed.sum(axis=0).tolist() == [30, 15, 15] and (changed.sum(axis=1) == 2).all()


def test_deviations_alone(tmp_path):
    """At plausible sizes, else at both ends of the ranges; entries at both ends; named vehicles."""
    file = tmp_path / "ranges.toml"
    file.write_text(
        'vehicles = ["crazyflie-2.0", "crazyflie-2.1"]\n[effects.mass]\nscale = [0.9, 1.2]\n'
        "[effects.thrust_scale]\nscale = [0.9, 1.1]\n[body]\nmass = [0.03, 0.04]\n",
        "utf-8",
    )
    mass, lower, upper, light, heavy, *named = read_ranges(file).each_alone(V)
    assert mass == LIBRARY["mass"].apply(V, {"scale": 1.08})
    assert [lower, upper] == [LIBRARY["thrust_scale"].apply(V, {"scale": x}) for x in (0.9, 1.1)]
    assert [light, heavy] == [V.changed(body_mass=x) for x in (0.03, 0.04)]
    assert [v.body_mass for v in named] == [load_vehicle("crazyflie-2.0").body_mass, V.body_mass]
    robust = read_ranges("robust")
    alone = [
        LIBRARY[name].apply(V, {parameter: LIBRARY[name].plausible[parameter] for parameter in given})
        for name, given in robust.effects.items()
    ]
    assert {repr(v) for v in robust.each_alone(V)} == {repr(v) for v in alone}


@pytest.mark.parametrize("plant", PLANTS)
def test_every_episode_draws_its_vehicle(plant, tmp_path):
    ranges = written(tmp_path)
    pool = ranges.draw(V, 0)
    env = environment(plant, 200, pool, ranges.nominal)
    env.reset()
    first, vehicles = env.plant.choice.copy(), (V, *pool)
    # 200 draws with a share of 0.25: within 5 standard deviations
    assert abs((first == 0).mean() - 0.25) < 5 * np.sqrt(0.25 * 0.75 / 200)
    assert len(set(first[first > 0])) > 50
    lags = [vehicles[k].hover_lag for k in first]
    np.testing.assert_allclose(env.plant.state[:, LAG], lags, rtol=1e-12)
    tilts = np.array([vehicles[k].platform_inclination for k in first])
    np.testing.assert_allclose(env.plant.inclination, tilts, atol=1e-15)
    env.reset(np.array([3, 7]))
    assert set(np.flatnonzero(env.plant.choice != first)) <= {3, 7}
    kept = env.plant.choice.copy()
    env.reset(np.arange(5), np.tile(env.plant.state[0], (5, 1)))  # given starts are flown as they are
    np.testing.assert_array_equal(env.plant.choice, kept)


def test_vehicles_that_fail_are_drawn_more_often():
    """In proportion to EASY plus the share of failures; a new seed forgets them, and a record keeps them."""
    env = environment("analytic", 1000, [V, V], nominal=0.0, by_failure=True)
    env.task.conditions = AIDED
    env.reset()
    first, before = env.plant.choice.copy(), env.episode_state()
    states = env.plant.state.copy()
    states[:, [X, Z, PITCH]] = *env.task.goal_position, env.task.inclination  # in the goal box
    states[first == 2, X] = 10.0  # outside the arena
    env.reset(np.arange(env.n), states)
    step = env.step(np.tile([0.0, env.task.inclination / V.command_angle_limit], (env.n, 1)))
    assert (step.success == (first == 1)).all() and step.terminated.all()
    np.testing.assert_allclose(env.failures, [0.0, 1.0], atol=1e-9)
    env.reset()
    # 1000 draws of a share of 0.2 / 1.4: within 5 standard deviations
    share = EASY / (2.0 * EASY + 1.0)
    assert abs((env.plant.choice == 1).mean() - share) < 5 * np.sqrt(share * (1.0 - share) / env.n)
    env.restore_episodes(before)
    assert env.failures.tolist() == [0.5, 0.5]
    env.failures[:] = 1.0, 0.0
    env.seed(0)
    env.reset()
    np.testing.assert_array_equal(env.plant.choice, first)


@pytest.mark.parametrize("plant", PLANTS)
def test_without_ranges_nothing_is_drawn(plant):
    """And a pool of which none are taken changes no bit."""
    states = []
    for pool, nominal in (((), None), ((), 0.5), (robust()[:5], None)):
        env = environment(plant, 4, pool, nominal)
        env.reset()
        for _ in range(5):
            env.step(np.full((4, 2), 0.2))
        assert not env.plant.choice.any()
        states.append(env.plant.state.copy())
    np.testing.assert_array_equal(states[0], states[1])
    np.testing.assert_array_equal(states[0], states[2])


def test_policies_fly_the_assigned_vehicles():
    """As in a plant of their own; the platform's tilt is the vehicle's, the goal the task's."""
    policy = load_policy("landing-nominal")
    pool = [LIBRARY[name].apply(V, LIBRARY[name].plausible) for name in ("platform_tilt", "thrust_scale")]
    starts = hover_states([(1.0, 2.0)] * 3, policy.task.vehicle)
    plant = make_plant("mujoco", 3, policy.task.vehicle, pool=pool)
    plant.assign(np.arange(3), [1, 2, 0])
    flights = record_flights(policy, plant, starts)
    for flight, vehicle in zip(flights, (*pool, V)):
        assert flight.inclination == pytest.approx(vehicle.platform_inclination, abs=1e-15)
    alone = record_flights(policy, make_plant("mujoco", 1, pool[1]), starts[:1])[0]
    np.testing.assert_array_equal(flights[1].state, alone.state)


def test_a_drawn_vehicle_that_diverges_has_failed():
    """With thrust that grows with the speed it flies off; the others fly on as if they were alone."""
    wild = LIBRARY["translational_lift"].apply(V, {"coefficient": 0.15})
    policy = load_policy("landing-nominal")
    starts = hover_states([(1.0, 2.0)] * 2, policy.task.vehicle)
    starts[1, VX] = 5000.0
    plant = make_plant("hybrid", 2, V, pool=[wild])
    plant.assign([1], [1])
    flights = record_flights(policy, plant, starts)
    alone = record_flights(policy, make_plant("hybrid", 1, V), starts[:1])[0]
    np.testing.assert_array_equal(flights[0].state, alone.state)
    assert flights[0].success and not flights[1].success
    assert flights[1].duration < 1.0 and np.isfinite(flights[1].state).all()
    with pytest.raises(FloatingPointError):
        record_flights(policy, make_plant("hybrid", 1, wild), starts[1:])


def test_robust_spans_the_library():
    """Every effect of the library at its plausible size lies in its ranges; seeds can be drawn.

    But for those which the file says why to leave out.
    """
    left_out = ("slung_load", "foot_height", "attitude_integral", "attitude_saturation", "estimator_delay")
    ranges = read_ranges("robust")
    library = {name: effect for name, effect in LIBRARY.items() if name not in left_out}
    assert list(ranges.effects) == list(library) and "robust" in randomise.shipped()
    for name, effect in library.items():
        for parameter in effect.parameters:
            if parameter.name in (
                "hold",
                "torque",
            ):  # of the motors' requests, and of loops that hold a moment
                assert parameter.is_reference
                continue
            low, high = ranges.effects[name][parameter.name]
            assert low <= parameter.plausible <= high, (name, parameter.name)
            assert parameter.is_reference or low <= parameter.neutral <= high, (name, parameter.name)
    for seed in range(5):
        assert len(ranges.draw(V, seed)) == randomise.POOL


def test_every_entry_is_taken_or_cannot_differ(tmp_path):
    """A range that holds the vehicle file's own value gives it back, bit for bit, whichever entry it is."""
    taken = set()
    for entry in constants():
        values = entry.value if isinstance(entry.value, tuple) else (entry.value,)
        ranges = [[float(x), float(x)] for x in values]
        text = f"[{entry.section}]\n{entry.name} = {ranges if isinstance(entry.value, tuple) else ranges[0]}"
        try:
            pool = written(tmp_path, text).draw(V, 0, 2)
        except UserError as error:
            assert "cannot vary between vehicles" in str(error)
            continue
        taken.add(entry.section)
        assert pool == [V, V]
    assert taken == {
        *("body", "environment", "thrust", "motor", "drag", "attitude", "platform", "contact"),
        *("disturbance", "effects"),
    }


ROW = "crazyflie-2.0", "crazyflie-2.1", "crazyflie-2.1-brushless", "hummingbird"


def test_vehicles_between_named_ones_are_possible(tmp_path):
    """Mass, arms and thrust go together: every drawn vehicle flies as one of its neighbours could."""
    ranges = written(tmp_path, f"vehicles = {list(ROW)}")
    named = [load_vehicle(name) for name in ROW]
    pool = ranges.draw(V, 0, 120)
    assert pool == ranges.draw(V, 0, 120)
    for value in ("body_mass", "rotor_arm", "hover_pwm", "thrust_lag_rate"):
        found, ends = ([getattr(v, value) for v in vehicles] for vehicles in (pool, named))
        assert min(ends) * (1 - 1e-12) <= min(found) and max(found) <= max(ends) * (1 + 1e-12)
    between = [v for v in pool if 0.0393 < v.body_mass < 0.5]
    assert len(between) == 30  # each end has half a place of its own beside the three between
    mass = np.array([v.body_mass for v in between])
    # Arms between two vehicles are a power of the mass.
    power = np.log(0.1202 / 0.0354) / np.log(0.5 / 0.0393)
    arm = [v.rotor_arm for v in between]
    np.testing.assert_allclose(arm, 0.0354 * (mass / 0.0393) ** power, rtol=1e-12)
    for vehicle in pool:  # and all else is the plant's
        assert vehicle.platform_width == V.platform_width and vehicle.command_pwm_range == V.command_pwm_range


def test_no_vehicle_begins_in_its_platform():
    """Though the task knows the smallest: those of other sizes draw other starts."""
    pool = [load_vehicle("hummingbird")]
    env = BatchEnv(make_task("landing"), make_plant("analytic", 400, pool=pool, keep_out=0.04), 0, 0.5)
    env.task.conditions = dataclasses.replace(env.task.conditions, start_reach=0.5)
    env.reset()
    clear = env.plant.clearance(np.arange(400), env.plant.state)
    assert clear.min() > 0.04 and 0 < env.plant.choice.mean() < 1
    plain = BatchEnv(make_task("landing"), make_plant("analytic", 400), 0)
    plain.task.conditions = env.task.conditions
    plain.reset()
    env.plant.assign(np.arange(400), np.ones(400, int))
    assert env.plant.clearance(np.arange(400), plain.plant.state).min() < 0.04
