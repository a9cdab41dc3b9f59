"""`landing-eval gap` from logs to folder; what it says to options that cannot be used."""

import json
import re

import numpy as np
import pytest

from inclined_landing.eval import cli
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
    """Names of their CSV files."""
    files = [str(tmp_path / f"flight_{k}.csv") for k in range(len(flown))]
    for file, table in zip(files, flown):
        table.to_csv(file, index=False)
    return files


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
    code, report, _ = gap(*logs[:3], "--heldout", logs[3])
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
    assert run["files"] == logs[:3] and "mujoco" in run["versions"]


def test_identification_recovers_a_weak_thrust(logs, tmp_path, capsys):
    out = tmp_path / "out"
    assert cli.main(["identify", *logs[:3], "--heldout", logs[3], "--out", str(out)]) == 0
    written = {"report.html", "report.json", "run.json", "vehicle.toml", "vehicle.posterior.json"}
    assert {p.name for p in out.iterdir()} == written
    record = json.loads((out / "report.json").read_text("utf-8"))
    gain = next(p for p in record["parameters"] if p["name"] == "thrust gain")
    assert gain["ci95"][0] < 0.88 < gain["ci95"][1]
    assert set(record["disturbance"]) >= {"x", "y", "z", "roll", "pitch"}
    assert record["ahead"]["after"] < 0.2 * record["ahead"]["before"]
    vehicle = load_vehicle(out / "vehicle.toml")
    known, said = read_reference(out / "vehicle.toml", vehicle)
    assert not said and np.diag(known.covariance).min() >= 0.0 and known.repeating.weights
    shown = capsys.readouterr().out
    assert (
        "on flights not fitted" in shown
        and "thrust gain" in shown
        and "flight_3" in (out / "report.html").read_text()
    )


@pytest.mark.slow
def test_gap_keeps_the_vehicle_that_it_identified(logs, gap, tmp_path):
    """From these flights, or from the file that identify writes of them: the same answer, and a plan."""
    one, two = (tmp_path / name for name in ("identified", "alone"))
    assert cli.main(["identify", *logs[:2], "--out", str(one)]) == 0
    assert cli.main(["gap", *logs[2:], "--vehicle", str(one / "vehicle.toml"), "--out", str(two)]) == 0
    _, report, _ = gap(*logs[2:], "--reference", *logs[:2])
    assert report["sets"] == json.loads((two / "report.json").read_text("utf-8"))["sets"]
    kept = load_vehicle(tmp_path / "out" / REFERENCE)
    assert kept == load_vehicle(one / "vehicle.toml")
    assert read_report(tmp_path / "out")[0].vehicle == kept


def test_options_that_cannot_be_used_are_refused(flown, logs, gap, tmp_path):
    """Logs as `landing-eval logs` refuses them: tests/eval/logs has all of it."""
    loop, flat = tmp_path / "loop.csv", tmp_path / "flat.csv"
    loop.symlink_to(loop)
    flown[0].drop(columns="z").to_csv(flat, index=False)
    for arguments, words in (
        ((logs[0], logs[0]), "more than once"),
        ((str(loop), logs[0]), "loop.csv: cannot be read"),
        ((flat,), r"flat\.csv.*\bz\b"),
        ((logs[0], "--heldout", logs[0]), "more than once"),
        ((tmp_path / "none.csv",), r"none\.csv"),
        ((tmp_path,), str(tmp_path)),
        ((*logs, "--vehicle", tmp_path / "none.toml"), r"none\.toml"),
        ((*logs, "--mapping", "no_such"), "no_such"),
        ((*logs, "--unit", "roll"), "COLUMN=UNIT"),
    ):
        code, _, error = gap(*arguments)
        assert code == 2 and re.search(words, error), error
