"""Touchdowns at the engine's steps: the same flight again, its contact forces, its pictures."""

import dataclasses

import numpy as np
import pytest

from inclined_landing.envs.flights import Flight
from inclined_landing.envs.policy import load_policy
from inclined_landing.eval.base.starts import usual_starts
from inclined_landing.eval.cli import main
from inclined_landing.eval.pictures import film
from inclined_landing.eval.pictures.flights import fly_from
from inclined_landing.eval.pictures.touchdown import LEAD, STEP, record_touchdown
from inclined_landing.models import surface
from inclined_landing.models.attitude import PITCH
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle

V = load_vehicle()
WEIGHT = V.body_mass * V.environment_gravity


def flown(name) -> Flight:
    policy = load_policy(name)
    return fly_from(policy, usual_starts(policy.task)[:1], "mujoco")[0]


@pytest.fixture(scope="module")
def flight():
    return flown("touchdown-nominal")


@pytest.fixture(scope="module")
def touchdown(flight):
    return record_touchdown(flight)


def test_forces_begin_with_the_touch_and_end_with_the_weight(touchdown):
    net = touchdown.net_forces
    before = round(LEAD / STEP)
    assert not net[:before].any() and net[before, 0] > 0
    alpha = abs(touchdown.platform[0, PITCH])
    # Still for 0.12 s; the thrust that decays with 60 ms still carries a few percent.
    assert net[-1] == pytest.approx([WEIGHT * np.cos(alpha), WEIGHT * np.sin(alpha)], rel=0.1)
    for points, forces in zip(touchdown.points, touchdown.forces):
        assert points.shape == forces.shape
    # On the slab: sunk in by less than 5 mm.
    [normal] = surface.normals(touchdown.platform[:1])
    points = np.concatenate(touchdown.points) - [0, 0, V.platform_surface_height]
    assert np.abs(points @ normal).max() < 0.005
    assert touchdown.largest_force < net[:, 0].max()


def test_a_flight_that_touches_nothing_is_a_sentence(flight):
    hover = dataclasses.replace(flight, t=flight.t[:6], state=flight.state[:6], commands=flight.commands[:6])
    with pytest.raises(UserError, match=r"there is no contact in the flight from x 1\.5, z 1\.8 m"):
        record_touchdown(hover)
    with pytest.raises(UserError, match="needs a task with a platform"):
        record_touchdown(dataclasses.replace(flight, inclination=None))


def test_the_command_films_every_engine_step(tmp_path, monkeypatch):
    seen = {}

    def write(paths, frames, fps):
        seen.update(frames=sum(1 for _ in frames), fps=fps)

    monkeypatch.setattr(film, "write_videos", write)
    options = ["--forces", "--slow", "16", "--camera", "touch", "--width", "160", "--height", "90"]
    assert main(["video", "touchdown", *options, "--out", str(tmp_path / "x.mp4")]) == 0
    assert seen["fps"] == pytest.approx(1 / (STEP * 16))
    assert 60 < seen["frames"] < 140


@pytest.mark.parametrize("policy, options, sentence", [
    ("touchdown", ["--camera", "touch", "--backend", "gl"], "--camera touch looks at a touchdown"),
    ("setpoint", [], "a setpoint flight has no contact"),
    ("landing", ["--plant", "analytic"], "--forces needs --plant mujoco"),
])  # fmt: skip
def test_forces_without_a_touch_are_one_sentence(policy, options, sentence, tmp_path, capsys):
    out = tmp_path / "x.mp4"
    assert main(["video", policy, "--forces", *options, "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert sentence in error and error.count("\n") == 1 and not out.exists()
