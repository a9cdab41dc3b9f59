"""Flights for pictures: from the points of --start, with a line on stderr about each."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated

import numpy as np
import tyro

from inclined_landing.envs.flights import Flight, record_flights
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.tasks import Start, Task
from inclined_landing.eval.pictures.to_rest import Landing, to_rest
from inclined_landing.models.errors import UserError, shown

_UNTIL = ("rest", "goal")
Until = Annotated[str, tyro.conf.arg(metavar="{rest,goal}")]


def points(starts: Sequence[str], task: Task) -> list[tuple[float, ...]]:
    """Where to fly from [m]: what --start says, or the task's own first point."""
    try:
        return [task.parse_start(text) for text in starts] or [task.film_starts[0]]
    except UserError as error:
        raise UserError(f"--{error}") from None


def fly(policy: Policy, points: Sequence[tuple[float, ...]], plant: str, steps: int | None = None):
    """Flights from hover at points of the task's start axes [m], at most `steps` control steps long."""
    return record_flights(policy, plant, policy.task.states_at(points), steps=steps)


def begin(task: Task, where: Sequence[tuple[float, ...]], drawn: int, seed: int) -> Start:
    """Starts from hover at points of the task's axes [m], or so many drawn ones, slopes included."""
    if drawn:
        return task.sample(np.random.default_rng(seed), drawn)
    return task.start(task.states_at(where))


def check_drawn(drawn: int, starts: Sequence[str]) -> None:
    """Raise UserError for starts that are given and drawn."""
    if drawn and starts:
        raise UserError("give either --start or --drawn")


def check_until(until: str) -> None:
    """Raise UserError for an --until that is not known."""
    if until not in _UNTIL:
        raise UserError(f"--until is {' or '.join(_UNTIL)}, not {shown(until)}")


def finish(flights: Sequence[Flight], until: str) -> list[Flight]:
    """The flights as --until asks: "rest" or "goal"."""
    return [to_rest(flight) for flight in flights] if until == "rest" else list(flights)


def report(flight: Flight, name: str) -> None:
    """One line on stderr about a flight."""
    task = flight.task
    words = task.flight_words(flight)
    if isinstance(flight, Landing):
        words += f", motors cut: {flight.ending}"
    print(f"{name}: from {task.start_words(flight.state[0])}: {words}", file=sys.stderr)
