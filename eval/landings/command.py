"""`landing-eval landings`: a study from its file to a folder with results, figures and a page.

While it runs, the folder holds `study.json` (the study resolved, written first) and `parts/`, one
Parquet file for each finished chunk, each whole or not there. In the end the parts become
`results.parquet`, and the rest is made from it. A study that was interrupted, even by kill -9, goes
on with --resume and ends with the same bits.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import shutil
import time
from pathlib import Path
from typing import Annotated

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from inclined_landing.envs.shared import pool, runs
from inclined_landing.eval.base import style
from inclined_landing.eval.base.options import Flag, Folder, VehicleFile
from inclined_landing.eval.landings import design, landing
from inclined_landing.eval.landings.study import MOST_LANDINGS, Study, known_parameters, read_study
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.parameters import load_vehicle

RECORD, RESULTS, PARTS = "study.json", "results.parquet", "parts"


def command(
    study: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="STUDY.toml")],
    /,
    out: Folder,
    vehicle: VehicleFile = None,
    engine: Annotated[str, tyro.conf.arg(metavar="{local,ray}")] = "local",
    address: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT")] = None,
    resume: Flag = False,
    chunk: tyro.conf.Suppress[int] = design.CHUNK,
) -> None:
    """Landing study: thousands of touchdowns over friction, speeds ..., each classified.

    Args:
        study: study file, or the name of a shipped study (paper_landing, steep_landing).
        out: new folder for results (Parquet), summary (JSON), figures (PNG) and page (HTML).
        vehicle: vehicle file (TOML), where it differs from the shipped one.
        engine: run in this process, or on a Ray cluster.
        address: of a running Ray cluster; without it, Ray is started on this machine.
        resume: go on with the study that was interrupted in this folder.
        chunk: landings that are simulated and written together.
    """
    pool.check(engine, address, "--engine")
    wanted = read_study(study, load_vehicle(vehicle))
    if resume and _begun(out):
        wanted, chunk = _resumed(wanted, out)
    else:
        runs.check_new_run(out)
        wanted = with_starts(wanted)
        _begin(wanted, out, chunk)
    count = math.ceil(design.total(wanted) / chunk)
    table = _read(out / RESULTS, range(design.total(wanted)))
    if table is None:
        todo = [k for k in range(count) if _read(_part(out, k), _rows(k, wanted, chunk)) is None]
        _simulate(wanted, out, engine, address, chunk, todo)
        table = _merge(out, count)
    from inclined_landing.eval.landings import report

    try:
        summary = report.write(wanted, table, out)
    except OSError as error:
        raise UserError(f"cannot write {out}: {str(error.strerror or error).lower()}") from error
    shutil.rmtree(out / PARTS, ignore_errors=True)
    report.show(summary, out)


def with_starts(study: Study) -> Study:
    """Return the study with the states at which its policy enters the goal box, from the frozen grid.

    Raises UserError when the policy is not for landing or never gets there.
    """
    if study.policy is None:
        return study
    from inclined_landing.envs import starts as landing_starts
    from inclined_landing.envs.flights import record_flights
    from inclined_landing.envs.policy import load_policy

    policy = load_policy(study.policy, "landing", vehicle=study.vehicle)
    inclination = known_parameters(study.vehicle)["inclination"].default
    if not math.isclose(policy.task.inclination, -inclination, rel_tol=1e-9):
        raise UserError(
            f"policy {study.policy} was trained for {math.degrees(policy.task.inclination):.1f} deg; "
            f"a study can start only from one for {-math.degrees(inclination):.1f} deg"
        )
    grid = landing_starts.clear(policy.task, landing_starts.grid())
    flights = record_flights(policy, "mujoco", landing_starts.at_rest(policy.task, grid))
    entries = [flight.state[-1] for flight in flights if flight.strict]
    if not entries:
        raise UserError(f"policy {study.policy} never reaches the goal box from the frozen grid")
    return dataclasses.replace(study, starts=tuple(tuple(map(float, row)) for row in entries))


def _begin(study: Study, out: Path, chunk: int) -> None:
    """Make the folder with its record, or nothing."""
    fresh = not out.exists()
    runs.new_run(out)
    record = {
        "study": study.to_dict(),
        "fingerprint": study.fingerprint(),
        "landings": design.total(study),
        "chunk": chunk,
        "versions": runs.versions(),
    }
    try:
        storage.write_json(out / RECORD, record)
        (out / PARTS).mkdir()
    except (UserError, OSError) as error:
        (out / RECORD).unlink(missing_ok=True)
        if fresh:
            with contextlib.suppress(OSError):
                out.rmdir()
        if isinstance(error, UserError):
            raise
        raise UserError(f"cannot write {out}: {str(error.strerror or error).lower()}") from error


def _begun(out: Path) -> bool:
    """Whether there is something to go on with: more than a kill left half-written."""
    return out.is_dir() and not all(map(storage.is_part, out.iterdir()))


def _resumed(wanted: Study, out: Path) -> tuple[Study, int]:
    """Return the study to continue, start states included, and its chunk size."""
    if not (out / RECORD).is_file():
        raise UserError(f"{out} holds no study that could be resumed ({RECORD} is missing)")
    storage.check_file(out / RESULTS)
    storage.check_folder(out / PARTS)
    record = storage.read_json(out / RECORD, "record")
    if not isinstance(record, dict):
        raise UserError(f"record {out / RECORD} is damaged: it holds no table")
    try:
        begun, chunk = Study.from_dict(record["study"]), record["chunk"]
        if type(chunk) is not int or not 0 < chunk <= MOST_LANDINGS:
            raise ValueError(f"its chunk is {chunk!r}")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise UserError(f"record {out / RECORD} is damaged: {shown(error)}") from error
    storage.remove_parts(out)
    wanted = dataclasses.replace(wanted, starts=begun.starts)
    if wanted.fingerprint() != record.get("fingerprint"):
        raise UserError(
            f"{out} was begun with another study, vehicle or engine version; choose another folder"
        )
    return wanted, chunk


def _part(out: Path, chunk: int) -> Path:
    return out / PARTS / f"{chunk:05d}.parquet"


def _table(path: Path) -> pa.Table:
    with path.open("rb") as file:  # pyarrow takes no file name that is not UTF-8
        return pq.read_table(file, page_checksum_verification=True)


def _read(path: Path, landings: range) -> pa.Table | None:
    """Return the table in `path` if it is there, undamaged, and holds these landings."""
    if path.exists() and not path.is_file():  # a pipe would never end
        return None
    try:
        table = _table(path)
        numbers = table["landing"].to_numpy()
    except (OSError, KeyError, pa.ArrowException):
        return None
    known = {"landing", "start", "outcome", *known_parameters(), *landing.RESULTS}
    return table if set(table.column_names) == known and np.array_equal(numbers, landings) else None


def _rows(chunk: int, study: Study, size: int) -> range:
    return range(chunk * size, min((chunk + 1) * size, design.total(study)))


def _simulate(study: Study, out: Path, engine: str, address, size: int, todo: list[int]) -> None:
    n = design.total(study)
    console = Console(stderr=True)
    columns = (
        *(TextColumn("landing"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()),
        TextColumn("{task.fields[rate]}"),
    )
    style.make_folder(out / PARTS)
    with Progress(*columns, console=console, transient=True) as progress:
        missing = sum(min(size, n - k * size) for k in todo)
        task = progress.add_task("", total=n, completed=n - missing, rate="")
        began, done = time.monotonic(), 0
        threads = 0 if engine == "local" else 1  # 0: all
        for chunk, table in pool.completed(design.run_chunk, (study, size, threads), todo, engine, address):
            try:
                _write(table, _part(out, chunk))
            except UserError as error:
                raise UserError(f"{error}; what is finished is kept, go on with --resume") from error
            done += table.num_rows
            rate = 60.0 * done / (time.monotonic() - began)
            progress.update(task, advance=table.num_rows, rate=f"{rate:.0f} per minute")


def _write(table: pa.Table, path: Path) -> None:
    file = pa.BufferOutputStream()
    pq.write_table(table, file, compression="zstd", write_page_checksum=True)
    storage.write_bytes(path, file.getvalue().to_pybytes())


def _merge(out: Path, count: int) -> pa.Table:
    table = pa.concat_tables([_table(_part(out, k)) for k in range(count)]).combine_chunks()
    _write(table, out / RESULTS)
    return table
