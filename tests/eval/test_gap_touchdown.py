"""Contact effects named from landings of the independent simulator."""

import numpy as np
import pytest

from inclined_landing.eval.gap import diagnose
from inclined_landing.eval.gap.flights.landings import landings_of
from inclined_landing.eval.gap.search.after_touch import sag
from inclined_landing.eval.gap.search.contact import FEWEST, name_contact
from inclined_landing.eval.proof.gap_blind.generate import landings, logs
from inclined_landing.models.effects import LIBRARY
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


def test_errors_of_known_covariance_come_out_white(higher):
    """Drawn with the inverse of what whitens them, they are independent with unit variance."""
    landing = landings_of(higher[0][:1], VEHICLE)[0]
    draws = np.random.default_rng(0).standard_normal((400, len(landing.compared)))
    for whiten in landing.whiten:
        errors = draws @ np.linalg.inv(whiten).T
        assert ((errors @ whiten.T) ** 2).mean() == pytest.approx(1.0, abs=0.05)
    # The resting pose is known less well than the approach along the slope, where feet slide.
    assert landing.deviation[-1, 0] > 1.5 * landing.deviation[0, 0]


def test_softer_feet_give_way_under_the_weight():
    soft = LIBRARY["contact_stiffness"].apply(VEHICLE, {"scale": 0.5})
    assert np.array(sag(soft, 0.018)) == pytest.approx(2.0 * np.array(sag(VEHICLE, 0.018)))
    assert sag(VEHICLE, 0.018)[0] == pytest.approx(9.81 * VEHICLE.contact_solref[0] ** 2)


def test_a_contact_effect_is_named_among_few(higher):
    """From as few landings as are taken: the offset within the 3 mm that start states leave open."""
    flights, offset = higher
    few = {name: LIBRARY[name] for name in ("friction", "platform_height")}
    problem, found = name_contact(landings_of(flights[:FEWEST], VEHICLE), VEHICLE, few)
    assert list(problem.library) == list(few) and list(found.fit.values) == ["platform_height"]
    assert found.fit.values["platform_height"]["offset"] == pytest.approx(offset, abs=0.003)
    assert found.classes == {"platform_height": ("platform_height",)} and not found.unexplained


@pytest.mark.slow
@pytest.mark.parametrize(
    "cause, size, seed",
    [("contact_stiffness", "strong", 403), ("contact_damping", "strong", 403), (None, None, 415)],
)
def test_springs_and_dampers_are_told_apart(cause, size, seed):
    recordings, _ = landings(cause, size, seed=seed)
    _, found = name_contact(landings_of(logs(recordings, contact=True), VEHICLE), VEHICLE, LIBRARY)
    assert list(found.fit.values) == ([cause] if cause else [])


@pytest.mark.slow
def test_platform_height_is_named(higher):
    flights, offset = higher
    d = diagnose(flights, VEHICLE, plants=("mujoco",), curves=False)
    assert [e.name for e in d.effects] == ["platform_height"]
    assert d.effects[0].parameters["offset"].value == pytest.approx(offset, abs=0.003)
    assert d.gap["mujoco"].after < 0.5 * d.gap["mujoco"].before
