"""One run of a sweep: its training and its evaluate commands, each done once.

SWEEP/steps/RUN.json says what was begun and how it ended, RUN.log beside it what the commands printed. A step
that is done is not done again, a training that was interrupted is resumed, what else was is begun again.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta, structs

from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.recipe import Recipe, filled, run_name
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown
from inclined_landing.train.sweep.children import Children

STEPS = "steps"  # folder of the records in that of the sweep
RESULT = "result.json"  # of a sweep that is finished, beside a copy of its recipe
TOGETHER = "together"  # the job that is not a run
# What a training writes into its run folder: the files with numbers, and the others (see `train.run`).
NUMBERS = ("metrics.json", "run.json")
OTHERS = (
    *("vehicle.toml", "randomise.toml", "learning.csv", "evaluations.csv", "tensorboard", "videos"),
    *("checkpoint.pt", "best.zip", "final.zip"),
)
Amount = Annotated[float, Meta(ge=0)]
DONE = (0, 3)  # exit codes of a command with a result: 3 says that it is not the one that was hoped for


@dataclasses.dataclass(frozen=True)
class Job:
    """A run, or what is made of all runs together.

    In its commands {run}, {sweep} and {here} still stand, so that a sweep that has been moved goes on.
    """

    name: str
    commands: tuple[tuple[str, ...], ...]  # landing-train ... or landing-eval ..., in their order
    run: Path
    sweep: Path
    here: Path  # the folder of the recipe
    taken: frozenset[str]  # what stands in its folder that is not its commands' to write

    @property
    def folder(self) -> Path:
        """Return where its commands write: the run folder, or that of the sweep."""
        return self.sweep if self.name == TOGETHER else self.run

    @property
    def record(self) -> Path:
        """Return the file that says what is done."""
        return self.sweep / STEPS / f"{self.name}.json"

    @property
    def log(self) -> Path:
        """Return the file of what its commands printed."""
        return self.record.with_suffix(".log")

    def filled(self, words: Sequence[str]) -> list[str]:
        """Return a command as it is run."""
        return filled(words, {"run": str(self.run), "sweep": str(self.sweep), "here": str(self.here)})

    def inside(self, out: Path) -> Path | None:
        """Return `out` from the folder of the job on; None where its commands may not write."""
        root = self.sweep.resolve() / self.folder.relative_to(self.sweep)
        try:
            below = out.resolve().relative_to(root)
        except (ValueError, OSError, RuntimeError):  # elsewhere, or links in a circle
            return None
        return below if below.parts and below.parts[0] not in self.taken else None


class Step(msgspec.Struct, forbid_unknown_fields=True):
    """A command of a job as the record has it."""

    words: Annotated[list[str], Meta(min_length=1)]
    attempts: Annotated[int, Meta(ge=0)] = 0
    code: int | None = None  # None: it has not ended
    cpu_seconds: Amount = 0.0  # of all attempts that ended
    wall_seconds: Amount = 0.0
    load: Amount = 0.0  # of the machine when it ended
    versions: dict[str, str] = {}  # and what it ran with, and on

    @property
    def done(self) -> bool:
        """Return whether its result is there."""
        return self.code in DONE


def of_runs(recipe: Recipe, sweep: Path, here: Path) -> dict[tuple[str, int], Job]:
    """Return the runs of a recipe by variant and seed."""
    made = {}
    for variant, seed in recipe.runs():
        names = {"run": "{run}", "sweep": "{sweep}", "here": "{here}", "seed": str(seed), "variant": variant}
        more, commands = recipe.variants[variant], []
        if recipe.train is not None:
            words = ("landing-train", *recipe.train, *more)
            commands.append((*words, "--seed", str(seed), "--out", "{run}", "--no-report"))
        own = () if recipe.train is not None else more
        commands += [("landing-eval", *filled((*words, *own), names)) for words in recipe.evaluate]
        name = run_name(variant, seed)
        taken = frozenset(() if recipe.train is None else (*NUMBERS, *OTHERS))
        made[variant, seed] = Job(name, tuple(commands), sweep / name, sweep, here, taken)
    return made


def of_all(recipe: Recipe, sweep: Path, here: Path) -> Job:
    """Return the job that is done once of all runs; {run} is the first one."""
    runs = [run_name(variant, seed) for variant, seed in recipe.runs()]
    names: dict[str, str | list[str]] = {name: f"{{{name}}}" for name in ("run", "sweep", "here")}
    names["runs"] = [f"{{sweep}}/{run}" for run in runs]
    commands = tuple(("landing-eval", *filled(words, names)) for words in recipe.together)
    taken = frozenset((*runs, STEPS, RESULT, f"{recipe.name}.toml"))
    return Job(TOGETHER, commands, sweep / runs[0], sweep, here, taken)


def read(job: Job) -> list[Step]:
    """Return the steps of a job as they stand, one for each command.

    Raises UserError for a damaged record, and for a training that was begun with other words.
    """
    found = _recorded(job.record)
    steps = []
    for k, words in enumerate(job.commands):
        before = found[k] if k < len(found) else None
        same = next((step for step in found if step.words == list(words)), None)
        if same is None and before is not None and words[0] == before.words[0] == "landing-train":
            raise UserError(
                f"{job.run} was begun as {shown(' '.join(before.words), 150)}, and the recipe says "
                "otherwise now; choose another --out"
            )
        attempts = 0 if before is None else before.attempts  # what was written has to make room
        steps.append(same or Step(list(words), attempts))
    return steps


def work(job: Job, children: Children, threads: int, patience: float = 0.0) -> list[Step]:
    """Do what is left of a job, until a command fails, and return its steps.

    patience: for how long [s] another process that does the same job is waited for. Raises UserError when it
    still does.
    """
    job.log.parent.mkdir(parents=True, exist_ok=True)
    with runs.held(job.run, job.log, patience) as log:
        steps = read(job)
        for step in steps:
            if step.done:
                continue
            words = _prepared(job, step, threads)
            step.attempts += 1
            _write(job, steps)
            ended = children.run(words, log, threads)
            step.code, step.load, step.versions = ended.code, ended.load, _versions()
            step.cpu_seconds += ended.cpu_seconds
            step.wall_seconds += ended.wall_seconds
            _write(job, steps)
            if not step.done:
                break
    return steps


def failure(job: Job, steps: Sequence[Step]) -> str | None:
    """Return what went wrong, in one sentence; None where nothing did."""
    wrong = next((step for step in steps if not step.done), None)
    if wrong is None:
        return None
    lines: list[str] = []
    with contextlib.suppress(OSError):
        lines = job.log.read_text("utf-8", "replace").strip().splitlines()
    said = shown(lines[-1], 150) if lines else "it printed nothing"
    return f"{job.name}: {wrong.words[0]} {wrong.words[1]} ended with {wrong.code}: {said} ({job.log})"


def _prepared(job: Job, step: Step, threads: int) -> list[str]:
    """Return the command of a step as it is run now: resumed, or with room made for what it writes."""
    words = job.filled(step.words)
    if step.words[0] == "landing-train":
        if not _keeps_checkpoints(job.run):
            shutil.rmtree(job.run, ignore_errors=True)
        resumed = ["--resume"] if (job.run / "run.json").is_file() else []
        return [*words, *resumed, "--threads", str(threads)]
    job.run.mkdir(parents=True, exist_ok=True)
    out = _out(words)
    if step.attempts and out is not None and job.inside(Path(out)) is not None:
        shutil.rmtree(out, ignore_errors=True)
    return words


def _out(words: Sequence[str]) -> str | None:
    """Return the last --out of a command."""
    found = [word.partition("=")[2] for word in words if word.startswith("--out=")]
    found += [value for word, value in itertools.pairwise(words) if word == "--out"]
    return found[-1] if found else None


def _keeps_checkpoints(run: Path) -> bool:
    """Return whether a training can be resumed: one with a replay buffer is begun again."""
    try:
        return storage.read_json(run / "run.json", "run record")["config"]["algorithm"] == "ppo"
    except (UserError, KeyError, TypeError):
        return True  # --resume says what is wrong


def _versions() -> dict[str, str]:
    return {name: str(text) for name, text in runs.versions().items() if text is not None}


def _write(job: Job, steps: Sequence[Step]) -> None:
    storage.write_json(job.record, [structs.asdict(step) for step in steps])


def _recorded(path: Path) -> list[Step]:
    """Return the steps of a record; raises UserError for a damaged one."""
    if not path.exists():
        return []
    try:
        return msgspec.convert(storage.read_json(path, "record", storage.LARGEST), list[Step])
    except msgspec.ValidationError as error:
        raise UserError(f"record {path} is damaged; choose another --out") from error
