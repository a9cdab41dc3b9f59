"""The record of a run in its folder, which `--resume` reads: run.json, metadata and metrics."""

from __future__ import annotations

import csv
import dataclasses
import importlib
import io
import itertools
import json
import os
import shlex
import sys
from collections.abc import Callable, Container, Mapping, Sequence
from pathlib import Path
from typing import Any

from inclined_landing.envs.randomise import read_ranges
from inclined_landing.envs.shared import runs
from inclined_landing.envs.tasks import is_path
from inclined_landing.models.base import schema, storage
from inclined_landing.models.base.errors import UserError, not_installed, shown
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.vehicle import Vehicle
from inclined_landing.train.config import COPIED, ENDING, TrainConfig, flag_of

RECORD = "run.json"
REPORT = "after_training.report"  # the function of `eval` that writes the report on a run
# Options that may differ from those the run was begun with.
FREE = ("out", "max_seconds", "report", "threads")


class RunRecord(schema.Table, frozen=True):
    """The content of run.json."""

    config: dict
    command: str
    versions: dict


class NotNamed(UserError):
    """Code is never imported because a run folder names it."""


def new_record(config: TrainConfig) -> dict:
    """Return the content of run.json for a new run; raises UserError if its folder cannot be used."""
    folder = config.folder
    if os.path.isfile(folder / RECORD) and not os.path.isfile(folder / "metrics.json"):
        raise UserError(
            f"the run folder {folder} exists and is not empty; choose another name, or continue its run: "
            f"landing-train --resume --out {shlex.quote(str(folder))}"
        )
    runs.check_new_run(folder)
    return {
        "config": config.as_json(),
        "command": shlex.join(["landing-train", *sys.argv[1:]]),
        "versions": runs.versions(),
    }


def run_to_resume(config: TrainConfig, given: Container[str]) -> tuple[TrainConfig, dict]:
    """Return configuration and run.json of the run to resume.

    Time limits are those of `config`; so are the steps if it sets them, which then are the length of the run.
    Copied files are read from the run folder. given: the options given on the command line, even at their
    defaults.
    """
    folder = config.folder
    path = folder / RECORD
    if os.path.exists(folder) and not folder.is_dir():
        raise UserError(f"nothing to resume: {folder} is a file, not a run folder")
    if not os.path.lexists(path):
        raise UserError(f"nothing to resume: {folder} contains no {RECORD}")
    storage.check_folder(folder)
    record = storage.read_json(path, "run record", storage.LARGEST)
    try:
        found = schema.parse(record, RunRecord)
        for package, now in runs.packages().items():
            then = found.versions.get(package)
            if then != now:
                raise UserError(f"it was begun with {package} {then}, and {now} would continue differently")
        # A run of another version of this package: options that are gone play no part, and new ones have
        # their defaults.
        names = {field.name for field in dataclasses.fields(TrainConfig)}
        written = {name: value for name, value in found.config.items() if name in names}
        begun = TrainConfig(**written)
        _check_named(config, begun)
        copies: dict[str, Any] = {
            name: folder / file if name != "start_from" else str(folder / file)
            for name, file in COPIED.items()
            if getattr(begun, name) is not None and (folder / file).is_file()
        }
        resolved = dataclasses.replace(begun, **copies).resolved()
        recorded = resolved.as_json() | {name: written[name] for name in copies}
        if any(recorded[name] != value for name, value in written.items()):
            raise UserError("its configuration has been changed")
    except NotNamed:
        raise
    except UserError as error:
        raise cannot_continue(path, error) from error
    _check_same(config, begun, given)
    if config.steps not in (None, begun.steps):
        length: dict[str, Any] = dict.fromkeys(ENDING) | {"steps": config.steps}
        resolved = dataclasses.replace(resolved, **length).resolved()
    resumed = dataclasses.replace(resolved, out=folder, resume=False, max_seconds=config.max_seconds)
    return resumed, record | {"config": recorded | {name: getattr(resumed, name) for name in ENDING}}


def _check_named(config: TrainConfig, begun: TrainConfig) -> None:
    if is_path(begun.task) and begun.task != config.task:
        task, out = shlex.quote(shown(begun.task, 60)), shlex.quote(str(config.out))
        raise NotNamed(
            f"{config.out} trains the task {task}; if you trust that code, name it: "
            f"landing-train {task} --resume --out {out}"
        )


def _check_same(config: TrainConfig, begun: TrainConfig, given: Container[str]) -> None:
    """Raise UserError for options given with --resume that differ from those of the run."""
    for field in dataclasses.fields(TrainConfig):
        asked, recorded = getattr(config, field.name), getattr(begun, field.name)
        if field.name in (*FREE, "steps", "resume") or asked == recorded or str(asked) == str(recorded):
            continue
        if asked == field.default and field.name not in given:
            continue
        if field.name == "net_arch" and list(asked) == list(recorded):
            continue
        was = f"has {shown(recorded, 40)}" if recorded is not None else "has none"
        final = shlex.quote(str(config.folder / "final.zip"))
        raise UserError(
            f"--resume continues with the options of the run, which {was} for {flag_of(field.name)}, not "
            f"{shown(asked, 40)}; start a new run with another --out, for example with --from {final}"
        )


def cannot_continue(path: Path, error: UserError) -> UserError:
    """Return the error for a run.json that cannot be continued."""
    why = shown(error, 120)
    return UserError(f"run record {path} cannot be continued: {why}; start a new run with another --out")


def changed_entries(vehicle: Vehicle) -> dict:
    """Return the entries in which a vehicle differs from the shipped one, with JSON types only."""
    shipped, flown = dataclasses.asdict(load_vehicle()), dataclasses.asdict(vehicle)
    return json.loads(storage.to_json({k: value for k, value in flown.items() if value != shipped[k]}))


def ranges_of(config: TrainConfig) -> dict:
    """Return the ranges that differ from episode to episode, as stated in the file."""
    return {} if config.randomise is None else read_ranges(config.randomise).given


def as_csv(rows: Sequence[Mapping[str, float]]) -> str:
    """Return rows as CSV; a number that is missing or NaN is empty."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(dict.fromkeys(itertools.chain(*rows))), lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: "" if x != x else x for name, x in row.items()} for row in rows)
    return text.getvalue()


def look_up(name: str) -> Callable[..., Any]:
    """Return a function of `eval`, named `module.function`; raises UserError if a package is missing.

    Training imports nothing of `eval` otherwise, and runs without its packages.
    """
    module_name, _, function = name.rpartition(".")
    try:
        module = importlib.import_module(f"inclined_landing.eval.{module_name}")
    except ModuleNotFoundError as error:
        raise UserError(not_installed(error, "eval")) from error
    return getattr(module, function)
