"""The examples run, shortened, and the policies they leave are read and flown."""

import json
import re
import runpy
import sys

import numpy as np
import pytest
import torch

from inclined_landing import envs, train
from inclined_landing.envs.tasks import frozen as starts
from inclined_landing.envs.tasks import hover_states
from inclined_landing.eval.logs import read_log
from tests import ROOT

EXAMPLES = ROOT / "examples"


@pytest.mark.parametrize(
    ("name", "task", "steps"), [("train_landing", "landing", 8192), ("train_setpoint_sac", "setpoint", 5100)]
)
def test_example(name, task, steps, tmp_path, monkeypatch, capsys):
    threads = torch.get_num_threads()
    path = tmp_path / "policy.zip"
    monkeypatch.setattr(sys, "argv", [name, "3", str(steps), str(path)])
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    torch.set_num_threads(threads)
    policy = envs.load_policy(path)
    assert policy.task.name == task and policy.metadata["seed"] == 3 and policy.metadata["steps"] >= steps
    start = policy.task.sample(np.random.default_rng(0), 3).state
    assert len(envs.record_flights(policy, "analytic", start, steps=5)) == 3
    assert str(path) in capsys.readouterr().out


def test_the_classical_law_lands():
    example = runpy.run_path(str(EXAMPLES / "classical_landing.py"))
    task = envs.make_task("landing")
    start = hover_states(starts.grid()[::25], task.vehicle)
    flights = envs.record_flights(example["Law"](task), "hybrid", start)
    assert all(flight.strict for flight in flights)


@pytest.mark.slow
def test_ppo_in_one_file_learns_and_judges_itself(monkeypatch, capsys):
    threads = torch.get_num_threads()
    monkeypatch.setattr(sys, "argv", ["cleanrl_ppo", "3", "300000"])
    runpy.run_path(str(EXAMPLES / "cleanrl_ppo.py"), run_name="__main__")
    torch.set_num_threads(threads)
    found = re.search(r"seed 3, 300000 steps: (\d+) of 251 starts", capsys.readouterr().out)
    assert int(found[1]) > 125  # an untrained one: none


def test_flights_in_the_columns_of_a_laboratory_are_read_as_they_were(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    example = runpy.run_path(str(EXAMPLES / "own_flights.py"))
    (tmp_path / "lab.toml").write_text(example["MAPPING"], "utf-8")
    path = example["write_flights"]()[1]
    log, original = read_log(path, mapping="lab.toml"), read_log(tmp_path / "example" / "fit" / path.name)
    assert path.read_text("utf-8").startswith("time_ms,north,east,down,")
    np.testing.assert_allclose(log.position, original.position, atol=1e-9)
    np.testing.assert_allclose(log.attitude, original.attitude, atol=1e-6)  # six decimals of a degree
    np.testing.assert_allclose(log.command, original.command, atol=1e-6)


@pytest.mark.slow
def test_the_loop_gains_on_the_true_vehicle(tmp_path, monkeypatch, capsys):
    out = tmp_path / "loop"
    monkeypatch.setattr(sys, "argv", ["close_the_loop", str(out), "--seed", "5"])
    runpy.run_path(str(EXAMPLES / "close_the_loop.py"), run_name="__main__")
    success = json.loads((out / "loop.json").read_text("utf-8"))["success"]
    assert success["before"]["high"] < success["after"]["low"]  # of 95 % intervals
    assert (out / "loop.png").is_file() and "true vehicle" in capsys.readouterr().out


def test_every_public_name_is_there():
    for package in (envs, train):
        assert all(getattr(package, name).__doc__ for name in package.__all__)
        with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
            package.nothing  # noqa: B018
