"""Flights over moving platforms: flown again, followed to rest, drawn where the platform is."""

import dataclasses

import numpy as np
import pytest

from inclined_landing.envs.flights import Flight, resimulate
from inclined_landing.envs.rendering import make_renderer, pose_from_state
from inclined_landing.envs.tasks import make_task
from inclined_landing.eval.pictures.figures.trajectory import trajectory_figure
from inclined_landing.eval.pictures.to_rest import to_rest
from inclined_landing.eval.replay.recording import from_flight
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.motion import MODES, Motion
from inclined_landing.models.plants import MujocoPlant

LOOK = {"width": 160, "height": 120, "camera": "hero"}


@pytest.fixture(scope="module")
def plant():
    return MujocoPlant(1, moving=True, torque_needs_motors=True, threads=1)


@pytest.fixture(scope="module")
def flight(plant):
    """A drop from 0.3 m over a platform that travels, heaves and tilts; it stays on it."""
    motion = Motion.still(1)
    motion.waves.velocity[0] = 0.4, 0.1, 0.0
    for mode, size, turn in (("heave", 0.1, 3.0), ("roll", 0.15, 2.0), ("pitch", 0.1, 4.0)):
        motion.waves.amplitude[0, MODES.index(mode)], motion.waves.frequency[0, MODES.index(mode)] = (
            size,
            turn,
        )
    plant.set_platform([0], -0.3, azimuth=0.4)
    plant.set_motion([0], motion)
    start = np.zeros((1, 13))
    start[0, :6] = 0, 0, 1.5, 0.4, 0.1, 0
    plant.reset([0], start)
    states, platforms = [plant.state[0].copy()], [plant.platform[0].copy()]
    for _ in range(60):
        plant.step(np.zeros((1, 4)))
        states.append(plant.state[0].copy())
        platforms.append(plant.platform[0].copy())
    rows = len(states)
    return Flight(
        task=make_task("landing"), t=0.02 * np.arange(rows), state=np.array(states),
        platform=np.array(platforms), commands=np.zeros((rows, 4)), actions=np.zeros((rows, 2)),
        reward=np.zeros(rows), inclination=-0.3, motion=motion, success=True, touched=True,
    )  # fmt: skip


def test_flown_again_at_the_engines_steps(flight):
    """Until the touch bit for bit; then platforms that are put in place at other times differ by a
    micrometre.
    """
    steps = resimulate(flight)
    touch = next(k for k, points in enumerate(steps.points) if len(points))
    np.testing.assert_array_equal(steps.state[: touch - 1 : 5], flight.state[: len(range(0, touch - 1, 5))])
    np.testing.assert_allclose(steps.state[::5, :3], flight.state[:, :3], atol=1e-6)
    np.testing.assert_allclose(steps.platform[::5], flight.platform, atol=1e-12)
    assert len(steps.points[-1]) == 4  # its feet


def test_followed_to_rest_on_the_same_platform(flight):
    cut = {
        name: getattr(flight, name)[:31]
        for name in ("t", "state", "platform", "commands", "actions", "reward")
    }
    landing = to_rest(dataclasses.replace(flight, **cut))
    assert landing.at_rest and landing.ending == "at rest on its feet"
    both = min(len(landing.t), len(flight.t))
    assert both > 31
    np.testing.assert_allclose(landing.state[:both], flight.state[:both], atol=1e-9)
    np.testing.assert_allclose(landing.platform[:both], flight.platform[:both], atol=1e-12)


@pytest.mark.parametrize("backend", ["ray", pytest.param("gl", marks=pytest.mark.gl)])
def test_the_platform_is_drawn_where_it_is(flight, backend):
    """A platform that was moved looks as one that was built there."""
    poses = [pose_from_state(flight.state[0], flight.platform[k], has_base=False) for k in (0, 30)]
    with make_renderer(**LOOK, backend=backend) as renderer:
        kept = [renderer.render(pose) for pose in poses]
    with make_renderer(**LOOK, backend=backend) as renderer:
        np.testing.assert_array_equal(renderer.render(poses[1]), kept[1])
        assert (renderer.render(poses[0]) != kept[1]).any()


def test_pages_and_figures_for_standing_platforms_say_so(flight):
    with pytest.raises(UserError, match="cannot show moving platforms"):
        from_flight(flight, "x", "mujoco")
    with pytest.raises(UserError, match="cannot show a moving platform"):
        trajectory_figure(flight)
