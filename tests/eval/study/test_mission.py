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
        assert cli.main(["mission", "--missions", "2", "--seed", "9", "--json"]) == 0
        reports.append(json.loads(capsys.readouterr().out))
    assert reports[0]["rows"] == reports[1]["rows"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--landing", "touchdown"], "the landing policy touchdown is for the task touchdown"),
        (["--touchdown", "landing"], "trained for the task landing, not for touchdown"),
        (["--start", "1,2"], "--start must be X,Y,Z in metres, not '1,2'"),
        (["--start", "0,0,1.2"], "start 0,0,1.2 lies within 0.25 m of the platform, under it"),
        (["--start", "9,0,1"], "outside the set-point task's starts (x -2.5 to 2.5"),
        (["--start=-1,0,1.5", "--missions", "5"], "--missions has no effect with --start"),
        (["--hand-over", "0,1"], "the hand-over point must lie above the platform"),
        (["--missions", "0"], "--missions must be a whole number from 1 to 2000"),
        (["--near", "0"], "--near must be a number from 0.005 to 0.5"),
        (["--width", "161"], "width and height of a video must be even, not"),
        (["--inclination", "80"], "inclination"),
    ],
)
def test_wrong_input(arguments, sentence, capsys, tmp_path):
    assert cli.main(["mission", *arguments, "--out", str(tmp_path / "new")]) == 2
    printed = capsys.readouterr()
    assert sentence in printed.err and not printed.out and not (tmp_path / "new").exists()
