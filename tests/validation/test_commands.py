"""The commands of `python -m tests.validation`, and what they were run for: flights, vehicles, a page."""

import subprocess
import sys

import pandas
import pytest

from inclined_landing.eval import cli
from inclined_landing.models.parameters import load_vehicle, locate_vehicle
from tests import ROOT
from tests.validation import __main__ as validation
from tests.validation import gap_example
from tests.validation.identified import vehicles


def test_one_command_runs_them_from_the_root():
    words = [sys.executable, "-m", "tests.validation", "-h"]
    done = subprocess.run(words, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0 and done.stderr == ""
    assert all(name in done.stdout and validation.find(name).__doc__ for name in validation.COMMANDS)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("gap-blin", "unknown command 'gap-blin', perhaps gap-blind; see python -m tests.validation --help"),
        ("gap-agreement --out {out} --family moon", "unknown family 'moon'; choose from dev, fresh"),
        ("gap-blind --out {file}", "cannot create the folder {file}/answers: not a directory"),
        ("gap-example --out {folder}", "the run folder {folder} exists and is not empty"),
        ("causes {folder}/none --out {out}", "{folder}/none: no folder"),
        ("gap-example --cause moon --out {out}", "unknown cause 'moon'; choose from thrust_scale"),
    ],
)
def test_wrong_words_are_one_sentence(words, sentence, tmp_path, capsys):
    (tmp_path / "file").touch()
    places = {"out": tmp_path / "out", "file": tmp_path / "file", "folder": tmp_path}
    assert validation.main(words.format(**places).split()) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.count("\n") == 1
    assert sentence.format(**places) in printed.err
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.slow
def test_the_shipped_flights_are_what_the_generator_makes(tmp_path, capsys):
    assert cli.main(["gap-example", "--out", str(tmp_path / "copied")]) == 0
    gap_example.command(tmp_path / "made")
    lines = capsys.readouterr().out.splitlines()
    assert [line.replace("copied", "made") for line in lines[:2]] == lines[2:]
    folders = [tmp_path / "copied", tmp_path / "made"]
    names = [sorted(p.relative_to(folder) for p in folder.rglob("*.csv")) for folder in folders]
    assert names[0] == names[1] and len(names[0]) == 20
    for name in names[0]:
        flights = [pandas.read_csv(folder / name) for folder in folders]
        # The last of six decimals, where another processor rounds another way; of a PWM of 40 000 more.
        pandas.testing.assert_frame_equal(*flights, rtol=1e-9, atol=2e-6)


@pytest.mark.parametrize("name", vehicles())
def test_a_shipped_vehicle_is_what_its_entry_says(name):
    entry, vehicle = vehicles()[name], load_vehicle(name)
    assert vehicle.body_mass == entry["mass"] and vehicle != load_vehicle(entry["base"])
    text = locate_vehicle(name).read_text("utf-8")
    assert f'based_on = "{entry["base"]}"' in text
    assert entry["commit"] in text
