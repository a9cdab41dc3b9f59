"""Run folders and tables of measured flights that other commands read, damaged: drawn or refused."""

import functools
import gzip
import io
import itertools
import json
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from inclined_landing.eval import cli
from inclined_landing.eval.truth.contact_truth import touchdowns
from tests.campaign.judge import TEXTS, Case, command, judge, mutations, parametrised, spoilt

CELLS = (
    *("nan", "inf", "-inf", "1e300", "-1", "0", "", "abc", "1e-300", "9" * 40, "True", "[1]", '"x', "é\x00"),
)
RUN = {
    "run.json": json.dumps({"config": {"task": "landing"}}),
    "learning.csv": "steps,level,episode_length,episode_reward\n8192,0.1,40,-60\n16384,0.2,50,-50\n",
    "evaluations.csv": "steps,score\n8192,0.5\n16384,0.75\n",
}
STEPS = np.arange(400) * 0.01


def _run(folder: Path, changed: dict[str, str | bytes]) -> Path:
    run = folder / "run"
    run.mkdir()
    for name, content in (RUN | changed).items():
        (run / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return run


def _cells(text: str):
    """The table with every column's first cell, and with all its cells, replaced by each of CELLS."""
    head, *rows = [line.split(",") for line in text.splitlines()]
    for column, cell in itertools.product(range(len(head)), CELLS):
        for count in (1, len(rows)):
            changed = [row.copy() for row in rows]
            for row in changed[:count]:
                row[column] = cell
            yield (
                f"{head[column]} {CELLS.index(cell)} {count}",
                "\n".join(map(",".join, [head, *changed])) + "\n",
            )


def _curves(run: Path) -> None:
    with tempfile.TemporaryDirectory() as away:
        command(cli.main, ["curves", str(run), "--out", f"{away}/curves.png"])


def tables():
    """Learning curves and evaluations with wrong cells, and their bytes damaged."""
    for file in ("learning.csv", "evaluations.csv"):
        for what, new in _cells(RUN[file]):
            yield _case(f"{file} {what}", {file: new})
        for what, make in mutations(RUN[file].encode(), 12):
            yield _case(f"{file} {what}", {file: make()})


def records():
    """The record of a run with a wrong entry."""
    for name, change in spoilt({"config": {"task": ""}}):
        yield _case(
            f"run.json {name}", {"run.json": json.dumps(change({"config": {"task": ""}}), default=str)}
        )
    for name, content in TEXTS.items():
        yield _case(f"run.json {name}", {"run.json": content})


def _case(name: str, changed: dict[str, str | bytes]) -> Case:
    return Case(f"curves of {name}", lambda folder: _run(folder, changed), _curves, named="run")


@functools.cache
def _flight() -> pd.DataFrame:
    table = pd.DataFrame({name: np.zeros(len(STEPS)) for name in touchdowns._COLUMNS})
    table["t"], table["z"], table["qw"] = STEPS, np.maximum(0.0, 1.0 - STEPS), 1.0
    table["vz"] = np.where(STEPS < 1.0, -1.0, 0.0)
    for motor in touchdowns._MOTORS:
        table[motor] = 30000.0
    return table


def _flights(folder: Path, column: str, cell: str, count: int) -> Path:
    table = _flight().astype(object)
    table.loc[: count - 1, column] = cell
    text = io.StringIO()
    table.to_csv(text, index=False)
    (folder / "nb_a.csv.gz").write_bytes(gzip.compress(text.getvalue().encode(), mtime=0))
    return folder


def flights():
    """Measured flights with wrong cells."""
    for column, cell, count in itertools.product(touchdowns._COLUMNS, CELLS, (1, 400)):
        yield Case(
            f"touchdowns of {column} {CELLS.index(cell)} {count}",
            make=functools.partial(_flights, column=column, cell=cell, count=count),
            take=lambda folder: touchdowns.find_touchdowns(touchdowns.read_flights(folder)),
            named="nb_a.csv.gz",
        )


@parametrised(tables, records, flights, each=2)
def test_what_others_wrote_is_read_or_refused(case, tmp_path):
    judge(case, tmp_path)
