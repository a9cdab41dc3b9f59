"""The blind set: the seed alone decides it, only the seal holds the labels, and the scorer counts right."""

import json
from collections import Counter

import numpy as np
import pytest

from inclined_landing.eval import cli
from inclined_landing.eval.logs import read_log
from inclined_landing.eval.proof.gap_blind import causes, generate, score, strata
from inclined_landing.eval.proof.gap_blind import command as run
from inclined_landing.eval.proof.gap_blind.page import markdown, page
from inclined_landing.models import effects
from inclined_landing.models.errors import UserError


def test_every_cause_is_in_the_library_or_declared_unknown():
    # An effect without a cause here is in the library, but its naming is not proved.
    assert (set(causes.FREE_FLIGHT) | set(causes.TOUCHDOWN)) - {"lateral_drag", "log_delay"} <= set(
        effects.LIBRARY
    )
    assert not set(causes.UNKNOWN) & set(effects.LIBRARY)
    rng = np.random.default_rng(0)
    for name in (set(causes.FREE_FLIGHT) - {"lateral_drag", "log_delay"}) | set(causes.TOUCHDOWN):
        drawn = causes.draw(name, "medium", rng)
        known = {parameter.name for parameter in effects.LIBRARY[name].parameters}
        # A battery is labelled by the slope that it gives thrust.
        assert set(drawn.parameters) == known or name.startswith("battery")
        assert score.comparable(name, drawn.parameters)


def far(name, size, rng):
    """How far a drawn cause is from neutral; factors on a logarithmic scale."""
    parameters = causes.draw(name, size, rng).parameters
    effect = {"lateral_drag": "rotor_drag", "log_delay": "mocap_delay"}.get(name, name)
    known = {p.name: p for p in effects.LIBRARY[effect].parameters}
    if all(p in known and known[p].is_factor for p in parameters):
        return abs(np.log(next(iter(parameters.values()))))
    return np.linalg.norm(list(score.comparable(name, parameters).values()))


def test_sizes_are_ordered_and_signs_vary():
    rng = np.random.default_rng(1)
    for name in causes.FREE_FLIGHT | causes.TOUCHDOWN:
        size = [np.median([far(name, s, rng) for _ in range(15)]) for s in causes.SIZES]
        assert size[0] < size[1] < size[2], name
    assert {np.sign(causes.draw("yaw_drift", "weak", rng).parameters["rate"]) for _ in range(20)} == {1, -1}


def test_a_set_is_its_seed():
    one, again, other = strata.cases((1, 5)), strata.cases((1, 5)), strata.cases((2, 5))
    assert one == again
    assert [case.label() for case in one] != [case.label() for case in other]
    count = Counter(case.stratum for case in one)
    assert set(count) == set(strata.STRATA) and len(one) > 163
    assert Counter(case.stratum for case in other) == count
    singles = {(case.causes, case.size) for case in one if case.stratum == "single"}
    assert len(singles) == 3 * len(causes.FREE_FLIGHT)
    small = Counter(case.stratum for case in strata.cases((1, 5), 24))
    assert set(small) == set(strata.STRATA) and sum(small.values()) == 24


def test_names_and_columns_tell_nothing():
    cases = strata.cases((1, 6))
    order = [strata.STRATA.index(case.stratum) for case in cases]
    assert [case.name for case in cases] == [f"case_{k:03d}" for k in range(len(cases))]
    assert abs(np.corrcoef(np.arange(len(order)), order)[0, 1]) < 0.25
    logged = [case for case in cases if case.voltage]
    battery = [case for case in logged if "battery_voltage" in case.causes]
    assert battery and len(logged) > 3 * len(battery)  # most batteries on record do not matter
    assert not any(case.voltage for case in cases if "battery_sag" in case.causes)
    assert all(case.drawn.spread or "battery_sag" in case.causes for case in cases)


def test_flights_repeat_and_read_back(tmp_path):
    case = next(case for case in strata.cases((1, 7)) if case.count == 3 and not case.landings)
    run.write_flights(case, tmp_path / "a")
    run.write_flights(case, tmp_path / "b")
    names = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert names == [f"flight_{k:02d}.csv" for k in range(3)] + [f"heldout_{k:02d}.csv" for k in range(3)]
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    log = read_log(tmp_path / "a" / "flight_00.csv")
    assert log.duration == pytest.approx(generate.SECONDS - 0.01)
    assert not log.missing and (log.voltage is None) == (not case.voltage)


def test_landings_are_cut_around_the_touch():
    logs = generate.logs(generate.landings("platform_height", "strong", 4, count=4)[0], contact=True)
    for k, log in enumerate(logs):
        touch = log.t[np.argmax(log.contact)]
        assert touch == pytest.approx(1.0, abs=0.02) and log.duration == pytest.approx(1.7, abs=0.03)
        assert np.ptp(log.position[-20:], axis=0).max() < 0.01  # at rest
        assert (log.position[-1, 2] < 0.05) == (k % 4 == 3)  # every fourth on the floor


def label(stratum="single", hidden=("wind",), size="weak", base=(), parameters=None):
    parameters = parameters or {
        name: causes.draw(name, size, np.random.default_rng(0)).parameters for name in hidden
    }
    return {
        "stratum": stratum,
        "causes": list(hidden),
        "size": size if hidden else None,
        "parameters": parameters,
        "base": {name: {"scale": 1.1} for name in base},
        "known": not set(hidden) & set(causes.UNKNOWN),
    }


def report(*named, verdict=None, gap=None):
    """named: (name, class, values)."""
    return {
        "verdict": verdict or ("effects" if named else "nothing"),
        "effects": [
            {
                "name": name,
                "class": list(members),
                "parameters": {key: {"value": x} for key, x in values.items()},
            }
            for name, members, values in named
        ],
        "gap": gap or {},
        "seconds": 5.0,
    }


WIND = ("wind", ("wind",), {"x": 0.2, "y": 0.0})
TRIM = ("attitude_trim", ("attitude_trim", "wind"), {"roll": 0.01, "pitch": 0.0})
DRAG = ("rotor_drag", ("rotor_drag",), {"lateral": 1.3, "axial": 1.3})
SCALE = ("thrust_scale", ("thrust_scale",), {"scale": 0.9})


@pytest.mark.parametrize(
    "hidden, answer, outcome",
    [
        (("wind",), report(WIND), "named"),
        (("wind",), report(TRIM), "tie"),
        (("wind",), report(DRAG), "misnamed"),
        (("wind",), report(WIND, DRAG), "spurious"),
        (("wind",), report(), "missed"),
        (("wind",), report(verdict="unknown"), "missed"),
        (("mass",), report(SCALE), "named"),  # one class in free flight
        (
            ("thrust_scale",),
            report(SCALE, ("attitude_time_constant", (), {"scale": 1.1})),
            "named",
        ),  # entailed
        (("mass",), report(SCALE, ("attitude_time_constant", (), {"scale": 1.1})), "spurious"),
        (("mocap_delay",), report(("thrust_delay", (), {"delay": 0.01})), "misnamed"),
        (
            ("mocap_delay",),
            report(("thrust_delay", (), {"delay": 0.01}), ("attitude_delay", (), {"delay": 0.01})),
            "named",
        ),
        (("wind", "rotor_drag"), report(WIND, DRAG), "named"),
        (("wind", "rotor_drag"), report(TRIM, DRAG), "tie"),
        (("wind", "rotor_drag"), report(WIND), "half"),
        (("wind", "rotor_drag"), report(WIND, SCALE), "half"),
        ((), report(), "right"),
        ((), report(WIND), "false alarm"),
        ((), report(verdict="unknown"), "false alarm"),
        (("updraft",), report(verdict="unknown"), "flagged"),
        (("updraft",), report(WIND, verdict="unknown"), "flagged"),
        (("updraft",), report(WIND), "misnamed"),
        (("updraft",), report(), "missed"),
    ],
)
def test_outcomes(hidden, answer, outcome):
    assert score.score_case(label(hidden=hidden), answer)["outcome"] == outcome


def test_base_constants_may_be_named():
    off = label("base off", ("wind",), base=("mass", "rotor_drag"))
    assert score.score_case(off, report(WIND, SCALE, DRAG))["outcome"] == "named"
    assert score.score_case(off, report(SCALE, DRAG))["outcome"] == "misnamed"


def test_parameter_error_and_gap():
    wind = label(parameters={"wind": {"x": 0.2, "y": 0.05}})
    gap = {"analytic": {"before": 0.06, "after": 0.012, "floor": 0.01}}
    row = score.score_case(wind, report(WIND, gap=gap))
    assert row["errors"]["wind"] == pytest.approx(0.05 / np.hypot(0.2, 0.05))
    assert row["closed"]["analytic"] == pytest.approx(0.96)
    assert score.closed_share({"before": 0.014, "after": 0.01, "floor": 0.01}) is None
    # 10 % more mass is 9 % less thrust over mass.
    assert score.parameter_error("mass", {"scale": 1.1}, report(SCALE)["effects"]) == pytest.approx(
        0.1, abs=1e-6
    )
    # A tie says nothing about the size.
    assert score.score_case(wind, report(TRIM))["errors"] == {}
    # A sag of 0.2 about 40 000 PWM, as its slope in hover.
    truth = {"slope": 0.2 / 40000 / (1 - 0.2 * (36000 / 40000 - 1)), "pwm": 36000.0}
    sag = report(("battery_sag", (), {"sag": 0.2, "reference": 40000.0}))["effects"]
    assert score.parameter_error("battery_sag", truth, sag) < 1e-3


def test_table_counts_with_intervals():
    rows = [score.score_case(label(), report(WIND)) for _ in range(9)]
    rows += [score.score_case(label(), report(DRAG)), score.score_case(label("nothing", ()), report())]
    lines = {line["stratum"]: line for line in score.table(rows)}
    single = lines["single"]
    assert (single["cases"], single["named"], single["misnamed"]) == (10, 9, 1)
    assert single["good"]["interval"] == pytest.approx([0.596, 0.982], abs=1e-3)  # Wilson's
    assert lines["nothing"]["right"] == 1 and "single, weak" in lines
    results = {"set": "dev", "seed": 0, "cases": 11, "labels sha256": "0" * 64}
    results["methods"] = {"workflow": {"table": score.table(rows), "cases": [{"case": "case_000"} | rows[0]]}}
    assert "| single | 10 | 9 | 1 |" in markdown(results)
    assert "attitude_trim" not in page(results) and "90 % [60, 98]" in page(results)


def test_labels_are_sealed_and_a_run_goes_on(tmp_path, monkeypatch):
    """Labels stand apart, sealed before the first diagnosis; a finished case is not flown again."""
    flown = []

    def fake(case, methods, out, keep):
        flown.append(case.name)
        assert (out / "sealed" / "labels.json").exists()
        for method in methods:
            run.storage.write_json(out / "reports" / method / f"{case.name}.json", report())

    class Now:
        """An executor that runs at once."""

        def __init__(self, *_, **__): ...
        def __enter__(self):
            return self

        def __exit__(self, *_): ...
        def submit(self, work, *arguments):
            from concurrent.futures import Future

            future = Future()
            future.set_result(work(*arguments))
            return future

    monkeypatch.setattr(run, "_case", fake)
    monkeypatch.setattr(run, "ProcessPoolExecutor", Now)
    out = tmp_path / "set"
    run.command(out, "dev", 3, cases=12)
    first = json.loads((out / "results.json").read_text())
    assert len(flown) == 12
    assert (
        first["methods"]["workflow"]["table"][0]["missed"]
        == first["methods"]["workflow"]["table"][0]["cases"]
    )
    assert not any("wind" in path.read_text() for path in (out / "reports").rglob("*.json"))
    assert set(json.loads((out / "set.json").read_text())) >= {"set", "seed", "labels sha256"}
    (out / "reports" / "workflow" / "case_004.json").unlink()
    run.command(out, "dev", 3, cases=12)
    assert json.loads((out / "results.json").read_text()) == first and flown[12:] == ["case_004"]
    with pytest.raises(UserError, match="another blind set"):
        run.command(out, "fresh", 3, cases=12)


@pytest.mark.parametrize(
    "wrong, sentence",
    [
        (("--set", "test"), "unknown set 'test'"),
        (("--method", "guess"), "unknown method 'guess'"),
        (("--cases", "3"), "cases"),
    ],
)
def test_wrong_options_are_sentences(tmp_path, capsys, wrong, sentence):
    assert cli.main(["gap-blind", "--out", str(tmp_path / "x"), *wrong]) == 2
    error = capsys.readouterr().err
    assert sentence in error and error.count("\n") == 1
    assert not (tmp_path / "x").exists()
