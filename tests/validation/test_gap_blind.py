"""The blind set: the seed alone decides it, only the seal holds the labels, and the scorer counts right."""

import json
from collections import Counter

import numpy as np
import pytest

from inclined_landing.models import effects
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from tests.validation import shared
from tests.validation.gap_blind import cases, causes, score, tables
from tests.validation.gap_blind import command as run
from tests.validation.gap_blind.accepted import ALIASES, EFFECT, ENTAILED, NOT_COMPARED
from tests.validation.simulator import FAMILIES


def test_every_cause_is_in_the_library_or_declared_outside():
    # An effect without a cause here is in the library, but its naming is not proved.
    known = {EFFECT.get(name, name): name for name in (*causes.FREE_FLIGHT, *causes.TOUCHDOWN)}
    assert set(known) <= set(effects.LIBRARY)
    assert not (set(causes.UNKNOWN) | set(causes.DISTURBANCE)) & set(effects.LIBRARY)
    rng = np.random.default_rng(0)
    for effect, name in known.items():
        drawn = causes.draw(name, "medium", rng)
        numbers = {parameter.name for parameter in effects.LIBRARY[effect].parameters}
        # A battery is labelled by the slope that it gives thrust, the ground by the thrust it adds.
        others = {"slope", "voltage", "pwm", "gain"}
        assert set(drawn.parameters) <= numbers or set(drawn.parameters) <= others
        assert score.comparable(name, drawn.parameters) or name in NOT_COMPARED
    for _, sets, why in (*ALIASES, *((ones, (names,), why) for ones, names, why in ENTAILED)):
        assert all(set(names) <= set(effects.LIBRARY) for names in sets) and why


def test_a_set_is_its_seed():
    one, again, other = cases.of_set("dev", 5), cases.of_set("dev", 5), cases.of_set("fresh", 5)
    assert one == again
    assert [case.label() for case in one] != [case.label() for case in other]
    count = Counter(case.stratum for case in one)
    assert set(count) == set(cases.STRATA) and 140 <= len(one) <= 200
    assert Counter(case.stratum for case in other) == count
    singles = Counter(case.causes[0] for case in one if case.stratum == "single")
    assert singles == dict.fromkeys(causes.FREE_FLIGHT, 2)
    small = Counter(case.stratum for case in cases.of_set("dev", 5, 24))
    assert set(small) == set(cases.STRATA) and sum(small.values()) == 24


def test_fresh_families_share_no_structure_with_those_of_development():
    """Of the forms of parts that stand beside each other in a build, no member of one set has those of
    another."""
    assert set(cases.SETS["dev"]) | set(cases.SETS["fresh"]) == set(FAMILIES) - {"reference"}
    forms = {}
    for name in cases.SETS:
        builds = [case.reality.build for case in cases.of_set(name, 1, 40) if case.stratum != "touchdown"]
        forms[name] = {
            "drag and ground": {(b.flapping > 0, b.quadratic_drag[0] > 0, b.ground) for b in builds},
            "controller": {(b.controller, b.feed_forward > 0, b.integral > 0) for b in builds},
            "motors": {(b.spin_down > 0, b.thrust_curve != 0, b.thrust_exponent != 1) for b in builds},
            "battery": {(b.polarisation > 0, b.battery_power != 2) for b in builds},
        }
    for part, dev in forms["dev"].items():
        assert not dev & forms["fresh"][part], part


def test_names_and_columns_tell_nothing():
    drawn = cases.of_set("dev", 6)
    order = [cases.STRATA.index(case.stratum) for case in drawn]
    assert [case.name for case in drawn] == [f"case_{k:03d}" for k in range(len(drawn))]
    assert abs(np.corrcoef(np.arange(len(order)), order)[0, 1]) < 0.25
    logged = [case for case in drawn if case.voltage]
    battery = [case for case in logged if "battery_voltage" in case.causes]
    assert battery and len(logged) > 3 * len(battery)  # most batteries on record do not matter
    assert not any(case.voltage for case in drawn if "battery_sag" in case.causes)


@pytest.mark.parametrize("family", ["dev", "fresh"])
def test_the_reality_does_not_depend_on_what_is_hidden(family):
    one = cases.draw(family, "single", "wind", "weak", seed=(1, 3))
    for cause in causes.FREE_FLIGHT:
        assert cases.draw(family, "single", cause, "strong", seed=(1, 3)).reality == one.reality


def test_constants_off_after_identification():
    case = cases.draw("dev", "base off", "wind", "weak", seed=1)
    vehicle, off = load_vehicle(), case.vehicle(load_vehicle())
    assert off.body_mass == pytest.approx(vehicle.body_mass / case.base["mass"])
    assert set(case.label()["base"]) == set(cases.BASE_OFF) and not set(case.causes) & set(cases.BASE_OFF)
    # What free flight cannot tell from them is not hidden beside them.
    hidden = {cases.draw("dev", "base off", seed=k).causes[0] for k in range(60)}
    off = {"mass", "thrust_scale", "thrust_bias", "rotor_drag", "attitude_gain"}
    assert len(hidden) > 10 and not hidden & off


def label(stratum="single", hidden=("wind",), size="weak", base=(), parameters=None):
    rng = np.random.default_rng(0)
    parameters = parameters or {name: causes.draw(name, size, rng).parameters for name in hidden}
    found = {"family": "cascade", "stratum": stratum, "causes": list(hidden), "parameters": parameters}
    return found | {"size": size if hidden else None, "base": list(base)}


def report(*named, verdict=None, gap=None, sets=()):
    """named: (name, class, values), values alone or with their interval; sets: (probability, *names)."""
    return {
        "sets": [{"probability": p, "effects": names} for p, *names in sets],
        "verdict": verdict or ("effects" if named else "nothing"),
        "effects": [
            {
                "name": name,
                "members": list(members),
                "parameters": {
                    key: {"value": x} if np.isscalar(x) else {"value": x[0], "ci95": x[1:]}
                    for key, x in values.items()
                },
            }
            for name, members, values in named
        ],
        "gap": gap or {},
        "seconds": {"name": 5.0},
    }


WIND = ("wind", ("wind",), {"x": 0.2, "y": 0.0})
TRIM = ("attitude_trim", ("attitude_trim", "wind"), {"roll": 0.01, "pitch": 0.0})
DRAG = ("rotor_drag", ("rotor_drag",), {"lateral": 1.3, "axial": 1.3})
SCALE = ("thrust_scale", ("thrust_scale",), {"scale": 0.9})
LOOP = ("attitude_time_constant", (), {"scale": 1.1})
LATE = [(name, (), {"delay": 0.01}) for name in ("thrust_delay", "attitude_delay", "mocap_delay")]

# What is hidden, the names (or the verdict without any), the outcome.
OUTCOMES = [
    ("wind", [WIND], "named"),
    ("wind", [TRIM], "tie"),
    ("wind", [DRAG], "misnamed"),
    ("wind", [WIND, DRAG], "spurious"),
    ("wind", "nothing", "missed"),
    ("wind", "unknown", "missed"),
    ("wind", "undecided", "undecided"),
    ("wind", "failed", "failed"),
    ("mass", [SCALE], "named"),  # one class in free flight
    ("thrust_scale", [SCALE, LOOP], "named"),  # entailed
    ("mass", [SCALE, LOOP], "spurious"),
    ("mocap_delay", LATE[:1], "misnamed"),
    ("mocap_delay", LATE[:2], "named"),
    ("log_delay", LATE[2:], "named"),
    ("lateral_drag", [DRAG], "named"),
    ("wind rotor_drag", [WIND, DRAG], "named"),
    ("wind rotor_drag", [TRIM, DRAG], "tie"),
    ("wind rotor_drag", [WIND], "half"),
    ("wind rotor_drag", [WIND, SCALE], "half"),
    ("", "nothing", "right"),
    ("", "unknown", "false unknown"),
    ("", "undecided", "undecided"),
    ("", [WIND], "false alarm"),
    ("updraft", "unknown", "flagged"),
    ("updraft", [WIND], "misnamed"),
    ("updraft", "nothing", "missed"),
    ("gust", "nothing", "right"),
    ("gust", "unknown", "false unknown"),
    ("gust", [WIND], "false alarm"),
    ("command_jitter", LATE[:1], "right"),  # late on average
]


@pytest.mark.parametrize("hidden, answer, outcome", OUTCOMES)
def test_outcomes(hidden, answer, outcome):
    answer = report(verdict=answer) if isinstance(answer, str) else report(*answer)
    assert score.score_case(label(hidden=hidden.split()), answer)["outcome"] == outcome
    if outcome == "flagged":  # whatever is named beside it
        both = report(WIND, verdict="unknown")
        assert score.score_case(label(hidden=hidden.split()), both)["outcome"] == outcome


def test_intervals_that_hold_the_truth():
    def hits(cause, truth, *named):
        one = label(hidden=[cause], parameters={cause: truth})
        return score.covered(cause, one, report(*named)["effects"])

    wind = ("wind", (), {"x": (0.2, 0.1, 0.3), "y": (0.0, -0.01, 0.01)})
    assert hits("wind", {"x": 0.28, "y": 0.05}, wind) == {"x": True, "y": False}
    # Across another unit: 1/1.1 lies between the ends of the thrust's scale, 1/1.2 does not.
    scale = ("thrust_scale", (), {"scale": (0.9, 0.89, 0.92)})
    assert hits("mass", {"scale": 1.1}, scale) == {"level": True}
    assert hits("mass", {"scale": 1.2}, scale) == {"level": False}
    # Drag across the rotors alone leaves that along them open.
    drag = ("rotor_drag", (), {"lateral": (2.0, 1.9, 2.1), "axial": (1.0, 0.5, 1.5)})
    assert hits("lateral_drag", {"lateral": 2.05}, drag) == {"lateral": True}
    strength = ("ground_effect", (), {"strength": (5.0, 4.0, 6.0), "range": (0.3, 0.2, 0.4)})
    assert hits("ground_effect", {"gain": 5.0 / 256.0}, strength) == {"gain": True}
    assert hits("wind", {"x": 0.2, "y": 0.0}, WIND) == {}
    # A sag of 0.2 about 40 000 PWM, as its slope in hover: 8 % more or less of it holds that, 8 to 16 % not.
    truth = {"slope": 0.2 / 40000 / (1 - 0.2 * (36000 / 40000 - 1)), "pwm": 36000.0}
    for low, high, held in ((0.184, 0.216, True), (0.216, 0.232, False)):
        sag = ("battery_sag", (), {"sag": (0.5 * (low + high), low, high), "reference": 40000.0})
        assert hits("battery_sag", truth, sag) == {"slope over load": held}
    assert hits("com_offset", {"x": 0.001}, ("com_offset", (), {"x": (0.001, 0.0, 0.002)})) == {}
    # A tie says nothing about the size.
    assert score.score_case(label(), report(TRIM))["covered"] == {}


def test_belief_in_the_truth():
    sets = ((0.5, "wind"), (0.3, "wind", "rotor_drag"), (0.2,))
    row = score.score_case(label(), report(WIND, sets=sets))
    assert row["belief"] == pytest.approx(0.5)
    assert score.score_case(label(hidden=()), report(sets=sets))["belief"] == pytest.approx(0.2)
    # Names that free flight cannot tell apart are one.
    level = report(SCALE, sets=((0.4, "mass"), (0.4, "thrust_scale"), (0.2, "wind")))
    assert score.score_case(label(hidden=("mass",)), level)["belief"] == pytest.approx(0.8)
    assert score.score_case(label(hidden=("updraft",)), report(sets=sets))["belief"] is None
    assert score.score_case(label(), report(WIND))["belief"] is None


def test_shares():
    """Every count of one case at a time: what it is a share of, and whether it is in it."""

    def counted(label, report):
        shares = tables.shares([score.score_case(label, report)])
        wrong, _ = shares.pop("wrong possible names per case"), shares.pop("cases")
        parts = [(share["count"], share["of"]) for share in shares.values()]
        names = ("sure", "quiet", "alone", "among", "nothing", "outside", "beside", "held")
        return dict(zip(names, parts)), wrong

    def sure(*named, **more):
        answer = report(*named, **more)
        for effect in answer["effects"]:
            effect["sure"] = True
        return answer

    none, medium = label("nothing", ()), label(size="medium")
    others = dict.fromkeys(("sure", "alone", "among", "outside", "beside", "held"), (0, 0))
    assert counted(none, report())[0] == others | {"quiet": (1, 1), "nothing": (0, 1)}
    # Undecided is not quiet, and for a hidden cause no wrong answer of nothing.
    assert counted(none, report(verdict="undecided"))[0]["quiet"] == (0, 1)
    assert counted(medium, report(verdict="undecided"))[0]["nothing"] == (0, 0)
    assert counted(medium, report())[0]["nothing"] == (1, 1)
    assert counted(label(), report())[0]["nothing"] == (0, 1)  # a weak one may be missed
    assert counted(label(hidden=("gust",), size="strong"), report())[0]["nothing"] == (0, 1)
    # Sure and alone; a name that is not sure, or one beside that is spurious, is not.
    found = counted(medium, sure(WIND))[0]
    assert (found["alone"], found["sure"], found["beside"]) == ((1, 1), (0, 1), (0, 1))
    assert counted(medium, report(WIND))[0]["alone"] == (0, 1)
    found = counted(medium, sure(WIND, DRAG, verdict="unknown"))[0]
    assert (found["alone"], found["sure"], found["beside"]) == ((0, 1), (1, 2), (1, 1))
    assert counted(label(), sure(WIND))[0]["alone"] == (0, 0)
    assert counted(label(), report() | {"possible": {"wind": 0.4}})[0]["among"] == (1, 1)
    outside = label(hidden=("updraft",), size="medium")
    assert counted(outside, report(verdict="unknown"))[0]["outside"] == (1, 1)
    assert counted(medium, report() | {"possible": {"wind": 0.5, "mass": 0.2, "yaw_loop": 0.1}})[1] == 2


def test_the_table_has_a_line_for_all_strata_and_families():
    rows = [score.score_case(label(size="medium"), report(WIND)) for _ in range(9)]
    rows += [score.score_case(label("nothing", ()), report())]
    results = {"set": "dev", "seed": 0, "cases drawn": 10} | tables.results_of(rows)
    assert list(results["shares"]) == ["all", "single", "nothing", "family cascade"]
    lines = tables.markdown(results).splitlines()
    assert lines[5].startswith("| single | 9 | ") and "9 of 9 [70, 100 %]" in lines[5]  # Wilson's interval


def test_labels_are_sealed_and_a_run_goes_on(tmp_path, monkeypatch):
    """Labels stand apart, sealed before the first diagnosis; a finished case is not flown again."""
    flown = []

    def at_once(work, calls, processes, done):
        for name in calls:
            flown.append(name)
            assert (out / "sealed" / "labels.json").exists()
            yield name, report()

    monkeypatch.setattr(shared, "in_processes", at_once)
    out = tmp_path / "set"
    run.command(out, "dev", 3, cases=12)
    first = json.loads((out / "results.json").read_text())
    assert len(flown) == 12 and first["shares"]["all"]["cases"] == 12
    assert first["shares"]["all"]["all causes among the names"]["count"] == 0
    assert not any("wind" in path.read_text() for path in (out / "reports").rglob("*.json"))
    (out / "reports" / "case_004.json").unlink()
    run.command(out, "dev", 3, cases=12)
    assert json.loads((out / "results.json").read_text()) == first and flown[12:] == ["case_004"]
    with pytest.raises(UserError, match="another blind set"):
        run.command(out, "fresh", 3, cases=12)
