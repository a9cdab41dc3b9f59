"""`landing-train sweep`: options, parallel runs and numbers."""

from __future__ import annotations

import contextlib
import io
import os
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import tyro
from msgspec import Meta

from inclined_landing.envs.shared import pool
from inclined_landing.envs.shared import runs as run_folders
from inclined_landing.envs.shared.command_line import parse
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.train.config import TrainConfig
from inclined_landing.train.sweep.jobs import STEPS, ending_together, jobs_of, work
from inclined_landing.train.sweep.recipe import Recipe, read_recipe, shipped
from inclined_landing.train.sweep.result import HEADS, Result, sum_up, take

FAILED = 1  # exit code
RESULT = "result.json"
# s for a lost machine to notice that it is lost, and to end its training: Ray takes one minute, a file server
# that holds its lock one or two.
_PATIENCE = 600.0


def command(
    recipe: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RECIPE.toml")],
    /,
    *,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    jobs: Annotated[int, Meta(ge=0, le=1024)] = 0,
    on: Annotated[str, tyro.conf.arg(metavar="{local,ray}")] = "local",
    address: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT")] = None,
) -> int:
    """Run the command lines of a recipe for every seed and variant, and summarise numbers over the seeds.

    Repeat the command to continue: finished commands are kept and interrupted trainings are resumed. The exit
    code is 1 if a run failed.

    Args:
        recipe: recipe file, or name of a shipped recipe. Like a script, it runs any command in it.
        out: folder of the sweep, with a run folder for each seed (default: runs/RECIPE).
        jobs: number of parallel runs (0: one for each core); the cores are divided among them.
        on: run on this machine, or on a Ray cluster whose machines all share the folder.
        address: address of a running Ray cluster (default: start Ray on this machine).
    """
    path = shipped().get(recipe, Path(recipe))
    if not os.path.lexists(path):
        raise UserError(f"recipe {shown(path, 100)} does not exist (shipped ones: {', '.join(shipped())})")
    read_one = read_recipe(path)
    pool.check(on, address, "--on")
    folder = Path("runs", path.stem) if out is None else out
    if on == "ray":
        folder = folder.absolute()
    sweep = Sweep(read_one, folder, f"landing-train sweep {shlex.quote(recipe)}")
    try:
        sweep.check()
    except UserError as error:
        raise UserError(f"recipe {shown(path, 200)}: {error}") from error
    with run_folders.owned(folder, STEPS), storage.made(folder / STEPS):
        return sweep.run(on, address, jobs)


class Sweep:
    """A recipe and the folder in which it is run."""

    def __init__(self, recipe: Recipe, folder: Path, command: str):
        self.recipe, self.folder, self.command = recipe, folder, command
        self.jobs = jobs_of(recipe, folder)

    def check(self) -> None:
        """Raise UserError for a command line that would be refused, with the options already checked."""
        from inclined_landing.train.record import REPORT, look_up  # here, for a quick --help

        for job in list(self.jobs.values())[: len(self.recipe.variants)]:  # other seeds differ in nothing
            for line in job.lines:
                program, *words = job.words(line)
                try:
                    with contextlib.redirect_stdout(io.StringIO()):  # --help
                        if program == "landing-train":
                            parse(TrainConfig, program, words).resolved()
                        else:
                            look_up(REPORT)  # the packages that evaluation imports when it runs
                            parse(look_up("cli.find")(words[0]), f"{program} {words[0]}", words[1:])
                except (UserError, KeyError, SystemExit) as error:
                    why = error if isinstance(error, UserError) else f"unknown command {shown(words[0], 40)}"
                    raise UserError(f"{shown(line, 100)}: {why}") from error

    def run(self, on: str, address: str | None, at_once: int) -> int:
        """Run all jobs, write and print the numbers, and return the exit code."""
        seconds = {job.name: sum(step.cpu_seconds for step in job.done()) for job in self.jobs.values()}
        todo = [job for job in self.jobs.values() if len(job.done()) < len(job.lines)]
        cores = len(os.sched_getaffinity(0))
        at_once = min(at_once or cores, max(1, len(todo)))
        shared = (max(1, cores // at_once), 0.0) if on == "local" else (1, _PATIENCE)
        failures = []
        with ending_together():
            done = pool.completed(work, shared, todo, on, address, at_once) if todo else ()
            for count, (job, (used, failure)) in enumerate(done, len(self.jobs) - len(todo) + 1):
                seconds[job.name] = used
                failures += [failure] if failure else []
                how = "failed" if failure else f"{used:.1f} s of CPU"
                print(f"{job.name}: {how} ({count} of {len(self.jobs)})", file=sys.stderr)
        for failure in failures:
            print(f"landing-train sweep: {failure}", file=sys.stderr)
        if failures:
            return FAILED
        self._show(list(seconds.values()))
        return 0

    def _show(self, cpu_seconds: Sequence[float]) -> None:
        """Write the result and print it as a table."""
        from inclined_landing.envs.shared.tables import new_table, say, show_table

        recipe, measured = self.recipe, []
        for variant in recipe.variants:
            folders = [self.jobs[variant, seed].folder for seed in recipe.seeds]
            for name, number in recipe.numbers.items():
                taken = [take(name, number, folder) for folder in folders]
                measured.append(sum_up(variant, name, number, taken))
        result = Result(
            command=self.command,
            versions=run_folders.versions(),
            cpu_seconds=tuple(cpu_seconds),
            measured=tuple(measured),
        )
        storage.write_json(self.folder / RESULT, msgspec.to_builtins(result))
        table = new_table(recipe.title, *HEADS, labels=2)
        for row in result.rows(recipe):
            table.add_row(*row)
        table.caption = result.cost()
        show_table(table)
        say(f"The results of this sweep are in {self.folder}.")
        say(f"{recipe.title}, {len(recipe.seeds)} seeds: {result.answer(recipe)}")
