"""`robustness --over vehicles`: policies on named and on drawn vehicles."""

import json

import pytest

from inclined_landing.eval import cli
from inclined_landing.eval.policies import vehicles
from inclined_landing.eval.policies.entrants import Entrant, parse_entrant, parse_entrants
from inclined_landing.models.errors import UserError

NAMED = ("crazyflie-2.1", "hummingbird")
OPTIONS = {"draws": 6, "starts": 2, "plant": "analytic", "seed": 5}


@pytest.fixture(scope="module")
def report():
    entries = [
        parse_entrant("plain=landing"),
        parse_entrant("both=landing-nominal+landing"),
        parse_entrant("own@hummingbird=landing-nominal"),
    ]
    return vehicles.run(entries, NAMED, "vehicles", **OPTIONS).report


def test_entries():
    assert parse_entrant("runs/a/final.zip") == Entrant("final", ("runs/a/final.zip",))
    assert parse_entrant("runs/a/") == Entrant("a", ("runs/a/",))  # a run folder
    assert parse_entrant("told=a.zip+b.zip") == Entrant("told", ("a.zip", "b.zip"))
    assert parse_entrant("own@hummingbird=a.zip") == Entrant("own", ("a.zip",), "hummingbird")
    for wrong in ("=a.zip", "told=", "told=a.zip+", "own@=a.zip", "@x=a.zip", "seeds=a.zip+a.zip"):
        with pytest.raises(UserError, match="policies are written LABEL=POLICY"):
            parse_entrant(wrong)


def test_runs_are_called_by_their_folders_and_files_told_apart(tmp_path):
    for name in "ab":
        (tmp_path / name).mkdir()
        (tmp_path / name / "final.zip").touch()
    one, other = tmp_path / "a", tmp_path / "b/final.zip"
    assert [entry.label for entry in parse_entrants([str(one), str(other), "landing"])] == [
        "a",
        "final",
        "landing",
    ]
    files = [str(one / "final.zip"), str(other)]
    assert [entry.label for entry in parse_entrants(files)] == ["a/final", "b/final"]
    with pytest.raises(UserError, match="policy landing is named twice"):
        parse_entrants(["landing", "landing"])


def test_every_policy_is_counted_on_every_vehicle_it_is_for(report):
    small, big = report["vehicles"]
    assert list(small["outcomes"]) == ["plain", "both"] and list(big["outcomes"]) == ["plain", "both", "own"]
    plain, both = (small["outcomes"][label] for label in ("plain", "both"))
    assert plain["strict"]["of"] == 251 and plain["strict"]["share"] > 0.9
    assert both["strict"]["of"] == 502
    assert both["strict"]["count"] == sum(p["strict"]["count"] for p in both["policies"])
    # With wider rotors fewer starts of the grid are clear; its thrust at action 0 is another: none arrives.
    assert 200 < big["outcomes"]["own"]["strict"]["of"] < 251
    assert big["outcomes"]["own"]["strict"]["count"] == 0
    assert big["mass"] == 0.5


def test_drawn_vehicles_are_those_of_the_ranges(report):
    draws = report["draws"]
    assert set(draws["outcomes"]) == {"plain", "both"} and draws["flown_each"] == {"plain": 2, "both": 4}
    for label, outcome in draws["outcomes"].items():
        assert outcome["strict"]["count"] == sum(m["strict"][label] for m in draws["members"])
        assert outcome["strict"]["of"] == 6 * draws["flown_each"][label]
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
