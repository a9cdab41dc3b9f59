"""Report of the gap workflow: words, page and corrected model of a diagnosis made by hand."""

import dataclasses
import json
import re
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec import ValidationError

from inclined_landing.eval.gap import pipeline
from inclined_landing.eval.gap.answer.identification import _Fit, _idle_references
from inclined_landing.eval.gap.answer.sizes import loop_pieces, step_response_time
from inclined_landing.eval.gap.model.columns import Candidates
from inclined_landing.eval.gap.model.reference import VehiclePosterior
from inclined_landing.eval.gap.plan.reading import PlanInput
from inclined_landing.eval.gap.report import files, words
from inclined_landing.eval.gap.report.page import Track, figures, page, show
from inclined_landing.eval.gap.result import (
    Dependence,
    Diagnosis,
    Difference,
    Disturbance,
    ErrorGrowth,
    Estimate,
    InconsistentFlights,
    NamedEffect,
    PlantGap,
    ReferenceErrors,
    ResidualAnalysis,
    ScoredSet,
)
from inclined_landing.models import effects
from inclined_landing.models.base import storage
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import constants, load_vehicle

FLIGHTS = ("a", "b", "c")
HORIZON = np.array([0.5, 1.0])  # s
SCALE, TRIM, WIND = {"scale": 0.88}, {"roll": 0.02, "pitch": -0.01}, {"x": 0.1, "y": 0.0}


def estimate(effect, name, value):
    p = LIBRARY[effect].parameter(name)
    half = 0.1 * abs(value - p.neutral)
    ci = (value - half, value + half)
    return Estimate(value, p.unit, ci, p.neutral, p.bounds, False)


def named(name, values, gain=0.5, *alike):
    parameters = {p: estimate(name, p, x) for p, x in values.items()}
    probability = 0.99 if name == "thrust_scale" else 0.97  # as of the sets of `example`
    return NamedEffect(name, (name, *alike), probability, parameters, gain, LIBRARY[name].remedy)


def example(verdict="effects"):
    """A diagnosis of this verdict; of `unknown`, 40 of the 49 cm are explained, and 20 of 28 repeat."""
    said = ()
    if verdict != "nothing":
        said = (named("thrust_scale", SCALE, 0.8, "mass"), named("attitude_trim", TRIM, 0.1))
    moved = (0.21, (0.1, 0.3))
    left = Dependence("z", "place", *moved)
    scored = {
        "nothing": (ScoredSet((), 0.9, {}, {}), ScoredSet(("wind",), 0.1, {"wind": WIND}, {})),
        "effects": (
            ScoredSet(
                ("thrust_scale", "attitude_trim"), 0.8, {"thrust_scale": SCALE, "attitude_trim": TRIM}, {}
            ),
            ScoredSet(("mass", "attitude_trim"), 0.17, {"mass": {"scale": 1.136}, "attitude_trim": TRIM}, {}),
            ScoredSet(("thrust_scale",), 0.02, {"thrust_scale": SCALE}, {}),
        ),
    }
    after = {"effects": 0.04, "nothing": 0.487, "unknown": 0.28}[verdict]
    grown = zip(["", *(e.name for e in said)], (0.487, 0.1, after))
    d = Diagnosis(
        effects=said,
        corrected=effects.apply(load_vehicle(), {n: v for e in said for n, v in e.fitted.items()}),
        sets=scored["nothing" if verdict == "nothing" else "effects"],
        disturbance={
            "z": Disturbance(0.001, 0.3, (0.2, 0.4), 0.25, (0.1, 0.4), "m/s2"),
            "roll": Disturbance(0.005, 0.0, (0.0, 0.0), 0.3, (0.3, 0.3), "rad/s2"),
        },
        residual=ResidualAnalysis(0.002, (left,) if verdict == "unknown" else ()),
        gap={
            "analytic": PlantGap(0.487, after, 0.01, 30),
            "mujoco": PlantGap(0.486, after + 0.001, 0.01, 30),
        },
        platform=True,
        flights=FLIGHTS,
        heldout=("d",),
        notes=("a: yaw_drift cannot be told",),
        growth=ErrorGrowth(HORIZON, {name: size * HORIZON for name, size in grown}, 0.01 * HORIZON),
    )
    assert d.verdict == verdict
    return d


@pytest.fixture
def track():
    t = np.linspace(0, 2, 41)
    times = (t[:21], t[20:])
    flown = np.outer(t, [0.0, 0.1, 1.0])
    there = (flown[:21], flown[20:])
    return Track("d", True, t, flown, times, tuple(p + p**2 for p in there), there)


def test_what_repeats_matters_by_the_second_that_it_moves():
    """A share of the squared error a second ahead; where that was not measured, all but the heading."""
    d = example("unknown")
    (one,) = d.residual.depends_on
    assert d.remaining.functions and not left(d, 1.0).remaining.functions
    unmeasured = dataclasses.replace(d.remaining, gap=None)
    assert unmeasured.functions and unmeasured.doubts(np.inf)
    heading = dataclasses.replace(one, channel="yaw", displacement=0.0)
    only = dataclasses.replace(unmeasured, residual=ResidualAnalysis(0.002, (heading,)))
    assert not only.functions and not only.doubts(float("nan"))


ALIKE = ReferenceErrors(0.35, 0.01, example().disturbance)  # 1.4 times as large: the error before


def left(d, after, **changes):
    """The diagnosis with this error one second ahead left, in the equations."""
    gap = {"analytic": dataclasses.replace(d.gap["analytic"], after=after)}
    return dataclasses.replace(d, gap=gap, **changes)


def test_nothing_is_said_where_the_errors_are_those_of_the_reference():
    """Not with a larger error, or where an effect that moves the vehicle is probable."""
    d = left(dataclasses.replace(example("nothing"), reference=ALIKE), 0.487)
    sets = (ScoredSet(("wind",), 0.6, {"wind": {"x": 0.1, "y": 0.0}}), ScoredSet((), 0.4, {}))
    likely = dataclasses.replace(d, sets=sets, displacements={"wind": 0.12})  # of 49 cm: 6 % of the square
    repeats = example("unknown").residual
    for case, verdict in (
        (d, "nothing"),
        (left(d, 0.48), "nothing"),
        (left(d, 0.5), "unknown"),
        (dataclasses.replace(left(d, 0.5), reference=None), "nothing"),
        (likely, "undecided"),
        (left(dataclasses.replace(likely, displacements={"wind": 0.15}), 0.6), "undecided"),  # 6 %
        (dataclasses.replace(likely, displacements={"wind": 0.1}), "nothing"),  # 4 %
        (left(d, 0.487, residual=repeats), "unknown"),
        (left(d, 0.34, residual=repeats), "nothing"),  # of 35, and 21 repeat: 38 % of the square
        (left(d, 0.29, residual=repeats), "unknown"),  # 52 %
        (left(likely, 0.487, residual=repeats), "unknown"),
    ):
        assert case.verdict == verdict
    assert likely.nothing == pytest.approx(0.4)
    assert dataclasses.replace(likely, displacements={"wind": 0.1}).nothing == pytest.approx(1.0)
    rougher = words.headline(left(d, 0.5))
    assert rougher.startswith("No effect is named: the error is larger than in the reference flights, 50 cm")
    said = words.how_much(d)
    assert "(reference flights: 35 cm, noise alone: 1.0 cm). The remaining error does not depend" in said


def test_unknown_stands_beside_names_where_much_repeats():
    """More than they explain, most of what they leave, or some of much more than the reference left.

    An error no larger than the reference left may be the reference's own, where that is small: 22 % of the
    error before.
    """
    d = example("effects")
    (one,) = example("unknown").residual.depends_on

    def repeating(moved, after, reference=None):
        ends = (moved - 0.01, moved + 0.01)
        some = dataclasses.replace(one, displacement=moved, displacement_ci95=ends)
        residual = dataclasses.replace(d.residual, depends_on=(some,))
        errors = dataclasses.replace(ALIKE, error=reference) if reference else None
        return left(d, after, residual=residual, reference=errors)

    for case, verdict in (
        (repeating(0.2, 0.3), "effects"),  # of 49 cm 38 explained; 44 % of the square of 30 cm
        (repeating(0.22, 0.3), "unknown"),  # 54 %
        (repeating(0.15, 0.47), "unknown"),  # 13 cm explained
        (repeating(0.1, 0.3, reference=0.18), "effects"),
        (repeating(0.1, 0.3, reference=0.17), "unknown"),  # more than 1.75 times as large
        (left(d, 0.3, reference=dataclasses.replace(ALIKE, error=0.17)), "unknown"),
        (repeating(0.09, 0.1, reference=0.105), "effects"),  # of 49 cm before, whose 22 % are 10.9
        (repeating(0.09, 0.1, reference=0.115), "unknown"),
        (repeating(0.09, 0.1, reference=0.095), "unknown"),
    ):
        assert case.verdict == verdict
    own = repeating(0.09, 0.1, reference=0.105)  # effects of less than 9 cm / sqrt(1/2) are in doubt
    assert own.remaining.doubts(0.127) and not own.remaining.doubts(0.128)
    assert dataclasses.replace(own.remaining, reference=None).doubts(np.inf)
    past = dataclasses.replace(one, channel="roll", on="commands", displacement=0.05)
    text = words.how_much(left(d, 0.1, residual=dataclasses.replace(d.residual, depends_on=(past,))))
    assert "5.0 cm repeats from flight to flight: in roll, depending on commands." in text


def test_the_posterior_keeps_the_errors_of_its_flights():
    vehicle = load_vehicle()
    known = dataclasses.replace(VehiclePosterior.of_file(None, vehicle), errors=ALIKE)
    table = json.loads(json.dumps(known.to_json(vehicle)))
    assert VehiclePosterior.from_json(table).errors == ALIKE
    with pytest.raises(ValidationError, match="version"):
        VehiclePosterior.from_json(table | {"version": 4})


def test_a_name_is_doubted_for_the_error_that_names_leave_and_for_a_moment_without_requests():
    def doubt(name="wind", too_small=False, requested=False):
        flights = [SimpleNamespace(shows_lags=True)]
        problem = SimpleNamespace(flights=flights, library=LIBRARY, requested=requested)
        return pipeline._doubt(problem, name, too_small)

    assert not doubt() and "leave more than noise" in doubt(too_small=True)
    for moment in ("com_offset", "weak_rotor_1"):
        assert "the requests of the motors" in doubt(moment)
        assert not doubt(moment, requested=True)


def test_only_effects_whose_slopes_mislead_are_large_beyond_them():
    """A centre of mass beyond a plausible 1 mm, where no requests of the motors show it; thrust is linear."""
    for x, requested, large in ((1.1e-3, False, {"com_offset"}), (9e-4, False, set()), (1.1e-3, True, set())):
        values = {"com_offset": {"x": x, "y": 0.0, "hold": 1.5}, "thrust_scale": {"scale": 0.5}}
        problem = SimpleNamespace(requested=requested, library={n: LIBRARY[n] for n in values})
        fit = SimpleNamespace(problem=problem, values=values)
        assert _Fit.large_beyond_slopes(fit) == large


def test_a_reference_is_not_identified_without_its_effect():
    """Flights hardly show when the loops take over a moment that is none; where they do, it stays."""
    hold = LIBRARY["com_offset"].parameter("hold").neutral
    for x, growth, kept in ((5e-5, 0.5, hold), (5e-5, 2.0, 3.9), (2e-4, 0.5, 3.9)):
        problem = Candidates.for_vehicle(load_vehicle(), LIBRARY)
        squares = {3.9: 100.0, hold: 100.0 + growth}
        costs = SimpleNamespace(
            library=problem.library,
            sizes=problem.sizes,
            squares=lambda values, squares=squares: squares[values["com_offset"]["hold"]],
        )
        offset = {"com_offset": {"x": x, "y": 0.0, "hold": 3.9}}
        assert _idle_references(costs, offset) == {"com_offset": {"x": x, "y": 0.0, "hold": kept}}


def test_the_response_of_the_loops_is_63_percent_after_its_time_constant():
    """Of a first-order loop (a rate loop of 0.1 ms), and a delay later."""
    quick = load_vehicle().changed(attitude_bandwidth=1e4, attitude_damping=1.0)
    late = quick.changed(effects_attitude_delay=0.03)
    assert step_response_time(quick) == pytest.approx(quick.attitude_time_constant, abs=5e-4)
    assert step_response_time(late) - step_response_time(quick) == pytest.approx(0.03)


def test_several_lags_of_the_loops_are_pieces_of_one_change():
    problem, slower = SimpleNamespace(library=LIBRARY), {"attitude_time_constant": {"scale": 1.5}}
    late, other = {"attitude_delay": {"delay": 0.02}}, {"estimator_delay": {"delay": 0.01}}
    for values, pieces in (
        (slower | other, ()),
        (late | {"thrust_delay": {"delay": 0.02}}, ()),
        (slower | late | other, ("attitude_time_constant", "attitude_delay")),  # 0.8 for 0.5 plausible sizes
        ({"attitude_time_constant": {"scale": 1.2}} | late, ("attitude_delay", "attitude_time_constant")),
    ):
        assert loop_pieces(problem, values) == pieces


def test_pieces_of_the_attitude_loops_are_one_name():
    parts = {"attitude_time_constant": {"scale": 0.3}, "second_order_attitude": {"rate_lag": 0.15}}
    response = Estimate(0.24, "s", (0.22, 0.26), 0.2, (0.0, 2.0), False)
    one = NamedEffect(*parts, 0.97, {"response": response}, 0.5, "Retune it.", parts=parts)
    one = dataclasses.replace(one, members=tuple(parts))
    assert one.sure and one.fitted == parts and words.title(one) == "attitude loops"
    assert words.sentence(one) == (
        "The attitude loops are slower than modelled: roll is at 63 % of its steady angle 240 ms after a "
        "step of the command, before at 200 ms."
    )
    d = dataclasses.replace(example(), effects=(one,))
    assert d.values() == parts and "220 to 260 ms" in page(d, None, versions={})


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
        text = words.sentence(named(name, effect.plausible))
        told = set(re.findall(r"\{(\w+)", effect.says))
        assert told >= {p.name for p in effect.parameters if not p.is_reference} or len(told) == 0
        numbers = len(re.findall(r"-?\d[\d.]*", text))
        assert numbers == max(1, len(told)) and "_" not in text, name
    assert words.sentence(named("thrust_delay", {"delay": 0.012})) == (
        "Thrust commands act 12.0 ms after they were sent."
    )
    younger = named("estimator_delay", {"delay": -0.0141})
    assert words.sentence(younger) == "The logged attitude is 14.1 ms younger than the logged position."
    sooner = named("attitude_delay", {"delay": -0.02})
    assert words.sentence(sooner) == "Attitude commands act 20.0 ms earlier than modelled."
    assert "when it was identified" in words.remedy(sooner)
    assert words.sentence(named("attitude_gain", {"scale": 0.87})) == (
        "Attitude gain is 13 % lower than modelled."
    )
    heavy = named("mass", {"scale": 1.25}, 0.5, "thrust_scale")
    assert words.sentence(heavy) == "Thrust over mass is 20 % lower than modelled."
    assert words.size_rows(heavy) == (("", "0.800", "0.784 to 0.816"),)


def test_headlines_say_what_is_known_and_what_is_not():
    ratio = "Thrust over mass is 12 % lower than modelled."
    assert words.headline(example()) == f"{ratio} Also wrong or missing: attitude trim."
    assert words.headline(example("unknown")).endswith(
        "the flights show an error that no effect of the library explains."
    )
    assert words.headline(example("nothing")).startswith("Nothing of a size that matters is missing (90 %)")
    certain = (ScoredSet(("wind",), 0.98, {"wind": WIND}, {}), ScoredSet((), 0.02, {}, {}))
    useless = dataclasses.replace(example("nothing"), sets=certain, displacements={"wind": 0.01})
    assert words.headline(useless).startswith("Nothing of a size that matters is missing (over 99 %)")
    likely = dataclasses.replace(useless, displacements={"wind": 0.4})
    assert words.headline(likely) == "Undecided: the model may lack wind (98 %)."
    (said,) = words.answers(likely)
    assert said.text.startswith("Possibly, the air moves with 0.100 m/s along x and 0.00 m/s along y. ")
    assert said.how == "undecided, 98 %" and words.possible_sentence(likely) == ""
    wind = dataclasses.replace(named("wind", {"x": 0.3, "y": 0.0}), probability=0.6)
    unsure = dataclasses.replace(example(), effects=(wind, example().effects[1]))
    assert words.headline(unsure).endswith("Possibly also: wind.")
    alone = dataclasses.replace(example(), effects=(wind,))
    assert words.headline(alone).startswith("Possibly, the air moves with 0.300 m/s")
    assert words.answers(alone)[0].how == "possible, 60 %"
    doubted = dataclasses.replace(example().effects[0], doubt="In doubt, because.")
    assert words.how_sure(doubted) == "in doubt, 99 %"
    nameless = dataclasses.replace(example("nothing"), residual=example("unknown").residual)
    assert words.headline(nameless) == "The flights show an error that no effect of the library explains."


@pytest.mark.parametrize("verdict", ["effects", "unknown", "nothing"])
def test_the_page_stands_alone(verdict, track):
    d = example(verdict)
    text = page(d, track, figures(d, track), versions={"mujoco": "4.0"}, notes=("a note on <all> logs",))
    assert words.headline(d) in text and "a note on &lt;all&gt; logs." in text
    assert not re.search(r"(src|href)=\"(?!data:)", text) and "nan" not in text.lower().split("base64")[0]
    assert text.count("data:image/png") == 1
    assert "17 %" in text if d.effects else "10 %" in text  # the second set
    repeats = "21 cm repeats from flight to flight: in z, depending on place"
    assert (repeats in text) == (verdict == "unknown")


def test_a_diagnosis_without_anything_to_draw_still_makes_a_page():
    d = dataclasses.replace(
        example("nothing"), sets=(), disturbance={}, gap={}, growth=None,
        heldout=FLIGHTS,
        residual=ResidualAnalysis(1.0, ()),
    )  # fmt: skip
    assert "a fit to the others" in page(d, None, versions={})


def test_every_view_shows_the_same_probabilities_and_sizes(capsys):
    """Page, terminal, report.json and plan: one number for each effect, set and size."""
    d = example()
    record = json.loads(storage.to_json(d.to_json()))
    vehicle = load_vehicle()
    plan_input = PlanInput.of(d, vehicle, VehiclePosterior.of_file(None, vehicle))
    text = page(d, None, versions={})
    body = re.sub(r"<[^>]+>", " ", text[text.index("<body>") :])
    show(d)
    seen = [" ".join(one.split()) for one in (body, capsys.readouterr().out)]
    # Effects: marginal over the sets, of the class as of each member.
    for name in ("thrust_scale", "mass", "attitude_trim"):
        marginal = sum(one["probability"] for one in record["sets"] if name in one["effects"])
        assert d.probability(name) == plan_input.probabilities[name] == pytest.approx(marginal)
    for one in seen:
        for name in ("thrust_scale", "mass"):
            shown = set(re.findall(rf"{words.label(name)} \((\d+) %\)", one))
            assert shown == {f"{100 * d.probability(name):.0f}"}
    for effect, entry in zip(d.effects, record["effects"]):
        assert entry["probability"] == effect.probability == pytest.approx(d.probability(*effect.members))
        for _, number, ends in words.size_rows(effect):
            assert all(f"{number} {ends}" in one for one in seen)
        assert all(words.title(effect) in one and words.how_sure(effect) in one for one in seen)
        for name, p in effect.parameters.items():
            assert entry["parameters"][name]["value"] == p.value
    # Sizes: every decimal of the effects' sentences is that of the size with its interval.
    for effect in d.effects:
        said = re.findall(r"\d+\.\d+", words.sentence(effect))
        assert set(said) <= set(re.findall(r"\d+\.\d+", str(words.size_rows(effect))))


def test_flights_that_contradict_the_others_are_said_before_the_answer(capsys):
    differences = (
        Difference("thrust_scale", ("mass",), False, {"scale": 0.86}, {"scale": (0.84, 0.88)}),
        Difference("thrust_delay", (), True, {"delay": 0.01}, {"delay": (0.008, 0.012)}),
    )
    d = dataclasses.replace(
        example(), inconsistent_flights=(InconsistentFlights(("b",), ("a", "c"), differences, 1e-4),)
    )
    show(d)
    out = " ".join(capsys.readouterr().out.split())
    who = "b contradicts the other 2 flights. Compared with the others, in b the rotors give"
    assert out.index(who) < out.rindex("Thrust over mass is 12 % lower")
    assert "0.860 times the modelled thrust (95 % interval: 0.840 to 0.880)." in out
    assert "The difference could equally be mass." in out
    assert "Compared with b, in the others thrust commands act 10.0 ms after" in out
    text = page(d, None, versions={})
    assert text.index("b contradicts the other 2 flights.") < text.index("What to change")
    record = json.loads(storage.to_json(d.to_json()))["inconsistent_flights"][0]
    assert record["flights"] == ["b"] and record["differences"][0]["ci95"]["scale"] == [0.84, 0.88]


def test_the_corrected_model_is_a_vehicle_file_with_provenance(tmp_path):
    d = example()
    files.write_corrected(d, load_vehicle(), tmp_path)
    disturbance = {
        "disturbance_acceleration": (0.0, 0.0, 0.3),
        "disturbance_acceleration_time": (0.0, 0.0, 0.25),
    }
    written, full = load_vehicle(tmp_path / "vehicle.toml"), dataclasses.replace(d.corrected, **disturbance)
    for field in dataclasses.fields(full):
        value = getattr(full, field.name)
        number = isinstance(value, (float, tuple))
        assert getattr(written, field.name) == (pytest.approx(value, rel=1e-5) if number else value)
    assert len(repr(written.thrust_state_gain)) <= len("0.000123456")
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
    files.write_corrected(d, load_vehicle(), tmp_path)
    code = "import mujoco, sys; print(mujoco.MjModel.from_xml_path(sys.argv[1]).nplugin)"
    done = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "landing.xml"], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == 0 and int(done.stdout) > 0, done.stderr


def test_the_json_has_the_promised_keys():
    record = json.loads(storage.to_json(example().to_json()))
    promised = ("version", "verdict", "effects", "gap", "residual")
    assert set(promised) <= set(record)
    assert set(record["effects"][0]) >= {"name", "members", "parameters", "gain"}
    assert set(record["effects"][0]["parameters"]["scale"]) >= {"value", "unit", "ci95"}
    assert record["nothing"] == 0.0 and record["sets"][1]["effects"] == ["mass", "attitude_trim"]
    assert (
        record["disturbance"]["z"]["noise"] == 0.001
        and record["disturbance"]["z"]["size"] == 0.3
        and record["platform"]
    )
    assert set(record["gap"]["mujoco"]) >= {"before", "after", "floor"}
