"""Other simulators beside the plants: a row for each, or why there is none."""

import importlib
import json

import pytest

from tests.validation import __main__ as validation
from tests.validation import peers


def _still(vehicles, seed):
    return peers.Simulation(lambda: None, vehicles, "none", "none", "64 bits", "none", seconds=0.01)


def _absent(vehicles, seed):
    importlib.import_module("no_such_simulator")


def _changed(vehicles, seed):
    raise TypeError("no such option")


def test_simulators_are_measured_or_named_with_their_remedy(tmp_path, monkeypatch):
    made = {"still": _still, "absent": _absent, "changed": _changed}
    rows = peers.rates(3, 0, repeats=2, seconds=0.001, peers=made)
    assert rows[0]["vehicles"] == 3 and 0 < rows[0]["per_second"]["min"]
    assert rows[1]["contact"] == f"not installed (no_such_simulator): {peers.INSTALL}"
    assert rows[2]["contact"] == "does not run: TypeError: no such option"
    monkeypatch.setattr(peers, "rates", lambda vehicles, seed: rows)
    assert validation.main(["peers", "--out", str(tmp_path / "out")]) == 0
    lines = (tmp_path / "out" / "peers.md").read_text().splitlines()
    assert len({line.count("|") for line in lines[2:]}) == 1 and len(lines) == 7
    assert len(json.loads((tmp_path / "out" / "peers.json").read_text())["peers"]) == 3


@pytest.mark.slow
@pytest.mark.parametrize("name", peers.PEERS)
def test_an_installed_simulator_steps(name):
    (row,) = peers.rates(8, 0, repeats=1, seconds=0.01, peers={name: peers.PEERS[name]})
    if "not installed" in row["contact"]:
        pytest.skip(row["contact"])
    if "SCIPY_ARRAY_API" in row["contact"]:
        pytest.skip("SciPy was imported first")
    assert row["per_second"]["median"] > 0
