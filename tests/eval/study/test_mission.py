"""`landing-eval mission`: what it counts and draws, and wrong input."""

import json

import imageio_ffmpeg
import numpy as np
import pandas as pd
import pytest
from PIL import Image

from inclined_landing.eval import cli


def test_missions_are_counted_and_drawn(tmp_path, capsys):
    out = tmp_path / "out"
    arguments = ["mission", "--start=-1,0.05,1.75", "--start=-1.3,0,1.5", "--no-film", "--out", str(out)]
    assert cli.main(arguments) == 0
    table = capsys.readouterr().out
    assert "At rest on the feet after 2 of 2 missions (100.0" in table and "touch slab" in table
    files = ("index.html", "flights.csv", "mission.json", "mission.png", "mission.pdf")
    assert {path.name for path in out.iterdir()} == set(files)
    report = json.loads((out / "mission.json").read_text())
    rows = {(row["leg"], row["measure"]): row for row in report["rows"]}
    assert rows["mission", "done"]["count"] == rows["mission", "done"]["flights"] == 2
    assert rows["climb", "done"]["flights"] == 1 and rows["touchdown", "touched_slab"]["count"] == 2
    assert rows[None, "distance"]["flights"] == 2 and rows[None, "distance"]["max"] < 0.05
    assert "seed" not in {fact["name"] for fact in report["facts"]}
    flights = pd.read_csv(out / "flights.csv").query("mission == 0").set_index("leg")
    np.testing.assert_allclose(flights.loc["mission", ["x", "y", "z"]].astype(float), [-1, 0.05, 1.75])
    assert list(flights.index) == ["approach", "landing", "touchdown", "mission"]
    assert flights["time"]["mission"] == pytest.approx(flights["time"][:-1].sum())


@pytest.mark.slow
def test_the_first_mission_is_filmed(tmp_path):
    out = tmp_path / "out"
    small = ("--width", "160", "--height", "90", "--backend", "ray")
    assert cli.main(["mission", "--start=-1,0.05,1.75", *small, "--out", str(out)]) == 0
    rows = json.loads((out / "mission.json").read_text())["rows"]
    time = next(row for row in rows if row["leg"] == "mission" and row["measure"] == "time")["value"]
    reader = imageio_ffmpeg.read_frames(str(out / "flight.mp4"))
    assert next(reader)["size"] == (160, 90)
    assert len(list(reader)) == round(50 * time) + 51  # the last one stays for a second
    assert (out / "flight.gif").stat().st_size and Image.open(out / "flight.png").size == (160, 90)


def test_the_same_seed_gives_the_same_missions(capsys):
    reports = []
    for _ in range(2):
        assert cli.main(["mission", "--missions", "1", "--seed", "9", "--json"]) == 0
        reports.append(json.loads(capsys.readouterr().out))
    assert reports[0]["rows"] == reports[1]["rows"]
