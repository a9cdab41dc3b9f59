"""`landing-train sweep`: the options, the runs side by side, the numbers; or the page of finished sweeps."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import shlex
import sys
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Annotated

import tyro
from msgspec import Meta
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from inclined_landing.envs.shared import cluster, measured
from inclined_landing.envs.shared import runs as run_folders
from inclined_landing.envs.shared.options import Flag, NewFolder
from inclined_landing.envs.shared.recipe import Recipe, read_recipe
from inclined_landing.envs.shared.tables import new_table, say, show_table
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown
from inclined_landing.train.evaluation import look_up
from inclined_landing.train.sweep import jobs as steps_of
from inclined_landing.train.sweep import record as recorded
from inclined_landing.train.sweep.children import Children
from inclined_landing.train.sweep.jobs import Job, Step
from inclined_landing.train.sweep.spread import PLACES, Key, Place, spread

FAILED = 1  # exit code


@dataclasses.dataclass(frozen=True)
class Sweep:
    """A recipe and where it is run."""

    recipe: Recipe
    command: str  # that runs it again
    folder: Path
    runs: dict[Key, Job]
    together: Job


def command(
    recipes: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RECIPE.toml")],
    /,
    *,
    out: NewFolder = None,
    jobs: Annotated[int, Meta(ge=0, le=1024)] = 0,
    on: Annotated[str, tyro.conf.arg(metavar="{local,ray}")] = "local",
    address: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT")] = None,
    record: Flag = False,
    allow: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="FILE.py:NAME")] = (),
    page: NewFolder = None,
    site: NewFolder = None,
) -> int:
    """Train and evaluate what a recipe describes, for every seed and variant; the numbers over the seeds.

    The same command again goes on: finished runs are kept, interrupted ones resumed. Exit code 1 says that a
    run failed. With --page or --site nothing is run: the sweeps named, one or more, are shown.

    Args:
        recipes: file, or the name of a shipped one; with --page folders of sweeps, or recipes with a result.
        out: folder of the sweep, with a run folder for each seed (default: runs/RECIPE).
        jobs: runs side by side (0: one for each core); the cores are shared out among them.
        on: on this machine, or on a Ray cluster whose machines all see the folder.
        address: of a running Ray cluster; without it, Ray is started on this machine.
        record: write the result into the recipe, as its table [result].
        allow: Python that the recipe may have imported, a task or a controller, file.py:NAME or module:NAME;
            repeat the option for more. A recipe that names any other is refused.
        page: new folder for one page of sweeps that are done: question, answer, numbers with their bars,
            figure and video of each, also as files.
        site: folder of a documentation: the same as beyond.md there, pictures in its folder beyond; what is
            there is replaced.
    """
    if page is not None or site is not None:
        if out is not None or record or allow or address is not None:
            raise UserError("--page and --site run nothing; leave out --out, --record, --allow and --address")
        if not recipes:
            raise UserError("name at least one sweep: its folder, or a recipe with a result")
        look_up("write_page")([shipped().get(name, Path(name)) for name in recipes], page, site)
        return 0
    if len(recipes) != 1:
        raise UserError(f"name one RECIPE.toml to run, not {len(recipes)}; --page shows several")
    (name,) = recipes
    path = shipped().get(name, Path(name))
    if not os.path.lexists(path):
        raise UserError(f"recipe {shown(path, 100)} does not exist (shipped ones: {', '.join(shipped())})")
    recipe = read_recipe(path)
    if on not in PLACES:
        raise UserError(f"--on must be {' or '.join(PLACES)}, not {shown(repr(on), 40)}")
    if on == "ray":
        cluster.check(address, "--on ray")
    elif address is not None:
        raise UserError("--address belongs to --on ray")
    if record:
        recorded.check(path)
    folder, here = Path("runs", recipe.name) if out is None else out, path.parent
    if on == "ray":
        folder, here = folder.absolute(), here.absolute()
    words = ["landing-train", "sweep", name, *(word for python in allow for word in ("--allow", python))]
    of_runs, of_all = steps_of.of_runs(recipe, folder, here), steps_of.of_all(recipe, folder, here)
    sweep = Sweep(recipe, shlex.join(words), folder, of_runs, of_all)
    _check(sweep, path, allow)
    try:
        (sweep.folder / steps_of.STEPS).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot create the folder {sweep.folder}: {storage.reason(error)}") from error
    with run_folders.held(sweep.folder):
        storage.write_bytes(sweep.folder / f"{recipe.name}.toml", storage.read_bytes(path, "recipe"))
        cores = len(os.sched_getaffinity(0))
        at_once = min(jobs or cores, len(sweep.runs))
        return _run(sweep, Place(on, address, at_once, max(1, cores // at_once)), path if record else None)


def shipped() -> dict[str, Path]:
    """Return the recipes that come with the package, by name."""
    folder = Path(str(resources.files("inclined_landing.train") / "recipes"))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def _check(sweep: Sweep, path: Path, allow: Sequence[str]) -> None:
    """Raise UserError for a sweep that would not begin; path: of its recipe."""
    from inclined_landing.train.sweep.check import check

    folder, recipe = sweep.folder, sweep.recipe
    storage.check_folder(folder)
    if not ((folder / steps_of.STEPS).is_dir() and (folder / f"{recipe.name}.toml").is_file()):
        run_folders.check_new_run(folder)
    for job in (*sweep.runs.values(), sweep.together):
        steps_of.read(job)
    try:
        check(recipe, sweep.runs, sweep.together, allow)
    except UserError as error:
        raise UserError(f"recipe {shown(path, 200)}: {error}") from error


def _run(sweep: Sweep, place: Place, path: Path | None) -> int:
    """Do all jobs, write and print the numbers, and return the exit code.

    path: of the recipe to write the result into. Raises UserError as soon as a run has ended that lacks a
    number; it would lack it in the others too.
    """
    children = Children()
    found: dict[Key, list[Step]] = {}
    columns = (TextColumn("runs"), BarColumn(), MofNCompleteColumn())
    try:
        screen = Console(stderr=True, markup=False, highlight=False)
        with (
            Progress(*columns, console=screen, transient=True, disable=not screen.is_terminal) as progress,
            contextlib.closing(spread(sweep.runs, place, children)) as done,
        ):
            bar = progress.add_task("", total=len(sweep.runs))
            for key, steps in done:
                job, found[key] = sweep.runs[key], steps
                wrong = steps_of.failure(job, steps)
                progress.update(bar, advance=1)
                cpu, wall = _seconds(steps)
                took = f"{'failed after ' if wrong else ''}{cpu:.1f} s of CPU in {wall:.1f} s"
                screen.print(f"{job.name}: {took}", soft_wrap=True)
                if wrong is None:
                    _check_numbers(sweep.recipe, job)
        failures = [steps_of.failure(job, found[key]) for key, job in sweep.runs.items()]
        if not any(failures) and sweep.together.commands:
            steps = steps_of.work(sweep.together, children, len(os.sched_getaffinity(0)))
            failures.append(steps_of.failure(sweep.together, steps))
    finally:
        children.stop()
    for text in filter(None, failures):
        print(f"landing-train sweep: {text}", file=sys.stderr)
    if any(failures):
        return FAILED
    result = _result(sweep, found)
    storage.write_json(sweep.folder / steps_of.RESULT, result.record())
    _show(sweep.recipe, result)
    if path is not None:
        recorded.write(path, result.record())
        say(f"The result is in {path}.")
    say(f"Everything about this sweep is in {sweep.folder}.")
    answer = f" {said}" if (said := result.answer(sweep.recipe.answer)) else ""
    say(f"{sweep.recipe.title}: {result.verdict}.{answer}")
    return 0


def _seconds(steps: list[Step]) -> tuple[float, float]:
    """Return the CPU and the wall time [s] that steps took."""
    return sum(step.cpu_seconds for step in steps), sum(step.wall_seconds for step in steps)


def _check_numbers(recipe: Recipe, job: Job) -> None:
    """Raise UserError where a run that has ended lacks a number of the recipe."""
    try:
        for number in recipe.numbers.values():
            measured.take(number, job.run)
    except UserError as error:
        raise UserError(f"{error}; the sweep stops: correct the recipe and give the same command") from error


def _result(sweep: Sweep, found: dict[Key, list[Step]]) -> measured.Result:
    """Return the numbers over the seeds, and what the runs took."""
    recipe, numbers = sweep.recipe, []
    for variant in recipe.variants:
        for number in recipe.numbers.values():
            taken = [measured.take(number, sweep.runs[variant, seed].run) for seed in recipe.seeds]
            numbers.append(measured.sum_up(variant, number, taken))
    done = [step for steps in found.values() for step in steps]
    loads = [step.load for step in done]
    versions = {
        name: " and ".join(dict.fromkeys(step.versions[name] for step in done if name in step.versions))
        for name in done[0].versions
    }
    return measured.Result(
        command=sweep.command,
        machine=f"{versions.pop('cpu', 'unknown')}, {versions.pop('cores', '?')} cores",
        versions=versions,
        load=(min(loads), max(loads)),
        measured=tuple(numbers),
        runs=tuple(_ran(sweep.runs[key], key, found[key]) for key in recipe.runs()),
    )


def _ran(job: Job, key: Key, steps: list[Step]) -> measured.Ran:
    """Return what a run took, and how it ended in its own words."""
    ended, (cpu, wall) = "evaluated", _seconds(steps)
    if steps[0].words[0] == "landing-train":
        metrics = storage.read_json(job.run / "metrics.json", "file")
        ended = shown(metrics.get("ended", "trained"), 200) if isinstance(metrics, dict) else "trained"
    return measured.Ran(variant=key[0], seed=key[1], cpu_seconds=cpu, wall_seconds=wall, ended=ended)


def _show(recipe: Recipe, result: measured.Result) -> None:
    """Print the numbers of every variant as a table."""
    heads = ("number", "median (range)", "mean [95 %]", "bar", "")
    count = len(recipe.seeds)
    table = new_table(f"{recipe.title}, {count} seed{'s' * (count > 1)}", "variant", *heads, left=2)
    for m in result.measured:
        bar, verdict = measured.bar_words(m.number), measured.VERDICTS[m.met]
        table.add_row(m.variant, m.number.title, m.words, m.interval_words, bar, verdict)
    table.caption = result.cost
    show_table(table)
