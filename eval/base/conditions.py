"""Policies under conditions: one loop that flies them, one way to count their flights."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import track

from inclined_landing.envs.flights import Flight
from inclined_landing.envs.shared.statistics import proportion, spread
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


def outcome(flights: Sequence[Flight]) -> dict[str, Any]:
    """Return the shares of landing flights with their intervals, and the time to the goal box [s].

    success: the goal box is reached in time; touched: a part met the platform before; strict: the first
    without the second.
    """
    n = len(flights)
    return {
        "strict": proportion(sum(f.strict for f in flights), n),
        "success": proportion(sum(f.success for f in flights), n),
        "touched": proportion(sum(f.touched for f in flights), n),
        "time_to_goal": spread([f.duration for f in flights if f.success]),
    }
