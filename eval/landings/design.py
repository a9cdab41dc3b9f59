"""The distribution of a study's landings over its parameters, and the simulation of chunks of them."""

from __future__ import annotations

import functools

import numpy as np
import pyarrow as pa
from scipy import stats

from inclined_landing.eval.landings.landing import OUTCOMES, RESULTS, Landings, simulate
from inclined_landing.eval.landings.parameters import known_parameters, touchdown_states
from inclined_landing.eval.landings.study import LandingStudy, Levels, Range
from inclined_landing.models.attitude import STATE_SIZE


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
