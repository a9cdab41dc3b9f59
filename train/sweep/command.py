"""`landing-train sweep`: the options, the runs side by side, the numbers."""

from __future__ import annotations

import contextlib
import os
import shlex
import sys
from importlib import resources
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from inclined_landing.envs.shared import cluster, measured, runs
from inclined_landing.envs.shared.options import Flag, NewFolder, Range
from inclined_landing.envs.shared.recipe import Recipe, read_recipe
from inclined_landing.envs.shared.tables import new_table, printer
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown
from inclined_landing.train.sweep import jobs, record
from inclined_landing.train.sweep.children import Children
from inclined_landing.train.sweep.jobs import Job, Step
from inclined_landing.train.sweep.spread import PLACES, spread

FAILED = 1  # exit code


def command(
    recipe: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RECIPE.toml")],
    /,
    out: NewFolder = None,
    jobs: Annotated[int, Range(0, 1024)] = 0,
    on: Annotated[str, tyro.conf.arg(metavar="{local,ray}")] = "local",
    address: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT")] = None,
    record: Flag = False,
    allow: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="FILE.py:NAME")] = (),
) -> int:
    """Train and judge what a recipe says, for every seed and variant; the numbers over the seeds.

    The same command again goes on: finished runs are kept, interrupted ones resumed. Exit code 1 says that a
    run failed.

    Args:
        recipe: file, or the name of a shipped one.
        out: folder of the sweep, with a run folder for each seed (default: runs/RECIPE).
        jobs: runs side by side (0: one for each core); the cores are shared out among them.
        on: on this machine, or on a Ray cluster whose machines all see the folder.
        address: of a running Ray cluster; without it, Ray is started on this machine.
        record: write the result into the recipe, as its table [result].
        allow: Python that the recipe may have imported, a task or a controller, file.py:NAME or module:NAME;
            repeat the option for more. A recipe that names any other is refused.
    """
    return sweep(recipe, out, jobs, on, address, record, allow)


def shipped() -> dict[str, Path]:
    """The recipes that come with the package, by name."""
    folder = Path(str(resources.files("inclined_landing.train") / "recipes"))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def sweep(
    name: str,
    out: Path | None,
    count: int,
    on: str,
    address: str | None,
    recorded: bool,
    allowed: tuple[str, ...],
) -> int:
    """See `command`."""
    from inclined_landing.train.sweep.check import check

    path = shipped().get(name, Path(name))
    if not os.path.lexists(path):
        raise UserError(f"recipe {shown(path, 200)} does not exist (shipped ones: {', '.join(shipped())})")
    recipe = read_recipe(path)
    if on not in PLACES:
        raise UserError(f"--on must be {' or '.join(PLACES)}, not {shown(repr(on), 40)}")
    if on == "ray":
        cluster.check(address, "--on ray")
    elif address is not None:
        raise UserError("--address belongs to --on ray")
    if recorded:
        record.check(path)
    folder = Path("runs", recipe.name) if out is None else out
    folder = folder.absolute() if on == "ray" else folder
    here = path.parent.absolute() if on == "ray" else path.parent
    todo = jobs.of_runs(recipe, folder, here)
    last = jobs.of_all(recipe, folder, here)
    _check_folder(folder, recipe)
    for job in (*todo.values(), last):
        jobs.read(job)
    try:
        check(recipe, todo, last, allowed)
    except UserError as error:
        raise UserError(f"recipe {shown(path, 200)}: {error}") from error
    try:
        (folder / jobs.STEPS).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot create the folder {folder}: {storage.reason(error)}") from error
    with runs.held(folder):
        storage.write_bytes(folder / f"{recipe.name}.toml", storage.read_bytes(path, "recipe"))
        named = [word for python in allowed for word in ("--allow", python)]
        again = shlex.join(["landing-train", "sweep", name, *named])
        return _run(recipe, again, path if recorded else None, folder, todo, last, count, on, address)


def _check_folder(folder: Path, recipe: Recipe) -> None:
    """Raise UserError for a folder that is there and not of a sweep of this recipe."""
    storage.check_folder(folder)
    if not ((folder / jobs.STEPS).is_dir() and (folder / f"{recipe.name}.toml").is_file()):
        runs.check_new_run(folder)


def _run(
    recipe: Recipe,
    again: str,
    path: Path | None,
    folder: Path,
    todo: dict[tuple[str, int], Job],
    last: Job,
    count: int,
    on: str,
    address: str | None,
) -> int:
    """Do all jobs; write and print the numbers.

    again: the command. path: of the recipe to write the result into. Raises UserError as soon as a run has
    ended that lacks a number; it would lack it in the others too.
    """
    cores = len(os.sched_getaffinity(0))
    at_once = min(count or cores, len(todo))
    threads = max(1, cores // at_once)
    console = printer()
    children = Children()
    found: dict[tuple[str, int], list[Step]] = {}
    done = spread(todo, on, address, children, threads, at_once)
    columns = (TextColumn("runs"), BarColumn(), MofNCompleteColumn())
    try:
        screen = Console(stderr=True)
        with Progress(*columns, console=screen, transient=True, disable=not screen.is_terminal) as progress:
            bar = progress.add_task("", total=len(todo))
            with contextlib.closing(done):
                for key, steps in done:
                    found[key] = steps
                    progress.update(bar, advance=1)
                    _tell(console, todo[key], steps)
                    if jobs.failure(todo[key], steps) is None:
                        _check_numbers(recipe, todo[key])
        wrong = [text for key, job in todo.items() if (text := jobs.failure(job, found[key]))]
        if not wrong and last.commands:
            wrong += filter(None, [jobs.failure(last, jobs.work(last, children, cores))])
    finally:
        children.stop()
    for text in wrong:
        print(f"landing-train sweep: {text}", file=sys.stderr)
    if wrong:
        return FAILED
    result = _result(recipe, again, todo, found)
    storage.write_json(folder / jobs.RESULT, result.record())
    _show(console, recipe, result)
    if path is not None:
        record.write(path, result.record())
        console.print(f"the result is in {path}")
    console.print(f"everything about this sweep is in {folder}")
    return 0


def _check_numbers(recipe: Recipe, job: Job) -> None:
    """Raise UserError where a run that has ended lacks a number of the recipe."""
    try:
        for number in recipe.numbers.values():
            measured.take(number, job.run)
    except UserError as error:
        raise UserError(f"{error}; the sweep stops: correct the recipe and give the same command") from error


def _result(recipe: Recipe, again: str, todo: dict, found: dict) -> measured.Result:
    """The numbers over the seeds, and what the runs took. again: the command."""
    numbers = []
    for variant in recipe.variants:
        for number in recipe.numbers.values():
            taken = [measured.take(number, todo[variant, seed].run) for seed in recipe.seeds]
            numbers.append(measured.sum_up(variant, number, taken))
    done = [step for steps in found.values() for step in steps]
    loads = [step.load for step in done]
    versions = {
        name: " and ".join(dict.fromkeys(step.versions[name] for step in done if name in step.versions))
        for name in done[0].versions
    }
    return measured.Result(
        command=again,
        machine=f"{versions.pop('cpu', 'unknown')}, {versions.pop('cores', '?')} cores",
        versions=versions,
        load=(min(loads), max(loads)),
        measured=tuple(numbers),
        runs=tuple(
            measured.Ran(
                variant=variant,
                seed=seed,
                cpu_seconds=sum(step.cpu_seconds for step in found[variant, seed]),
                wall_seconds=sum(step.wall_seconds for step in found[variant, seed]),
                ended=_ended(todo[variant, seed], found[variant, seed]),
            )
            for variant, seed in recipe.runs()
        ),
    )


def _ended(job: Job, steps: list[Step]) -> str:
    """How a run ended, in its own words."""
    if steps[0].words[0] != "landing-train":
        return "evaluated"
    metrics = storage.read_json(job.run / "metrics.json", "file")
    return shown(metrics.get("ended", "trained"), 200) if isinstance(metrics, dict) else "trained"


def _tell(console: Console, job: Job, steps: list[Step]) -> None:
    wrong = jobs.failure(job, steps)
    cpu, wall = (sum(getattr(step, name) for step in steps) for name in ("cpu_seconds", "wall_seconds"))
    console.print(wrong or f"{job.name}: {cpu:.1f} s of CPU in {wall:.1f} s")


def _show(console: Console, recipe: Recipe, result: measured.Result) -> None:
    verdicts = {True: "met", False: "missed", None: ""}
    heads = ("number", "median (range)", "mean [95 %]", "bar", "")
    count = len(recipe.seeds)
    table = new_table(f"{recipe.title}, {count} seed{'s' * (count > 1)}", "variant", *heads, left=2)
    for m in result.measured:
        bar = measured.bar_words(m.number)
        table.add_row(m.variant, m.number.title, m.words, m.interval_words, bar, verdicts[m.met])
    table.caption = result.cost
    console.print(table)
