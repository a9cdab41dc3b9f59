"""Run chunks of a study: in this process, or on a Ray cluster. Both give the same bits."""

from __future__ import annotations

import socket
from collections.abc import Iterator, Sequence

import pyarrow as pa

from inclined_landing.eval.landings.design import run_chunk
from inclined_landing.eval.landings.study import Study
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown

ENGINES = ("local", "ray")
_AHEAD = 2  # chunks in flight per core of the cluster
_PATIENCE = 5.0  # s to wait for a connection

Chunks = Iterator[tuple[int, pa.Table]]


def local(study: Study, chunks: Sequence[int], size: int) -> Chunks:
    """Chunk after chunk, each on all cores."""
    for chunk in chunks:
        yield chunk, run_chunk(study, chunk, size)


def on_ray(study: Study, chunks: Sequence[int], size: int, address: str | None) -> Chunks:
    """Chunks as Ray tasks of one core each, in the order in which they end.

    address: of a running cluster, on whose machines this package must be installed; None starts Ray
    on this machine.
    """
    ray = _import_ray()
    began = not ray.is_initialized()
    if began:
        try:
            ray.init(address=address, include_dashboard=False, log_to_driver=False, configure_logging=False)
        except (ConnectionError, ValueError, RuntimeError, OSError) as error:
            where = f"at {address}" if address else "on this machine"
            raise UserError(f"Ray cannot be reached {where}: {shown(error, 150)}") from error
    try:
        remote = ray.remote(num_cpus=1, max_retries=3)(run_chunk)
        shared, todo, flying = ray.put(study), list(chunks), {}
        limit = _AHEAD * max(1, int(ray.cluster_resources().get("CPU", 1)))
        while todo or flying:
            while todo and len(flying) < limit:
                chunk = todo.pop(0)
                flying[remote.remote(shared, chunk, size, 1)] = chunk
            (done,), _ = ray.wait(list(flying), num_returns=1)
            yield flying.pop(done), _result(ray, done)
    finally:
        if began:
            ray.shutdown()


def _result(ray, reference) -> pa.Table:
    try:
        return ray.get(reference)
    except ray.exceptions.RayError as error:
        last = (str(error).strip().splitlines() or ["no reason given"])[-1]
        raise UserError(f"a chunk of the study failed on Ray: {last}") from error


def _import_ray():
    try:
        import ray

        ray.init  # noqa: B018 (a folder named ray, such as Ray's own in /tmp, imports as a package)
    except (ImportError, AttributeError) as error:
        raise UserError(
            "--engine ray needs Ray, which is not installed; pip install 'inclined-landing[ray]'"
        ) from error
    return ray


def check(engine: str, address: str | None) -> None:
    """Raise UserError for an engine that is unknown or not installed, or an address without use."""
    if engine not in ENGINES:
        raise UserError(f"unknown engine {shown(repr(engine))}; known are {' and '.join(ENGINES)}")
    if engine == "local" and address is not None:
        raise UserError("--address belongs to --engine ray")
    if engine == "ray":
        _import_ray()
        if address is not None:
            _knock(address)


def _knock(address: str) -> None:
    """Raise UserError unless something listens at the address: Ray itself would try for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not (port.isascii() and port.isdigit() and len(port) <= 5) or not 0 < int(port) < 65536:
        raise UserError(f"--address must be HOST:PORT, not {shown(repr(address))}")
    try:
        socket.create_connection((host, int(port)), timeout=_PATIENCE).close()
    except (OSError, ValueError) as error:  # ValueError: no name of a host
        raise UserError(f"no Ray cluster answers at {shown(address)}: {storage.reason(error)}") from error


def chunks_of(engine: str, study: Study, chunks: Sequence[int], size: int, address: str | None) -> Chunks:
    """The chunks' tables as they are ready."""
    return on_ray(study, chunks, size, address) if engine == "ray" else local(study, chunks, size)
