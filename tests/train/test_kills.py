"""A run that is killed, at whatever moment, and resumed ends in the bits of one that was left alone."""

import functools
import json
import multiprocessing
import os
import random
import signal
import time

import pandas as pd
import pytest

from inclined_landing.train.run import RECORD
from tests.training import assert_same_policy, train

OPTIONS = {"landing": "landing --steps 4096", "touchdown": "touchdown --steps 4096"}
COMMON = "--environments 8 --rollout 64 --batch-size 256 --epochs 2 --threads 1 --no-report"
INTERVALS = "--evaluate-every 3 --checkpoint-every 2"
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
TIMES = 20  # of each signal


@pytest.fixture(scope="module")
def processes():
    """Makes processes that have everything imported, so that a case takes seconds."""
    context = multiprocessing.get_context("forkserver")
    used = ["inclined_landing.train.run", "inclined_landing.eval.after_training", "torch._dynamo"]
    context.set_forkserver_preload(used)
    return context


def begin(processes, folder, arguments, **options):
    """Start `landing-train` with the run folder `folder`/run and its output in log."""
    given = [*arguments.split(), "--out", str(folder / "run")]
    process = processes.Process(target=train, args=(given, str(folder / "log")), kwargs=options)
    process.start()
    return process


def finish(processes, folder, kind):
    """Resume what can be resumed, otherwise begin again, to the end."""
    resumable = (folder / "run" / RECORD).exists()
    process = begin(processes, folder, "--resume --no-report" if resumable else arguments(kind))
    process.join()
    assert process.exitcode == 0, (folder / "log").read_text()


def arguments(kind):
    return f"{OPTIONS[kind]} {COMMON} {INTERVALS}"


@pytest.fixture(scope="module")
def whole(processes, tmp_path_factory):
    """By kind of run: the folder of one that was left alone, and the seconds it took."""

    @functools.cache
    def made(kind):
        folder = tmp_path_factory.mktemp(kind)
        began = time.monotonic()
        begin(processes, folder, arguments(kind)).join()
        return folder / "run", time.monotonic() - began

    return made


def assert_same_run(a, b):
    """Policies, curves, metrics without seconds and names of files; nothing is left over."""
    for name in ("final.zip", "best.zip"):
        assert_same_policy(a / name, b / name)
    for name in ("learning.csv", "evaluations.csv"):
        tables = [
            pd.read_csv(folder / name).drop(columns=["training_seconds", "cpu_seconds"]) for folder in (a, b)
        ]
        pd.testing.assert_frame_equal(*tables, check_exact=True)
    assert plain(json.loads((a / "metrics.json").read_text())) == plain(
        json.loads((b / "metrics.json").read_text())
    )
    assert files(a) == files(b)
    assert {path.name for path in b.parent.iterdir()} == {"run", "log"}


def plain(value):
    """A value of metrics.json without what two runs differ in."""
    if isinstance(value, list):
        return [plain(item) for item in value]
    if not isinstance(value, dict):
        return value
    without = ("seconds", "steps_per_second", "training_seconds", "cpu_seconds", "out", "git revision")
    return {name: plain(item) for name, item in value.items() if name not in without}


def files(folder):
    found = {str(path.relative_to(folder)) for path in folder.rglob("*")}
    return {name for name in found if not name.startswith("tensorboard/events")}


@pytest.mark.slow
def test_killed_while_writing_a_file(processes, whole, tmp_path):
    """Every file that is written."""
    for k in range(40):
        folder = tmp_path / str(k)
        folder.mkdir()
        process = begin(processes, folder, arguments("landing"), dies_at=k)
        process.join()
        if process.exitcode == 0:  # fewer files are written
            assert k > 10
            return
        assert process.exitcode == -signal.SIGKILL
        assert list(folder.rglob(".*.part*"))
        finish(processes, folder, "landing")
        assert_same_run(whole("landing")[0], folder / "run")


@pytest.mark.slow
@pytest.mark.parametrize("k", range(TIMES))
@pytest.mark.parametrize("number", SIGNALS)
def test_killed_at_a_random_time(processes, whole, tmp_path, number, k):
    """Every fourth run is a touchdown run with its warm start; every third is killed once more."""
    rng = random.Random(1000 * number + k)
    kind = "touchdown" if k % 4 == 3 else "landing"
    folder, seconds = whole(kind)
    for again in range(2 if k % 3 == 0 else 1):
        resumable = again and (tmp_path / "run" / RECORD).exists()
        process = begin(processes, tmp_path, "--resume --no-report" if resumable else arguments(kind))
        process.join(0.1 + rng.random() * seconds)
        if process.exitcode is None:
            os.kill(process.pid, number)
        process.join()
        clean = {signal.SIGKILL: -9, signal.SIGTERM: 143, signal.SIGINT: 130}[number]
        assert process.exitcode in (0, clean), (tmp_path / "log").read_text()
        if process.exitcode == clean != -9:
            said = (tmp_path / "log").read_text().splitlines()[-1]
            assert said.startswith("landing-train: interrupted") and "Traceback" not in said
            assert not list(tmp_path.rglob(".*.part*"))
    finish(processes, tmp_path, kind)
    assert_same_run(folder, tmp_path / "run")
