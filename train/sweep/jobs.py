"""One run of a sweep: its command lines, each executed exactly once.

SWEEP/steps/RUN.json records the commands that have a result, and RUN.log their output. A recorded command is
not repeated, and an interrupted training is resumed.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from inclined_landing.envs.shared import runs
from inclined_landing.models.base import schema, storage
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.train.sweep.recipe import Recipe, filled

PROGRAMS = {"landing-train": "inclined_landing.train", "landing-eval": "inclined_landing.eval"}
STEPS = "steps"  # folder of the records in that of the sweep
DONE = (0, 3)  # exit codes of a command with a result: 3 says that it is not the one that was hoped for
# Libraries that otherwise start a thread for each core.
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
# Runs a module as `python -m` does, in a process that the kernel kills when its parent ends.
_PR_SET_PDEATHSIG = 1
_BEGIN = (
    f"import ctypes, runpy, sys; ctypes.CDLL(None).prctl({_PR_SET_PDEATHSIG}, {signal.SIGKILL.value})\n"
    "del sys.argv[0]; runpy.run_module(sys.argv[0], run_name='__main__', alter_sys=True)"
)
_under_way: set[int] | None = set()  # processes of this one's commands; None: no further ones begin


class Step(msgspec.Struct, frozen=True):
    """A command that has a result."""

    line: str
    cpu_seconds: Annotated[float, Meta(ge=0)]


class Job(msgspec.Struct, frozen=True):
    """A run. Its lines contain {out} unexpanded, so that a sweep can be continued after it was moved."""

    name: str
    lines: tuple[str, ...]
    sweep: str  # folder
    directory: str  # the base of relative names in the command lines

    @property
    def folder(self) -> Path:
        """Return the folder to which its commands write, {out}."""
        return Path(self.sweep, self.name)

    @property
    def record(self) -> Path:
        """Return the file that records the commands with a result."""
        return Path(self.sweep, STEPS, f"{self.name}.json")

    @property
    def log(self) -> Path:
        """Return the file with the output of its commands."""
        return self.record.with_suffix(".log")

    def words(self, line: str) -> list[str]:
        """Return the words of a command line; raises UserError if a shell could not parse it."""
        try:
            words = shlex.split(filled(line, {"out": shlex.quote(str(self.folder))}))
        except ValueError as error:
            raise UserError(f"{shown(line, 100)}: {error}") from error
        if len(words) < 2 or words[0] not in PROGRAMS:
            raise UserError(f"{shown(line, 100)}: a command line begins with {' or '.join(PROGRAMS)}")
        return words

    def done(self) -> list[Step]:
        """Return the recorded steps; raises UserError for a damaged record, or one of other commands."""
        if not self.record.exists():
            return []
        steps = schema.parse(storage.read_json(self.record, "record"), list[Step], f"record {self.record}: ")
        if tuple(step.line for step in steps) != self.lines[: len(steps)]:
            raise UserError(f"{self.sweep} was begun with other command lines; choose another --out")
        return steps


def jobs_of(recipe: Recipe, sweep: Path) -> dict[tuple[str, int], Job]:
    """Return the runs of a recipe by variant and seed."""
    made = {}
    for variant, seed in recipe.runs():
        values = {"seed": str(seed), "variant": shlex.quote(variant), "options": recipe.variants[variant]}
        lines = tuple(filled(line, values) for line in recipe.commands)
        made[variant, seed] = Job(f"{variant or 'seed'}-{seed}", lines, str(sweep), os.getcwd())
    return made


def work(threads: int, patience: float, job: Job) -> tuple[float, str]:
    """Run the remaining commands of a job until one fails.

    Return the CPU time [s] of those with a result, and a sentence on the failure, "" without one. threads: of
    each command. patience: how long [s] to wait for another process that runs the same job. Raises UserError
    if it still does, or if the folder of the sweep does not exist.
    """
    if not job.record.parent.is_dir():
        raise UserError(f"{os.uname().nodename} cannot access {job.sweep}; all machines must share it")
    with runs.locked(job.folder, job.log, patience) as log:
        steps, failure = job.done(), ""
        for line in job.lines[len(steps) :]:
            code, seconds = _run(_prepared(job, line, threads), job.directory, log, threads)
            if code not in DONE:
                printed = job.log.read_text("utf-8", "replace").strip().splitlines() or ["it printed nothing"]
                ended = f"{shown(line, 60)} ended with {code}: {shown(printed[-1], 150)}"
                failure = f"{job.name}: {ended} ({job.log})"
                break
            steps.append(Step(line, seconds))
            storage.write_json(job.record, msgspec.to_builtins(steps))
    return sum(step.cpu_seconds for step in steps), failure


def _prepared(job: Job, line: str, threads: int) -> list[str]:
    """Return the command to run now: a training that is resumed if it was begun, or an evaluation, whose
    unrecorded output below the run's folder is removed.
    """
    words = job.words(line)
    given = [word.removeprefix("--out=") for word in words if word.startswith("--out=")]
    given += [value for word, value in itertools.pairwise(words) if word == "--out"]
    out = storage.real(Path(job.directory, given[-1] if given else os.devnull))
    job.folder.mkdir(parents=True, exist_ok=True)
    if words[0] == "landing-train":
        resume = ["--resume"] if (out / "run.json").is_file() else []
        return [*words, *resume, "--threads", str(threads)]
    if storage.real(job.folder) in out.parents:
        shutil.rmtree(out, ignore_errors=True)
    return words


@contextlib.contextmanager
def ending_together() -> Iterator[None]:
    """Kill the commands that this process has under way if the context ends by an error or a signal."""
    global _under_way
    _under_way = set()
    try:
        yield
    except BaseException:
        left, _under_way = _under_way, None
        for process in left:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process, signal.SIGKILL)
        raise


def _run(words: list[str], directory: str, log: int, threads: int) -> tuple[int, float]:
    """Run a command to its end and return its exit code and CPU time [s], including its child processes."""
    # Unbuffered, so that the last line of the log is the last that was said; without the present folder among
    # those that are imported from, as the programs themselves are started.
    process = subprocess.Popen(
        [sys.executable, "-u", "-P", "-c", _BEGIN, PROGRAMS[words[0]], *words[1:]],
        cwd=directory if os.path.isdir(directory) else None,
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=subprocess.STDOUT,
        env=os.environ | dict.fromkeys(_THREADS, str(threads)),
        start_new_session=True,  # Ctrl-C reaches the sweep alone, which ends its commands
    )
    if _under_way is None:
        process.kill()
    else:
        _under_way.add(process.pid)
    _, status, used = os.wait4(process.pid, 0)
    if _under_way is not None:
        _under_way.discard(process.pid)
    process.returncode = os.waitstatus_to_exitcode(status)
    return process.returncode, used.ru_utime + used.ru_stime
