"""A landing study: its landings distributed over the parameters, simulated in chunks, here or on Ray.

While it runs, the folder contains `study.json` (the complete study, written first) and `parts/` with one
Parquet file for each finished chunk, written atomically. At the end the parts are joined to
`results.parquet`, from which the other files are made. A study that was interrupted, even by kill -9,
continues with --resume and produces the same bits.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import os
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from scipy import stats

from inclined_landing.envs.shared import pool, runs
from inclined_landing.envs.shared.progress import stages
from inclined_landing.envs.tasks import hover_states
from inclined_landing.eval.landings.landing import OUTCOMES, RESULTS, Landings, simulate
from inclined_landing.eval.landings.parameters import known_parameters, touchdown_states
from inclined_landing.eval.landings.study import LandingStudy, Levels, Range
from inclined_landing.models.attitude import STATE_SIZE
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError

RECORD, TABLE, PARTS = "study.json", "results.parquet", "parts"
CHUNK = 500  # landings


def begin_study(wanted: LandingStudy, out: Path, resume: bool) -> LandingStudy:
    """Return the study with its start states, written to its folder or read from there."""
    if resume:
        storage.remove_parts(out)
        return _resumed(wanted, out)
    wanted = with_starts(wanted)
    record = {
        "study": dataclasses.asdict(wanted),
        "fingerprint": wanted.fingerprint(),
        "landings": wanted.total,
        "chunk": CHUNK,
        "versions": runs.versions(),
    }
    storage.write_json(out / RECORD, record)
    return wanted


def landings_of(study: LandingStudy, out: Path, engine: str, address: str | None) -> pa.Table:
    """Return all landings of a study; those that are not in the folder are simulated."""
    table = _read(out / TABLE, range(study.total))
    return _simulated(study, out, engine, address) if table is None else table


def with_starts(study: LandingStudy) -> LandingStudy:
    """Return the study with the states at which its policy enters the goal box, from the frozen grid.

    Raises UserError if the policy is not for landing or never reaches the box.
    """
    if study.policy is None:
        return study
    from inclined_landing.envs.flights import record_flights
    from inclined_landing.envs.policy import load_policy
    from inclined_landing.envs.tasks import frozen

    policy = load_policy(study.policy, "landing", vehicle=study.vehicle)
    inclination = known_parameters(study.vehicle)["inclination"].default
    if not math.isclose(policy.task.inclination, -inclination, rel_tol=1e-9):
        raise UserError(
            f"policy {study.policy} was trained for {math.degrees(policy.task.inclination):.1f} deg; "
            f"a study can start only from one for {-math.degrees(inclination):.1f} deg"
        )
    grid = frozen.clear(policy.task, frozen.grid())
    flights = record_flights(policy, "mujoco", hover_states(grid, policy.task.vehicle))
    entries = [flight.state[-1] for flight in flights if flight.strict]
    if not entries:
        raise UserError(f"policy {study.policy} never reaches the goal box from the frozen grid")
    return dataclasses.replace(study, starts=tuple(tuple(map(float, row)) for row in entries))


def _resumed(wanted: LandingStudy, out: Path) -> LandingStudy:
    """Return the study to continue, including its start states."""
    record = storage.read_json(out / RECORD, "record")
    try:
        starts, fingerprint = record["study"]["starts"], record["fingerprint"]
        wanted = dataclasses.replace(wanted, starts=tuple(tuple(map(float, row)) for row in starts))
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(f"record {out / RECORD} is damaged: {error}") from error
    if wanted.fingerprint() != fingerprint:
        raise UserError(
            f"{out} was begun with a different study, vehicle or engine version; choose another folder"
        )
    return wanted


def _read(path: Path, landings: range) -> pa.Table | None:
    """Return the table in `path` if it exists, is undamaged and contains these landings."""
    try:
        with path.open("rb") as file:  # pyarrow takes no file name that is not UTF-8
            table = pq.read_table(file, page_checksum_verification=True)
        numbers = table["landing"].to_numpy()
    except (OSError, KeyError, pa.ArrowException):
        return None
    known = {"landing", "start", "outcome", *known_parameters(), *RESULTS}
    return table if set(table.column_names) == known and np.array_equal(numbers, landings) else None


def _simulated(study: LandingStudy, out: Path, engine: str, address: str | None) -> pa.Table:
    """Simulate the missing chunks, and write and return all landings."""
    chunks = [range(k, min(k + CHUNK, study.total)) for k in range(0, study.total, CHUNK)]
    parts = {rows: out / PARTS / f"{k:05d}.parquet" for k, rows in enumerate(chunks)}
    missing = [rows for rows, part in parts.items() if _read(part, rows) is None]
    done, cores = study.total - sum(map(len, missing)), len(os.sched_getaffinity(0))
    with storage.made(out / PARTS), stages(study.total, "landings", done) as tick:
        for rows, table in pool.completed(run_chunk, (study,), missing, engine, address, cores):
            try:
                write(table, parts[rows])
            except UserError as error:
                raise UserError(f"{error}; finished chunks are kept, continue with --resume") from error
            done += table.num_rows
            tick(done=done)
    table = pa.concat_tables([_read(part, rows) for rows, part in parts.items()]).combine_chunks()
    write(table, out / TABLE)
    return table


def run_chunk(study: LandingStudy, rows: range) -> pa.Table:
    """Return the landings with these numbers, simulated by one thread.

    The result depends only on the arguments, and a landing does not depend on other rows.
    """
    values, start = design(study)
    p = {name: column[rows].copy() for name, column in values.items()}
    if study.starts:
        states = np.array(study.starts)[start[rows]].reshape(-1, STATE_SIZE)
    else:
        states = touchdown_states(p, study.vehicle)
    landings = simulate(
        states, p, from_start=bool(study.starts), duration=study.duration, timestep=study.timestep,
        vehicle=study.vehicle, threads=1,
    )  # fmt: skip
    return _table(study, rows, p, start[rows], landings)


def _table(study: LandingStudy, rows: range, p: dict, start: np.ndarray, landings: Landings) -> pa.Table:
    """Return the columns landing, start, parameters, outcome, RESULTS [SI]; units are in the metadata."""
    numbers, outcome = pa.array(rows, pa.int64()), [OUTCOMES[k] for k in landings.outcome]
    columns = {
        "landing": (numbers, {"meaning": "number in the study"}),
        "start": (pa.array(start, pa.int32()), {"meaning": "index of the start state"}),
    }
    for name, entry in known_parameters(study.vehicle).items():
        values = pa.array(p[name], pa.float64(), from_pandas=True)
        columns[name] = (values, {"unit": entry.kind, "meaning": entry.label})
    columns["outcome"] = (pa.array(outcome, pa.string()), {"meaning": ", ".join(OUTCOMES)})
    for (name, meaning), column in zip(RESULTS.items(), landings.values.T):
        columns[name] = (pa.array(column, pa.float64(), from_pandas=True), {"meaning": meaning})
    fields = [pa.field(name, array.type, metadata=meta) for name, (array, meta) in columns.items()]
    return pa.table([array for array, _ in columns.values()], schema=pa.schema(fields))


@functools.lru_cache(maxsize=2)
def design(study: LandingStudy) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the parameters by name, arrays (n,) [SI], and the index (n,) of the start state.

    Parameters that are not in the study have their defaults. A factorial iterates over its levels in the
    file's order, the last parameter fastest, with every start state at each level; a Latin hypercube draws
    the start states too.
    """
    n = study.total
    values = {name: np.full(n, p.default) for name, p in known_parameters(study.vehicle).items()}
    starts = max(1, len(study.starts))
    if study.sampling == "factorial":
        axes = [np.array(p.values) for p in study.parameters if isinstance(p, Levels)]
        grid = np.meshgrid(*axes, np.arange(starts), indexing="ij")
        for p, column in zip(study.parameters, grid):
            values[p.name] = column.ravel()
        return values, grid[-1].ravel().astype(np.int64)
    sampler = stats.qmc.LatinHypercube(len(study.parameters) + 1, rng=np.random.default_rng(study.seed))
    drawn = sampler.random(n)
    for p, u in zip(study.parameters, drawn.T):
        values[p.name] = _quantile(p, u)
    return values, np.minimum((drawn[:, -1] * starts).astype(np.int64), starts - 1)


def _quantile(p: Levels | Range, u: np.ndarray) -> np.ndarray:
    """Return the quantiles of a parameter at probabilities u (n,)."""
    # Inverse distribution: levels equally likely; truncated normal; uniform.
    if isinstance(p, Levels):
        return np.array(p.values)[np.minimum((u * len(p.values)).astype(int), len(p.values) - 1)]
    if p.distribution == "normal":
        low, high = (p.low - p.mean) / p.deviation, (p.high - p.mean) / p.deviation
        return np.clip(stats.truncnorm.ppf(u, low, high, p.mean, p.deviation), p.low, p.high)
    return p.low + (p.high - p.low) * u


def write(table: pa.Table, path: Path) -> None:
    """Write a table, with checksums that reading verifies."""
    file = pa.BufferOutputStream()
    pq.write_table(table, file, compression="zstd", write_page_checksum=True)
    storage.write_bytes(path, file.getvalue().to_pybytes())
