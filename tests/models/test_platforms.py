"""Moving platforms: they follow their motion, nothing moves them, they carry along what stands on them."""

import dataclasses
import math

import numpy as np
import pytest

from inclined_landing.models import geometry
from inclined_landing.models.attitude import LAG, PITCH, ROLL, VX, VZ, YAW, X, Y, Z, rotation, rotations
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.motion import MODES, Motion
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import MujocoPlant, make_plant
from inclined_landing.models.plants.recorder import impulses
from inclined_landing.models.scene import compile_scene
from inclined_landing.models.surface import normals, relative

V = load_vehicle()
CALM = dataclasses.replace(V, drag_coefficients=(0.0, 0.0, 0.0))
MASS, G = V.body_mass, V.environment_gravity
OFF = np.zeros((1, 4))
STEP, PERIOD = 0.004, 0.02  # s, of the engine and of control
TAU = V.contact_solref[0]  # s, time constant of the contact


def motion(n: int = 1, travel=(0.0, 0.0, 0.0), **waves) -> Motion:
    """The same for n platforms; a wave is its mode's amplitude, frequency, phase."""
    moves = Motion.still(n)
    moves.waves.velocity[:] = travel
    for mode, values in waves.items():
        for part, value in zip(moves.waves[1:], values):
            part[:, MODES.index(mode)] = value
    return moves


def standing(plant, moves: Motion | None, *, inclination=0.0, azimuth=0.0, above=0.0) -> MujocoPlant:
    """The plant's vehicles on their platforms, moving with them, motors off; `above` [m] the surface."""
    ids = np.arange(plant.n)
    plant.set_platform(ids, inclination, azimuth=azimuth)
    if moves is not None:
        plant.set_motion(ids, moves)
    plant.reset(ids, plant.state)  # time 0
    state, platform = np.zeros((plant.n, 13)), plant.platform
    state[:, :LAG] = platform
    state[:, : Z + 1] += (plant.foot_height + above) * normals(platform)
    lever = state[:, : Z + 1] - platform[:, : Z + 1]
    turning = np.array([rotation(*d[ROLL : ROLL + 3]) @ d[9:12] for d in platform])
    state[:, VX : VZ + 1] += np.cross(turning, lever)
    plant.reset(ids, state)
    return plant


SWELL = {
    "surge": (0.2, 3.0, 0.3),
    "sway": (0.1, 5.0, 1.0),
    "heave": (0.1, 6.0, 2.0),
    "roll": (0.2, 4.0, 0.5),
    "pitch": (0.3, 3.0, 1.5),
    "yaw": (0.3, 2.0, 2.5),
}


@pytest.mark.parametrize("integrator", ["RK4", "implicitfast"])
def test_a_platform_follows_its_motion_under_a_hard_touchdown(integrator):
    """At every step of the engine, within the error of one control period, see `plants/platforms.py`.

    J T h^2 / 12 with J = amplitude frequency^3, and what the impulse of the touchdown, m v (1 + restitution)
    and a weight, gives an inertia of 1e5: at most 1e-6 of speed, for one period.
    """
    plant = MujocoPlant(2, moving=True, integrator=integrator, threads=1)
    moves = motion(2, travel=(0.5, -0.3, 0.2), **SWELL)
    standing(plant, moves, inclination=-0.3, azimuth=0.7, above=0.05)
    state = plant.state.copy()
    state[0, VZ] -= 2.0  # hits; the other one is elsewhere
    state[1, X] += 3.0
    plant.reset([0, 1], state)
    order = [0, 1, 2, 5, 3, 4]  # of the joints: yaw before roll and pitch
    size, turn, _ = (part[0, order, 0] for part in moves.waves[1:])
    bound = size * turn**3 * PERIOD * STEP**2 / 12 + PERIOD * 1e-6
    worst, strongest = np.zeros(6), 0.0
    for _ in range(40):
        begun = plant.batch.bind("time")[0]
        seen = plant.advance(np.zeros((2, 4)), record=("qpos",))["qpos"]
        strongest = max(strongest, plant.contacts.force[0].max())
        for k in range(5):
            platform = moves.platforms(begun + (k + 1) * STEP, plant.platforms.moving.rest)
            expected = platform[:, [X, Y, Z, 8, ROLL, PITCH]]
            worst = np.maximum(worst, np.abs(seen[:, k, 7:] - expected).max(axis=0))
        assert np.abs(seen[0, :, 7:] - seen[1, :, 7:]).max() < PERIOD * 1e-6
    assert strongest > 20 * MASS * G
    assert (worst < bound).all() and (worst > 0.1 * (bound - PERIOD * 1e-6)).all()


def test_how_quickly_platforms_stray_from_a_steady_path_is_bounded():
    """`most` bounds how far each corner of the slab strays within a control period."""
    rng, n = np.random.default_rng(6), 40
    moves = Motion(
        rng.normal(size=(n, 3)), *rng.uniform(0.0, [[[[0.1]]], [[[6.0]]], [[[7.0]]]], (3, n, 6, 2))
    )
    alone = np.arange(n)[:, None, None] % 6 == np.arange(6)[:, None]
    moves.waves.amplitude[20:] *= (alone & (np.arange(2) == 0))[20:]  # one wave: the bound is reached
    plant = MujocoPlant(n, moving=True, threads=1)
    plant.set_platform(np.arange(n), rng.uniform(-0.3, 0.3, n))
    plant.set_motion(np.arange(n), moves)
    rest, most = plant.platforms.moving.rest, plant.platforms.moving.most
    corners = np.array([[x, y, 0.0] for x in (-1, 1) for y in (-1, 1)])
    corners *= [V.slab_half_length, 0.5 * V.platform_depth, 0.0]

    def places(time):
        platform = moves.platforms(time, rest)
        return np.array([d[:3] + corners @ rotation(*d[ROLL : ROLL + 3]).T for d in platform])

    reached = 0.0
    for begin in np.arange(0.0, 3.0, 0.1):
        velocity = moves.platforms(begin, rest)[:, None, VX : VZ + 1]
        for after in np.linspace(0.0, PERIOD, 5)[1:]:
            strayed = (places(begin + after) - places(begin)) / after - velocity
            share = np.linalg.norm(strayed, axis=-1).max(axis=1) / most
            assert (share <= 1.0).all()
            reached = max(reached, share.max())
    assert reached > 0.8, "the bound is no mere guess"


def test_the_bound_of_a_vehicles_distance_is_below_that_of_its_shapes():
    """In any attitude, with slab and base; over the middle of a level slab it is the feet's own."""
    rng, n, level = np.random.default_rng(8), 400, 20
    state, slope = np.zeros((n, 13)), rng.uniform(-0.6, 0.6, n)
    state[:, : Z + 1] = rng.uniform([-0.7, -0.4, 0.6], [0.7, 0.4, 1.6], (n, 3))
    state[:, ROLL : YAW + 1] = rng.uniform(-0.9, 0.9, (n, 3))
    slope[:level] = state[:level, ROLL : YAW + 1] = state[:level, : Z + 1] = 0.0
    state[:level, Z] = V.platform_surface_height + rng.uniform(0.05, 0.3, level)
    shapes = geometry.shapes_of(compile_scene(V))
    poses, _ = geometry.platform_poses(slope, np.ones(n, bool), V)
    least = geometry.clearances(state, slope, poses, shapes)[:, :2].min(axis=(1, 2))
    frames = rotations(np.ascontiguousarray(state[:, ROLL : YAW + 1]))
    turns = [geometry.platform_turns(0.0, angle, 0.0) for angle in slope]
    of_each = zip(state[:, : Z + 1], frames[:, :, Z].copy(), turns, poses)
    bound = np.array([geometry.hull_distance(*parts, shapes, 0, 0.0) for parts in of_each])
    assert (bound <= least + 1e-12).all()
    np.testing.assert_allclose(bound[:level], least[:level], rtol=0.0, atol=1e-12)
    outside = least > 0.0
    assert outside.sum() > 200 and (least - bound)[outside].max() < 0.06  # the vehicle's sphere: up to 0.13


@pytest.mark.parametrize("kind", ["mujoco", "hybrid"])
def test_landings_are_the_same_seen_from_a_moving_frame(kind):
    """Galilean invariance, without the drag that knows the air's frame.

    Positions and speeds of some metres are rounded differently, at 1e-16 of them in each of 500 steps, and
    contacts with a time constant of 10 ms forget what they are given: 1e-12 m.
    """
    rng = np.random.default_rng(4)
    n, travel = 12, np.array([0.8, -0.5, 0.25])
    states = np.zeros((n, 13))
    states[:, : Z + 1] = rng.uniform([-0.25, -0.15, 1.45], [0.25, 0.15, 1.6], (n, 3))
    states[:, VX : VZ + 1] = rng.normal(size=(n, 3)) * 0.4
    states[:, ROLL : PITCH + 1] = rng.normal(size=(n, 2)) * 0.2
    inclination, azimuth = rng.uniform(-0.5, 0.5, n), rng.uniform(-3, 3, n)
    ends = []
    for speed in (0.0 * travel, travel):
        plant = make_plant(kind, n, CALM, moving=True, torque_needs_motors=True, threads=1)
        plant.set_platform(np.arange(n), inclination, azimuth=azimuth)
        plant.set_motion(np.arange(n), motion(n, travel=speed))
        begun = states.copy()
        begun[:, VX : VZ + 1] += speed
        plant.reset(np.arange(n), begun)
        for _ in range(100):
            plant.step(np.zeros((n, 4)))
        ends.append(plant.state.copy())
        ends[-1][:, : Z + 1] -= 2.0 * speed
        ends[-1][:, VX : VZ + 1] -= speed
    moved = np.abs(ends[1] - ends[0])[:, : Z + 1].max(axis=1)
    on_it = plant.contacts.touch[:, 0].any(axis=1)
    assert on_it.sum() >= 4
    assert moved[on_it].max() < 1e-12


@pytest.mark.parametrize("integrator", ["RK4", "implicitfast"])
def test_force_on_a_heaving_platform(integrator):
    """m (g + a), which the contact follows with its time constant: late by 2 tau, times m da/dt."""
    size, turn = 0.25, 4.0
    plant = MujocoPlant(1, moving=True, integrator=integrator, threads=1)
    standing(plant, motion(heave=(size, turn, 0.0)))
    for k in range(150):
        begun = plant.batch.bind("time")[0]
        plant.step(OFF)
        if k > 10:
            expected = MASS * (G - size * turn**2 * math.sin(turn * begun))
            late = 2 * TAU + PERIOD  # the largest of one control period is seen
            assert abs(plant.contacts.force[0, 0, 0] - expected) < MASS * size * turn**3 * late
    assert 0.25 * 4.0**3 * late < 0.3 * 4.0  # m/s2: small beside the acceleration of 4 m/s2


@pytest.mark.parametrize("moving", [False, True])
def test_impulses_of_contacts_explain_the_motion(moving):
    """m dv = impulse - m g dt in every engine step of a drop onto a level platform, to rounding."""
    plant = MujocoPlant(1, CALM, moving=moving, control_period=STEP, threads=1)
    moves = motion(travel=(0.5, 0.2, 0.0), heave=SWELL["heave"]) if moving else None
    standing(plant, moves, above=0.01)
    met = 0.0
    for _ in range(40):
        given, before = impulses(plant, OFF)[0], plant.state[0, VX : VZ + 1].copy()
        plant.step(OFF)
        gained = MASS * (plant.state[0, VX : VZ + 1] - before)
        np.testing.assert_allclose(
            gained, given - [0, 0, MASS * G * STEP], rtol=0, atol=1e-9 * MASS * G * STEP
        )
        met = max(met, np.linalg.norm(given))
    assert met > 5 * MASS * G * STEP
    with pytest.raises(UserError, match="need the integrator RK4"):
        impulses(MujocoPlant(1, integrator="implicitfast"), OFF)


def slip(acceleration, friction: float, seconds: float) -> float:
    """Largest distance [m] that a mass slides on a level platform of a given acceleration(t) [m/s2]."""
    dt, speed, place, farthest = 1e-4, 0.0, 0.0, 0.0
    for k in range(round(seconds / dt)):
        pull, hold = -acceleration(k * dt), friction * G * dt
        speed += pull * dt
        speed -= math.copysign(min(abs(speed), hold), speed)
        place += speed * dt
        farthest = max(farthest, abs(place))
    return farthest


@pytest.mark.parametrize("mode", ["surge", "sway"])
@pytest.mark.parametrize("share", [0.9, 1.3])
def test_a_platform_that_accelerates_faster_than_friction_slides_away(mode, share):
    """With 0.9 mu g it carries the vehicle along, with 1.3 mu g as Coulomb friction says."""
    friction, turn = 0.3, 3.0
    size = share * friction * G / turn**2
    plant = MujocoPlant(1, moving=True, threads=1)
    plant.set_contact([0], friction=friction)
    # Begins with the largest speed and without acceleration.
    standing(plant, motion(**{mode: (size, turn, 0.0)}))
    farthest = 0.0
    for _ in range(100):
        plant.step(OFF)
        place, _, _ = relative(plant.state, plant.platform)
        farthest = max(farthest, np.hypot(*place[0, :2]))
    expected = slip(lambda t: -size * turn**2 * math.sin(turn * t), friction, 2.0)
    # 0.1 mm/s of creep, and feet that settle into the surface by tau^2 g = 1 mm before they hold.
    assert abs(farthest - expected) < 0.05 * expected + 1e-3
    assert (expected > 0.02) == (share > 1.0)


@pytest.mark.parametrize("mode", ["roll", "pitch"])
def test_on_a_tilting_platform_it_slips_where_the_tangent_is_the_friction(mode):
    """Tilting at 0.12 rad/s it reaches 5 mm/s after the time in which g rate t^2/2 does: 0.011 rad later."""
    friction, turn = 0.3, 0.3
    plant = MujocoPlant(1, moving=True, threads=1)
    plant.set_contact([0], friction=friction)
    standing(plant, motion(**{mode: (0.5, turn, 0.0)}))
    for step in range(200):
        plant.step(OFF)
        _, velocity, _ = relative(plant.state, plant.platform)
        if step >= 5 and np.linalg.norm(velocity) > 5e-3:  # after it has settled into the surface
            break
    angle, rate = math.acos(normals(plant.platform)[0, 2]), 0.5 * turn * math.cos(turn * 2.0)
    late = rate * math.sqrt(2 * 5e-3 / (G * rate))
    assert math.atan(friction) < angle < math.atan(friction) + 1.5 * late


def test_standing_on_a_swell_it_rides_along():
    """On a platform that moves in all ways the vehicle stays where it stands, to 0.1 mm/s of creep."""
    plant = standing(MujocoPlant(1, moving=True, threads=1), motion(travel=(0.5, 0.2, 0.0), **{
        mode: (0.3 * size, turn, phase) for mode, (size, turn, phase) in SWELL.items()}))  # fmt: skip
    platform, state = plant.platform[0].copy(), plant.state[0].copy()
    place = rotation(*platform[6:9]).T @ (state[:3] - platform[:3])
    for _ in range(150):
        plant.step(OFF)
    platform, state = plant.platform[0], plant.state[0]
    now = rotation(*platform[6:9]).T @ (state[:3] - platform[:3])
    assert np.abs(now - place)[:2].max() < 3e-4 and plant.contacts.touch[0, 0, 0]


def test_a_platform_set_anew_stands_still():
    plant = standing(MujocoPlant(2, moving=True, threads=1), motion(2, travel=(1.0, 0, 0)))
    plant.step(np.zeros((2, 4)))
    assert plant.platform[:, X] == pytest.approx([0.02, 0.02]) and plant.platform[:, VX].tolist() == [
        1.0,
        1.0,
    ]
    np.testing.assert_array_equal(plant.platform_at(0.02), plant.platform)
    plant.set_platform([1], 0.2, azimuth=0.5)
    plant.step(np.zeros((2, 4)))
    assert plant.platform[0, X] == pytest.approx(0.04)
    assert plant.platform[1].tolist() == [0, 0, V.platform_surface_height, 0, 0, 0, 0, 0.2, 0.5, 0, 0, 0]
    plant.set_platform([1], 0.2, False)
    falling = plant.state.copy()
    falling[:, [X, Z]] = 0.0, 1.3
    plant.reset([0, 1], falling)
    for _ in range(30):
        plant.step(np.zeros((2, 4)))
    assert plant.state[1, Z] < 0.5  # through where it was


def test_motions_of_fixed_platforms_are_refused():
    for plant in (make_plant("analytic", 1), make_plant("mujoco", 1)):
        with pytest.raises(UserError, match="cannot move"):
            plant.set_motion([0], Motion.still(1))
    with pytest.raises(UserError, match="cannot move"):
        make_plant("analytic", 1, moving=True)
    with pytest.raises(UserError, match="platforms need"):
        MujocoPlant(2, moving=True).set_motion([0, 1], Motion.still(1))
