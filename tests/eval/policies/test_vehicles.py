"""`robustness --over vehicles`: policies on named and on drawn vehicles."""

import json

import pytest

from inclined_landing.eval import cli
from inclined_landing.eval.policies import vehicles
from inclined_landing.eval.policies.study import named_policies
from inclined_landing.models.errors import UserError

NAMED = ("crazyflie-2.1", "hummingbird")
OPTIONS = {"draws": 6, "starts": 2, "plant": "analytic", "seed": 5}


@pytest.fixture(scope="module")
def report():
    policies = {"plain": "landing", "nominal": "landing-nominal"}
    return vehicles.run(policies, NAMED, "vehicles", **OPTIONS).report


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


def test_every_policy_is_counted_on_every_vehicle(report):
    small, big = report["vehicles"]
    assert list(small["outcomes"]) == list(big["outcomes"]) == ["plain", "nominal"]
    plain = small["outcomes"]["plain"]
    assert plain["strict"]["of"] == 251 and plain["strict"]["share"] > 0.9
    # With wider rotors fewer starts of the grid are clear; its thrust at action 0 is another: none arrives.
    assert 200 < big["outcomes"]["nominal"]["strict"]["of"] < 251
    assert big["outcomes"]["nominal"]["strict"]["count"] == 0
    assert big["mass"] == 0.5


def test_drawn_vehicles_are_those_of_the_ranges(report):
    draws = report["draws"]
    assert set(draws["outcomes"]) == {"plain", "nominal"}
    for label, outcome in draws["outcomes"].items():
        assert outcome["strict"]["count"] == sum(m["strict"][label] for m in draws["members"])
        assert outcome["strict"]["of"] == 6 * 2
    assert len({m["mass"] for m in draws["members"]}) == 6


def test_the_command_writes_a_whole_folder(tmp_path, capsys):
    arguments = ["landing", "--vehicle", "crazyflie-2.0", "--draws", "0", "--plant", "analytic"]
    assert cli.main(["robustness", *arguments, "--over=vehicles", "--out", str(tmp_path / "out")]) == 0
    assert "crazyflie-2.0" in capsys.readouterr().out
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        "index.html",
        "flights.csv",
        "vehicles.json",
        "vehicles.pdf",
        "vehicles.png",
    }
    assert json.loads((tmp_path / "out/vehicles.json").read_text())["draws"] is None
