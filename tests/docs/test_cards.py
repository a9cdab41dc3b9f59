"""The cards of the shipped policies are what their generator makes, and what was flown are these files."""

import json
import shutil
import subprocess

import pytest

import tests.documents  # noqa: F401  (finds docs/site)
from inclined_landing.envs.ids import SHIPPED
from inclined_landing.envs.policy import load_policy

import cards  # isort: skip
import recipes  # isort: skip


def test_the_page_is_what_the_generator_makes():
    assert cards.PAGE.read_text("utf-8") == cards.page(), "run `python docs/site/cards.py`"
    assert cards.LIST.read_text("utf-8") == cards.overview(), "run `python docs/site/cards.py`"
    assert recipes.PAGE.read_text("utf-8") == recipes.page(), "run `python docs/site/recipes.py`"


def test_a_card_names_the_file_and_how_it_was_made():
    text = cards.PAGE.read_text("utf-8")
    for name in SHIPPED:
        _, _, section = text.partition(f"\n## {name}\n")
        section, _, _ = section.partition("\n## ")
        policy = load_policy(name)
        done = subprocess.run(["sha256sum", policy.path], capture_output=True, text=True, check=True)
        assert done.stdout.split()[0] in section
        assert cards.made_by(policy.metadata) in section and f"seed {policy.metadata['seed']}" in section


def test_a_policy_that_did_not_fly_is_refused(tmp_path, monkeypatch):
    folder = shutil.copytree(cards.FOLDER, tmp_path / "shipped")
    (folder / "landing.zip").write_bytes(b"another")
    monkeypatch.setattr(cards, "FOLDER", folder)
    with pytest.raises(cards.Stale, match=r"landing is not what was flown: run .*--fly landing"):
        cards.page()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["landing", "landing-slopes", "landing-vehicles", "setpoint"])
def test_what_is_recorded_is_what_it_does(name):
    """The first command of its card, flown again: equal on one machine, a flight or two apart on another."""
    recorded = json.loads(cards.FLOWN.read_text("utf-8"))[name]["judged"][0]
    flown = cards.fly(name, recorded["command"])
    for before, now in zip(recorded["rows"], flown["rows"], strict=True):
        assert before["what"] == now["what"]
        if "count" in before:
            assert before["of"] == now["of"] and abs(before["count"] - now["count"]) <= 2
        else:
            assert now["value"] == pytest.approx(before["value"], rel=0.05)
