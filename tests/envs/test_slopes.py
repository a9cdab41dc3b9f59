"""Landing on any slope and in space: what the options draw, show, judge and refuse."""

import hashlib
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import inclined_landing  # noqa: F401 (registers the environments)
from inclined_landing.envs import make_batch
from inclined_landing.envs.tasks import StepContext, hover_states, make_task
from inclined_landing.envs.tasks.frozen import START_CLEARANCE
from inclined_landing.envs.tasks.landing import GOAL_HEIGHT, LandingConditions
from inclined_landing.envs.tasks.slopes import over_slopes
from inclined_landing.models.attitude import PITCH, ROLL, VX, YAW, X, Y, Z
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.plants.base import PLATFORM_SIZE
from inclined_landing.models.surface import turned

STEEP = math.radians(50)
PLANE = make_task("landing", steepest=STEEP, angle_limit=math.radians(55))
SPACE = make_task("landing", steepest=0.5, dimensions=3, random_yaw=True)


PLANE_DIGEST, SPACE_DIGEST = "c9354facd7c69359", "5cf7c8bcbcd0bae6"  # of the frozen starts


def platforms(inclination, azimuth):
    """Platforms (n, 12) that stand still."""
    platform = np.zeros((len(inclination), PLATFORM_SIZE))
    platform[:, Z], platform[:, PITCH], platform[:, YAW] = 1.15, inclination, azimuth
    return platform


def test_slopes_are_drawn_evenly_and_starts_are_clear():
    rng = np.random.default_rng(0)
    plane, space = PLANE.sample(rng, 2000), SPACE.sample(rng, 2000)
    # Means of 2000 uniform numbers: within four standard errors of their ranges' middles.
    assert abs(plane.inclination.mean()) < 4 * 2 * STEEP / math.sqrt(12 * 2000)
    assert plane.inclination.min() < -0.98 * STEEP and plane.inclination.max() > 0.98 * STEEP
    assert plane.azimuth is None and not plane.state[:, [Y, YAW]].any()
    assert 0.0 <= space.inclination.min() and 0.49 < space.inclination.max() <= 0.5
    for angle in (space.azimuth, space.state[:, YAW]):
        assert abs(angle.mean()) < 4 * 2 * math.pi / math.sqrt(12 * 2000) and np.ptp(angle) > 6.2
    low, high = SPACE.vehicle.arena_y
    assert space.state[:, Y].min() < low + 0.2 and space.state[:, Y].max() > high - 0.2
    assert (space.state[:, Z] >= 1.2).all()
    for task, start in ((PLANE, plane), (SPACE, space)):
        assert (task.start_clearance(start) >= START_CLEARANCE).all()
    SPACE.conditions = LandingConditions(tilt=0.1)
    try:
        assert SPACE.sample(rng, 100).inclination.max() <= 0.05
    finally:
        SPACE.conditions = LandingConditions()


@settings(max_examples=30, deadline=None)
@given(st.floats(0, 0.5), st.floats(-3, 3), st.floats(-3, 3), st.integers(0, 10**6))
def test_what_is_seen_and_judged_does_not_depend_on_where_the_slope_faces(slope, azimuth, yaw, seed):
    rng = np.random.default_rng(seed)
    goal = SPACE.goal_on(platforms([slope], [0.0])[0])
    state = np.tile(goal, (8, 1))
    state[:, :8] += rng.normal(size=(8, 8)) * [0.08, 0.08, 0.08, 0.8, 0.8, 0.8, 0.02, 0.02]
    state[0] = goal
    platform, other = platforms([slope] * 8, [0.0] * 8), platforms([slope] * 8, [azimuth] * 8)
    moved = turned(state, np.full(8, azimuth))
    seen = SPACE.observe(StepContext(state, platform=platform))
    np.testing.assert_allclose(SPACE.observe(StepContext(moved, platform=other)), seen, atol=1e-5)  # float32
    inside = SPACE.in_goal(state, 0.1, platform)
    assert inside[0] and (SPACE.in_goal(moved, 0.1, other) == inside).all()


@pytest.mark.parametrize("inclination", [-STEEP, -0.3, 0.0, STEEP])
def test_goal_lies_along_the_normal_with_the_papers_half_widths(inclination):
    platform = platforms([inclination], [0.0])
    goal = PLANE.goal_on(platform[0])
    height = goal[X] * math.sin(inclination) + (goal[Z] - 1.15) * math.cos(inclination)
    assert height == pytest.approx(GOAL_HEIGHT) and goal[PITCH] == inclination
    across = {Y: 0.1, VX + 1: 1.0, ROLL: 0.025}  # bounded in space alone
    for column, width in {X: 0.1, Z: 0.1, VX: 1.0, PITCH: 0.025, **across}.items():
        for sign in (-1, 1):
            for share, inside in ((0.999, True), (1.001, False)):
                state = goal.copy()
                state[column] += sign * share * width
                assert SPACE.in_goal(state[None], 0.1, platform)[0] == inside
                assert PLANE.in_goal(state[None], 0.1, platform)[0] == (inside or column in across)


def test_attitude_limit_is_that_of_task_plant_and_actions():
    batch = make_batch("landing", 1, plant="analytic", angle_limit=math.radians(55))
    assert batch.plant.vehicle.command_angle_limit == pytest.approx(math.radians(55))
    assert batch.task.commands(np.array([[0.0, 1.0]]))[0, 2] == pytest.approx(math.radians(55))


def test_frozen_starts_over_slopes_never_change():
    """The digests stand here so that an edit of the set is seen."""
    for task, digest, shape in ((PLANE, PLANE_DIGEST, (21, 2)), (SPACE, SPACE_DIGEST, (7, 13))):
        fixed = make_task("landing", **{k: v for k, v in task.options.items() if k != "random_yaw"})
        found = over_slopes(fixed)
        assert (len(found.inclinations), len(found.azimuths)) == shape
        numbers = [found.start.state[:, :3], found.start.inclination, found.cell]
        text = " ".join(f"{x:.6f}" for rows in numbers for x in np.ravel(rows))
        assert hashlib.sha256(text.encode()).hexdigest()[:16] == digest
        low, high = (found.inclinations[found.cell[0] + k] for k in (0, 1))
        assert ((found.start.inclination >= low) & (found.start.inclination <= high)).all()
    with pytest.raises(UserError, match="has one slope and does not observe it"):
        over_slopes(make_task("landing"))


def test_a_given_slope_in_space_has_an_inclination_from_0_on():
    """Down to -x is up to +x: given starts have inclinations from 0 on too, turned by half a circle."""
    task = make_task("landing", steepest=0.5, dimensions=3, inclination=-0.3, azimuth=0.2)
    start = task.start(hover_states([(1.5, 0.0, 1.8)], task.vehicle))
    assert start.inclination[0] == pytest.approx(0.3) and start.azimuth[0] == pytest.approx(0.2 + math.pi)
