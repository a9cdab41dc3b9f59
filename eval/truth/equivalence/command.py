"""`landing-eval equivalence`: the vehicle in MuJoCo against the paper's equations."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from inclined_landing.eval.base.options import Flag, RunFolder, Seed, VehicleFile

if TYPE_CHECKING:
    from inclined_landing.envs.policy import Policy
    from inclined_landing.eval.base.claims import Section

SEQUENCES, STATES = 16, 1000  # of each family and dimension; random states of a forward pass
QUICK_SEQUENCES, QUICK_STATES = 4, 200
QUICK_STARTS = 4  # every fourth of the frozen grid


def command(
    *,
    out: RunFolder,
    vehicle: VehicleFile = None,
    seed: Seed = 0,
    quick: Flag = False,
) -> int:
    """Check the vehicle in MuJoCo against the paper's equations; writes a page of claims.

    Takes about 12 s on two cores. The exit code is 1 if a claim does not hold.

    Args:
        out: new folder for report.html, report.json and the figures.
        vehicle: vehicle file (TOML) or name of a shipped vehicle (default: Crazyflie 2.1).
        seed: seed for commands and states.
        quick: use fewer commands, states and starts.
    """
    from inclined_landing.envs.policy import load_policy
    from inclined_landing.eval.truth.report import check

    policy = load_policy("landing", vehicle=vehicle)
    return check(
        out,
        "report",
        measurements(policy, seed, quick),
        title="The MuJoCo vehicle and the paper's model",
        lead="The MuJoCo vehicle, with its native plugins, against the equations of Kooi and Babuska "
        "(IROS 2021).",
    )


def measurements(policy: Policy, seed: int, quick: bool) -> dict[str, Callable[[], Section]]:
    """Return functions that measure the sections of the page, in its order."""
    from inclined_landing.envs.tasks import frozen
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

    v = policy.task.vehicle
    n, states = (QUICK_SEQUENCES, QUICK_STATES) if quick else (SEQUENCES, STATES)
    starts = frozen.clear(policy.task, frozen.grid())[:: QUICK_STARTS if quick else 1]
    flights = flying.all_sequences(v, n, seed, policy)
    by_label = {s.label: s for s in flights}
    return {
        "three levels": lambda: levels.section(v, flights, states, seed),
        "single terms": lambda: isolated.section(v),
        "native twin": lambda: twin.section(v, by_label["full steps, 2-D"].commands),
        "motor function": lambda: motor.section(v, seed),
        "closed loop": lambda: closed_loop.section(policy, starts),
        "check cases": lambda: check_cases.section(v),
        "inconsistencies": lambda: inconsistencies.section(v, by_label["recorded, 2-D"]),
    }
