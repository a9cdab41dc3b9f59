"""Run chunks of a study: in this process, or on a Ray cluster. Both give the same bits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import as_completed

import pyarrow as pa

from inclined_landing.envs.shared import cluster
from inclined_landing.eval.landings.design import run_chunk
from inclined_landing.eval.landings.study import Study
from inclined_landing.models.errors import UserError, shown

ENGINES = ("local", "ray")

Chunks = Iterator[tuple[int, pa.Table]]


def local(study: Study, chunks: Sequence[int], size: int) -> Chunks:
    """Yield chunk after chunk, each on all cores."""
    for chunk in chunks:
        yield chunk, run_chunk(study, chunk, size)


def on_ray(study: Study, chunks: Sequence[int], size: int, address: str | None) -> Chunks:
    """Yield chunks, each on one core of a Ray cluster, as they finish.

    address: of a running cluster, on whose machines this package must be installed; None starts Ray
    on this machine.
    """
    with cluster.connected(address) as ray:
        shared = ray.share(study)
        flying = {ray.submit(run_chunk, shared, chunk, size, 1): chunk for chunk in chunks}
        for future in as_completed(flying):
            yield flying.pop(future), future.result()


def check(engine: str, address: str | None) -> None:
    """Raise UserError for an engine that is unknown or not installed, or an address without use."""
    if engine not in ENGINES:
        raise UserError(f"unknown engine {shown(repr(engine))}; known are {' and '.join(ENGINES)}")
    if engine == "local" and address is not None:
        raise UserError("--address belongs to --engine ray")
    if engine == "ray":
        cluster.check(address, "--engine ray")


def chunks_of(engine: str, study: Study, chunks: Sequence[int], size: int, address: str | None) -> Chunks:
    """Return the chunks' tables as they finish."""
    return on_ray(study, chunks, size, address) if engine == "ray" else local(study, chunks, size)
