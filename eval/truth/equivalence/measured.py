"""The vehicle in MuJoCo against the paper's equations: all sections of the page."""

from __future__ import annotations

from collections.abc import Callable

from inclined_landing.envs.policy import Policy
from inclined_landing.envs.tasks import frozen as landing_starts
from inclined_landing.eval.base.claims import Section
from inclined_landing.eval.truth.equivalence import (
    check_cases,
    closed_loop,
    flying,
    inconsistencies,
    isolated,
    levels,
    motor,
    twin,
)
from inclined_landing.eval.truth.report import measured

SEQUENCES, STATES = 16, 1000  # of each family and dimension; random states of a forward pass
QUICK_SEQUENCES, QUICK_STATES = 4, 200
QUICK_STARTS = 4  # every fourth of the frozen grid


def measure(policy: Policy, seed: int, quick: bool) -> tuple[list[Section], dict[str, bytes]]:
    """Return all sections and their figures."""
    v = policy.task.vehicle
    n, states = (QUICK_SEQUENCES, QUICK_STATES) if quick else (SEQUENCES, STATES)
    starts = landing_starts.clear(policy.task, landing_starts.grid())[:: QUICK_STARTS if quick else 1]
    flights = flying.all_sequences(v, n, seed, policy)
    by_label = {s.label: s for s in flights}
    work: dict[str, Callable[[], Section]] = {
        "three levels": lambda: levels.section(v, flights, states, seed),
        "single terms": lambda: isolated.section(v),
        "native twin": lambda: twin.section(v, by_label["full steps, 2-D"].commands),
        "motor function": lambda: motor.section(v, seed),
        "closed loop": lambda: closed_loop.section(policy, starts),
        "check cases": lambda: check_cases.section(v),
        "inconsistencies": lambda: inconsistencies.section(v, by_label["recorded, 2-D"]),
    }
    return measured(work)
