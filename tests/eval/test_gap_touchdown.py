"""Contact effects named from landings of the independent simulator."""

import numpy as np
import pytest

from inclined_landing.eval.gap import diagnose
from inclined_landing.eval.gap.blind.generate import landings, logs
from inclined_landing.eval.gap.touchdown import landings_of
from inclined_landing.models.parameters import load_vehicle

VEHICLE = load_vehicle()


@pytest.fixture(scope="module")
def higher():
    """Sixteen landings on a platform some 3 cm off its nominal height, and its offset."""
    recordings, drawn = landings("platform_height", "strong", seed=23)
    return logs(recordings, contact=True), drawn.parameters["offset"]


def test_landings_are_found_with_their_start_states(higher):
    """The start lies before the touch and on the measured path within 2 mm."""
    flights, _ = higher
    found = landings_of(flights, VEHICLE)
    assert len(found) == len(flights)
    for landing, log in zip(found, flights):
        assert log.contact[landing.touch] and not log.contact[: landing.touch].any()
        assert landing.start.shape == (13,)
        path = log.position[landing.first - 2 : landing.first + 3].mean(axis=0)
        assert landing.start[:3] == pytest.approx(path, abs=2e-3)
        assert np.all(landing.deviation > 0)


@pytest.mark.slow
def test_platform_height_is_named(higher):
    flights, offset = higher
    d = diagnose(flights, VEHICLE, plants=("mujoco",), curves=False)
    assert [e.name for e in d.effects] == ["platform_height"]
    assert d.effects[0].parameters["offset"].value == pytest.approx(offset, abs=0.003)
    assert d.gap["mujoco"].after < 0.5 * d.gap["mujoco"].before
