"""The commands of `python -m tests.proof`, and that the shipped flights are those of their generator."""

import subprocess
import sys

import pandas
import pytest

from inclined_landing.eval import cli
from tests import ROOT
from tests.proof import __main__ as proof
from tests.proof import gap_example


def test_one_command_runs_them_from_the_root():
    words = [sys.executable, "-m", "tests.proof", "-h"]
    done = subprocess.run(words, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0 and done.stderr == ""
    assert all(name in done.stdout for name in proof.COMMANDS)
    assert all(proof.find(name).__doc__ for name in proof.COMMANDS)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ([], "no command; python -m tests.proof --help lists them"),
        (
            ["gap-blin"],
            "unknown command 'gap-blin', perhaps gap-blind; python -m tests.proof --help",
        ),
        (["plan-proof"], "Missing from python -m tests.proof plan-proof: --out DIR"),
        (["flight-table", "--flights", "nan"], "Error parsing --flights"),
        (["gap-agreement", "--out", "{out}", "--cases", "0"], "--cases must be "),
        (["plan-proof", "--out", "{out}", "--family", "moon"], "unknown family 'moon'; known are dev, fresh"),
        (
            ["plan-loop", "--out", "{out}", "--causes", "moon"],
            "unknown cause 'moon'; known are attitude_delay, ",
        ),
        (["from-logs", "--out", "{out}", "--cases", "moon"], "unknown case 'moon'; known are thrust_scale, "),
        (
            ["identified", "{folder}", "--out", "{out}", "--only", "moon"],
            "unknown vehicle 'moon'; known are ",
        ),
        (["gap-blind", "--out", "{file}"], "the run folder {file} exists and is not a folder; choose "),
        (["gap-example", "--out", "{folder}"], "the run folder {folder} exists and is not empty; choose "),
    ],
)
def test_wrong_words_are_one_sentence(words, sentence, tmp_path, capsys):
    (tmp_path / "file").touch()
    places = {"out": tmp_path / "out", "file": tmp_path / "file", "folder": tmp_path}
    assert proof.main([word.format(**places) for word in words]) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.count("\n") == 1
    assert printed.err.startswith("python -m tests.proof: " + sentence.format(**places)), printed.err
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.slow
def test_the_shipped_flights_are_what_the_generator_makes(tmp_path, capsys):
    assert cli.main(["gap-example", "--out", str(tmp_path / "copied")]) == 0
    gap_example.command(tmp_path / "made")
    lines = capsys.readouterr().out.splitlines()
    assert [line.replace("copied", "made") for line in lines[:2]] == lines[2:]
    folders = [tmp_path / "copied", tmp_path / "made"]
    names = [sorted(p.relative_to(folder) for p in folder.rglob("*.*")) for folder in folders]
    assert names[0] == names[1] and len(names[0]) == 20
    for name in names[0]:
        flights = [pandas.read_csv(folder / name) for folder in folders]
        # The last of six decimals, where another processor rounds another way; of a PWM of 40 000 more.
        pandas.testing.assert_frame_equal(*flights, rtol=1e-9, atol=2e-6)
