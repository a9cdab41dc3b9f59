"""Report of the gap workflow: words, page and corrected model of a diagnosis made by hand."""

import dataclasses
import json
import re
import subprocess
import sys

import numpy as np
import pytest

from inclined_landing.eval.gap.report import figures, model, terminal, words
from inclined_landing.eval.gap.report.page import page
from inclined_landing.eval.gap.report.tracks import Track
from inclined_landing.eval.gap.result import (
    Dependence,
    Diagnosis,
    Difference,
    Disturbance,
    Estimate,
    HorizonCurve,
    InconsistentFlights,
    NamedEffect,
    PlantGap,
    RegimeError,
    ResidualAnalysis,
    ScoredSet,
    WindowCurves,
)
from inclined_landing.models import effects, storage
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import constants, load_vehicle
from tests.pages import EVIL, check_page

FLIGHTS = ("a", "b", "c")
SCALE, TRIM = {"scale": 0.88}, {"roll": 0.02, "pitch": -0.01}


def estimate(effect, name, value):
    p = LIBRARY[effect].parameter(name)
    half = 0.1 * abs(value - p.neutral)
    per_flight = (value, value + half, float("nan"))
    ci = (value - half, value + half)
    return Estimate(value, p.unit, ci, p.neutral, p.bounds, False, per_flight, (half,) * 3, 0.0)


def named(name, values, gain=0.5, *alike):
    parameters = {p: estimate(name, p, x) for p, x in values.items()}
    return NamedEffect(name, (name, *alike), 0.97, parameters, gain, LIBRARY[name].remedy)


def example(verdict="effects"):
    said = ()
    if verdict != "nothing":
        said = (named("thrust_scale", SCALE, 0.8, "mass"), named("attitude_trim", TRIM, 0.1))
    t = np.linspace(0.01, 1.0, 20)
    shape = np.outer(t, np.ones(6))
    bins = np.arange(3.0)
    moved = (0.05, (0.03, 0.08))
    left = Dependence("z", "place", 0.3, "m/s2", 0.4, 9.0, *moved, {"hover": 0.4}, "position z", bins, bins)
    scored = {
        "nothing": (
            ScoredSet((), 0.9, {}, {}),
            ScoredSet(("wind",), 0.1, {"wind": {"x": 0.1, "y": 0.0}}, {}),
        ),
        "effects": (
            ScoredSet(
                ("thrust_scale", "attitude_trim"), 0.8, {"thrust_scale": SCALE, "attitude_trim": TRIM}, {}
            ),
            ScoredSet(("mass", "attitude_trim"), 0.17, {"mass": {"scale": 1.136}, "attitude_trim": TRIM}, {}),
            ScoredSet(("thrust_scale",), 0.02, {"thrust_scale": SCALE}, {}),
        ),
    }
    return Diagnosis(
        verdict=verdict,
        effects=said,
        corrected=effects.apply(load_vehicle(), {e.name: e.values() for e in said}),
        separating_manoeuvre="Weigh the vehicle. To tell thrust_scale from mass: weigh." if said else None,
        where=tuple(
            RegimeError(r, c, 1.0, 0.1, 0.05, "m/s2" if c == "z" else "rad", 12)
            for r in ("hover", "all")
            for c in ("z", "roll")
        ),
        sets=scored["nothing" if verdict == "nothing" else "effects"],
        disturbance={
            "z": Disturbance(0.001, 0.3, (0.2, 0.4), 0.25, (0.1, 0.4), "m/s2"),
            "roll": Disturbance(0.005, 0.0, (0.0, 0.0), 0.3, (0.3, 0.3), "rad/s2"),
        },
        horizon=(
            HorizonCurve("nominal", (), t, 0.5 * t**2, 0.01 * t),
            HorizonCurve("+ thrust_scale", ("thrust_scale",), t, 0.04 * t, 0.01 * t),
        ),
        windows=(WindowCurves("a", "hover", 3.0, t, shape, shape + t[:, None] ** 2, shape),),
        residual=ResidualAnalysis(0.002, {"z": 0.2}, (left,) if verdict == "unknown" else (), 0.1),
        gap={
            "analytic": PlantGap(0.487, 0.04, 0.01, 0.5, 0.05, 30, 1.0),
            "mujoco": PlantGap(0.486, 0.041, 0.01, 0.5, 0.05, 30, 1.0),
        },
        platform=True,
        flights=FLIGHTS,
        heldout=("d",),
        seconds={"name": 1.5},
        notes=("a: yaw_drift cannot be told",),
    )


@pytest.fixture
def track():
    t = np.linspace(0, 2, 41)
    times = (t[:21], t[20:])
    flown = np.outer(t, [0.0, 0.1, 1.0])
    there = (flown[:21], flown[20:])
    return Track("d", True, 1.0, t, flown, times, tuple(p + p**2 for p in there), there)


def test_what_repeats_matters_by_the_second_that_it_moves():
    """A share of the squared error a second ahead; where that was not measured, all but the heading."""
    left = example("unknown").residual
    (one,) = left.depends_on
    assert left.unexplained and not dataclasses.replace(left, error=1.0).unexplained
    assert dataclasses.replace(left, error=float("nan")).unexplained
    heading = dataclasses.replace(one, channel="yaw", displacement=0.0)
    assert not dataclasses.replace(left, depends_on=(heading,), error=float("nan")).unexplained
    assert left.material(one) and not left.material(heading)


def test_what_was_not_named_is_possible_from_some_probability_on():
    """Neither a name, nor what takes its place, nor what is too rare."""
    d = example()
    more = (ScoredSet(("thrust_scale", "wind"), 0.06, {}, {}), ScoredSet(("rotor_drag",), 0.01, {}, {}))
    assert d.possible == {} and dataclasses.replace(d, sets=(*d.sets, *more)).possible == {"wind": 0.06}


def test_a_size_that_may_be_zero_is_not_sure():
    effect = named("thrust_scale", {"scale": 0.9})
    for ends, sure in (((0.85, 0.95), True), ((0.85, 1.02), False)):
        parameters = {"scale": dataclasses.replace(effect.parameters["scale"], ci95=ends)}
        assert dataclasses.replace(effect, parameters=parameters).sure is sure


def test_every_effect_is_said_in_words_with_its_numbers():
    for name, effect in LIBRARY.items():
        text = words.meaning(named(name, effect.plausible))
        assert len(re.findall(r"-?\d[\d.]*", text)) == len(effect.parameters) and "_" not in text
    late = words.meaning(named("thrust_delay", {"delay": 0.012}))
    assert late == "thrust commands act 12.0 ms after they were sent"


def test_headlines_say_what_is_known_and_what_is_not():
    ratio = "thrust scale or mass (97 %: flights show only their ratio)"
    assert words.headline(example()) == f"Wrong or missing in the model: {ratio} and attitude trim (97 %)."
    assert words.headline(example("unknown")).endswith("something that no effect of the library explains.")
    assert words.headline(example("nothing")).startswith("Nothing is missing (90 %)")
    certain = (ScoredSet(("wind",), 0.98, {}, {}), ScoredSet((), 0.02, {}, {}))
    useless = words.headline(dataclasses.replace(example("nothing"), sets=certain))
    assert useless.startswith("Nothing to correct: wind (98 %) fits these flights, but")
    little = dataclasses.replace(
        example(), effects=(named("wind", {"x": 0.3, "y": 0.0}, 0.5), example().effects[1])
    )
    little = dataclasses.replace(little, effects=(little.effects[0], named("attitude_trim", TRIM, 0.001)))
    assert words.headline(little) == "Wrong or missing in the model: wind (97 %) and attitude trim (97 %)."
    unsure = dataclasses.replace(little, effects=(dataclasses.replace(little.effects[0], probability=0.6),))
    assert words.headline(unsure) == "Possibly wrong or missing in the model: wind (60 %)."
    assert words.answer_rows(unsure)[0][:2] == ("wind", "possible, 60 %")
    assert "Something is missing" in words.headline(
        dataclasses.replace(example("nothing"), verdict="unknown")
    )


def test_the_first_sentences_hold_class_remedy_manoeuvre_and_gap():
    text = " ".join(words.sentences(example()))
    assert "the rotors give 0.880 times the modelled thrust" in text.lower()
    assert "It may as well be mass: free flight shows only the ratio" in text
    assert "To tell thrust scale from mass: weigh." in text
    assert "from 49 cm to 4.0 cm (94 % of the gap closed); the measurement noise alone makes 1.0 cm" in text
    assert "in MuJoCo" in text
    rows = words.answer_rows(example())
    assert LIBRARY["attitude_trim"].remedy in rows[1] and rows[1][1] == "sure, 97 %"


@pytest.mark.parametrize("verdict", ["effects", "unknown", "nothing"])
def test_the_page_stands_alone(verdict, track):
    d = example(verdict)
    text = page(d, track, versions={"mujoco": "4.0"}, notes=("a note on <all> logs",)).replace("\u00a0", " ")
    assert words.headline(d) in text and "a note on &lt;all&gt; logs." in text
    assert not re.search(r"(src|href)=\"(?!data:)", text) and "nan" not in text.lower().split("base64")[0]
    assert text.count("data:image/svg+xml") == {"effects": 6, "unknown": 7, "nothing": 3}[verdict]
    assert "17 %" in text if d.effects else "10 %" in text  # the second set
    assert "0.20 to 0.40 m/s²" in text and "250 ms" in text  # the disturbance
    assert ("0.300 m/s² in z depends on place, most in hover" in text) == (verdict == "unknown")


def test_the_page_escapes_names_of_flights_and_notes(track):
    d = dataclasses.replace(
        example("unknown"),
        flights=(f"{EVIL} flight", "b"),
        heldout=(f"{EVIL} heldout",),
        notes=(f"{EVIL} note",),
    )
    html = page(d, track, versions={"python": f"{EVIL} version"}, notes=(f"{EVIL} log",))
    check_page(html, *(f"{EVIL} {word}" for word in ("flight", "heldout", "note", "log", "version")))


def test_a_diagnosis_without_anything_to_draw_still_makes_a_page():
    d = dataclasses.replace(
        example("nothing"), where=(), sets=(), disturbance={}, horizon=(), windows=(), gap={},
        heldout=FLIGHTS,
        residual=ResidualAnalysis(1.0, {}, ()),
    )  # fmt: skip
    assert "in turn" in page(d, None, versions={})
    figures.overview(example("nothing"), None)


def test_the_terminal_says_the_same(capsys):
    terminal.show(example(), ("hover thrust differs",))
    out = " ".join(capsys.readouterr().out.split())
    assert out.endswith(words.headline(example()))
    assert (
        "thrust scale scale 0.8800 0.868 to 0.892 97 % 80 %" in out and "Note: hover thrust differs." in out
    )


def test_flights_that_contradict_the_others_are_said_before_the_verdict(capsys):
    differences = (
        Difference("thrust_scale", ("mass",), False, {"scale": 0.86}, {"scale": (0.84, 0.88)}),
        Difference("thrust_delay", (), True, {"delay": 0.01}, {"delay": (0.008, 0.012)}),
    )
    d = dataclasses.replace(
        example(), inconsistent_flights=(InconsistentFlights(("b",), ("a", "c"), differences, 1e-4, 0.01),)
    )
    terminal.show(d)
    out = " ".join(capsys.readouterr().out.split())
    who = "b contradicts the other 2 flights. Beside a model of the others, in b the rotors give"
    assert out.index(who) < out.index("Wrong or missing in the model:")
    assert "0.8600 times the modelled thrust (95 % interval: 0.840 to 0.880)." in out
    assert "What differs may as well be mass." in out
    assert "Beside a model of b, in the others thrust commands act 10.00 ms after" in out
    text = page(d, None, versions={}).replace("\u00a0", " ")
    assert text.index("b contradicts the other 2 flights.") < text.index(
        "Wrong or missing in the model:", text.index("<body>")
    )
    record = json.loads(storage.to_json(d.to_json()))["inconsistent_flights"][0]
    assert record["flights"] == ["b"] and record["differences"][0]["ci95"]["scale"] == [0.84, 0.88]


def test_the_corrected_model_is_a_vehicle_file_with_provenance(tmp_path):
    d = example()
    model.write(d, load_vehicle(), tmp_path)
    disturbance = {
        "disturbance_acceleration": (0.0, 0.0, 0.3),
        "disturbance_acceleration_time": (0.0, 0.0, 0.25),
    }
    assert load_vehicle(tmp_path / "vehicle.toml") == dataclasses.replace(d.corrected, **disturbance)
    entries = {f"{c.section}_{c.name}": c for c in constants(tmp_path / "vehicle.toml")}
    gain = entries["thrust_state_gain"]
    assert gain.source.startswith(
        "identified by landing-eval gap: thrust_scale scale 0.88, 95 % interval 0.868 to 0.892"
    )
    # Half the width of the interval, of the scale, times the nominal gain.
    assert gain.uncertainty == pytest.approx(0.012 * load_vehicle().thrust_state_gain, rel=1e-2)
    assert entries["disturbance_acceleration"].uncertainty == (0.0, 0.0, 0.1)
    assert entries["effects_attitude_trim"].uncertainty == (0.002, 0.001)
    assert entries["body_mass"] in constants()


def test_the_corrected_mjcf_loads_in_plain_mujoco(tmp_path):
    d = example()
    model.write(d, load_vehicle(), tmp_path)
    code = "import mujoco, sys; print(mujoco.MjModel.from_xml_path(sys.argv[1]).nplugin)"
    done = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "landing.xml"], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == 0 and int(done.stdout) > 0, done.stderr


def test_the_json_has_the_promised_keys():
    record = json.loads(storage.to_json(example().to_json()))
    promised = ("verdict", "effects", "separating_manoeuvre", "where", "gap", "residual", "seconds")
    assert set(promised) <= set(record)
    assert set(record["effects"][0]) >= {"name", "members", "parameters", "gain"}
    assert set(record["effects"][0]["parameters"]["scale"]) >= {"value", "unit", "ci95"}
    assert record["nothing"] == 0.0 and record["sets"][1]["effects"] == ["mass", "attitude_trim"]
    assert (
        record["disturbance"]["z"]["noise"] == 0.001
        and record["disturbance"]["z"]["size"] == 0.3
        and record["platform"]
    )
    assert set(record["where"][0]) >= {"regime", "channel", "before", "after", "floor", "unit"}
    assert set(record["gap"]["mujoco"]) >= {"before", "after", "floor"}
