"""Training options and run folders: taken as they should be, or refused in one sentence."""

import functools
import io
import os
import shutil
import tempfile
import typing
import unittest.mock
import zipfile
from pathlib import Path

import numpy as np
import torch

from inclined_landing.train import run
from inclined_landing.train.checkpoint import read
from inclined_landing.train.checkpoint import write as write_checkpoint
from inclined_landing.train.cli import main
from inclined_landing.train.config import ENDING, TrainConfig
from inclined_landing.train.run import CHECKPOINT, RECORD, Run
from tests.campaign.judge import (
    EVIL,
    TEXTS,
    Case,
    command,
    judge,
    mutations,
    parametrised,
    respelt,
    spoilt,
    write,
)

TINY = {"environments": 2, "rollout": 4, "batch_size": 8, "steps": 16, "epochs": 1, "threads": 1,
        "evaluate_every": 1, "video_every": 0}  # fmt: skip
NUMBERS = {name: value for name, value in EVIL.items() if type(value) in (int, float)}


def numbers():
    """Every numeric option with every evil number; texts are in `test_options.py`."""
    for name, kind in typing.get_type_hints(TrainConfig).items():
        if kind not in (int, float, int | None, float | None):
            continue
        for evil, value in NUMBERS.items():
            yield Case(
                f"{name} {evil}",
                make=lambda folder: folder,
                take=lambda folder, name=name, value=value: try_option(folder, name, value),
                named=name.replace("_", "-"),
            )


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


@functools.cache
def template() -> tempfile.TemporaryDirectory:
    """A run folder as a kill after the first checkpoints leaves it."""
    holder = tempfile.TemporaryDirectory()
    starts, run.EVALUATION_STARTS = run.EVALUATION_STARTS, 2
    try:
        run.train(TrainConfig(out=Path(holder.name, "run"), **TINY))
    finally:
        run.EVALUATION_STARTS = starts
    return holder


def copied(folder: Path) -> Path:
    return Path(shutil.copytree(Path(template().name, "run"), folder / "run"))


def resume(path):
    return Run(TrainConfig(out=path.parent, resume=True))


def folder_case(name, file, change):
    """`change(path)` is done to one file of a run folder that is then resumed."""

    def make(folder):
        path = copied(folder) / file
        change(path)
        return path

    return Case(name, make=make, take=resume)


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


def records():
    """The record of a run with a wrong entry."""
    names = [name for name in TrainConfig.__dataclass_fields__ if name not in ("out", "max_seconds")]
    for name, change in spoilt({"config": dict.fromkeys(names)}):

        def spoil(path, change=change):
            write(path, respelt(path.read_bytes(), change))

        yield folder_case(f"{RECORD} {name}", RECORD, spoil)


def checkpoints():
    """A checkpoint with a wrong entry of its state, or a wrong array."""
    for name, change in spoilt(dict.fromkeys(run._STATE)):
        if name.endswith("date"):  # JSON has none
            continue

        def spoil(state, change=change):
            new = change(state)
            state.clear()
            state.update(new)

        yield folder_case(f"state {name}", CHECKPOINT, functools.partial(with_state, change=spoil))
    for kind, value in (EVIL | {"date": ""}).items():
        for name in ("history", "evaluations", "numpy_rng", "ended"):

            def first(state, name=name, value=value):
                state[name] = [value, *state[name][1:]]

            yield folder_case(
                f"first of {name} {kind}", CHECKPOINT, functools.partial(with_state, change=first)
            )
    for name in ARRAYS:
        for kind, change in EVIL_ARRAYS.items():
            spoil = functools.partial(with_array, name=name, change=change)
            yield folder_case(f"array {name} {kind}", CHECKPOINT, spoil)


def other_files():
    """Other texts and damaged bytes in place of record and checkpoint."""
    for file in (RECORD, CHECKPOINT):
        for kind, content in TEXTS.items():
            yield folder_case(f"{file} is {kind}", file, functools.partial(write, content=content))
        pickled = lambda path: torch.save({"command": print}, path)  # noqa: E731
        yield folder_case(f"{file} is a pickle", file, pickled)
        yield folder_case(f"{file} is a folder", file, lambda path: (path.unlink(), path.mkdir()))
        yield folder_case(f"{file} is a pipe", file, lambda path: (path.unlink(), os.mkfifo(path)))
        for k in range(40):
            yield folder_case(f"{file} damage {k}", file, functools.partial(damage, number=k))


def damage(path, number):
    write(path, list(mutations(path.read_bytes(), number + 1))[number][1]())


@parametrised(numbers, records, checkpoints, other_files, each=3)
def test_training_begins_and_goes_on_or_says_why_not(case, tmp_path):
    judge(case, tmp_path)


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
