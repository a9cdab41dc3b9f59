"""`crazyflie.toml` is complete, is refused when it is wrong, and is the only place of its numbers."""

import ast
import dataclasses
import itertools
import re
from importlib import resources

import numpy as np
import pytest

from inclined_landing.models.base.errors import UserError
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import check_vehicle, constants, load_vehicle, write_vehicle
from tests import ROOT

FOLDERS = ("models", "envs", "eval", "train")
# Sections whose numbers are the vehicle's own; arena and platform sizes are ordinary numbers such as 0.5.
DISTINCTIVE = ("body", "thrust", "motor", "drag", "attitude")


@pytest.fixture
def text() -> str:
    return (resources.files("inclined_landing.models") / "crazyflie.toml").read_text("utf-8")


@pytest.fixture
def load(tmp_path):
    """Loader of a vehicle file with the given text."""

    def load(text: str, name="vehicle.toml"):
        path = tmp_path / name
        path.write_text(text, "utf-8")
        return load_vehicle(path)

    return load


@pytest.mark.parametrize("constant", constants(), ids=lambda c: f"{c.section}.{c.name}")
def test_every_constant_has_unit_source_and_uncertainty(constant):
    assert isinstance(constant.unit, str) and constant.unit.strip()
    assert isinstance(constant.source, str) and constant.source.strip()
    uncertainty = constant.uncertainty
    if isinstance(uncertainty, str):
        assert uncertainty.startswith("not ")  # "not published", "not measured"
    else:
        assert np.all(np.asarray(uncertainty) >= 0)
        assert np.ndim(uncertainty) in (0, np.ndim(constant.value))
    if "[E]" in constant.source:  # an estimate is never given as exact
        assert isinstance(uncertainty, str) or np.all(np.asarray(uncertainty) > 0)


WRONG = {  # what stands in the file, what instead, part of the sentence
    "missing": ("\nmass ", "\n#", r"lacks entries: body\.mass; a file that contains only differences"),
    "unknown": (
        "[thrust]",
        '[thrust]\nlag = { value = 1, unit = "1", source = "", uncertainty = 0 }',
        r"thrust\.lag$",
    ),
    "negative": ("value = 0.03303", "value = -1.0", r"body\.mass is -1 kg; it must be from 0\.001 to 20 kg$"),
    "unit": ('unit = "kg"', 'unit = "g"', r"body\.mass must be in 'kg', not in 'g'"),
    "range": ("[0.001, 20.0]", "[0, 99]", r"body\.mass must not have a range"),
}


@pytest.mark.parametrize("problem", WRONG)
def test_wrong_files_are_refused_in_one_sentence(load, text, problem):
    there, instead, sentence = WRONG[problem]
    assert there in text
    with pytest.raises(UserError, match=sentence) as error:
        load(text.replace(there, instead, 1))
    assert "vehicle.toml" in str(error.value) and "\n" not in str(error.value)


CONTRADICTIONS = {
    "triangle": ({"body_inertia": (1e-5, 1e-5, 3e-5)}, r"body\.inertia is impossible"),
    "gyration": ({"body_inertia": (1e-2, 1e-2, 1e-2)}, r"radius of gyration of 0\.55 m"),
    "overlap": ({"rotor_radius": 0.04}, "the rotors overlap"),
    "half a motor": ({"motor_count": 3.5}, r"motor\.count must be a whole number"),
    "too heavy": (
        {"body_mass": 3.0, "body_inertia": (1e-3,) * 3},
        r"cannot hover: .* is 0\.57 N, its weight 29\.4 N",
    ),
    "static map": ({"motor_pwm_to_force": (1e-11, 1e-6, 1.0)}, "carries the weight at PWM 0"),
    "bias": ({"effects_thrust_bias": -9.0}, r"effects\.thrust_bias of -9 N is more than 10 times the weight"),
    "reference": ({"effects_battery_reference": 0.0}, r"effects\.battery_reference must not be 0"),
    "sag": (
        {"effects_battery_sag": 0.5, "effects_battery_reference": 1.0},
        r"effects\.battery_sag makes the thrust in hover -1\.7e\+04 times",
    ),
    "reversed PWM": ({"command_pwm_range": (6e4, 1e4)}, r"command\.pwm_range must be increasing"),
    "centre": ({"command_pwm_centre": 5e3}, r"command\.pwm_centre of 5000 PWM is outside"),
    "reversed arena": ({"arena_y": (1.4, -1.4)}, r"arena\.y must be increasing, not 1\.4 to -1\.4 m"),
    "empty arena": ({"arena_z": (1.0, 1.0)}, r"arena\.z must be increasing"),
    "solref": ({"contact_solref": (0.01, -5.0)}, r"contact\.solref must be"),
    "period": ({"command_control_period": 0.015}, "not a whole number of engine steps"),
    "lag": (
        {"thrust_lag_rate": 400.0, "thrust_direct_gain": 1e-5},
        r"thrust\.lag_rate of 400 1/s is too fast for steps of 0\.02 s",
    ),
    "loop": (
        {"attitude_bandwidth": 700.0},
        r"attitude\.bandwidth of 700 1/s is too fast for steps of 0\.004",
    ),
    "drag": ({"drag_coefficients": (-1e-3, 0.0, 0.0)}, r"drag\.coefficients slow the vehicle"),
}
MISPLACED = {
    "inclination": ({"platform_inclination": 1.0}, "outside the supported range of -50 to 50 deg"),
    "outside": ({"arena_x": (-0.3, 3.4)}, r"from -0\.4 to 0\.4 m in x and does not fit into arena\.x"),
    "above": ({"platform_surface_height": 2.3}, r"in z and does not fit into arena\.z, 0 to 2\.4 m"),
}


@pytest.mark.parametrize("problem", CONTRADICTIONS | MISPLACED)
def test_values_that_contradict_each_other_are_refused(tmp_path, problem):
    change, sentence = (CONTRADICTIONS | MISPLACED)[problem]
    vehicle = dataclasses.replace(load_vehicle(), **change)
    write_vehicle(tmp_path / "v.toml", vehicle)
    with pytest.raises(UserError, match=rf"v\.toml: .*{sentence}"):
        load_vehicle(tmp_path / "v.toml")
    if problem in MISPLACED:  # fits of the platform may look there
        check_vehicle(vehicle)
    else:
        with pytest.raises(UserError, match=sentence):
            check_vehicle(vehicle)


def alike(mass):
    """A vehicle of another mass [kg] with the proportions of the shipped one."""
    v, share = load_vehicle(), mass / load_vehicle().body_mass
    size = share ** (1 / 3)
    return dataclasses.replace(
        v,
        body_mass=mass,
        body_inertia=tuple(x * share * size**2 for x in v.body_inertia),
        rotor_arm=v.rotor_arm * size,
        rotor_radius=v.rotor_radius * size,
        rotor_height=v.rotor_height * size,
        thrust_state_gain=v.thrust_state_gain * share,
        thrust_direct_gain=v.thrust_direct_gain * share,
        motor_pwm_to_force=tuple(x * share for x in v.motor_pwm_to_force),
        motor_pwm_to_speed=tuple(x / size for x in v.motor_pwm_to_speed),
        drag_coefficients=tuple(x * share for x in v.drag_coefficients),
    )


@pytest.mark.parametrize("mass", [0.005, 0.03303, 0.5, 5.0])
def test_ranges_leave_room_for_other_vehicles_with_every_effect_at_its_bounds(mass):
    vehicle = alike(mass)
    check_vehicle(vehicle)
    for effect in LIBRARY.values():
        names = [p.name for p in effect.parameters]
        for corner in itertools.product(*(p.bounds for p in effect.parameters)):
            check_vehicle(effect.apply(vehicle, dict(zip(names, corner))))


def test_the_two_hover_points_differ():
    """A trap of the paper: the transfer function that flies the vehicle hovers at 34 100 PWM, while the
    42 000 at the centre of its action range is where the *static* map carries the weight."""
    v = load_vehicle()
    assert v.hover_pwm == pytest.approx(34_100, abs=50)  # "34 100", rounded to hundreds
    # The paper rounds to thousands, and gives no mass for it.
    assert v.static_hover_pwm == pytest.approx(v.command_pwm_centre, abs=500)
    weight = v.body_mass * v.environment_gravity
    a, b, c = v.motor_pwm_to_force
    static = v.motor_count * (a * v.static_hover_pwm**2 + b * v.static_hover_pwm + c)
    assert static == pytest.approx(weight, rel=1e-12)
    # At 42 000 the equations therefore climb: nearly a quarter more than the weight.
    assert v.thrust_per_pwm * v.command_pwm_centre / weight == pytest.approx(1.23, abs=0.01)


def _python_numbers(source: str):
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
            yield float(node.value)


def _text_numbers(source: str):
    source = re.sub(r"/\*.*?\*/|//[^\n]*|<!--.*?-->", "", source, flags=re.S)
    for number in re.findall(r"(?<![\w.])[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?", source):
        yield float(number)


def _sources():
    """Not the XML: it is the shipped vehicle, and `test_scene.py` holds it to the vehicle file."""
    for folder in FOLDERS:
        for path in (ROOT / folder).rglob("*"):
            if path.suffix in (".py", ".cc", ".h", ".in"):
                yield path


def test_no_number_of_the_vehicle_file_stands_anywhere_else():
    """Same number, whatever its notation; short ones such as 4 motors or 1/10 s cannot be told apart."""
    numbers = {}
    for c in constants():
        for value in c.value if isinstance(c.value, tuple) else (c.value,):
            digits = repr(abs(float(value))).partition("e")[0].replace(".", "").strip("0")
            if c.section in DISTINCTIVE and len(digits) >= 3:
                numbers[abs(value)] = f"{c.section}.{c.name}"
    assert len(numbers) >= 15
    known, found, seen = np.array([*numbers]), [], 0
    for path in _sources():
        read = _python_numbers if path.suffix == ".py" else _text_numbers
        there = np.abs([*read(path.read_text("utf-8"))]).reshape(-1, 1)
        seen += len(there)
        for k, name in zip(*np.nonzero(np.isclose(there, known, rtol=1e-5, atol=0.0))):
            found.append(f"{path.relative_to(ROOT)}: {there[k, 0]} ({numbers[known[name]]})")
    assert not found
    assert seen > 500  # the readers read


def test_a_written_vehicle_reads_back_with_its_sources(tmp_path):
    vehicle = dataclasses.replace(load_vehicle(), body_mass=0.01 + 0.02, effects_wind=(0.5, -1 / 3))
    path = tmp_path / "v.toml"
    write_vehicle(
        path, vehicle, {"body_mass": 'a "scale"'}, {"body_mass": 0.01}, heading="two lines\nof comment"
    )
    assert load_vehicle(path) == vehicle
    entries = {(c.section, c.name): c for c in constants(path)}
    assert (entries["body", "mass"].source, entries["body", "mass"].uncertainty) == ('a "scale"', 0.01)
    assert entries["effects", "wind"].source == "changed from [0.0, 0.0]"
    assert entries["thrust", "lag_rate"] in constants()
    # The changes of a changed vehicle stand against the file it came from.
    write_vehicle(tmp_path / "w.toml", vehicle, base=path)
    assert constants(tmp_path / "w.toml") == constants(path)
    with pytest.raises(UserError, match="cannot write"):
        write_vehicle(tmp_path / "nowhere" / "v.toml", vehicle)
