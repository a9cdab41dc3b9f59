"""`robustness --over vehicles`: policies on named and on drawn vehicles."""

import json

import pytest

from inclined_landing.envs.shared.measures import STRICT
from inclined_landing.eval import cli
from inclined_landing.eval.study import vehicles
from inclined_landing.eval.study.engine import run
from inclined_landing.eval.study.flights import named_policies
from inclined_landing.models.base.errors import UserError

NAMED = ("crazyflie-2.1", "hummingbird")
OPTIONS = {"draws": 6, "plant": "analytic"}


@pytest.fixture(scope="module")
def results():
    policies = {"plain": "landing", "nominal": "landing-nominal"}
    return run([vehicles.study(policies, NAMED, **OPTIONS)])[0]


def test_runs_are_called_by_their_folders_and_files_told_apart(tmp_path):
    for name in "ab":
        (tmp_path / name).mkdir()
        (tmp_path / name / "final.zip").touch()
    one, other = tmp_path / "a", tmp_path / "b/final.zip"
    assert list(named_policies([str(one), str(other), "landing"])) == ["a", "final", "landing"]
    assert list(named_policies([str(one / "final.zip"), str(other)])) == ["a/final", "b/final"]
    assert named_policies(["told=a.zip", "runs/b/"]) == {"told": "a.zip", "b": "runs/b/"}
    with pytest.raises(UserError, match="policy landing is named twice"):
        named_policies(["landing", "landing"])


def test_every_policy_is_counted_on_every_vehicle(results):
    assert results.labels("vehicle") == [*NAMED, "6 drawn vehicles"]
    plain = results.one(STRICT, vehicle="crazyflie-2.1", policy="plain")
    assert plain["flights"] == 251 and plain["value"] > 0.9
    # With wider rotors fewer starts of the grid are clear; its thrust at action 0 is another: none arrives.
    nominal = results.one(STRICT, vehicle="hummingbird", policy="nominal")
    assert 200 < nominal["flights"] < 251 and nominal["count"] == 0 and nominal["mass"] == "500"


def test_drawn_vehicles_are_those_of_the_ranges(results):
    for policy in ("plain", "nominal"):
        together = results.one(STRICT, vehicle="6 drawn vehicles", policy=policy)
        each = [row for row in results.all(STRICT, policy=policy) if row["drawn"] is not None]
        assert len(each) == 6 and {row["flights"] for row in each} == {4}
        assert together["flights"] == 24 and together["count"] == sum(row["count"] for row in each)
    masses = {
        row["value"] for row in results.study.facts if row["of"].startswith("drawn") and row["name"] == "mass"
    }
    assert len(masses) == 6


def test_the_command_writes_a_whole_folder(tmp_path, capsys):
    arguments = ["landing", "--vehicle", "crazyflie-2.0", "--draws", "0", "--plant", "analytic"]
    assert cli.main(["robustness", *arguments, "--over=vehicles", "--out", str(tmp_path / "out")]) == 0
    assert "crazyflie-2.0" in capsys.readouterr().out
    names = {"index.html", "flights.csv", "robustness.json", "vehicles.pdf", "vehicles.png"}
    assert {p.name for p in (tmp_path / "out").iterdir()} == names
    rows = json.loads((tmp_path / "out/robustness.json").read_text())["rows"]
    assert {row["vehicle"] for row in rows} == {"crazyflie-2.0"}
