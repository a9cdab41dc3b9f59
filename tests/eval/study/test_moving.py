"""The frozen benchmark of moving platforms: its files, its scorer, controllers of others."""

import hashlib
import json
import math

import numpy as np
import pytest

from inclined_landing.eval.cli import main
from inclined_landing.eval.study import moving
from inclined_landing.eval.study.engine import run
from inclined_landing.eval.study.moving import fly
from inclined_landing.eval.study.platforms import controllers
from inclined_landing.eval.study.platforms.controllers import vehicle_flown
from inclined_landing.eval.study.platforms.scenario import read_scenario, shipped
from tests import ROOT
from tests.eval.study import spectra

VEHICLE = vehicle_flown()
MOVING = ("robustness", "--over", "moving", "--every", "1")
# Never edited: a change is another scenario, with another name.
FROZEN = (ROOT / "tests/eval/study/scenarios.txt").read_text()
DRAWN = "38373780da98e06d"


def test_the_scenarios_are_frozen():
    assert "".join(f"{read_scenario(name).fingerprint}  {name}.toml\n" for name in shipped()) == FROZEN


def test_what_the_scenarios_draw_is_frozen():
    """Starts and motions at 1 s to a micrometre: other generators or waves would be another benchmark."""
    digest = hashlib.sha256()
    for name in shipped():
        drawn = read_scenario(name).draw(VEHICLE)
        place, rate, _ = drawn.motion.at(1.0)
        for array in (drawn.start[:, :3], drawn.azimuth[:, None], place, rate):
            digest.update((np.rint(1e6 * array).astype(np.int64) + 0).tobytes())
    assert digest.hexdigest()[:16] == DRAWN


@pytest.mark.parametrize("name", spectra.MADE)
def test_ship_and_car_move_as_their_spectra_say(name):
    scenario, made = read_scenario(name), spectra.MADE[name]()
    found = scenario.waves.amplitude * np.exp(1j * scenario.waves.phase)
    # Of the files' digits: 5e-6 m or 5e-4 deg, and 0.05 deg of phase of the largest.
    wanted = made.amplitude * np.exp(1j * made.phase)
    for got, want, digits in zip(found, wanted, [5e-6] * 3 + [math.radians(5e-4)] * 3):
        bound = digits + math.radians(0.05) * np.abs(want).max()
        np.testing.assert_allclose(got, want, rtol=0, atol=1.5 * bound + 1e-12)
    np.testing.assert_allclose(scenario.waves.period, made.period, atol=5.1e-5)


def test_a_car_on_a_smooth_slow_wave_follows_the_road():
    """Known truth: far below its resonances, a car moves as the road, and a long wave lifts the ship by
    itself."""
    strut = spectra.SPRING + 1j * spectra.DAMPER * 0.01
    body = strut * spectra.TYRE / ((strut - 1e-4) * (strut + spectra.TYRE - 1.5e-5) - strut**2)
    assert abs(body) == pytest.approx(1.0, abs=1e-4)


def test_the_sea_has_its_height():
    """Significant height is four times the root of the variance; the components cover most of the
    spectrum."""
    _, amplitude = spectra.sea(5)
    assert 4.0 * math.sqrt(0.5 * (amplitude**2).sum()) == pytest.approx(3.25, rel=0.05)


GOOD = (shipped()["ship_5_bow"]).read_text()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("seed = 7402", "", "seed is missing"),
        ("friction = 0.8", "friction = 0.8\ncolour = 1", "unknown entry 'colour'"),
        ('azimuth_deg = "any"', 'azimuth_deg = "north"', "[deck] azimuth_deg must be a number"),
        ("roll = { amplitude = [0.085,", "roll = { amplitude = [70.0,", "together reach"),
        ("x = [-2.5, 2.5]", "x = [2.5, -2.5]", "is above the upper"),
        ("hold = 0.3", "hold = 12.0", "must be shorter than within"),
    ],
)
def test_a_malformed_scenario_is_one_sentence(tmp_path, capsys, old, new, said):
    assert old in GOOD
    file = tmp_path / "mine.toml"
    file.write_text(GOOD.replace(old, new, 1))
    assert main([*MOVING, "planner", "--scenario", str(file), "--out", str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert said in err and "mine.toml" in err and err.count("\n") == 1
    assert not (tmp_path / "out").exists()


BAD = """
import numpy as np
def short(t, state, deck): return np.zeros((len(state), 3))
def nan(t, state, deck): return np.full((len(state), 4), np.nan)
def text(t, state, deck): return "up"
def broken(t, state, deck): return 1 / 0
number = 3
class Deaf:
    def __init__(self, vehicle): pass
"""


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("short", "finite numbers of shape (2, 4), not (2, 3)"),
        ("nan", "finite numbers"),
        ("text", "must be an array of real numbers"),
        ("broken", "raised ZeroDivisionError: division by zero"),
        ("number", "no function or class"),
        ("Deaf", "object is not callable"),
    ],
)
def test_a_bad_controller_is_one_sentence(tmp_path, capsys, name, said):
    file = tmp_path / "mine.py"
    file.write_text(BAD)
    line = [*MOVING, f"{file}:{name}", "--scenario", "still_00_deg", "--flights", "2"]
    assert main([*line, "--out", str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert said in err and err.count("\n") == 1 and not (tmp_path / "out").exists()


def test_the_planner_lands_and_the_report_is_the_same_again(tmp_path, capsys):
    """On a ship at sea; fewer flights are the first ones, with the same numbers."""
    scenario, planner = read_scenario("ship_5_bow"), controllers.find("planner", VEHICLE)
    flown = fly(scenario, planner, 3)
    assert flown["at_rest"].all() and (flown["normal_speed"] > 0).all()
    assert fly(scenario, planner, 1).iloc[0].equals(flown.iloc[0])
    arguments = [*MOVING, "planner", "--scenario", "ship_5_bow", "--flights", "3"]
    assert main([*arguments, "--out", str(tmp_path / "out"), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((tmp_path / "out/robustness.json").read_text())
    counts = [row["count"] for row in printed["rows"] if row["measure"] == "at_rest" and row["scenario"]]
    assert counts == [3]
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        *("flights.csv", "index.html", "moving.pdf", "moving.png", "robustness.json")
    ]
    assert moving.PARTLY in (tmp_path / "out/index.html").read_text()


def test_who_does_nothing_does_not_land(tmp_path):
    """A vehicle whose motors are off falls to the floor, or onto the platform it started over."""
    file = tmp_path / "still.py"
    file.write_text("import numpy as np\ndef off(t, state, deck): return np.zeros((len(state), 4))\n")
    found = controllers.find(f"{file}:off", VEHICLE)
    flown = fly(read_scenario("travel_200_cm_s"), found, 4)
    assert not flown["at_rest"].any()
    (results,) = run([moving.study([read_scenario("travel_200_cm_s")], [found], 1)])
    assert results.one("at_rest", together="all scenarios")["count"] == 0


def test_a_pilot_gets_no_more_than_it_is_told(tmp_path):
    """Its arrays are copies of 12 columns: what it writes into them changes nothing."""
    file = tmp_path / "mine.py"
    file.write_text(
        "def mine(t, state, deck):\n"
        "    assert state.shape == deck.shape == (1, 12)\n"
        "    state[:], deck[:] = 1e9, 1e9\n"
        "    return [[0, 0, 0, 0]]\n"
    )
    assert not fly(read_scenario("still_00_deg"), controllers.find(f"{file}:mine", VEHICLE), 1)["at_rest"][0]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("touchdown-nominal",), "flies in a plane"),
        (("planner", "--scenario", "ship_9"), "scenario ship_9 does not exist"),
        (("no-such-policy",), "does not exist"),
    ],
)
def test_wrong_names_are_sentences(arguments, said, capsys):
    assert main([*MOVING, *arguments]) == 2
    assert said in capsys.readouterr().err


def test_the_example_lands_and_is_the_one_of_the_page():
    example, page = ROOT / "examples/own_controller.py", (ROOT / "docs/guides/platforms.md").read_text()
    text = example.read_text()
    assert text[text.index("class Descend") :].strip() in page
    found = controllers.find(f"{example}:Descend", VEHICLE)
    assert fly(read_scenario("travel_050_cm_s"), found, 2)["at_rest"].all()
