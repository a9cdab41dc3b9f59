"""`landing-eval gap` from logs to folder; what it says to logs that are not as they should be."""

import json
import re

import numpy as np
import pytest

from inclined_landing.eval import cli
from inclined_landing.eval.gap import diagnose
from inclined_landing.eval.gap.measured.usable import read_flights
from inclined_landing.eval.gap.model.reference import read_reference
from inclined_landing.eval.gap.plan.reading import read_report
from inclined_landing.eval.gap.result import REFERENCE
from inclined_landing.eval.logs.read import log_table
from inclined_landing.models.parameters import load_vehicle
from tests.validation.gap_blind import generate
from tests.validation.gap_blind.causes import Drawn

HIDDEN = Drawn(world={"thrust_scale": 0.88}, parameters={})
FILES = {"gap.png", "landing.xml", "report.html", "report.json", "run.json", "vehicle.toml"}


@pytest.fixture(scope="module")
def flown():
    """Four flights of 8 s with weak propellers, as tables of the documented CSV."""
    recordings = generate.fly_all(HIDDEN, np.random.default_rng(3), count=4, seconds=8.0)
    return [log_table(log) for log in generate.logs(recordings, voltage=True)]


@pytest.fixture
def logs(flown, tmp_path):
    """Writer of CSV files: logs() as flown, logs(a, b) with the first tables changed; returns the names."""

    def write(*changes, count=4):
        files = []
        for k, one in enumerate(flown[:count]):
            changed = changes[k](one.copy()) if k < len(changes) else one
            files.append(str(tmp_path / f"flight_{k}.csv"))
            changed.to_csv(files[-1], index=False)
        return files

    return write


@pytest.fixture
def gap(tmp_path, capsys):
    """Run the command; returns exit code, report.json (None: nothing was written) and stderr."""

    def run(*arguments):
        out = tmp_path / "out"
        before = set(tmp_path.iterdir())
        code = cli.main(["gap", *map(str, arguments), "--out", str(out)])
        error = capsys.readouterr().err
        assert "Traceback" not in error
        if code:
            assert set(tmp_path.iterdir()) == before  # nothing half-written
            assert error.count("\n") == 1
            return code, None, error
        return code, json.loads((out / "report.json").read_text("utf-8")), error

    return run


def test_from_logs_to_report_and_corrected_model(logs, gap, tmp_path):
    files = logs()
    code, report, _ = gap(*files[:3], "--heldout", files[3])
    assert code == 0 and {p.name for p in (tmp_path / "out").iterdir()} == FILES
    assert {"thrust_scale", "mass"} <= set(report["effects"][0]["members"])
    assert "Weigh the vehicle" in (tmp_path / "out" / "report.html").read_text("utf-8")
    assert report["heldout"] == ["flight_3"]
    assert sum(one["probability"] for one in report["sets"]) == pytest.approx(1.0, abs=0.05)
    for plant in ("analytic", "mujoco"):
        assert report["gap"][plant]["after"] < 0.2 * report["gap"][plant]["before"]
    corrected = load_vehicle(tmp_path / "out" / "vehicle.toml")
    assert corrected.hover_pwm == pytest.approx(load_vehicle().hover_pwm / 0.88, rel=0.02)
    run = json.loads((tmp_path / "out" / "run.json").read_text("utf-8"))
    assert run["files"] == files[:3] and "mujoco" in run["versions"]


def test_identification_recovers_a_weak_thrust(logs, tmp_path, capsys):
    files = logs()
    out = tmp_path / "out"
    assert cli.main(["identify", *files[:3], "--heldout", files[3], "--out", str(out)]) == 0
    written = {"report.html", "report.json", "run.json", "vehicle.toml", "vehicle.posterior.json"}
    assert {p.name for p in out.iterdir()} == written
    record = json.loads((out / "report.json").read_text("utf-8"))
    gain = next(p for p in record["parameters"] if p["name"] == "thrust gain")
    assert gain["ci95"][0] < 0.88 < gain["ci95"][1]
    assert set(record["disturbance"]) >= {"x", "y", "z", "roll", "pitch"}
    assert record["fit"]["z"]["after"] > 95 > 0 > record["fit"]["z"]["before"]
    vehicle = load_vehicle(out / "vehicle.toml")
    known, said = read_reference(out / "vehicle.toml", vehicle)
    assert not said and np.diag(known.covariance).min() >= 0.0 and known.repeating.weights
    shown = capsys.readouterr().out
    assert "85.3 %" in shown and "thrust gain" in shown and "flight_3" in (out / "report.html").read_text()


@pytest.mark.slow
def test_gap_keeps_the_vehicle_that_it_identified(logs, gap, tmp_path):
    """From these flights, or from the file that identify writes of them: the same answer, and a plan."""
    files = logs()
    one, two = (tmp_path / name for name in ("identified", "alone"))
    assert cli.main(["identify", *files[:2], "--out", str(one)]) == 0
    assert cli.main(["gap", *files[2:], "--vehicle", str(one / "vehicle.toml"), "--out", str(two)]) == 0
    _, report, _ = gap(*files[2:], "--reference", *files[:2])
    assert report["sets"] == json.loads((two / "report.json").read_text("utf-8"))["sets"]
    kept = load_vehicle(tmp_path / "out" / REFERENCE)
    assert kept == load_vehicle(one / "vehicle.toml")
    assert read_report(tmp_path / "out")[0].vehicle == kept


def without(column):
    return lambda table: table.drop(columns=column)


def other_vehicle(table):
    table["cmd_thrust_pwm"] *= 1.3
    return table


@pytest.mark.parametrize(
    ("change", "words"), [(without("z"), r"flight_0\.csv.*\bz\b"), (other_vehicle, "different vehicles")]
)
def test_what_cannot_be_used_is_refused_in_one_sentence(logs, gap, change, words):
    """As `landing-eval logs` refuses it: tests/eval/logs has all of it."""
    code, _, error = gap(*logs(change))
    assert code == 2
    assert re.search(words, error), error


def with_a_hole(table):
    return table[(table.t < 4) | (table.t > 6)]


def with_some_nan(table):
    table.loc[100:110, "x"] = np.nan
    return table


def with_a_flat_battery(table):
    table["vbat"] = 3.9
    return table


def notes_on(files):
    """What the command would say beside the answer, without the page."""
    flights = read_flights(files)
    d = diagnose(flights.logs, load_vehicle(), plants=())
    return "\n".join((*d.notes, *flights.notes))


@pytest.mark.slow
def test_what_limits_the_answer_is_said_beside_it(logs):
    files = logs(with_a_hole, with_some_nan, with_a_flat_battery, without("cmd_yaw_rate"))
    notes = notes_on(files)
    for words in ("flight_0: .*gap.* 2 s", "flight_1: .*x", "flight_2: .*vbat", "flight_3: .*yaw"):
        assert re.search(words, notes), notes


def test_options_that_cannot_be_used_are_refused(logs, gap, tmp_path):
    files, loop = logs(), tmp_path / "loop.csv"
    loop.symlink_to(loop)
    for arguments, words in (
        ((files[0], files[0]), "more than once"),
        ((str(loop), files[0]), "loop.csv: cannot be read"),
        ((files[0], "--heldout", files[0]), "more than once"),
        ((tmp_path / "none.csv",), r"none\.csv"),
        ((tmp_path,), str(tmp_path)),
        ((*files, "--vehicle", tmp_path / "none.toml"), r"none\.toml"),
        ((*files, "--mapping", "no_such"), "no_such"),
        ((*files, "--unit", "roll"), "COLUMN=UNIT"),
    ):
        code, _, error = gap(*arguments)
        assert code == 2 and re.search(words, error), error
