"""Deviations that are drawn for every episode: their file, their ranges, and whom they reach."""

import numpy as np
import pytest

from inclined_landing.envs.batch import BatchEnv
from inclined_landing.envs.randomise import read_ranges
from inclined_landing.envs.tasks import make_task
from inclined_landing.models import perturbation
from inclined_landing.models.errors import UserError
from inclined_landing.models.plants import PLANTS, make_plant

RANGES = {"thrust_scale": (0.8, 1.1), "mass_scale": (0.9, 1.2), "drag_change": (0.5, 0.5)}
COLUMNS = [perturbation.NAMES.index(name) for name in RANGES]


def environment(plant, n, ranges=RANGES, seed=0):
    return BatchEnv(make_task("landing"), make_plant(plant, n), seed, ranges)


def test_a_file_of_ranges(tmp_path):
    path = tmp_path / "ranges.toml"
    path.write_text("thrust_scale = [0.8, 1.1]  # of the battery\nthrust_bias = [0, 0]\n", "utf-8")
    assert read_ranges(path) == {"thrust_scale": (0.8, 1.1), "thrust_bias": (0.0, 0.0)}


@pytest.mark.parametrize("text, sentence", [
    ("", "is empty; it should hold ranges of thrust_scale, "),
    ("body_mass = [0.03, 0.04]", "body_mass cannot differ from vehicle to vehicle; thrust_scale, .* can"),
    ("[thrust]\nscale = [1, 2]", "thrust cannot differ from vehicle to vehicle"),
    ("mass_scale = 1.2", r"mass_scale must be two numbers from 0.1 to 10, not 1.2"),
    ("mass_scale = [1.2]", r"mass_scale must be two numbers from 0.1 to 10"),
    ("mass_scale = [0, 1]", r"mass_scale must be two numbers from 0.1 to 10, not \[0, 1\]"),
    ("mass_scale = [true, 1]", "mass_scale must be two numbers"),
    ("thrust_bias = [-inf, nan]", "thrust_bias must be two numbers from -1 to 1"),
    ("gain_scale = [1.1, 0.9]", "gain_scale begins at 1.1 and ends below it, at 0.9"),
    ("gain_scale = [", "is not TOML"),
])  # fmt: skip
def test_wrong_files_are_refused(text, sentence, tmp_path):
    path = tmp_path / "ranges.toml"
    path.write_text(text, "utf-8")
    with pytest.raises(UserError, match=sentence) as refused:
        read_ranges(path)
    assert str(refused.value).startswith(f"randomise file {path}")


@pytest.mark.parametrize("plant", PLANTS)
def test_every_episode_draws_within_its_ranges(plant):
    env = environment(plant, 200)
    env.reset()
    first = env.plant.perturbation.copy()
    for (low, high), column in zip(RANGES.values(), COLUMNS):
        assert (first[:, column] >= low).all() and (first[:, column] <= high).all()
        # of 200 uniform numbers, all within the inner nine tenths: probability 0.9**200 < 1e-9
        assert np.ptp(first[:, column]) >= 0.85 * (high - low)
    untouched = np.setdiff1d(np.arange(len(perturbation.NAMES)), COLUMNS)
    assert (first[:, untouched] == np.array(perturbation.NEUTRAL)[untouched]).all()
    env.reset(np.array([3, 7]))
    changed = np.flatnonzero((env.plant.perturbation != first).any(axis=1))
    assert changed.tolist() == [3, 7]


@pytest.mark.parametrize("plant", PLANTS)
def test_a_flight_goes_on_as_it_was_while_others_begin_anew(plant):
    flights = []
    for others_begin in (False, True):
        env = environment(plant, 3)
        env.reset()
        for k in range(30):
            if others_begin and k % 5 == 4:
                env.reset(np.array([1, 2]))
            env.step(np.full((3, 2), 0.1))
        flights.append(env.plant.state[0].copy())
    np.testing.assert_array_equal(*flights)


def test_what_is_drawn_acts():
    """Free flight at full thrust: the heavier vehicle is lower."""
    env = environment("mujoco", 2, {"mass_scale": (0.8, 1.3)})
    state = make_task("landing").states_at([(1.5, 1.5)] * 2)
    env.reset(state=state)
    for _ in range(10):
        env.step(np.array([[0.3, 0.0]] * 2))
    mass = env.plant.perturbation[:, perturbation.MASS_SCALE]
    assert (env.plant.state[:, 2][np.argsort(mass)][0]) > env.plant.state[:, 2][np.argsort(mass)][1]


@pytest.mark.parametrize("plant", PLANTS)
def test_without_ranges_nothing_is_drawn(plant):
    states = []
    for ranges in (None, {}):
        env = environment(plant, 4, ranges)
        env.reset()
        states.append(env.plant.state.copy())
        assert (env.plant.perturbation == perturbation.NEUTRAL).all()
    np.testing.assert_array_equal(*states)
