"""Flights for pictures from the points of --start, with a line on each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from inclined_landing.envs.flights import Flight, record_flights
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.shared.tables import say
from inclined_landing.envs.tasks import Start, Task, hover_states
from inclined_landing.eval.base.options import Until
from inclined_landing.eval.pictures.starts import Point, parse_starts, start_words, usual_starts
from inclined_landing.eval.pictures.to_rest import LandedFlight, to_rest


def start_points(starts: Sequence[str], task: Task) -> list[Point]:
    """Return start points [m] from --start, or the first of the task's usual ones."""
    return parse_starts(starts, task) or [usual_starts(task)[0]]


def fly_from(policy: Policy, points: Sequence[Point], plant: str, steps: int | None = None):
    """Return flights from hover at points [m], at most `steps` steps long."""
    return record_flights(policy, plant, hover_states(points, policy.task.vehicle), steps=steps)


def choose_starts(task: Task, where: Sequence[Point], drawn: int, seed: int) -> Start:
    """Return starts from hover at points [m], or `drawn` random ones, slopes included."""
    if drawn:
        return task.sample(np.random.default_rng(seed), drawn)
    return task.start(hover_states(where, task.vehicle))


def continue_flights(flights: Sequence[Flight], until: Until) -> list[Flight]:
    """Return the flights up to the end selected by --until: "rest" or "goal"."""
    return [to_rest(flight) for flight in flights] if until == "rest" else list(flights)


def say_outcomes(flights: Mapping[str, Flight], shown_in: str) -> None:
    """Print a line for each flight, and the number of successes; shown_in: the file that shows them."""
    for name, flight in flights.items():
        outcome = flight.task.flight_words(flight)
        if isinstance(flight, LandedFlight):
            outcome += f", motors cut: {flight.ending}"
        say(f"{name}: from {start_words(flight.task, flight.state[0])}: {outcome}")
    count, succeeded = len(flights), sum(flight.success for flight in flights.values())
    say(f"{succeeded} of {count} flight{'s' * (count != 1)} succeeded; {shown_in}.")
