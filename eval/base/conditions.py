"""Policies under conditions: one loop that flies them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeVar

from rich.console import Console
from rich.progress import track

from inclined_landing.models.errors import UserError

K = TypeVar("K", bound=tuple[str, ...])
T = TypeVar("T")


def fly_all(work: Mapping[K, Callable[[], T]]) -> dict[K, T]:
    """Return what each flight of `work` returns, by the names of policy and condition, with a progress bar.

    Raises UserError, with these names, where the simulation diverges.
    """
    console = Console(stderr=True)
    found: dict[K, T] = {}
    for names in track(work, "flying", console=console, transient=True, disable=not console.is_terminal):
        try:
            found[names] = work[names]()
        except FloatingPointError as error:
            raise UserError(f"{', '.join(names)}: {error}") from error
    return found
