"""Folders that commands go on in or read, with one file damaged: gone on with, read, or refused.

An entry of `FOLDERS` is all that a new kind of folder needs.
"""

import dataclasses
import functools
import gzip
import io
import json
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pandas as pd
import pytest
from hypothesis import given

from inclined_landing.eval import cli
from inclined_landing.eval.landings import command as landings
from inclined_landing.eval.landings import engines
from inclined_landing.eval.landings.study import read_study
from inclined_landing.eval.truth.contact import touchdowns
from inclined_landing.models import storage
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.train import run
from inclined_landing.train.config import TrainConfig
from tests.campaign.judge import Case, command, contents, examples, judged, respelt, spoilt, write
from tests.campaign.test_toml import STUDY
from tests.proof.gap_blind import cases as drawn
from tests.proof.gap_blind import command as blind

CELLS = (
    "nan",
    "inf",
    "-inf",
    "1e300",
    "-1",
    "0",
    "",
    "abc",
    "1e-300",
    "9" * 40,
    "True",
    "[1]",
    '"x',
    "é\x00",
)
TINY = {"environments": 2, "rollout": 4, "batch_size": 8, "steps": 16, "epochs": 1, "threads": 1,
        "evaluate_every": 1, "video_every": 0}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Kind:
    """A kind of folder: its good files, what goes on in it or reads it, and what then must hold."""

    good: Callable[[], dict[str, bytes]]
    take: Callable[[Path], object]
    works: Callable[[object], None] = lambda result: None
    files: tuple[str, ...] = ()  # that are damaged; of folders only whether they are there
    like: dict[str, dict] = dataclasses.field(default_factory=dict)  # what JSON files hold
    tables: tuple[str, ...] = ()  # files of CSV
    named: str = "out"
    pipes: bool = False  # may a file be a pipe, where opening one would wait for ever


def below(folder: Path) -> dict[str, bytes]:
    """Every file below a folder."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@functools.cache
def a_study() -> dict[str, bytes]:
    """A study that was interrupted after its last landing but one chunk."""
    with tempfile.TemporaryDirectory() as place:
        study = read_study(write(Path(place) / "study.toml", STUDY))
        out = Path(place) / "out"
        landings._begin(study, out, 5)
        for chunk, table in engines.local(study, [0, 1], 5):
            landings._write(table, landings._part(out, chunk))
        return below(out)


def study_resumed(out: Path) -> dict:
    with tempfile.TemporaryDirectory() as place:
        study = write(Path(place) / "study.toml", STUDY)
        landings.command(study, out, resume=True, chunk=5)
    return json.loads((out / "summary.json").read_text("utf-8"))


def as_uninterrupted(summary: dict) -> None:
    assert sum(entry["count"] for entry in summary["outcomes"].values()) == 12


LABELS = {case.name: case.label() for case in drawn.of_set("dev", 0, len(drawn.STRATA))}
NAME, LABEL = next((name, label) for name, label in LABELS.items() if label["causes"])
SET = {"set": "dev", "seed": 0, "cases": len(LABELS)}
REPORT = {
    "verdict": "effects",
    "effects": [{"name": LABEL["causes"][0], "class": [], "parameters": {}}],
    "sets": [{"effects": [LABEL["causes"][0]], "probability": 1.0}],
    "gap": {},
    "seconds": 1.0,
}
REPORTED = str(blind._report(Path(), "workflow", NAME))


@functools.cache
def a_set() -> dict[str, bytes]:
    """A blind set with one report."""
    with tempfile.TemporaryDirectory() as place:
        blind._open_set(Path(place), SET, LABELS)
        return below(Path(place)) | {REPORTED: json.dumps(REPORT).encode()}


def set_resumed(folder: Path) -> None:
    blind._open_set(folder, SET, LABELS)
    row = blind._scored(folder, "workflow", NAME, LABEL)
    if row is None:  # is made again
        storage.write_json(folder / REPORTED, REPORT)
        assert blind._scored(folder, "workflow", NAME, LABEL)["outcome"]


@functools.cache
def a_training() -> dict[str, bytes]:
    """A run as a kill after the first checkpoints leaves it."""
    starts, run.EVALUATION_STARTS = run.EVALUATION_STARTS, 2
    try:
        with tempfile.TemporaryDirectory() as place:
            run.train(TrainConfig(out=Path(place, "run"), **TINY))
            return below(Path(place, "run"))
    finally:
        run.EVALUATION_STARTS = starts


def training_resumed(out: Path) -> run.Run:
    return run.Run(TrainConfig(out=out, resume=True))


def curves(out: Path) -> None:
    with tempfile.TemporaryDirectory() as away:
        command(cli.main, ["curves", str(out), "--out", f"{away}/curves.png"])


@functools.cache
def a_flight() -> bytes:
    """A measured flight that sinks to the floor in a second."""
    steps = np.arange(400) * 0.01
    table = pd.DataFrame({name: np.zeros(len(steps)) for name in touchdowns._COLUMNS})
    table["t"], table["z"], table["qw"] = steps, np.maximum(0.0, 1.0 - steps), 1.0
    table["vz"] = np.where(steps < 1.0, -1.0, 0.0)
    table[list(touchdowns._MOTORS)] = 30000.0
    text = io.StringIO()
    table.to_csv(text, index=False)
    return gzip.compress(text.getvalue().encode(), mtime=0)


def found(folder: Path) -> object:
    return touchdowns.find_touchdowns(touchdowns.read_flights(folder), load_vehicle())


RUN = {
    "run.json": b'{"config": {"task": "landing"}}',
    "learning.csv": b"steps,level,episode_length,episode_reward\n8192,0.1,40,-60\n16384,0.2,50,-50\n",
    "evaluations.csv": b"steps,score,strict_success\n8192,0.5,0.4\n16384,0.75,0.7\n",
}
CONFIG = [name for name in TrainConfig.__dataclass_fields__ if name not in ("out", "max_seconds")]
RECORD = {
    "study": dict.fromkeys(("starts", "parameters", "maps", "seed")),
    **{"chunk": 5, "fingerprint": "", "landings": 12},
}
FOLDERS = {
    "study": Kind(
        *(a_study, study_resumed, as_uninterrupted),
        files=("study.json", "parts/00000.parquet", "results.parquet", "parts/00007.parquet", "parts"),
        like={"study.json": RECORD},
    ),
    "set": Kind(
        *(a_set, set_resumed),
        files=("set.json", "sealed/labels.json", REPORTED),
        like={"set.json": SET, REPORTED: REPORT},
    ),
    "training": Kind(
        *(a_training, training_resumed),
        pipes=True,
        files=(run.RECORD, run.CHECKPOINT),
        like={run.RECORD: {"config": dict.fromkeys(CONFIG)}},
    ),
    "curves": Kind(
        *(lambda: RUN, curves),
        files=tuple(RUN),
        like={"run.json": {"config": {"task": ""}}},
        tables=("learning.csv", "evaluations.csv"),
    ),
    "flights": Kind(
        *(lambda: {"nb_a.csv.gz": a_flight()}, found),
        files=("nb_a.csv.gz",),
        tables=("nb_a.csv.gz",),
        named="",
    ),
}


def case(kind: str, file: str, name: str, change: Callable[[Path], object]) -> Case:
    """A folder of a kind; `change(path)` is done to one of its files."""

    def make(folder: Path) -> Path:
        for path, content in FOLDERS[kind].good().items():
            (folder / "out" / path).parent.mkdir(parents=True, exist_ok=True)
            write(folder / "out" / path, content)
        change(folder / "out" / file)
        return folder / "out"

    reader = FOLDERS[kind]
    return Case(f"{kind} {file} {name}", make, reader.take, reader.works, named=reader.named, seconds=60)


def gone(path: Path) -> None:
    shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)


def written(path: Path, content: bytes) -> None:
    gone(path)
    write(path, content)


OTHERS = {
    "missing": gone,
    "a folder": lambda path: (gone(path), path.mkdir()),
    "a pipe": lambda path: (gone(path), os.mkfifo(path)),
}


def celled(table: bytes, column: int, cell: str, rows: int) -> bytes:
    """A table, perhaps a packed one, with another cell in a column of its first rows."""
    if table[:2] == b"\x1f\x8b":
        return gzip.compress(celled(gzip.decompress(table), column, cell, rows), mtime=0)
    lines = [line.split(",") for line in table.decode().splitlines()]
    for line in lines[1 : rows + 1]:
        line[column % len(line)] = cell
    return ("\n".join(map(",".join, lines)) + "\n").encode()


@functools.cache
def damages(kind: str) -> st.SearchStrategy[Case]:
    """Draw a folder of a kind with one file damaged."""
    reader = FOLDERS[kind]

    def other(file: str):
        good = lambda: reader.good().get(file, b"PAR1")  # noqa: E731
        texts = contents(good).map(lambda s: (s[0], lambda path: written(path, s[1]())))
        others = {name: way for name, way in OTHERS.items() if reader.pipes or name != "a pipe"}
        return (st.sampled_from(list(others.items())) | texts).map(lambda s: case(kind, file, *s))

    def entry(file: str):
        def respell(s):
            return case(kind, file, s[0], lambda path: write(path, respelt(path.read_bytes(), s[1])))

        return spoilt(reader.like[file]).map(respell)

    def cell(file: str, column: int, cell: str, rows: int):
        def change(path: Path) -> None:
            write(path, celled(path.read_bytes(), column, cell, rows))

        return case(kind, file, f"{column} {cell!r} {rows}", change)

    drawn = [st.sampled_from(reader.files).flatmap(other)] if reader.files else []
    drawn += [entry(file) for file in reader.like]
    if reader.tables:
        columns, rows = st.integers(0, 30), st.sampled_from((1, 400))
        drawn.append(st.builds(cell, st.sampled_from(reader.tables), columns, st.sampled_from(CELLS), rows))
    return st.one_of(drawn)


@pytest.mark.parametrize("kind", FOLDERS)
@examples(8)
@given(data=st.data())
def test_what_was_begun_goes_on_or_says_why_not(kind, data):
    judged(data.draw(damages(kind)))


@pytest.mark.parametrize("kind", FOLDERS)
def test_what_is_whole_goes_on(kind):
    assert judged(case(kind, "", "whole", lambda path: None)) == "works"
