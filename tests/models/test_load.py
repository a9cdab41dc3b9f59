"""The slung load: a pendulum under a moving vehicle, in equations and engine."""

import math

import numpy as np
import pytest

from inclined_landing.eval.truth.equivalence.flying import UNLIMITED, full_steps, largest_gaps
from inclined_landing.eval.truth.equivalence.levels import FLIGHT_LIMITS
from inclined_landing.models import forces, load
from inclined_landing.models.attitude import LAG, VX, VZ, X, Z
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import make_plant

SHIPPED = load_vehicle()
MASS, LENGTH = 0.005, 0.4
V = SHIPPED.changed(effects_load_mass=MASS, effects_load_length=LENGTH)
AIRLESS = V.changed(drag_coefficients=(0.0, 0.0, 0.0))
G, M = V.environment_gravity, V.body_mass
SHARE = MASS / (M + MASS)
SWING = math.sqrt(G / LENGTH * (1.0 + MASS / M))  # rad/s, of a small swing under a hovering vehicle
PLANTS = [
    pytest.param("analytic", {"attitude": "rate_loop", "substeps": 5}, id="analytic"),
    pytest.param("analytic", {"substeps": 5}, id="analytic kinematic"),
    pytest.param("mujoco", {}, id="mujoco"),
    pytest.param("mujoco", {"attitude": "kinematic"}, id="mujoco kinematic"),
    pytest.param("hybrid", {}, id="hybrid"),
]


def aloft(kind, options, vehicle=AIRLESS, n=1):
    """A plant whose vehicles hover 50 m above the floor, without a platform."""
    plant, state = make_plant(kind, n, vehicle, **options), np.zeros((n, 13))
    plant.set_platform(np.arange(n), 0.0, False)
    state[:, Z], state[:, LAG] = 50.0, vehicle.hover_lag
    plant.reset(np.arange(n), state)
    return plant


def flown(plant, steps, pwm):
    """States and loads (steps + 1, 19) of one vehicle held level at a PWM."""
    rows = [np.concatenate([plant.state[0], plant.load[0]])]
    for _ in range(steps):
        plant.step(np.array([[pwm, 0.0, 0.0, 0.0]]))
        rows.append(np.concatenate([plant.state[0], plant.load[0]]))
    return np.array(rows)


@pytest.mark.parametrize("kind, options", PLANTS)
def test_the_rotors_carry_both(kind, options):
    plant = aloft(kind, options)
    assert forces.settled_hover(AIRLESS) == pytest.approx(AIRLESS.hover_pwm, rel=1e-12)
    assert AIRLESS.hover_pwm == pytest.approx(SHIPPED.hover_pwm * (1.0 + MASS / M), rel=1e-12)
    rows = flown(plant, 100, AIRLESS.hover_pwm)
    # Forces cancel to roundings of g, 2e-15 m/s2, over 2 s.
    np.testing.assert_allclose(rows[-1, VX : VZ + 1], 0.0, atol=1e-12)
    np.testing.assert_allclose(rows[-1, 13:], load.HANGING, atol=1e-12)


@pytest.mark.parametrize("kind, options", PLANTS)
def test_a_small_swing_has_its_frequency(kind, options):
    """q_x = e cos(w t), w^2 = g/L (1 + m_l/m), and the vehicle moves against it about the common centre."""
    e, steps = 0.01, 150
    plant = aloft(kind, options)
    plant.set_load([0], [math.sin(e), 0.0, -math.cos(e)])
    rows = flown(plant, steps, AIRLESS.hover_pwm)
    wanted = e * np.cos(SWING * 0.02 * np.arange(steps + 1))
    # An amplitude e slows it by a share of e^2/4 at most: over 3 s, 16 rad, by 4e-4 e.
    np.testing.assert_allclose(rows[:, 13], wanted, atol=4e-4 * e)
    centre = rows[:, X] + SHARE * LENGTH * rows[:, 13]
    assert np.ptp(centre) < 1e-9 and np.ptp(rows[:, X]) > 1.9 * SHARE * LENGTH * e


def energy(rows, thrust):
    """Energy (k,) [J] of vehicle and load, that of a constant upward thrust [N] included."""
    q, rate = rows[:, 13:16], rows[:, 16:]
    loads = rows[:, VX : VZ + 1] + LENGTH * rate
    moving = M * (rows[:, VX : VZ + 1] ** 2).sum(axis=1) + MASS * (loads**2).sum(axis=1)
    return 0.5 * moving + (M * G - thrust) * rows[:, Z] + MASS * G * (rows[:, Z] + LENGTH * q[:, 2])


@pytest.mark.parametrize("kind, options", PLANTS)
@pytest.mark.parametrize("share", [0.0, 1.0])
def test_energy_is_conserved(kind, options, share):
    """A wide swing on all sides, under a vehicle in hover and one that falls; the string stays taut."""
    plant, pwm = aloft(kind, options), share * AIRLESS.hover_pwm
    state = plant.state.copy()
    state[:, LAG] *= share
    plant.reset([0], state)
    plant.set_load([0], [math.sin(1.0), 0.0, -math.cos(1.0)], [0.0, 3.0, 0.0])
    rows = flown(plant, 100, pwm)
    total = energy(rows, share * (M + MASS) * G)
    # An RK4 step is off by (w h)^5/120, 5.3 rad/s at most, in 500 steps by 2e-8. In the engine the load's own
    # moment of inertia, 1e-7 of that about the joint, turns with it.
    scale = MASS * G * LENGTH
    assert np.abs(total - total[0]).max() < (2e-8 if kind == "analytic" else 1e-7) * scale
    np.testing.assert_allclose(np.linalg.norm(rows[:, 13:16], axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose((rows[:, 13:16] * rows[:, 16:]).sum(axis=1), 0.0, atol=1e-9)
    upward = share * (M + MASS) * G / M
    tension = [M * load.pull(*row[13:], 0.0, 0.0, upward, SHARE, LENGTH) for row in rows]
    assert min(tension) > 0.0


def test_both_plants_fly_it_alike():
    """Full commands for 3 s, from swings of all directions, with thrusts that differ, in moving air."""
    n, rng = 8, np.random.default_rng(2)
    vehicle = V.changed(
        disturbance_acceleration=(0.5, 0.3, 0.4), disturbance_acceleration_time=(0.2, 0.3, 0.1), **UNLIMITED
    )
    commands = full_steps(SHIPPED, n, np.random.default_rng(4))[:150]
    direction, rate = rng.normal(size=(n, 3)) - [0.0, 0.0, 2.0], rng.normal(size=(n, 3)) * 3.0
    flights = []
    for kind, options in (
        ("analytic", {"attitude": "rate_loop", "substeps": 5}),
        ("mujoco", {}),
        ("hybrid", {}),
    ):
        plant = aloft(kind, options | {"disturbance": 5}, vehicle, n)
        plant.set_thrust_scale(np.linspace(1.1, 0.9, n))
        plant.set_load(np.arange(n), direction, rate)
        rows = []
        for row in commands:
            plant.step(row)
            rows.append(np.concatenate([plant.state, plant.load], axis=1))
        flights.append(np.array(rows))
    metres, degrees = FLIGHT_LIMITS["rate_loop"]
    for other in flights[1:]:
        position, angle = largest_gaps(flights[0][..., :13], other[..., :13])
        assert position < metres and angle < degrees
        # The load's way is the vehicle's and LENGTH times its direction's.
        np.testing.assert_allclose(flights[0][..., 13:16], other[..., 13:16], atol=metres / LENGTH)
    assert plant.in_engine.sum() == 0 and np.abs(flights[0][..., 16:]).max() > 5.0


@pytest.mark.parametrize("length", [0.1, 0.5])
def test_a_step_along_a_measured_attitude_follows_the_equations(length):
    """`advance` at 10 ms with forces held over each step, against 100 steps of 0.1 ms."""
    rng = np.random.default_rng(3)
    force = np.cumsum(rng.normal(size=(300, 3)), axis=0) * 0.3
    force = np.clip(force, -6.0, 6.0) + [0.0, 0.0, G]  # m/s2, of up to 17 m/s2
    coarse, fine = (np.array([0.6, 0.0, -0.8, 0.0, 1.0, 0.0]) for _ in range(2))
    speed, wanted = np.zeros(3), np.zeros(3)
    for a in force:
        speed += 0.01 * np.array(load.advance(coarse, *a, SHARE, length, 0.01))
        for _ in range(100):
            wanted += 1e-4 * np.array(load.advance(fine, *a, SHARE, length, 1e-4))
    # A phase of sqrt(17/0.1) 0.01 = 0.13 a step: 0.13^5/120 = 3e-7 in each of 300; speed: SHARE L w of it.
    error = 300 * (math.sqrt(17.0 / length) * 0.01) ** 5 / 120
    assert np.abs(coarse[:3] - fine[:3]).max() < error
    assert np.abs(speed - wanted).max() < error * SHARE * math.sqrt(17.0 * length)


@pytest.mark.parametrize("kind, options", PLANTS)
def test_a_load_is_put_onto_its_sphere(kind, options):
    """Along the direction, with the part of the rate that turns it; of one vehicle, or of a mask."""
    plant = aloft(kind, options, V, 3)
    for one in ([1], np.array([False, True, False])):
        plant.set_load(one, [1.0, 1.0, -1.0], [2.0, 0.0, 0.0])
        np.testing.assert_allclose(plant.load[1, :3], np.array([1, 1, -1]) / math.sqrt(3.0))
        turn = np.array([2.0, 0, 0]) - 2.0 / 3.0 * np.array([1, 1, -1])
        np.testing.assert_allclose(plant.load[1, 3:], turn)
        plant.step(np.zeros((3, 4)))
        plant.reset(np.arange(3), plant.state)
        np.testing.assert_array_equal(plant.load, load.hanging(3))


@pytest.mark.parametrize("kind, options", PLANTS)
def test_a_vehicle_without_a_load_refuses_one(kind, options):
    with pytest.raises(UserError, match="no vehicle of this plant has a slung load"):
        aloft(kind, options, SHIPPED).set_load([0], [0.0, 0.0, -1.0])
    plant = aloft(kind, options)
    for direction in ([0.0, 0.0, 0.0], [math.nan, 0.0, 1.0]):
        with pytest.raises(UserError, match="direction of a slung load must be finite numbers"):
            plant.set_load([0], direction)
    np.testing.assert_array_equal(plant.load, load.hanging(1))


def test_strings_that_steps_cannot_follow_are_refused():
    with pytest.raises(
        UserError, match=r"the swing of a load on effects\.load_length of 130 1/s is too fast"
    ):
        make_plant("analytic", 1, V.changed(effects_load_length=0.02, effects_load_mass=0.25))
    with pytest.raises(UserError, match=r"effects\.load_mass is -0\.001 kg; it must be from 0"):
        make_plant("analytic", 1, V.changed(effects_load_mass=-0.001))


def test_the_effect_adds_loads_and_goes_with_the_vehicles_mass():
    effect = LIBRARY["slung_load"]
    mass, length = effect.parameters
    twice = effect.apply(
        effect.apply(SHIPPED, {"mass": 0.002, "length": 0.3}), {"mass": 0.004, "length": 0.6}
    )
    assert (twice.effects_load_mass, twice.effects_load_length) == pytest.approx((0.006, 0.5))
    less = effect.apply(V, {"mass": -MASS, "length": 1.0})
    assert less == V.changed(effects_load_mass=0.0) and less.hover_pwm == SHIPPED.hover_pwm
    heavier = mass.sized_for(SHIPPED.changed(body_mass=2.0 * M))
    assert heavier.plausible == pytest.approx(2.0 * mass.plausible)
    assert heavier.bounds == pytest.approx((0.0, 2.0 * mass.bounds[1]))
    assert mass.sized_for(V).possible == (-MASS, mass.bounds[1])
    # The length alone says nothing: it has no size, and is no end of two columns.
    assert length.size(1.2) == 0.0 and effect.reference is None
    assert effect.apply(SHIPPED, {"length": 1.2}) == SHIPPED
