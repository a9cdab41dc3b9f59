"""The jobs of a sweep side by side: in threads of this process, or on a Ray cluster."""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Generator, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed

from inclined_landing.envs.shared import cluster
from inclined_landing.models.errors import UserError
from inclined_landing.train.sweep import jobs
from inclined_landing.train.sweep.children import Children
from inclined_landing.train.sweep.jobs import Job, Step

PLACES = ("local", "ray")
# s for a lost machine to notice that it is lost, and to end its training: Ray takes one minute, a file server
# that holds its lock one or two.
_PATIENCE = 600.0

Key = tuple[str, int]


@dataclasses.dataclass(frozen=True)
class Place:
    """Where jobs are done: on this machine, or each on a core of a Ray cluster."""

    on: str  # one of PLACES
    address: str | None  # of a running cluster, see `cluster.connected`
    at_once: int  # jobs, on this machine
    threads: int  # of each


def spread(todo: Mapping[Key, Job], place: Place, children: Children) -> Generator[tuple[Key, list[Step]]]:
    """Yield the jobs with their steps, as they end; those first with which nothing is left to do.

    Raises UserError for a job that could not be carried out.
    """
    stands = {key: jobs.read(job) for key, job in todo.items()}
    left = [key for key, steps in stands.items() if not all(step.done for step in steps)]
    yield from ((key, steps) for key, steps in stands.items() if key not in left)
    if not left:
        return
    local = place.on == "local"
    executor = ThreadPoolExecutor(place.at_once) if local else cluster.connected(place.address)
    with executor as pool:
        try:
            flying = {
                pool.submit(jobs.work, todo[key], children, place.threads)
                if local
                else pool.submit(_on_worker, todo[key], os.getcwd()): key
                for key in left
            }
            for future in as_completed(flying):
                yield flying[future], future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            children.stop()
            raise


def _on_worker(job: Job, place: str) -> list[Step]:
    """Do a job on a machine of the cluster, perhaps again after the loss of the first machine.

    place: the folder from which the words of the recipe name files.
    """
    if not job.record.parent.is_dir():
        raise UserError(f"{os.uname().nodename} does not see {job.sweep}: all machines must share it")
    with contextlib.suppress(OSError):  # not shared; then the names have to be whole
        os.chdir(place)
    children = Children()
    try:
        return jobs.work(job, children, 1, _PATIENCE)
    finally:
        children.stop()
