"""Training options and run folders: taken as they should be, or refused in one sentence."""

import functools
import io
import json
import os
import shutil
import tempfile
import typing
import unittest.mock
import zipfile
from pathlib import Path

import numpy as np
import torch

from campaign.judge import EVIL, Case, command, judge, mutations, parametrised, write
from inclined_landing.envs.randomise import read_ranges
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.train import run
from inclined_landing.train.checkpoint import read
from inclined_landing.train.checkpoint import write as write_checkpoint
from inclined_landing.train.cli import main
from inclined_landing.train.config import ENDING, TrainConfig
from inclined_landing.train.run import CHECKPOINT, RECORD, Run

TINY = {"environments": 2, "rollout": 4, "batch_size": 8, "steps": 16, "epochs": 1, "threads": 1,
        "evaluate_every": 1, "video_every": 0}  # fmt: skip
OTHER = {"text": "heavy", "empty": "", "long": "x" * 2000, "control": "a\nb\x1b[31m\u202e", "list": "[1.0]"}
NUMBERS = {name: value for name, value in EVIL.items() if type(value) in (int, float)}


def option_cases():
    kinds = typing.get_type_hints(TrainConfig)
    for name in kinds:
        if name in ("out", "resume", "report"):
            continue
        number = kinds[name] in (int, float, int | None, float | None)
        for kind, value in ((NUMBERS if number else {}) | OTHER).items():
            option = {"task": [], "start_from": ["--from"]}.get(name, ["--" + name.replace("_", "-")])
            words = [f"{option[0]}={value}"] if option else [str(value)]
            yield Case(
                f"{name} {kind}",
                make=lambda folder: folder,
                take=lambda folder, words=words, name=name: try_option(folder, words, name),
                named=option[0] if number else "",
            )


def try_option(folder, words, name):
    """landing-train with one odd option and otherwise as little work as there can be."""
    left_out = {name, "evaluate_every"} | ({"steps"} if name in ENDING else set())
    tiny = [f"--{k.replace('_', '-')}={v}" for k, v in TINY.items() if k not in left_out]
    steps = ["--max-seconds=0.001"] if name in ENDING else []
    evaluate = "--evaluate-every=1" if name in ENDING[1:] else "--evaluate-every=0"
    given = [*tiny, *steps, f"--out={folder / 'run'}", evaluate, "--no-report", *words]
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


def with_entry(path, keys, value):
    record = json.loads(path.read_text("utf-8"))
    inside = record
    for key in keys[:-1]:
        inside = inside[key]
    inside[keys[-1]] = value
    write(path, json.dumps(record))


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
WHOLE = {
    "nothing": lambda path: write(path, b""),
    "a folder": lambda path: (path.unlink(), path.mkdir()),
    "a pipe": lambda path: (path.unlink(), os.mkfifo(path)),
    "text": lambda path: write(path, "steps: 3\n"),
    "a list": lambda path: write(path, "[]"),
    "nested": lambda path: write(path, "[" * 100_000),
    "a pickle": lambda path: torch.save({"command": print}, path),
}


class Harmful:
    """Would leave a file behind if it were unpickled."""

    def __reduce__(self):
        return os.mkdir, ("harm",)


def folder_cases():
    date = {"date"}  # no JSON
    names = TrainConfig.__dataclass_fields__
    for kind, value in EVIL.items():
        if kind in date:
            continue
        for keys in (
            *(("config", name) for name in names if name not in ("out", "max_seconds")),
            ("config",),
        ):
            yield folder_case(
                f"{RECORD} {' '.join(keys)} {kind}",
                RECORD,
                lambda path, keys=keys, value=value: with_entry(path, keys, value),
            )
        for name in run._STATE:
            yield folder_case(
                f"{CHECKPOINT} {name} {kind}",
                CHECKPOINT,
                lambda path, name=name, value=value: with_state(path, lambda s: s.update({name: value})),
            )
        for name in ("history", "evaluations", "numpy_rng", "ended"):
            yield folder_case(
                f"{CHECKPOINT} first of {name} {kind}",
                CHECKPOINT,
                lambda path, name=name, value=value: with_state(
                    path, lambda s: s.update({name: [value, *s[name][1:]]})
                ),
            )
    for name in ARRAYS:
        for kind, change in EVIL_ARRAYS.items():
            yield folder_case(
                f"{CHECKPOINT} {name} {kind}",
                CHECKPOINT,
                lambda path, name=name, change=change: with_array(path, name, change),
            )
    for file in (RECORD, CHECKPOINT):
        for kind, change in WHOLE.items():
            yield folder_case(f"{file} is {kind}", file, change)
        for k in range(40):
            yield folder_case(f"{file} mutated {k}", file, functools.partial(mutate, number=k))


def mutate(path, number):
    content = path.read_bytes()
    write(path, dict(mutations(content, number + 1, seed=number)).popitem()[1])


RANGES = b"nominal = 0.1\n[effects.mass]\nscale = [0.8, 1.1]\n[effects]\nwind = [[0, 1], [0, 0]]\n"


def ranges_cases():
    for kind, change in WHOLE.items():
        yield ranges_case(f"ranges are {kind}", change)
    for k, content in mutations(RANGES, 200):
        yield ranges_case(f"ranges mutated {k}", functools.partial(write, content=content))
    for kind, value in EVIL.items():
        lines = {"range": f"effects.mass.scale = {value!r}", "end": f"effects.mass.scale = [{value!r}, 1.1]",
                 "entry": f"body.mass = {value!r}", "name": f"{value!r} = [1, 1]",
                 "parameter": f"effects.mass.{value!r} = [1, 1]",
                 "share": f"nominal = {value!r}"}  # fmt: skip
        for what, line in lines.items():
            content = line.encode("utf-8", "replace")
            yield ranges_case(f"ranges {what} {kind}", functools.partial(write, content=content))


def ranges_case(name, change):
    def make(folder):
        path = folder / "ranges.toml"
        write(path, RANGES)
        change(path)
        return path

    return Case(name, make=make, take=lambda path: read_ranges(path).draw(load_vehicle(), 0, 3))


@parametrised(ranges_cases(), sample=40)
def test_ranges_are_taken_or_refused(case, tmp_path):
    judge(case, tmp_path)


@parametrised(option_cases(), sample=25)
def test_options_are_taken_or_refused_by_name(case, tmp_path):
    judge(case, tmp_path)


@parametrised(folder_cases(), sample=25)
def test_run_folders_are_resumed_or_refused(case, tmp_path):
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


OUTS = {
    "under a file": "file/run",
    "a file": "file",
    "a full folder": "full",
    "too long": "x" * 300,
    "too long below": "a/" + "x" * 300 + "/b",
    "a device": "/dev/null/run",
    "a folder of the kernel": "/proc/run",
}


@parametrised(
    (
        Case(
            f"out {kind}",
            make=lambda folder, out=out: (
                write(folder / "file", "x"), (folder / "full").mkdir(), write(folder / "full" / "x", "x")
            ) and folder / out,
            take=lambda path: command(main, ["--out", str(path), "--steps", "8", "--no-report"]),
            named="",
        )
        for kind, out in OUTS.items()
    ),
    sample=99,
)  # fmt: skip
def test_where_a_run_cannot_be_written_is_said_at_once(case, tmp_path):
    assert judge(case, tmp_path) != "works"


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
