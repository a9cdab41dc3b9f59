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

from campaign.judge import EVIL, Case, command, judge, mutations, parametrised
from inclined_landing.eval import cli
from inclined_landing.eval.truth.contact_truth import touchdowns

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


def _damaged():
    for name in ("learning", "evaluations"):
        text = RUN[f"{name}.csv"]
        yield from ((f"{name} {what}", {f"{name}.csv": new}) for what, new in _cells(text))
        bytes_ = mutations(text.encode(), 12, seed=3)
        yield from ((f"{name} bytes {k}", {f"{name}.csv": new}) for k, (_, new) in enumerate(bytes_))
    for name, value in EVIL.items():
        if not isinstance(value, (int, float, str, list, dict)):
            continue
        for k, record in enumerate((value, {"config": value}, {"config": {"task": value}})):
            yield f"run.json {name} {k}", {"run.json": json.dumps(record)}


def run_cases():
    for name, changed in _damaged():
        yield Case(
            f"curves of {name}",
            make=lambda folder, changed=changed: _run(folder, changed),
            take=_curves,
            named="run",
        )


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


def flight_cases():
    for column, cell in itertools.product(touchdowns._COLUMNS, CELLS):
        for count in (1, 400):
            yield Case(
                f"touchdowns of {column} {CELLS.index(cell)} {count}",
                make=lambda folder, c=column, x=cell, k=count: _flights(folder, c, x, k),
                take=lambda folder: touchdowns.find_touchdowns(touchdowns.read_flights(folder)),
                named="nb_a.csv.gz",
            )


@parametrised(run_cases(), sample=12)
def test_run_folders_are_drawn_or_refused(case, tmp_path):
    judge(case, tmp_path)


@parametrised(flight_cases(), sample=12)
def test_measured_touchdowns_are_read_or_refused(case, tmp_path):
    judge(case, tmp_path)
