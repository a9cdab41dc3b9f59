"""What the commands of a sweep would do, checked before the first of them runs.

A recipe is data: its words are parsed, and nothing that they name is imported unless the person who runs the
sweep names it too. They write into the folder of the sweep alone, and its numbers must be of files that they
write. Of every variant the runs of the smallest and the largest seed are looked at: others differ in nothing.
"""

from __future__ import annotations

import contextlib
import dataclasses
import inspect
import io
import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from inclined_landing.envs.shared.command_line import bound, parse
from inclined_landing.envs.shared.recipe import Number, Recipe
from inclined_landing.envs.tasks.own import would_import
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown
from inclined_landing.train.config import TrainConfig
from inclined_landing.train.curriculum import make_curriculum
from inclined_landing.train.evaluation import look_up
from inclined_landing.train.sweep import jobs
from inclined_landing.train.sweep.jobs import Job

Runs = Mapping[tuple[str, int], Job]


@dataclasses.dataclass(frozen=True)
class _Call:
    """A command of a job and what its options would be."""

    job: Job
    words: tuple[str, ...]  # as the recipe has them
    given: dict[str, Any]  # options by name
    config: TrainConfig | None  # of a training

    @property
    def out(self) -> Path | None:
        """Return what it writes, from the folder of its job on; None: nothing, or the run folder."""
        out = self.given.get("out")
        return None if out is None or self.config is not None else self.job.inside(out)


def check(recipe: Recipe, runs: Runs, last: Job, allowed: Sequence[str] = ()) -> None:
    """Raise UserError for a command that would not begin, or would do what no recipe may.

    runs, last: the jobs of the recipe; allowed: Python that its words may have imported, `file.py:NAME`.
    """
    ends = sorted({min(recipe.seeds), max(recipe.seeds)})
    looked_at = [runs[variant, seed] for seed in ends for variant in recipe.variants]
    calls = [call for job in (*looked_at, last) for call in _calls(job)]
    _check_python(calls, allowed)
    for job in runs.values():
        _check_place(job)
    for call in calls:
        _check_out(call)
        if getattr(call.given.get("in_window"), "window", False):
            raise UserError(f"{_shown(call.words)}: a recipe opens no window")
    for job in looked_at:
        written = [call.out for call in calls if call.job is job and call.out is not None]
        for number in recipe.numbers.values():
            _check_number(number, job, written, recipe.train is not None)
    _check_pictures(recipe, calls, looked_at[0], last)
    for words, config in {call.words: call.config for call in calls}.items():
        if config is not None:
            with _saying(words):
                _check_training(config)


@contextlib.contextmanager
def _saying(words: Sequence[str]) -> Iterator[None]:
    """Let a UserError say which command it is about."""
    try:
        yield
    except (UserError, SystemExit) as error:
        said = error if isinstance(error, UserError) else "--help does no work"
        raise UserError(f"{_shown(words)}: {said}") from error


def _shown(words: Sequence[str]) -> str:
    return shown(shlex.join(words), 100)


def _calls(job: Job) -> Iterator[_Call]:
    """Yield the commands of a job, parsed: options have their types and ranges; nothing is imported."""
    for words in job.commands:
        program, *rest = job.filled(words)
        with _saying(words), contextlib.redirect_stdout(io.StringIO()):  # --help
            if program == "landing-train":
                config = parse(TrainConfig, program, rest)
                call = _Call(job, words, vars(config), config)
            else:
                name, *others = look_up("renamed")(rest)
                later = parse(bound(look_up("find")(name)), f"{program} {name}", others)
                given = inspect.signature(later.func).bind(*later.args, **later.keywords).arguments
                call = _Call(job, words, given, None)
        yield call


def _check_python(calls: Sequence[_Call], allowed: Sequence[str]) -> None:
    """Raise UserError for Python that would be imported and nobody has named, or that is named in vain."""
    for name in allowed:
        if not would_import(name):
            raise UserError(f"--allow takes module:NAME or FILE.py:NAME, not {shown(name, 60)}")
    named = {_python(name): name for name in allowed}
    found = {text: call for call in calls for text in _texts(call.given) if would_import(text)}
    for text, call in found.items():
        if _python(text) not in named:
            raise UserError(
                f"{_shown(call.words)} would run Python, which a recipe alone may not; if you trust that "
                f"code, name it: --allow {shlex.quote(shown(text, 100))}"
            )
    for python in set(named) - set(map(_python, found)):
        raise UserError(f"--allow {shown(named[python], 60)}: the recipe names no such Python")


def _python(text: str) -> tuple[str, str]:
    """Return where Python is, and its name in there: a file may be written in several ways."""
    source, _, name = text.rpartition(":")
    return (str(storage.real(source)) if source.endswith(".py") else source), name


def _texts(value: Any) -> Iterator[str]:
    """Yield all texts in the options of a command."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for item in value.values():
            yield from _texts(item)
    elif isinstance(value, (list, tuple)):
        for item in value:
            yield from _texts(item)
    elif dataclasses.is_dataclass(value):
        yield from _texts(vars(value))


def _check_place(job: Job) -> None:
    """Raise UserError where the folder of a run, or that of the records, leads out of the sweep."""
    for folder in (job.run, job.sweep / jobs.STEPS):
        if (real := storage.real(folder)) != storage.real(job.sweep) / folder.name:
            raise UserError(f"{folder} leads to {real}, out of the sweep")


def _check_out(call: _Call) -> None:
    out = call.given.get("out")
    if out is None or call.config is not None or call.out is not None:
        return
    own = "{sweep}, beside its runs" if call.job.name == jobs.TOGETHER else "{run}, beside what is there"
    raise UserError(f"{_shown(call.words)}: --out must be a new name in {own}, not {shown(out, 100)}")


def _check_number(number: Number, job: Job, written: Sequence[Path], trained: bool) -> None:
    """Raise UserError for a number of a file that a run will not have."""
    files = jobs.NUMBERS if trained else ()
    if number.file in files or any(Path(number.file).is_relative_to(out) for out in written):
        return
    has = [*files, *(f"what is in {out}" for out in dict.fromkeys(written))]
    raise UserError(
        f"number {number.name}: a run will have no {shown(number.file, 60)}; it has "
        f"{shown(' and '.join(has), 120) or 'no file, as no command has --out'}"
    )


def _check_pictures(recipe: Recipe, calls: Sequence[_Call], first: Job, last: Job) -> None:
    """Raise UserError for a figure or a video that no command makes."""
    for what, text in (("figure", recipe.figure), ("video", recipe.video)):
        if text is None:
            continue
        place, _, rest = text.partition("/")
        job = first if place == "{run}" else last
        written = [call.out for call in calls if call.job is job and call.out is not None]
        if not any(Path(rest).is_relative_to(out) for out in written):
            raise UserError(f"{what}: no command of the recipe writes {shown(text, 60)}")


def _check_training(config: TrainConfig) -> None:
    """Raise UserError for a training that would not begin; imports its task."""
    config = config.resolved()
    make_curriculum(config.curriculum, config.task, config.gamma, config.without or "")
