"""Tasks over moving platforms: everything is relative to the platform."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from inclined_landing.envs.batch import BatchEnv
from inclined_landing.envs.make import make_batch
from inclined_landing.envs.tasks import StepContext, make_task, moving
from inclined_landing.envs.tasks.touchdown import FRICTION, TouchdownConditions, resting
from inclined_landing.models.attitude import ROLL, VX, VZ, WX, WZ, YAW, Z, rotation
from inclined_landing.models.plants import Contacts, make_plant
from inclined_landing.train.descent import Descent

TASK = make_task("touchdown", dimensions=3, fastest=2.0, swell=1.0, steepest=0.35)
SPEEDS = st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3)


def on_feet(n: int) -> Contacts:
    contacts = Contacts(np.zeros((n, 3, 3), bool), np.zeros((n, 3, 3), bool), np.zeros((n, 3, 3)))
    contacts.touch[:, 0, 0] = True
    return contacts


def a_moment(rng: np.random.Generator, n: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """States (n, 13) and platforms (n, 12) in any motion."""
    return rng.normal(0.0, 0.3, (n, 13)), rng.normal(0.0, 0.3, (n, 12))


@given(SPEEDS, st.integers(0, 1000))
@settings(max_examples=30, deadline=None)
def test_rest_and_what_is_seen_are_the_same_in_a_moving_room(speed, seed):
    """Galilean invariance; but for the platform's own velocity, which is observed as it is."""
    state, platform = a_moment(np.random.default_rng(seed))
    state[:4, VX : VZ + 1] = platform[:4, VX : VZ + 1] + 0.02  # some are slow
    faster, faster_platform = state.copy(), platform.copy()
    for array in (faster, faster_platform):
        array[:, VX : VZ + 1] += speed
    idle = np.ones(len(state), bool)
    slow = resting(state, platform, idle, on_feet(8), speed=0.5, rate=2.0)
    assert (slow == resting(faster, faster_platform, idle, on_feet(8), speed=0.5, rate=2.0)).all()
    seen, again = (
        TASK.observe(StepContext(s, platform=d)) for s, d in ((state, platform), (faster, faster_platform))
    )
    own = TASK.observation_names.index("platform vx")
    np.testing.assert_allclose(seen[:, :own], again[:, :own], atol=1e-5)  # float32 at 3 m/s
    np.testing.assert_allclose(seen[:, own + 3 :], again[:, own + 3 :], atol=1e-6)


def test_who_stands_on_a_turning_platform_rests_though_it_moves_in_the_room():
    """Known truth: a point fixed to a rigid platform has v + w x r and the platform's own rates."""
    rng = np.random.default_rng(3)
    _, platform = a_moment(rng, 1)
    turn = rotation(*platform[0, ROLL : YAW + 1])
    arm = turn @ [0.2, -0.1, 0.02]
    state = np.zeros((1, 13))
    state[0, : Z + 1] = platform[0, : Z + 1] + arm
    state[0, VX : VZ + 1] = platform[0, VX : VZ + 1] + np.cross(turn @ platform[0, WX : WZ + 1], arm)
    state[0, ROLL : YAW + 1], state[0, WX : WZ + 1] = platform[0, ROLL : YAW + 1], platform[0, WX : WZ + 1]
    idle = np.ones(1, bool)
    assert np.linalg.norm(state[0, VX : VZ + 1]) > 0.2
    assert resting(state, platform, idle, on_feet(1)).all()
    platform[0, WX] += 1.1
    assert not resting(state, platform, idle, on_feet(1)).any()


def test_over_platforms_that_stand_still_a_moving_plant_judges_as_the_plain_one():
    """Onto the same slopes with motors idle, in both plants: the same rewards and success."""
    outcomes = []
    for task in (make_task("touchdown", dimensions=3), make_task("touchdown", dimensions=3, fastest=0.0)):
        task.conditions = TouchdownConditions(close=1.0)
        env = BatchEnv(task, make_plant("mujoco", 6, task.vehicle, threads=1, **task.plant_options), seed=5)
        start = make_task("touchdown", dimensions=3)
        start.conditions = task.conditions
        env.reset(start=start.sample(np.random.default_rng(5), 6))
        steps = [env.step(np.tile([-1.0, 0.0, 0.0], (6, 1))) for _ in range(30)]
        outcomes.append((np.array([s.reward for s in steps]), np.array([s.success for s in steps])))
    (reward, success), (again, success_again) = outcomes
    assert (success == success_again).all() and success.any()
    # The impact's price only differs by the contact solver's digits: the moving slab is a body of its own.
    np.testing.assert_allclose(reward, again, atol=0.05)


def test_starts_are_clear_of_platforms_that_move_and_at_rest_in_the_room():
    start = TASK.sample(np.random.default_rng(0), 200)
    assert len(start.motion) == 200 and (start.state[:, VX : VZ + 1] == 0.0).all()
    assert (TASK.start_clearance(start) >= 0.05).all()
    speed = np.linalg.norm(start.motion.waves.velocity[:, :2], axis=1)
    assert speed.max() <= 2.0 and speed.max() > 1.5 and (start.motion.waves.velocity[:, 2] == 0.0).all()


def test_the_swell_keeps_within_what_it_says():
    motion = moving.draw(np.random.default_rng(1), 1.0, 1.0, np.full(500, math.pi))
    place, rate, _ = motion.at(np.linspace(0.0, 60.0, 500))
    assert np.abs(place[:, 2]).max() <= moving.WAVES * moving.HEAVE
    assert np.abs(rate[:, 2]).max() <= moving.WAVES * moving.HEAVE_SPEED
    assert np.abs(place[:, 3:5]).max() <= moving.WAVES * moving.TILT
    assert math.hypot(*np.abs(place[:, 3:5]).max(axis=0)) <= moving.STEEPEST
    still = moving.draw(np.random.default_rng(1), 0.0, 0.0, np.zeros(5)).at(3.0)
    assert not any(array.any() for array in still)
    room = np.linspace(0.0, 0.3, 500)
    narrow = moving.draw(np.random.default_rng(1), 1.0, 1.0, room)
    assert (moving.largest_tilt(narrow.waves.amplitude) <= room + 1e-12).all()
    np.testing.assert_array_equal(
        narrow.waves.amplitude[:, 2], motion.waves.amplitude[:, 2]
    )  # heave is as it was


def test_drawn_friction_holds_on_drawn_slopes():
    """Coulomb: a slope is held by a friction above the tangent of its angle, at its steepest moment."""
    task = make_task(
        "touchdown",
        dimensions=3,
        fastest=2.0,
        swell=1.0,
        steepest=math.radians(50),
        angle_limit=math.radians(55),
    )
    task.conditions = TouchdownConditions(friction=FRICTION, steep=0.5)
    start = task.sample(np.random.default_rng(4), 400)
    slope = np.abs(start.inclination) + moving.largest_tilt(start.motion.waves.amplitude)
    assert slope.max() <= math.radians(55) + 1e-9 and slope.max() > math.radians(50)
    assert (start.contact["friction"] >= 1.04 * np.tan(slope) - 1e-9).all()
    assert start.contact["friction"].min() < 0.7  # level platforms stay slippery
    # Of 400, half of them and a tenth of the others: 220, with a standard deviation of 10.
    assert 170 < (start.inclination >= 0.9 * math.radians(50)).sum() < 270


def test_close_starts_move_along_with_their_platforms():
    task = make_task("touchdown", dimensions=3, fastest=2.0, swell=1.0, steepest=0.35)
    task.conditions = TouchdownConditions(close=1.0)
    start = task.sample(np.random.default_rng(2), 100)
    platform = start.platforms(task.vehicle)
    apart = start.state[:, : Z + 1] - platform[:, : Z + 1]
    assert np.linalg.norm(apart, axis=1).max() < 0.6  # 0.25 m along, half the depth across, 0.27 m up
    # At most 0.8 m/s into and 0.5 m/s along the slope, relative to it.
    relative = np.linalg.norm(start.state[:, VX : VZ + 1] - platform[:, VX : VZ + 1], axis=1)
    assert relative.max() <= math.hypot(0.8, 0.5) + 1e-9


def test_the_arena_is_carried_along():
    """A vehicle over a platform 20 m away is in the middle of its arena; the room itself ends at 3.4 m."""
    state, platform = np.zeros((1, 13)), np.zeros((1, 12))
    state[0, :3], platform[0, :3] = (20.0, -8.0, 1.5), (20.0, -8.0, 1.15)
    assert not TASK.near_bounds(StepContext(state, platform=platform))[0]
    still = make_task("touchdown", dimensions=3)
    assert still.near_bounds(StepContext(state, platform=platform))[0]


def test_the_law_that_training_begins_with_lands():
    env = make_batch(
        "touchdown", 48, plant="hybrid", seed=3, dimensions=3, fastest=2.0, swell=1.0,
        steepest=math.radians(40), angle_limit=math.radians(55), plant_options={"threads": 1},
    )  # fmt: skip
    law, success = Descent(env.task), np.zeros(48, bool)
    env.task.conditions = TouchdownConditions(friction=FRICTION)
    env.reset()
    for _ in range(200):
        step = env.step(law(StepContext(env.plant.state, platform=env.plant.platform), -1.0), ~success)
        success |= step.success
    assert success.mean() > 0.9  # of 234 others up to 40 deg: 0.996
