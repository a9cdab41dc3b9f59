"""Calls in several threads of this process, for compiled functions that release the GIL."""

from __future__ import annotations

import functools
import itertools
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any


def shares(count: int, parts: int) -> list[tuple[int, int]]:
    """Return the first index and the end index of each of `parts` equal parts of `count` numbers.

    If `parts` is less than 1, there is one part.
    """
    parts = max(1, parts)
    return list(itertools.pairwise(count * k // parts for k in range(parts + 1)))


def in_threads(call: Callable[..., Any], parts: Sequence[Any]) -> list[Any]:
    """Return the results of `call` for each part; the first runs in this thread, the others in a pool."""
    others = [_pool().submit(call, part) for part in parts[1:]]
    return [call(parts[0]), *(other.result() for other in others)]


def two_at_a_time(call: Callable[..., Any], *arguments: Iterable[Any]) -> list[Any]:
    """Return the results of `call` for the first elements of all `arguments`, the second ones, and so on."""
    return list(_pool(2).map(call, *arguments))


@functools.cache
def _pool(most: int | None = None) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(most, thread_name_prefix="vehicles")


os.register_at_fork(after_in_child=_pool.cache_clear)  # a forked process has none of its parent's threads
