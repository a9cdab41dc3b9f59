"""Training options and run folders: taken as they should be, or refused in one sentence."""

import functools
import io
import json
import os
import typing
import unittest.mock
import zipfile
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import torch
from hypothesis import given

from inclined_landing.train import run
from inclined_landing.train.checkpoint import read
from inclined_landing.train.checkpoint import write as write_checkpoint
from inclined_landing.train.cli import main
from inclined_landing.train.config import ENDING, TrainConfig
from inclined_landing.train.run import CHECKPOINT, Run
from tests.campaign.judge import EVIL, Case, command, examples, judge, judged, spoilt, write
from tests.campaign.test_folders import TINY, a_training

NUMBERS = [name for name, value in EVIL.items() if type(value) in (int, float)]


def try_option(folder, name, value):
    """landing-train with one odd option and otherwise as little work as there can be."""
    left_out = {name, "evaluate_every"} | ({"steps"} if name in ENDING else set())
    tiny = [f"--{k.replace('_', '-')}={v}" for k, v in TINY.items() if k not in left_out]
    steps = ["--max-seconds=0.001"] if name in ENDING else []
    evaluate = "--evaluate-every=1" if name in ENDING[1:] else "--evaluate-every=0"
    odd = f"--{name.replace('_', '-')}={value}"
    given = [*tiny, *steps, f"--out={folder / 'run'}", evaluate, "--no-report", odd]
    with unittest.mock.patch.object(run, "ENDING_STARTS", 2):
        return command(trained, given)


def trained(arguments):
    """Exit code of landing-train; a run that ended without success is as good as one with it."""
    code = main(arguments)
    return 0 if code == run.NOT_REACHED else code


def copied(folder: Path) -> Path:
    """A folder with a run as a kill after the first checkpoints leaves it."""
    for name, content in a_training().items():
        (folder / "run" / name).parent.mkdir(parents=True, exist_ok=True)
        write(folder / "run" / name, content)
    return folder / "run"


def resume(path):
    return Run(TrainConfig(out=path.parent, resume=True))


def with_state(path, change):
    saved = read(path)
    change(saved.state)
    write_checkpoint(path, saved)


def with_array(path, name, change):
    saved = read(path)
    saved.arrays[name] = change(saved.arrays[name])
    write_checkpoint(path, saved)


ARRAYS = ("last_obs", "torch_rng", "policy.log_std", "optimizer.0.exp_avg", "plant.engine", "episodes.length")
EVIL_ARRAYS = {
    "empty": lambda a: a[:0],
    "of one more axis": lambda a: a[None],
    "longer": lambda a: np.concatenate([a, a]),
    "complex": lambda a: a.astype(complex),
    "text": lambda a: np.full(a.shape, "x"),
    "a record": lambda a: np.zeros(a.shape, [("x", float)]),
    "nan": lambda a: np.full(a.shape, np.nan, a.dtype) if a.dtype.kind == "f" else np.full(a.shape, np.nan),
}


class Harmful:
    """Would leave a file behind if it were unpickled."""

    def __reduce__(self):
        return os.mkdir, ("harm",)


def option(name: str, evil: str) -> Case:
    """A numeric option with an evil number; texts are in `test_options.py`."""
    take = functools.partial(try_option, name=name, value=EVIL[evil])
    return Case(f"{name} {evil}", lambda folder: folder, take, named=name.replace("_", "-"))


def checkpoint(name: str, change) -> Case:
    """A run that goes on from a checkpoint after `change(path)`."""

    def make(folder: Path) -> Path:
        path = copied(folder) / CHECKPOINT
        change(path)
        return path

    return Case(name, make, resume)


def state(chosen) -> Case:
    """A checkpoint with a wrong entry of its state."""
    name, change = chosen

    def spoil(state):
        new = json.loads(json.dumps(change(state), default=str))
        state.clear()
        state.update(new)

    return checkpoint(f"state {name}", functools.partial(with_state, change=spoil))


def first(name: str, evil: str) -> Case:
    """A checkpoint with a wrong first element of a list of its state."""

    def spoil(state):
        state[name] = [str(EVIL[evil]) if evil == "date" else EVIL[evil], *state[name][1:]]

    return checkpoint(f"first of {name} {evil}", functools.partial(with_state, change=spoil))


def array(name: str, kind: str) -> Case:
    """A checkpoint with a wrong array."""
    spoil = functools.partial(with_array, name=name, change=EVIL_ARRAYS[kind])
    return checkpoint(f"array {name} {kind}", spoil)


NUMERIC = [
    name
    for name, kind in typing.get_type_hints(TrainConfig).items()
    if kind in (int, float, int | None, float | None)
]
LISTS = ("history", "evaluations", "numpy_rng", "ended")
CASES = st.one_of(
    st.builds(option, st.sampled_from(NUMERIC), st.sampled_from(NUMBERS)),
    st.builds(option, st.sampled_from(NUMERIC), st.sampled_from(NUMBERS)),
    spoilt(dict.fromkeys(run._STATE)).map(state),
    st.builds(first, st.sampled_from(LISTS), st.sampled_from(list(EVIL))),
    st.builds(array, st.sampled_from(ARRAYS), st.sampled_from(list(EVIL_ARRAYS))),
)


@examples(16)
@given(case=CASES)
def test_training_begins_and_goes_on_or_says_why_not(case):
    judged(case)


def test_nothing_in_a_checkpoint_is_executed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = copied(tmp_path) / CHECKPOINT
    torch.save(Harmful(), path)
    with_pickle = io.BytesIO()
    with zipfile.ZipFile(with_pickle, "w") as archive:
        archive.writestr("state.json", "{}")
        with archive.open("a.npy", "w") as file:
            np.lib.format.write_array(file, np.array([Harmful()], object), allow_pickle=True)
    for content in (path.read_bytes(), with_pickle.getvalue()):
        write(path, content)
        assert CHECKPOINT in judge(Case("harm", lambda folder: path, resume), tmp_path)
    assert not (tmp_path / "harm").exists()


def test_a_run_folder_says_how_its_run_goes_on(tmp_path):
    """Also when it is finished, and when another process works in it."""
    folder = copied(tmp_path)
    (folder / "metrics.json").unlink()
    refused = judge(Case("begun", lambda _: folder, lambda path: Run(TrainConfig(out=path))), tmp_path)
    assert f"--resume --out {folder}" in refused
    with run.runs.held(folder):
        again = Case("held", lambda _: folder, lambda path: run.train(TrainConfig(out=path, resume=True)))
        refused = judge(again, tmp_path)
    assert "another process" in refused
    command(main, ["--resume", "--no-report", "--out", str(folder)])
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    assert "is finished" in command(main, ["--resume", "--no-report", "--out", str(folder)])
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before
