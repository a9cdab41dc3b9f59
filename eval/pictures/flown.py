"""Flights for pictures: from the points of --start, with a line on stderr about each."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from inclined_landing.envs.flights import Flight, record_flights
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.tasks import Task
from inclined_landing.models.errors import UserError


def points(starts: Sequence[str], task: Task) -> list[tuple[float, ...]]:
    """Where to fly from [m]: what --start says, or the task's own first point."""
    try:
        return [task.parse_start(text) for text in starts] or [task.film_starts[0]]
    except UserError as error:
        raise UserError(f"--{error}") from None


def fly(policy: Policy, points: Sequence[tuple[float, ...]], plant: str, steps: int | None = None):
    """Flights from hover at points of the task's start axes [m], at most `steps` control steps long."""
    return record_flights(policy, plant, policy.task.states_at(points), steps=steps)


def report(flight: Flight, name: str) -> None:
    """One line on stderr about a flight."""
    task = flight.task
    print(f"{name}: from {task.start_words(flight.state[0])}: {task.flight_words(flight)}", file=sys.stderr)
