"""`landing-eval equivalence`: the vehicle in MuJoCo against the paper's equations."""

from __future__ import annotations

import time
from collections.abc import Callable

from matplotlib.figure import Figure

from inclined_landing.envs.policy import Policy, load_policy
from inclined_landing.envs.shared import runs
from inclined_landing.envs.tasks import frozen as landing_starts
from inclined_landing.eval.base.claims import Section
from inclined_landing.eval.base.options import Flag, PolicyName, RunFolder, Seed, VehicleFile
from inclined_landing.eval.truth.equivalence import (
    bandwidth,
    check_cases,
    closed_loop,
    convergence,
    flying,
    inconsistencies,
    isolated,
    levels,
    motor,
    twin,
)
from inclined_landing.eval.truth.report import progress, publish
from inclined_landing.models.parameters import load_vehicle

SEQUENCES, STATES = 16, 1000  # of each family and dimension; random states of a forward pass
QUICK_SEQUENCES, QUICK_STATES = 4, 200
QUICK_STARTS = 4  # every fourth of the frozen grid


def command(
    *,
    out: RunFolder,
    policy: PolicyName = "landing",
    vehicle: VehicleFile = None,
    seed: Seed = 0,
    quick: Flag = False,
) -> int:
    """Check the vehicle in MuJoCo against the paper's equations; writes a page of claims.

    The exit code is 1 when a claim fails.

    Args:
        out: new folder for report.html, report.json and the figures.
        policy: landing policy for recorded commands and closed loops, a file or the name of a shipped one.
        vehicle: vehicle file (TOML) or name of a shipped vehicle (default: Crazyflie 2.1).
        seed: seed for commands and states.
        quick: use fewer commands, states and starts.
    """
    loaded = load_policy(policy, "landing", vehicle=None if vehicle is None else load_vehicle(vehicle))
    began = time.monotonic()
    with progress(9) as tick:
        sections, drawn = measure(loaded, seed, quick, tick)
    seconds = round(time.monotonic() - began, 1)
    claims = [c for s in sections for c in s.claims]
    record = {
        "command": "equivalence",
        "policy": str(loaded.path),
        "vehicle": str(vehicle) if vehicle is not None else "crazyflie.toml",
        "seed": int(seed),
        "quick": quick,
        "seconds": seconds,
        "versions": runs.versions(),
        "passed": all(c.passed for c in claims),
        "claims": len(claims),
        "failed": [c.name for c in claims if not c.passed],
        "sections": {s.key: s.record() for s in sections},
    }
    name = "landing-eval equivalence" + (" --quick" if quick else "")
    passed = publish(
        out,
        "report",
        sections,
        drawn,
        record,
        title="The MuJoCo vehicle and the paper's model",
        lead="The MuJoCo vehicle, with its native plugins, against the equations of Kooi and Babuska "
        "(IROS 2021).",
        run=f"{name} · seed {seed} · policy {loaded.path.name} · {seconds:.0f} s",
    )
    return 0 if passed else 1


def measure(policy: Policy, seed: int, quick: bool, tick) -> tuple[list[Section], dict[str, Figure]]:
    """Return all the sections, and the figures by file name. `tick` is called with what comes next."""
    v = policy.task.vehicle
    n, states = (QUICK_SEQUENCES, QUICK_STATES) if quick else (SEQUENCES, STATES)
    starts = landing_starts.clear(policy.task, landing_starts.grid())[:: QUICK_STARTS if quick else 1]
    flights = flying.all_sequences(v, n, seed, policy)
    by_label = {s.label: s for s in flights}
    full, recorded = by_label["full steps, 3-D"], by_label["recorded, 2-D"]
    work: dict[str, Callable[[], Section | tuple[Section, Figure]]] = {
        "three levels": lambda: levels.section(v, flights, states, seed),
        "single terms": lambda: isolated.section(v, states // 2, seed),
        "native twin": lambda: twin.section(v, by_label["full steps, 2-D"].commands),
        "motor function": lambda: motor.section(v, seed),
        "convergence": lambda: convergence.section(v, full.commands),
        "bandwidth": lambda: bandwidth.section(v, full, recorded),
        "closed loop": lambda: closed_loop.section(policy, starts),
        "check cases": lambda: check_cases.section(v),
        "inconsistencies": lambda: inconsistencies.section(v, recorded),
    }
    sections, figures = [], {}
    for what, measured in work.items():
        tick(what)
        found = measured()
        part, figure = found if isinstance(found, tuple) else (found, None)
        if figure is not None:
            figures[f"{part.key}.png"] = figure
        sections.append(part)
    return sections, figures
