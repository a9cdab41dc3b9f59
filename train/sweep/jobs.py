"""One run of a sweep: its command lines, each executed exactly once.

SWEEP/steps/RUN.json records their exit codes, and RUN.log their output. A finished command is not repeated,
an interrupted training is resumed, and everything else is started again.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import runpy
import shlex
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterable, Iterator, Sequence
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
TOGETHER = "together"  # the job that is done once, after all runs
DONE = (0, 3)  # exit codes of a command with a result: 3 says that it is not the one that was hoped for
# Libraries that otherwise start a thread for each core.
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class Step(msgspec.Struct):
    """A command line of a job as recorded."""

    line: str
    code: int | None = None  # None: it has not ended
    begun: bool = False  # with this line
    cpu_seconds: Annotated[float, Meta(ge=0)] = 0.0  # of all attempts that ended

    @property
    def done(self) -> bool:
        """Return whether its result exists."""
        return self.code in DONE


class Job(msgspec.Struct, frozen=True):
    """A run, or the commands over all runs together.

    Its lines contain {out} and {sweep} unexpanded, so that a sweep can be continued after it was moved.
    """

    name: str
    lines: tuple[str, ...]
    sweep: str  # folder
    directory: str  # from which relative names in the command lines are read

    @property
    def folder(self) -> Path:
        """Return the folder to which its commands write, {out}."""
        return Path(self.sweep, self.name)

    @property
    def record(self) -> Path:
        """Return the file that records finished commands."""
        return Path(self.sweep, STEPS, f"{self.name}.json")

    @property
    def log(self) -> Path:
        """Return the file with the output of its commands."""
        return self.record.with_suffix(".log")

    def words(self, line: str) -> list[str]:
        """Return the words of a command line; raises UserError if a shell could not parse it."""
        places = {"out": str(self.folder), "sweep": self.sweep}
        try:
            words = shlex.split(filled(line, {name: shlex.quote(path) for name, path in places.items()}))
        except ValueError as error:
            raise UserError(f"{shown(line, 100)}: {error}") from error
        if len(words) < 2 or words[0] not in PROGRAMS:
            raise UserError(f"{shown(line, 100)}: a command line begins with {' or '.join(PROGRAMS)}")
        return words


def jobs_of(recipe: Recipe, sweep: Path) -> dict[tuple[str, int], Job]:
    """Return the runs of a recipe by variant and seed."""
    made = {}
    for variant, seed in recipe.runs():
        values = {"seed": str(seed), "variant": shlex.quote(variant), "options": recipe.variants[variant]}
        lines = tuple(filled(line, values) for line in recipe.commands)
        made[variant, seed] = Job(f"{variant or 'seed'}-{seed}", lines, str(sweep), os.getcwd())
    return made


def job_of_all(recipe: Recipe, sweep: Path, jobs: Iterable[Job]) -> Job:
    """Return the job that is run once for all runs together."""
    folders = {"runs": " ".join(f"{{sweep}}/{job.name}" for job in jobs)}
    return Job(TOGETHER, tuple(filled(line, folders) for line in recipe.together), str(sweep), os.getcwd())


def read(job: Job) -> list[Step]:
    """Return the recorded steps of a job, one for each command line.

    Steps with another command line, and all later steps, count as not done. Raises UserError for a
    damaged record.
    """
    recorded = _recorded(job)
    same = _in_common(recorded, job)
    return recorded[:same] + [Step(line) for line in job.lines[same:]]


def forget(job: Job) -> None:
    """Mark all steps of a job as not done, because the input of its commands is made again."""
    for step in _recorded(job):
        _remove_output(job, step)
    job.record.unlink(missing_ok=True)


def _recorded(job: Job) -> list[Step]:
    if not job.record.exists():
        return []
    return schema.parse(storage.read_json(job.record, "record"), list[Step], f"record {job.record}: ")


def _in_common(recorded: list[Step], job: Job) -> int:
    """Return the number of leading recorded steps whose command lines are those of the job."""
    pairs = zip(recorded, job.lines)
    return sum(1 for _ in itertools.takewhile(lambda pair: pair[0].line == pair[1], pairs))


def work(threads: int, patience: float, leash: int | None, job: Job) -> list[Step]:
    """Run the remaining steps of a job until a command fails, and return its steps.

    threads: threads of each command. patience: how long [s] to wait for another process that runs the same
    job. leash: see `leashed`; None makes one for this job. Raises UserError if another process still runs the
    job, or if the folder of the sweep does not exist.
    """
    if leash is None:
        with leashed() as leash:
            return work(threads, patience, leash, job)
    if not job.record.parent.is_dir():
        raise UserError(f"{os.uname().nodename} cannot access {job.sweep}; all machines must share it")
    with runs.locked(job.folder, job.log, patience) as log:
        recorded = _recorded(job)
        for step in recorded[_in_common(recorded, job) :]:  # of a recipe that was another one
            _remove_output(job, step)
        steps = read(job)
        for step in steps:
            if step.done:
                continue
            words = _prepared(job, step, threads)
            step.begun = True
            storage.write_json(job.record, msgspec.to_builtins(steps))
            step.code, seconds = _run(words, job.directory, log, threads, leash)
            step.cpu_seconds += seconds
            storage.write_json(job.record, msgspec.to_builtins(steps))
            if not step.done:
                break
    return steps


def failure(job: Job, steps: Sequence[Step]) -> str | None:
    """Return a sentence on the failure of a job; None if it did not fail."""
    wrong = next((step for step in steps if not step.done), None)
    if wrong is None:
        return None
    printed = job.log.read_text("utf-8", "replace").strip().splitlines() or ["it printed nothing"]
    return (
        f"{job.name}: {shown(wrong.line, 60)} ended with {wrong.code}: {shown(printed[-1], 150)} ({job.log})"
    )


@contextlib.contextmanager
def leashed() -> Iterator[int]:
    """Yield the read end of a pipe; commands that inherit it end with the context, or with this process."""
    leash, end = os.pipe()
    try:
        yield leash  # it stays open for what begins a command in the very end
    finally:
        os.close(end)


def _prepared(job: Job, step: Step, threads: int) -> list[str]:
    """Return the command to run now: a resumed one, or one whose old output has been removed."""
    words = job.words(step.line)
    training = words[0] == "landing-train"
    if training and step.begun and (_output(job, words) / "run.json").is_file():
        words = [*words, "--resume"]
    else:
        _remove_output(job, step)
    job.folder.mkdir(parents=True, exist_ok=True)
    return [*words, "--threads", str(threads)] if training else words


def _remove_output(job: Job, step: Step) -> None:
    """Remove the output of a command below the folder of its job, or of a training in that folder itself."""
    words = job.words(step.line)
    out, folder = storage.real(_output(job, words)), storage.real(job.folder)
    if out.is_relative_to(folder) and (words[0] == "landing-train" or out != folder):
        shutil.rmtree(out, ignore_errors=True)


def _output(job: Job, words: Sequence[str]) -> Path:
    """Return the folder in --out of a command."""
    given = [word.partition("=")[2] for word in words if word.startswith("--out=")]
    given += [value for word, value in itertools.pairwise(words) if word == "--out"]
    return Path(job.directory, given[-1] if given else os.devnull)


def _run(words: list[str], directory: str, log: int, threads: int, leash: int) -> tuple[int, float]:
    """Run a command to its end and return its exit code and CPU time [s], including its child processes."""
    # Unbuffered, so that the last line of the log is the last that was said; without the present folder among
    # those that are imported from, as the programs themselves are started.
    command = [sys.executable, "-u", "-P", "-m", __spec__.name, PROGRAMS[words[0]], *words[1:]]
    process = subprocess.Popen(
        command,
        cwd=directory if os.path.isdir(directory) else None,
        stdin=leash,
        stdout=log,
        stderr=subprocess.STDOUT,
        env=os.environ | dict.fromkeys(_THREADS, str(threads)),
        start_new_session=True,  # Ctrl-C reaches the sweep alone, which ends its commands
    )
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return process.returncode, used.ru_utime + used.ru_stime


def _main() -> None:
    """Run a module with arguments as `python -m` does, and end it with the pipe on standard input."""
    pipe = os.dup(0)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    threading.Thread(target=_end_with, args=(pipe,), daemon=True).start()
    module, *sys.argv[1:] = sys.argv[1:]
    runpy.run_module(module, run_name="__main__", alter_sys=True)


def _end_with(pipe: int) -> None:
    """Wait until a pipe has no writers, then kill this program and its child processes."""
    os.read(pipe, 1)
    os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    _main()
