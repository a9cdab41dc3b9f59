"""The disturbance of the air: its statistics, alike in both plants, replayed from snapshots, off at first."""

import dataclasses
import math

import gymnasium
import numpy as np
import pytest

import inclined_landing.envs  # noqa: F401, registers the environments
from inclined_landing.eval.truth.equivalence.flying import UNLIMITED, full_steps, largest_gaps, start_states
from inclined_landing.eval.truth.equivalence.levels import FLIGHT_LIMITS
from inclined_landing.models.attitude import LAG, ROLL, VX, VZ, WX, WZ, YAW, Z
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle, write_vehicle
from inclined_landing.models.plants import make_plant

V = load_vehicle()
SIZES, TIMES = np.array([0.3, 0.2, 0.1, 4.0, 2.0, 1.0]), np.array([0.3, 0.5, 0.2, 0.1, 0.2, 0.05])
RESTLESS = dataclasses.replace(
    V,
    disturbance_acceleration=tuple(SIZES[:3]),
    disturbance_acceleration_time=tuple(TIMES[:3]),
    disturbance_angular=tuple(SIZES[3:]),
    disturbance_angular_time=tuple(TIMES[3:]),
)
BOTH = ("mujoco", "analytic")
N = 8
COMMANDS = full_steps(V, N, np.random.default_rng(4))[:100]


def plant_of(kind, n=N, vehicle=RESTLESS, **options):
    """High above everything."""
    own = {} if kind == "mujoco" else {"attitude": "rate_loop", "substeps": 5}
    plant = make_plant(kind, n, vehicle.changed(**UNLIMITED), **(own | options))
    plant.set_platform(np.arange(n), V.platform_inclination, False)
    plant.reset(np.arange(n), start_states(n))
    return plant


def fly(plant, commands=COMMANDS):
    """States (steps, n, 13) after every control step."""
    rows = []
    for row in commands:
        plant.step(row)
        rows.append(plant.state.copy())
    return np.array(rows)


@pytest.mark.parametrize("kind", BOTH)
def test_it_has_the_size_and_correlation_of_the_table(kind):
    """Four standard errors of n independent vehicles: 1/sqrt(2 n) of a size, 1/sqrt(n) of a correlation."""
    n, steps = 2000, 6
    plant = plant_of(kind, n, disturbance=1)
    drawn = [plant.disturbance.now.copy()]
    for _ in range(steps):
        plant.step(np.tile([V.hover_pwm, 0.0, 0.0, 0.0], (n, 1)))
        drawn.append(plant.disturbance.now.copy())
    for one in (drawn[0], drawn[-1]):
        np.testing.assert_allclose(one.std(axis=0), SIZES, rtol=4 / math.sqrt(2 * n))
        np.testing.assert_allclose(one.mean(axis=0) / SIZES, 0.0, atol=4 / math.sqrt(n))
    for k in (1, steps):
        found = (drawn[0] * drawn[k]).mean(axis=0) / SIZES**2
        np.testing.assert_allclose(
            found, np.exp(-k * V.command_control_period / TIMES), atol=4 * math.sqrt(2 / n)
        )
    across = np.corrcoef(drawn[0].T) - np.eye(6)
    assert np.abs(across).max() < 4 / math.sqrt(n)


@pytest.mark.parametrize("kind", BOTH)
def test_it_pushes_along_the_worlds_and_turns_about_the_bodys_axes(kind):
    """Against still air, after one period: velocity = acceleration dt, rates by the loops' impulse response.

    A level vehicle; drag takes 0.2 % of the velocity, a tilt of 1 mrad gives g times that for the period.
    """
    dt, a = V.command_control_period, 1 / V.attitude_time_constant
    b, c = V.attitude_bandwidth, V.attitude_yaw_bandwidth
    start = np.zeros((N, 13))
    start[:, Z], start[:, YAW], start[:, LAG] = 5.0, 0.7, V.hover_lag
    states = []
    for seed in (None, 3):
        plant = plant_of(kind, disturbance=seed)
        plant.reset(np.arange(N), start)
        push = plant.disturbance.now.copy() if seed else None
        plant.step(np.tile([V.hover_pwm, 0.0, 0.0, 0.0], (N, 1)))
        states.append(plant.state.copy())
    change = states[1] - states[0]
    np.testing.assert_allclose(change[:, VX : VZ + 1], push[:, :3] * dt, rtol=0.01, atol=9.81 * 1e-3 * dt)
    drive = (math.exp(-a * dt) - math.exp(-b * dt)) / (b - a)
    response = np.array([drive, drive, (1 - math.exp(-c * dt)) / c])
    np.testing.assert_allclose(change[:, WX : WZ + 1], push[:, 3:] * response, rtol=0.01, atol=1e-3)


def test_both_plants_fly_the_same_disturbance_alike():
    """The tolerances of the equivalence tests; in still air the flight is another.

    It is an acceleration: another mass changes thrust and drag over mass, not that.
    """
    metres, degrees = FLIGHT_LIMITS["rate_loop"]
    for scale in (1.5, 1.0):
        vehicle = RESTLESS.changed(body_mass=scale * RESTLESS.body_mass)
        flights = [fly(plant_of(kind, vehicle=vehicle, disturbance=7)) for kind in BOTH]
        position, angle = largest_gaps(*flights)
        assert position < metres and angle < degrees
    position, angle = largest_gaps(flights[1], fly(plant_of("analytic")))
    assert position > 100 * metres and angle > 100 * degrees


@pytest.mark.parametrize("kind", BOTH)
def test_kinematic_attitudes_have_no_torque(kind):
    plants = [plant_of(kind, disturbance=seed, attitude="kinematic") for seed in (7, None)]
    restless, still = (fly(plant) for plant in plants)
    np.testing.assert_allclose(restless[..., ROLL:LAG], still[..., ROLL:LAG], atol=1e-12)
    assert np.linalg.norm((restless - still)[-1, :, :3], axis=1).min() > 0.01


@pytest.mark.parametrize("kind", BOTH)
def test_it_is_reset_saved_and_restored(kind):
    first = fly(plant_of(kind, disturbance=7))
    plant = plant_of(kind, disturbance=np.random.default_rng(2))
    assert not np.array_equal(fly(plant), first)
    plant.disturbance.seed(7)
    plant.reset(np.arange(N), start_states(N))
    plant.reset(np.arange(N), start_states(N))  # as a new plant, which resets itself once
    fly(plant, COMMANDS[:10])
    snapshot = plant.save()
    later = fly(plant, COMMANDS[10:])
    np.testing.assert_array_equal(later, first[10:])
    other = plant_of(kind, disturbance=0)
    for one in (plant, other):
        one.restore(snapshot)
        np.testing.assert_array_equal(fly(one, COMMANDS[10:]), later)
    with pytest.raises(UserError, match="a different kind or size"):
        plant_of(kind).restore(snapshot)
    before = plant.disturbance.now.copy()
    plant.reset(np.array([1, 4]), start_states(2))
    assert (plant.disturbance.now != before).any(axis=1).nonzero()[0].tolist() == [1, 4]


@pytest.mark.parametrize("kind", BOTH)
def test_without_it_no_bit_changes(kind):
    plain = fly(plant_of(kind, vehicle=V))
    np.testing.assert_array_equal(fly(plant_of(kind)), plain)  # not asked for
    np.testing.assert_array_equal(fly(plant_of(kind, vehicle=V, disturbance=1)), plain)  # still air


def test_an_environment_has_the_disturbance_of_its_seed(tmp_path):
    write_vehicle(tmp_path / "restless.toml", RESTLESS)
    options = {"vehicle": str(tmp_path / "restless.toml"), "plant_options": {"disturbance": 0}}
    env = gymnasium.make("InclinedLanding-v0", **options)
    seen = []
    for seed in (1, 2, 1):
        env.reset(seed=seed)
        seen.append([env.step(np.full(env.action_space.shape, 0.1, np.float32))[0] for _ in range(5)])
    np.testing.assert_array_equal(seen[0], seen[2])
    assert not np.array_equal(seen[0], seen[1])


def test_wrong_disturbance_seeds_are_refused():
    for seed in (-1, 0.5, True, "gust"):
        with pytest.raises(
            UserError, match="disturbance must be a seed, a whole number from 0, or a generator"
        ):
            make_plant("analytic", 1, disturbance=seed)
    with pytest.raises(
        UserError, match=r"disturbance\.angular_time must be above 0 s where disturbance\.angular is"
    ):
        make_plant("analytic", 1, dataclasses.replace(V, disturbance_angular=(0.0, 0.1, 0.0)))
