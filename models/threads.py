"""Calls in several threads of this process, for compiled functions that release the GIL."""

from __future__ import annotations

import functools
import itertools
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any


def shares(count: int, parts: int) -> list[tuple[int, int]]:
    """Return the first and one past the last of `count` numbers in each of `parts` parts of equal size.

    One part where `parts` is less than that.
    """
    parts = max(1, parts)
    return list(itertools.pairwise(count * k // parts for k in range(parts + 1)))


def in_threads(call: Callable[..., Any], parts: Sequence[Any]) -> list[Any]:
    """Return what `call` returns for each part: the first is done in this thread, the others in a pool."""
    others = [_pool().submit(call, part) for part in parts[1:]]
    return [call(parts[0]), *(other.result() for other in others)]


def two_at_a_time(call: Callable[..., Any], *arguments: Iterable[Any]) -> list[Any]:
    """Return what `call` returns for the first of all `arguments`, for the second, and so on."""
    return list(_pool(2).map(call, *arguments))


@functools.cache
def _pool(most: int | None = None) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(most, thread_name_prefix="vehicles")


os.register_at_fork(after_in_child=_pool.cache_clear)  # a forked process has none of its parent's threads
