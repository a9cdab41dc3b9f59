"""The frozen benchmark of moving platforms: its scenarios, and what is counted."""

import dataclasses
import hashlib
import json

import numpy as np
import pandas as pd
import pytest

from inclined_landing.eval.cli import main
from inclined_landing.eval.study import moving
from inclined_landing.eval.study import scenarios as study
from inclined_landing.eval.study.engine import run
from inclined_landing.eval.study.moving import fly, planner, vehicle_flown
from inclined_landing.eval.study.scenarios import scenarios

VEHICLE = vehicle_flown()
DRAWN = "38373780da98e06d"


def test_what_the_scenarios_draw_is_frozen():
    """Starts and motions at 1 s to a micrometre: other generators or waves would be another benchmark."""
    digest = hashlib.sha256()
    for scenario in scenarios().values():
        drawn = scenario.draw(VEHICLE)
        place, rate, _ = drawn.motion.at(1.0)
        for array in (drawn.state[:, :3], drawn.azimuth[:, None], place, rate):
            digest.update((np.rint(1e6 * array).astype(np.int64) + 0).tobytes())
    assert digest.hexdigest()[:16] == DRAWN


def test_the_planner_lands_and_the_report_is_the_same_again(tmp_path, monkeypatch, capsys):
    """On a ship at sea; fewer flights are the first ones, with the same numbers."""
    scenario, out = scenarios()["ship_5_bow"], tmp_path / "out"
    monkeypatch.setattr(study, "scenarios", lambda: {"ship_5_bow": scenario})
    assert main(["robustness", "planner", "--over", "moving", "--out", str(out), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((out / "robustness.json").read_text())
    counts = [row["count"] for row in printed["rows"] if row["measure"] == "at_rest" and row["scenario"]]
    assert counts == [4]
    flown, first = pd.read_csv(out / "flights.csv"), fly(scenario, planner, 1).iloc[0]
    assert len(flown) == 4 and (flown["normal_speed"] > 0).all()
    for measure in ("at_rest", "normal_speed"):
        assert float(flown[measure][0]) == pytest.approx(float(first[measure]), rel=1e-5)  # six digits
    assert sorted(p.name for p in out.iterdir()) == [
        *("flights.csv", "index.html", "moving.pdf", "moving.png", "robustness.json")
    ]
    assert moving.PARTLY in (out / "index.html").read_text()


def test_who_does_nothing_does_not_land():
    """A vehicle whose motors are off falls to the floor, or onto the platform it started over."""

    def off(n):
        return lambda t, context: np.zeros((n, 4))

    travel = scenarios()["travel_200_cm_s"]
    assert not fly(travel, off, 4)["at_rest"].any()
    (results,) = run([moving.study({"travel_200_cm_s": travel}, {"off": off}, 1)])
    assert results.one("at_rest", together="all scenarios")["count"] == 0


def test_nothing_rests_on_a_slope_without_friction():
    slope = scenarios()["still_20_deg"]
    assert fly(slope, planner, 2)["at_rest"].all()
    assert not fly(dataclasses.replace(slope, friction=0.05), planner, 2)["at_rest"].any()
