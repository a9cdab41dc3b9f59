"""A plant with a pool of vehicles: each flies as in a plant of its own."""

import functools

import numpy as np
import pytest

from inclined_landing.models.attitude import LAG, Z
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import load_vehicle, vehicle_names
from inclined_landing.models.plants import make_plant

V = load_vehicle()
# Without loads: scenes with one have a body more, see `test_vehicles_with_and_without_loads_share_a_plant`.
UNLOADED = [effect for effect in LIBRARY.values() if effect.name != "slung_load"]
EFFECTS = {effect.name: effect.apply(V, effect.plausible) for effect in UNLOADED}
FIELDS = {
    "mass": V.changed(body_mass=0.028),
    "inertia": V.changed(body_inertia=(2e-5, 1.5e-5, 3e-5)),
    "gravity": V.changed(environment_gravity=9.0),
    "friction": V.changed(contact_friction=0.2),
    "spring": V.changed(contact_solref=(-2e4, -60.0)),
    "torque limits": V.changed(attitude_torque_limit=1e-3, attitude_yaw_torque_limit=1e-4),
    "bandwidth": V.changed(attitude_bandwidth=30.0, attitude_yaw_bandwidth=5.0),
    "motor maps": V.changed(motor_pwm_to_force=(1e-11, 2e-6, 1e-4), motor_pwm_to_speed=(0.05, 300.0)),
    "drag": V.changed(drag_coefficients=(-2e-6, -1e-6, -3e-6)),
    "disturbance": V.changed(
        disturbance_acceleration=(0.5, 0.1, 0.2), disturbance_acceleration_time=(0.3, 0.3, 0.3)
    ),
    "two delays": V.changed(effects_thrust_delay=0.013, effects_attitude_delay=0.047),
    "all at once": functools.reduce(lambda v, e: e.apply(v, e.plausible), UNLOADED, V),
}
LOADED = {
    "light": V.changed(effects_load_mass=0.002, effects_load_length=0.3),
    "heavy": V.changed(effects_load_mass=0.02, effects_load_length=1.2),
    "all at once": LIBRARY["slung_load"].apply(FIELDS["all at once"], {"mass": 0.004, "length": 0.2}),
}
POOL = {**EFFECTS, **FIELDS}
SIZES = {name: load_vehicle(name) for name in vehicle_names()}
STEPS = 30
ANALYTIC = pytest.param("analytic", {}, id="analytic")
LOOP = pytest.param("analytic", {"attitude": "rate_loop"}, id="analytic rate_loop")
MUJOCO = pytest.param("mujoco", {}, id="mujoco")
HYBRID = pytest.param("hybrid", {}, id="hybrid")
KINEMATIC = pytest.param("mujoco", {"attitude": "kinematic"}, id="mujoco kinematic")


def starts(n):
    """A little above the slab's middle, so that most of them touch it before long."""
    state = np.zeros((n, 13))
    state[:, Z], state[:, LAG] = 1.3, V.hover_lag
    return state


def begin(plant, choice):
    ids = np.arange(plant.n)
    plant.assign(ids, choice)
    plant.set_platform(ids, V.platform_inclination + plant.tilt)
    plant.reset(ids, starts(plant.n))
    return plant


def alone(kind, vehicle, **options):
    plant = make_plant(kind, 1, vehicle, **options)
    plant.set_platform([0], plant.inclination)
    plant.reset([0], starts(1))
    return plant


def flight(plant, commands):
    """Everything that is seen of each vehicle: (n, ...)."""
    rows = []
    for u in commands:
        plant.step(np.broadcast_to(u, (plant.n, 4)))
        seen = plant.state, plant.measurement, plant.contacts.touch, plant.contacts.force
        rows.append(np.concatenate([x.reshape(plant.n, -1) for x in seen], axis=1))
    return np.stack(rows, axis=1)


def commands(steps=STEPS, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform([15_000, -0.5, -0.5, -3], [45_000, 0.5, 0.5, 3], (steps, 4))


@pytest.mark.parametrize("kind, options", [ANALYTIC, LOOP, MUJOCO, KINEMATIC, HYBRID])
@pytest.mark.parametrize("members", [POOL, LOADED, SIZES], ids=["pool", "loaded", "sizes"])
def test_each_flies_as_in_a_plant_of_its_own(kind, options, members):
    """Bit for bit: equations, engine's model and command histories are the same numbers.

    With other attitude dynamics than usual all effects at once, which are among the loaded, stand for each.
    """
    if members is POOL and "attitude" in options:
        members = FIELDS
    pool = list(members.values())
    own = LOADED["light"] if members is LOADED else V
    together = begin(make_plant(kind, len(pool), own, pool=pool, **options), np.arange(1, len(pool) + 1))
    found = flight(together, commands())
    for k, vehicle in enumerate(pool):
        expected = flight(alone(kind, vehicle, **options), commands())[0]
        np.testing.assert_array_equal(found[k], expected, err_msg=list(members)[k])
    touched = found[:, :, 26 : 26 + 9].any(axis=(1, 2))
    assert touched.mean() > 0.25


@pytest.mark.parametrize("kind, options", [ANALYTIC, LOOP, MUJOCO, KINEMATIC, HYBRID])
def test_vehicles_with_and_without_loads_share_a_plant(kind, options):
    """In the engine whoever has none carries 1e-10 kg: in the air 3e-8 m/s2, for 0.2 s."""
    pool = [LOADED["heavy"], FIELDS["mass"]]
    together = begin(make_plant(kind, 3, V, pool=pool, **options), [0, 1, 2])
    found = flight(together, commands(10))[..., :13]
    for k, vehicle in enumerate((V, *pool)):
        own = flight(alone(kind, vehicle, **options), commands(10))[0, :, :13]
        np.testing.assert_allclose(found[k], own, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("kind, options", [ANALYTIC, MUJOCO, HYBRID])
def test_others_fly_on_while_some_become_another(kind, options):
    pool = list(POOL.values())
    flights = []
    for others_change in (False, True):
        plant = begin(make_plant(kind, 4, V, pool=pool, **options), [3, 8, 20, 30])
        rows = [flight(plant, commands(20))[:2]]
        if others_change:
            ids = np.array([2, 3])
            plant.assign(ids, [40, 1])
            plant.set_platform(ids, V.platform_inclination + plant.tilt[ids])
            plant.reset(ids, starts(2))
        rows.append(flight(plant, commands(20, seed=1))[:2])
        flights.append(np.concatenate(rows, axis=1))
        if others_change:  # and nothing of what they were before is left
            new = begin(make_plant(kind, 4, V, pool=pool, **options), [3, 8, 40, 1])
            expected = flight(new, commands(20, seed=1))[2:, -1]
            np.testing.assert_array_equal(plant.state[2:], expected[:, :13])
    np.testing.assert_array_equal(*flights)


@pytest.mark.parametrize("changed, sentence", [
    ({"command_angle_limit": 0.4}, "command.angle_limit must be the same for all vehicles"),
    ({"platform_width": 1.0}, "slab.half_length must be the same"),
    ({"command_pwm_range": (0.0, 60_000.0)}, "command.pwm_range must be the same"),
    ({"body_mass": -1.0}, "body.mass is -1 kg"),
])  # fmt: skip
def test_vehicles_that_do_not_go_together_are_refused(changed, sentence):
    with pytest.raises(UserError, match=sentence):
        make_plant("analytic", 2, V, pool=[V, V.changed(**changed)])


def test_unknown_vehicle_numbers_are_refused():
    plant = make_plant("analytic", 2, V, pool=[V])
    for wrong in (2, -1):
        with pytest.raises(UserError, match="choose vehicles 1 to 1 of the pool"):
            plant.assign(np.arange(2), [0, wrong])
    assert not plant.choice.any()
    snapshot = make_plant("analytic", 2, V, pool=[V, V])
    snapshot.assign(np.arange(2), [2, 2])
    with pytest.raises(UserError, match="a different pool"):
        plant.restore(snapshot.save())
