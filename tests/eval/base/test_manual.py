"""What commands say about themselves: --help, --version, and the scripts that complete command lines."""

import dataclasses
import re

import pytest

from inclined_landing.envs.rendering import CAMERAS
from inclined_landing.envs.shared import command_line
from inclined_landing.eval import cli, demo
from inclined_landing.eval.base.options import FITTED, Look
from inclined_landing.train.cli import main as train
from inclined_landing.train.config import TrainConfig, flag_of

NOTHING = re.compile(r"\{None\}|\(default: (None|False|'')?\)|\(repeatable\)")
OPTION = re.compile(r"^  (--[a-z-]+|-h)\b", re.MULTILINE)


@pytest.fixture(scope="module")
def pages() -> dict[str, str]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", "100")
        found = {
            name: command_line.help_page(cli.find(name), f"landing-eval {name}") for name in cli.COMMANDS
        }
        return found | {"landing-train": command_line.help_page(TrainConfig, "landing-train")}


def rows(page: str) -> list[str]:
    """The options of a page, each with its text on one line."""
    parts = re.split(r"\n(?=  \S)", page)
    return [" ".join(part.partition("\n\n")[0].split()) for part in parts if re.match("  --?[a-z]", part)]


def test_every_option_of_every_command_is_explained_once(pages):
    for name, page in pages.items():
        options = OPTION.findall(page)
        assert len(set(options)) == len(options), name
        assert not NOTHING.search(page), (name, NOTHING.search(page))
        for row in rows(page):
            text = re.sub(r"\(default: .*\)|^-\S+( \S+)?", "", row)
            assert re.search(r"[a-z]{2}", text) and row.count("(") == row.count(")"), f"{name}: {row}"


def test_the_first_line_is_that_of_the_list_of_commands(pages):
    for name in cli.COMMANDS:
        usage, text = pages[name].split("\n\n")[:2]
        assert usage.startswith(f"usage: landing-eval {name} ") and " ".join(text.split()) == cli.summary(
            name
        )


def test_help_names_every_camera(pages):
    for name in ("video", "picture", "mission"):
        (row,) = (row for row in rows(pages[name]) if row.startswith("--camera"))
        assert not [camera for camera in (*CAMERAS, FITTED) if not re.search(rf"\b{camera}\b", row)], row


def test_help_of_a_training_is_one_screen(monkeypatch, capsys):
    """What people change on 50 lines of 100 columns; every option is in --help-all."""
    monkeypatch.setenv("COLUMNS", "100")
    printed = []
    for word in ("--help", "--help-all"):
        assert train([word]) == 0
        printed.append(capsys.readouterr().out)
        assert max(map(len, printed[-1].splitlines())) <= 100
    short, full = printed
    assert len(short.splitlines()) <= 50 and set(OPTION.findall(short)) < set(OPTION.findall(full))
    flags = {flag_of(field.name) for field in dataclasses.fields(TrainConfig) if field.name != "task"}
    assert set(OPTION.findall(full)) == flags | {"-h"}


def test_versions_of_both_programs(capsys):
    assert cli.main(["--version"]) == 0 and train(["--version"]) == 0
    lines = capsys.readouterr().out.splitlines()
    form = r"(landing-\w+) [0-9.]+ \(MuJoCo 4\.0\.0, PyTorch \S+, Python 3\.\d+\.\d+\S*\)"
    assert [re.fullmatch(form, line)[1] for line in lines] == ["landing-eval", "landing-train"]


# ---- demo


def test_demo_counts_films_and_pictures(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(demo, "STARTS", 4)
    monkeypatch.setattr(demo, "LOOK", Look(width=64, height=48))
    out = tmp_path / "demo"
    assert cli.main(["demo", "--out", str(out), "--seed", "5"]) == 0
    printed = capsys.readouterr().out
    assert re.search(r"random, seed 5 +4 +100\.0 \[51\.0, 100\.0\] +0 ", printed)
    names = sorted(path.name for path in out.iterdir())
    assert names == ["landing.gif", "landing.html", "landing.mp4", "landing.png"] and all(
        name in printed for name in names
    )
    assert cli.main(["demo", "--out", str(out)]) == 2
    assert "exists and is not empty" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["demo"]
