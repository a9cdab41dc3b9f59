"""Motions of platforms: speeds are the derivatives of places, points of a platform move as a rigid body."""

import numpy as np
import pytest

from inclined_landing.models.attitude import PITCH, ROLL, VX, VZ, YAW, Z, rotation
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.motion import MODES, Motion
from inclined_landing.models.surface import relative

H = 1e-4  # s, of central differences
# Waves of at most 0.2 m or rad and 6 rad/s, three of them, and their products in a turning frame: the third
# derivative stays below 3 x 0.2 x 6^3 = 130, times what turns multiply it by; H^2/6 of it, and rounding.
NEAR = 1e-5


def motions(n: int, waves: int = 3, seed: int = 0) -> Motion:
    rng = np.random.default_rng(seed)
    sizes = rng.uniform(0, 0.2, (n, 6, waves)) / np.arange(1, waves + 1)
    turns, phases = rng.uniform(1, 6, (n, 6, waves)), rng.uniform(0, 6, (n, 6, waves))
    return Motion(rng.normal(size=(n, 3)), sizes, turns, phases)


def rests(n: int) -> np.ndarray:
    rest = np.zeros((n, 12))
    rest[:, Z], rest[:, PITCH], rest[:, YAW] = 1.15, 0.3, np.linspace(-3, 3, n)
    return rest


def test_rates_are_derivatives():
    motion, times = motions(8), np.linspace(0, 5, 8)
    before, now, after = (motion.at(times + shift) for shift in (-H, 0.0, H))
    for order in (0, 1):
        np.testing.assert_allclose((after[order] - before[order]) / (2 * H), now[order + 1], atol=NEAR)


def test_fewer_waves_than_there_were_leave_none_of_them():
    motion, given = motions(3, waves=3), motions(1, waves=2, seed=1)
    motion[[1]] = given
    assert motion.waves.amplitude.shape == (3, 6, 3) and not motion.waves.amplitude[1, :, 2].any()
    np.testing.assert_array_equal(motion[[1]].at(0.4)[0], given.at(0.4)[0])


def test_points_of_a_platform_move_with_it():
    motion, rest, local = motions(8), rests(8), np.array([0.4, -0.2, -0.01])

    def point(time):
        platform = motion.platforms(time, rest)
        return platform, np.array([d[: Z + 1] + rotation(*d[ROLL : YAW + 1]) @ local for d in platform])

    (_, before), (platform, now), (_, after) = (point(2.0 + shift) for shift in (-H, 0.0, H))
    carried = np.zeros((8, 13))
    carried[:, : Z + 1], carried[:, VX : VZ + 1] = now, (after - before) / (2 * H)
    np.testing.assert_allclose(relative(carried, platform)[1], 0.0, atol=NEAR)


def test_selection_and_assignment_keep_each_platforms_motion():
    few, many = motions(3, waves=2), motions(2, waves=4, seed=1)
    mixed, rest = Motion.still(5), rests(5)
    mixed[[0, 2, 4]], mixed[np.array([False, True, False, True, False])] = few, many
    places = mixed.platforms(1.3, rest)
    np.testing.assert_array_equal(places[[0, 2, 4]], few.platforms(1.3, rest[[0, 2, 4]]))
    np.testing.assert_array_equal(places[[1, 3]], mixed[1:4:2].platforms(1.3, rest[[1, 3]]))
    np.testing.assert_array_equal(Motion.still(5).platforms(9.0, rest), rest)


@pytest.mark.parametrize(
    "change",
    [
        {"velocity": np.zeros((2, 2))},
        {"velocity": 1.0},
        {"amplitude": np.zeros((2, 6))},
        {"phase": np.zeros((2, 6, 2))},
        {"frequency": np.full((2, 6, 1), np.nan)},
        {"amplitude": [["heave"]]},
        {"amplitude": np.full((2, len(MODES), 1), 1.3)},
    ],
)
def test_wrong_motions_are_refused(change):
    parts = Motion.still(2).waves._asdict()
    with pytest.raises(UserError, match=r"motion|platform"):
        Motion(**(parts | change))
