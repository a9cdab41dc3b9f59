"""`landing-eval landings`: a study from its file to a folder with results, figures and a page.

While it runs, the folder holds `study.json` (the study resolved, written first) and `parts/`, one
Parquet file for each finished chunk, each whole or not there. In the end the parts become
`results.parquet`, and the rest is made from it. A study that was interrupted, even by kill -9, goes
on with --resume and ends with the same bits.
"""

from __future__ import annotations

import dataclasses
import math
import shutil
from pathlib import Path
from typing import Annotated

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from inclined_landing.envs.shared import pool, runs
from inclined_landing.eval.base.options import Flag, Folder, VehicleFile
from inclined_landing.eval.landings import design, landing
from inclined_landing.eval.landings.parameters import known_parameters
from inclined_landing.eval.landings.study import MOST_LANDINGS, Study, read_study
from inclined_landing.models import schema, storage
from inclined_landing.models.attitude import STATE_SIZE
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import load_vehicle

RECORD, RESULTS, PARTS = "study.json", "results.parquet", "parts"
CHUNK = 500  # landings


def command(
    study: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="STUDY.toml")],
    /,
    out: Folder,
    vehicle: VehicleFile = None,
    engine: Annotated[str, tyro.conf.arg(metavar="{local,ray}")] = "local",
    address: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT")] = None,
    resume: Flag = False,
    chunk: tyro.conf.Suppress[int] = CHUNK,
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
    if resume and out.is_dir() and not all(map(storage.is_part, out.iterdir())):
        wanted, chunk = _resumed(wanted, out)
    else:
        runs.check_new_run(out)
        wanted = with_starts(wanted)
        begin(wanted, out, chunk)
    table = _read(out / RESULTS, range(wanted.total))
    if table is None:
        table = _simulated(wanted, out, engine, address, chunk)
    from inclined_landing.eval.landings import report

    try:
        summary = report.write(wanted, table, out)
    except OSError as error:
        raise UserError(f"cannot write {out}: {storage.reason(error)}") from error
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


def begin(study: Study, out: Path, chunk: int) -> None:
    """Make the folder with its record, or nothing."""
    record = {
        "study": dataclasses.asdict(study),
        "fingerprint": study.fingerprint(),
        "landings": study.total,
        "chunk": chunk,
        "versions": runs.versions(),
    }
    with storage.made(out / PARTS):
        storage.write_json(out / RECORD, record)


def _resumed(wanted: Study, out: Path) -> tuple[Study, int]:
    """Return the study to continue, start states included, and its chunk size."""
    if not (out / RECORD).is_file():
        raise UserError(f"{out} holds no study that could be resumed ({RECORD} is missing)")
    storage.check_file(out / RESULTS)
    storage.check_folder(out / PARTS)
    record = storage.read_json(out / RECORD, "record")
    try:
        begun, chunk, fingerprint = record["study"], record["chunk"], record["fingerprint"]
        starts = schema.parse(begun["starts"], tuple[tuple[float, ...], ...])
        sound = type(chunk) is int and 0 < chunk <= MOST_LANDINGS
        if not sound or any(len(row) != STATE_SIZE for row in starts):
            raise UserError("its chunk or its starts are none")
    except (UserError, KeyError, TypeError) as error:
        raise UserError(f"record {out / RECORD} is damaged: {error}") from error
    storage.remove_parts(out)
    wanted = dataclasses.replace(wanted, starts=starts)
    if wanted.fingerprint() != fingerprint:
        raise UserError(
            f"{out} was begun with another study, vehicle or engine version; choose another folder"
        )
    return wanted, chunk


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


def _simulated(study: Study, out: Path, engine: str, address: str | None, size: int) -> pa.Table:
    """Simulate the chunks that are missing, and return all landings, which are written too."""
    parts = [out / PARTS / f"{chunk:05d}.parquet" for chunk in range(math.ceil(study.total / size))]
    rows = [design.rows_of(study, size, chunk) for chunk in range(len(parts))]
    missing = [chunk for chunk, part in enumerate(parts) if _read(part, rows[chunk]) is None]
    shared = (study, size, 0 if engine == "local" else 1)
    columns = TextColumn("landing"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with storage.made(out / PARTS), Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        done = study.total - sum(len(rows[chunk]) for chunk in missing)
        task = bar.add_task("", total=study.total, completed=done)
        for chunk, table in pool.completed(design.run_chunk, shared, missing, engine, address):
            try:
                write(table, parts[chunk])
            except UserError as error:
                raise UserError(f"{error}; what is finished is kept, go on with --resume") from error
            bar.advance(task, table.num_rows)
    table = pa.concat_tables([_table(part) for part in parts]).combine_chunks()
    write(table, out / RESULTS)
    return table


def write(table: pa.Table, path: Path) -> None:
    """Write a table, with checksums that reading verifies."""
    file = pa.BufferOutputStream()
    pq.write_table(table, file, compression="zstd", write_page_checksum=True)
    storage.write_bytes(path, file.getvalue().to_pybytes())
