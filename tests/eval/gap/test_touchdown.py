"""Contact effects named from landings of the independent simulator."""

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec import ValidationError

from inclined_landing.eval.gap import diagnose, thresholds
from inclined_landing.eval.gap.infer.contact import (
    ContactPosterior,
    common_residual_p_value,
    contact_effects,
    contact_posterior,
    inflation,
    joint_sets,
)
from inclined_landing.eval.gap.infer.landing_reference import landing_reference
from inclined_landing.eval.gap.infer.sets import confounded_with
from inclined_landing.eval.gap.infer.touchdown_simulation import TouchdownProblem, static_deflection
from inclined_landing.eval.gap.measured.landings import (
    LandingReference,
    contact_model_covariance,
    landings_of,
)
from inclined_landing.eval.gap.result import Estimate, ScoredSet, Touchdowns, from_plain, marginal, plain
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import load_vehicle
from tests.validation.gap_blind import causes
from tests.validation.gap_blind.generate import land_all, logs

VEHICLE = load_vehicle()


def flown(cause, seed, count=16):
    """Return landings with a strong cause of contact (None: without), and what is hidden."""
    rng = np.random.default_rng(seed)
    drawn = causes.Drawn({}, {}) if cause is None else causes.draw(cause, "strong", rng)
    return logs(land_all(drawn, rng, count=count), contact=True), drawn.parameters


@pytest.fixture(scope="module")
def higher():
    """Sixteen landings on a platform some 3 cm off its nominal height, and its offset."""
    flights, hidden = flown("platform_height", 23)
    return flights, hidden["offset"]


def judged(name, value, share):
    """The effects named from twelve landings in which one has probability `share`, with this value."""
    ((parameter, neutral),) = LIBRARY[name].neutral.items()
    low, high = sorted((value, 0.7 * value + 0.3 * neutral))
    sized = Estimate(value, "", (low, high), neutral, (-9.0, 9.0), False)
    probable = ScoredSet((name,), share, {name: {parameter: value}})
    posterior = ContactPosterior(
        (probable, ScoredSet((), 1.0 - share)),
        {name: sized},
        Touchdowns(12, unexplained=False, p_value=0.5),
    )
    return contact_effects(SimpleNamespace(library=LIBRARY), posterior)


def test_an_unlikely_effect_of_contact_is_not_named():
    """Though it is in the most probable set."""
    assert not judged("friction", 0.6, thresholds.NAMED - 0.05)
    assert not judged("friction", 0.6, 0.8)[0].sure


@pytest.mark.parametrize(
    ("name", "value", "alike"),
    [
        ("friction", 0.6, ()),
        ("friction", 1.6, ("contact_damping", "contact_stiffness")),  # feet that rebound slide less
        ("contact_damping", 0.5, ("contact_stiffness", "friction")),
        ("contact_stiffness", 0.4, ("contact_damping", "foot_height", "friction")),
        ("foot_height", -0.003, ("contact_stiffness",)),  # soft feet give way
        ("foot_height", -0.006, ()),
        ("foot_height", 0.006, ()),
        ("platform_tilt", 0.05, ()),
    ],
)
def test_what_another_law_of_contact_would_show_is_not_sure(name, value, alike):
    (effect,) = judged(name, value, 0.99)
    assert effect.members == (name, *alike)
    assert effect.sure == (not alike) and ("laws of contact differ" in effect.doubt) == bool(alike)


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
    assert np.array(static_deflection(soft, 0.018)) == pytest.approx(
        2.0 * np.array(static_deflection(VEHICLE, 0.018))
    )
    assert static_deflection(VEHICLE, 0.018)[0] == pytest.approx(9.81 * VEHICLE.contact_solref[0] ** 2)


def test_a_contact_effect_is_named_among_few(higher):
    """From as few landings as are taken: the offset within the 3 mm that start states leave open."""
    flights, offset = higher
    few = {name: LIBRARY[name] for name in ("friction", "platform_height")}
    problem, found = contact_posterior(
        landings_of(flights[: thresholds.LEAST_LANDINGS], VEHICLE), VEHICLE, few
    )
    assert list(problem.library) == list(few) and found.names == {"platform_height"}
    assert (
        found.probability("platform_height") > 0.9
        and confounded_with(found.sets, found.names, "platform_height") == ()
    )
    assert found.sets[0].values["platform_height"]["offset"] == pytest.approx(offset, abs=0.003)
    low, high = found.sizes["platform_height"].ci95
    assert low < found.sets[0].values["platform_height"]["offset"] < high and high - low < 0.006
    assert not found.touchdowns.unexplained


def made_up(monkeypatch, landings, hidden, noise=1.0, seed=0):
    """What is found in landings whose errors go with the logarithm of factors, and with offsets."""
    rng = np.random.default_rng(seed)
    q, few = 30, {name: LIBRARY[name] for name in ("friction", "contact_stiffness", "platform_height")}
    slopes = {name: rng.standard_normal((len(landings), 6, q)) for name in few}
    unit = {"friction": 0.05, "contact_stiffness": 0.1, "platform_height": 0.002}
    white = noise * rng.standard_normal((len(landings), 6, q))

    def sizes(vehicle):
        return {
            "friction": np.log(vehicle.contact_friction / VEHICLE.contact_friction),
            "contact_stiffness": np.log(abs(vehicle.contact_solref[0]) / 1e4)
            if vehicle.contact_solref[0] < 0
            else 0.0,
            "platform_height": vehicle.platform_surface_height - VEHICLE.platform_surface_height,
        }

    def errors(self, vehicle):
        now = sizes(vehicle)
        return white + sum(slopes[n] * (hidden.get(n, 0.0) - now[n]) / (4.0 * unit[n]) for n in few)

    monkeypatch.setattr(TouchdownProblem, "errors", errors)
    monkeypatch.setattr("inclined_landing.eval.gap.infer.contact.common_residual_p_value", lambda *_: 1.0)
    return contact_posterior(landings, VEHICLE, few)[1]


def test_probabilities_of_sets_of_linear_landings(higher, monkeypatch):
    """Nothing and one hidden effect; what is as small as laws of contact differ is not named."""
    landings = landings_of(higher[0], VEHICLE)
    assert made_up(monkeypatch, landings, {}).names == frozenset()
    assert made_up(monkeypatch, landings, {"friction": 0.1}).names == frozenset()
    assert made_up(monkeypatch, landings, {"contact_stiffness": -0.5}).names == frozenset()
    found = made_up(monkeypatch, landings, {"platform_height": -0.02})
    assert found.names == {"platform_height"} and found.sets[0].probability > 0.9
    assert found.sets[0].values["platform_height"]["offset"] == pytest.approx(-0.02, abs=0.001)
    assert sum(s.probability for s in found.sets) == pytest.approx(1.0, abs=0.02)


def test_landings_that_contradict_each_other_are_no_certainty():
    """Few landings far beyond the noise: the samples are counted for less, and nothing is sure."""
    errors = np.random.default_rng(1).standard_normal((16, 6, 30))
    slopes = np.random.default_rng(2).standard_normal((16, 6, 30, 2))
    assert inflation(errors, slopes).max() < 2.0
    along = slopes[..., 0] * np.random.default_rng(3).choice((-1.0, 1.0), (16, 1, 1))
    assert inflation(errors + along, slopes).min() > 4.0


def test_false_alarms_of_what_landings_have_in_common(higher):
    """With errors that idealised contacts may have in common the p-value is even; a shift of 2 cm is seen."""
    landings = landings_of(higher[0], VEHICLE)
    t = landings[0].compared * landings[0].dt - 0.1
    spread = np.linalg.cholesky(contact_model_covariance(t) + 1e-12 * np.eye(len(t)))
    rng, values = np.random.default_rng(4), []
    whiten = np.stack([x.whiten for x in landings])
    for _ in range(100):
        common = [np.einsum("cij,cj->ci", spread, rng.standard_normal((6, len(t)))) for _ in range(2)]
        shared = np.stack([common[x.on_platform] for x in landings])
        left = np.einsum("icab,icb->ica", whiten, shared) + rng.standard_normal((len(landings), 6, len(t)))
        values.append(common_residual_p_value(landings, left, np.ones(6)))
    assert np.mean(np.array(values) < 0.05) < 0.12  # 5 of 100, and what chance makes of it
    shift = np.zeros((6, len(t)))
    shift[1] = 0.02 * (t > 0.1)
    assert (
        common_residual_p_value(landings, left + np.einsum("icab,cb->ica", whiten, shift), np.ones(6)) < 1e-3
    )


def test_sets_of_flight_and_of_contact_are_told_together(higher, monkeypatch):
    found = made_up(monkeypatch, landings_of(higher[0], VEHICLE), {"platform_height": -0.02})
    flown = (ScoredSet(("wind",), 0.8, {"wind": {"x": 0.3, "y": 0.0}}, {}), ScoredSet((), 0.2, {}, {}))
    sets = joint_sets(flown, found)
    assert sets[0].effects == ("wind", "platform_height") and set(sets[0].values) == set(sets[0].effects)
    total = sum(s.probability for s in found.sets)
    assert sets[0].probability == pytest.approx(0.8 * found.sets[0].probability / total)
    assert marginal(sets, ["wind"]) == pytest.approx(0.8, abs=1e-4)  # as of the flights alone


def test_what_the_reference_leaves_is_expected_of_other_landings(higher, monkeypatch):
    """A motion that all landings have beside the model is no effect; it is read back from its file."""
    flights, few = higher[0], {"friction": LIBRARY["friction"]}
    monkeypatch.setattr("inclined_landing.eval.gap.infer.landing_reference._fitted", lambda _: [{}])
    vehicle, reference, _ = landing_reference(flights[:8], VEHICLE, few)
    assert vehicle == VEHICLE and reference.count == (2, 6)
    again = from_plain(plain(reference), LandingReference)
    known, unknown = (
        TouchdownProblem.of(landings_of(flights[8:], VEHICLE, one), VEHICLE, few).deviations(VEHICLE)
        for one in (again, None)
    )
    # The platform is some 3 cm off; the mean of 12 axes' noise of 1 mm is 0.4 mm, start states leave 1 mm.
    on_platform = [k for k in range(8) if (k + 8) % 4 != 3]
    assert np.abs(unknown[on_platform, 20:, 2].mean()) > 0.015
    assert np.abs(known[on_platform, 20:, 2].mean()) < 0.003
    with pytest.raises(ValidationError, match="another shape"):
        from_plain(plain(reference) | {"time": [0.0]}, LandingReference)


@pytest.fixture(scope="module")
def identified():
    """The vehicle that twelve landings without a cause identify, and what these leave."""
    return landing_reference(flown(None, (6, 99), 12)[0], VEHICLE, LIBRARY)[:2]


@pytest.mark.slow
@pytest.mark.parametrize("cause", ["foot_height", "platform_tilt", "soft_feet"])
def test_effects_of_contact_are_named_on_another_engine(identified, cause):
    """After landings without the cause. Soft feet are not, for they could be shorter ones."""
    vehicle, reference = identified
    landings = landings_of(flown(cause, (6, 0), 12)[0], vehicle, reference)
    named = contact_effects(*contact_posterior(landings, vehicle, LIBRARY, reference))
    assert [e.members[0] for e in named if e.sure] == [cause] * (cause != "soft_feet")


@pytest.mark.slow
@pytest.mark.parametrize("cause", ["contact_stiffness", "contact_damping"])
def test_springs_and_dampers_are_no_sure_names(cause):
    """The vehicle file's contact may differ by as much, for all that is known of it."""
    landings = landings_of(flown(cause, 403)[0], VEHICLE)
    assert not any(e.sure for e in contact_effects(*contact_posterior(landings, VEHICLE, LIBRARY)))


@pytest.mark.slow
def test_where_nothing_is_hidden_no_effect_of_contact_is_sure():
    """Two contact models are not alike: a false name may be the likeliest set, but is no certainty."""
    _, found = contact_posterior(landings_of(flown(None, 415)[0], VEHICLE), VEHICLE, LIBRARY)
    assert max(found.probability(name) for name in LIBRARY) < 0.8 and not found.touchdowns.unexplained


@pytest.mark.slow
def test_platform_height_is_named(higher):
    flights, offset = higher
    d = diagnose(flights, VEHICLE, plants=("mujoco",))
    assert [e.name for e in d.effects] == ["platform_height"]
    assert d.effects[0].parameters["offset"].value == pytest.approx(offset, abs=0.003)
    assert d.effects[0].probability > 0.9 and "platform_height" in d.sets[0].effects
    assert d.touchdowns.landings == len(flights) and not d.touchdowns.unexplained
