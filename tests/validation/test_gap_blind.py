"""The blind test: the seed alone decides a case, fresh families are others, and the scorer counts right."""

import numpy as np
import pytest

from inclined_landing.models import effects
from tests.validation.gap_blind import cases, causes, score
from tests.validation.simulator import FAMILIES


def test_every_cause_is_in_the_library_or_declared_outside():
    # An effect without a cause here is in the library, but its naming is not proved.
    known = {score.EFFECT.get(name, name): name for name in (*causes.FREE_FLIGHT, *causes.TOUCHDOWN)}
    assert set(known) <= set(effects.LIBRARY)
    assert not (set(causes.UNKNOWN) | set(causes.DISTURBANCE)) & set(effects.LIBRARY)
    rng = np.random.default_rng(0)
    for effect, name in known.items():
        drawn = causes.draw(name, "medium", rng)
        numbers = {parameter.name for parameter in effects.LIBRARY[effect].parameters}
        # A battery is labelled by the slope that it gives thrust, the ground by the thrust it adds.
        assert set(drawn.parameters) <= numbers | {"slope", "voltage", "pwm", "gain"}
        assert score.comparable(name, drawn.parameters) or name in score.NOT_COMPARED
    for _, sets, why in (*score.ALIASES, *((ones, (names,), why) for ones, names, why in score.ENTAILED)):
        assert all(set(names) <= set(effects.LIBRARY) for names in sets) and why


def test_a_population_is_its_seed_and_has_every_cause():
    sets = ("dev", "fresh")
    every = cases.population(sets, 5, 1000)
    again, other = cases.population(sets, 5, 30), cases.population(sets, 6, 30)
    assert again == every[:30] and [one.label() for one in again] != [one.label() for one in other]
    assert len({one.name for one in every}) == len(every)
    for name in sets:
        own = [one for one in every if one.name.startswith(name)]
        for table in (causes.FREE_FLIGHT, causes.UNKNOWN, causes.DISTURBANCE):
            assert {cause for one in own for cause in one.causes} >= set(table)
        assert sum(not one.causes for one in own) == cases.NOTHING


def test_fresh_families_share_no_structure_with_those_of_development():
    """Of the forms of parts that stand beside each other in a build, no member of one set has those of
    another."""
    assert set(cases.SETS["dev"]) | set(cases.SETS["fresh"]) == set(FAMILIES) - {"reference"}
    forms = {}
    for name in ("dev", "fresh"):
        builds = [case.reality.build for case in cases.population((name,), 1, 40)]
        forms[name] = {
            "drag and ground": {(b.flapping > 0, b.quadratic_drag[0] > 0, b.ground) for b in builds},
            "controller": {(b.controller, b.feed_forward > 0, b.integral > 0) for b in builds},
            "motors": {(b.spin_down > 0, b.thrust_curve != 0, b.thrust_exponent != 1) for b in builds},
            "battery": {(b.polarisation > 0, b.battery_power != 2) for b in builds},
        }
    for part, dev in forms["dev"].items():
        assert not dev & forms["fresh"][part], part


@pytest.mark.parametrize("family", ["dev", "fresh"])
def test_the_reality_does_not_depend_on_what_is_hidden(family):
    one = cases.draw(family, "wind", "weak", (1, 3))
    for cause in causes.FREE_FLIGHT:
        assert cases.draw(family, cause, "strong", (1, 3)).reality == one.reality


def label(hidden="wind", size="medium", parameters=None):
    names, rng = hidden.split(), np.random.default_rng(0)
    parameters = parameters or {name: causes.draw(name, size, rng).parameters for name in names}
    return {"causes": names, "size": size if names else None, "parameters": parameters}


def report(*named):
    """named: (name, class, values with their interval)."""
    found = [
        {
            "name": name,
            "members": [name, *members],
            "sure": False,
            "parameters": {key: {"value": x[0], "ci95": x[1:]} for key, x in values.items()},
        }
        for name, members, values in named
    ]
    return {"verdict": "effects" if named else "nothing", "effects": found}


WIND, TRIM = ("wind", (), {}), ("attitude_trim", ("wind",), {})
DRAG, SCALE, LOOP = ("rotor_drag", (), {}), ("thrust_scale", (), {}), ("attitude_time_constant", (), {})
LATE = [(name, (), {}) for name in ("thrust_delay", "attitude_delay", "mocap_delay")]


@pytest.mark.parametrize(
    ("hidden", "named", "alone"),
    [
        ("wind", [WIND], True),
        ("wind", [TRIM], True),  # in its class
        ("wind", [DRAG], False),
        ("wind", [WIND, DRAG], False),  # spurious
        ("wind", [], False),
        ("mass", [SCALE], True),  # only thrust over mass shows
        ("thrust_scale", [SCALE, LOOP], True),  # entailed
        ("mass", [SCALE, LOOP], False),
        ("mocap_delay", LATE[:1], False),
        ("mocap_delay", LATE[:2], True),
        ("log_delay", LATE[2:], True),
        ("lateral_drag", [DRAG], True),
        ("wind rotor_drag", [WIND, DRAG], True),
        ("wind rotor_drag", [WIND], False),
        ("wind rotor_drag", [WIND, SCALE], False),
    ],
)
def test_all_causes_are_named_and_nothing_else(hidden, named, alone):
    assert score.score_case(label(hidden), report(*named))["alone"] == alone


def test_intervals_are_compared_with_what_was_hidden():
    def held(cause, truth, *effect):
        one = label(cause, parameters={cause: truth})
        return score.score_case(one, report(effect))["covered"].get(cause, {})

    wind = {"x": (0.2, 0.1, 0.3), "y": (0.0, -0.01, 0.01)}
    assert held("wind", {"x": 0.28, "y": 0.05}, "wind", (), wind) == {"x": True, "y": False}
    # Across another unit: 1/1.1 lies between the ends of the thrust's scale, 1/1.2 does not.
    for mass, inside in ((1.1, True), (1.2, False)):
        scale = ("thrust_scale", (), {"scale": (0.9, 0.89, 0.92)})
        assert held("mass", {"scale": mass}, *scale) == {"level": inside}
    # Drag across the rotors alone leaves that along them open.
    drag = ("rotor_drag", (), {"lateral": (2.0, 1.9, 2.1), "axial": (1.0, 0.5, 1.5)})
    assert held("lateral_drag", {"lateral": 2.05}, *drag) == {"lateral": True}
    ground = ("ground_effect", (), {"strength": (5.0, 4.0, 6.0), "range": (0.3, 0.2, 0.4)})
    assert held("ground_effect", {"gain": 5.0 / 256.0}, *ground) == {"gain": True}
    # A sag of 0.2 about 40 000 PWM, as its slope in hover: 8 % more or less of it holds that, 8 to 16 % not.
    truth = {"slope": 0.2 / 40000 / (1 - 0.2 * (36000 / 40000 - 1)), "pwm": 36000.0}
    for low, high, inside in ((0.184, 0.216, True), (0.216, 0.232, False)):
        sag = {"sag": (0.5 * (low + high), low, high), "reference": (40000.0, 4e4, 4e4)}
        assert held("battery_sag", truth, "battery_sag", (), sag) == {"slope over load": inside}
    assert held("com_offset", {"x": 0.001}, "com_offset", (), {"x": (0.001, 0.0, 0.002)}) == {}
    assert held("wind", {"x": 0.2, "y": 0.0}, *TRIM) == {}  # another name of its class says nothing of it
