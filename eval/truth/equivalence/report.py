"""Every measurement of the equivalence, as sections, figures, one JSON record and one page."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from matplotlib.figure import Figure

from inclined_landing.envs import starts as landing_starts
from inclined_landing.envs.policy import Policy
from inclined_landing.eval.base.claims import Claim, Section
from inclined_landing.eval.base.page import claims_page
from inclined_landing.eval.truth.equivalence import (
    bandwidth,
    closed_loop,
    convergence,
    figures,
    inconsistencies,
    isolated,
    levels,
    motor,
    sequences,
    twin,
)

TITLE = "Is the MuJoCo vehicle the paper's model?"
SEQUENCES, STATES = 16, 1000  # of each family and dimension; random states of a forward pass
QUICK_SEQUENCES, QUICK_STATES = 4, 200
QUICK_STARTS = 4  # every fourth of the frozen grid
TICKS = 30  # of the progress bar


def measure(
    policy: Policy, *, seed: int = 0, quick: bool = False, tick=lambda text: None
) -> tuple[list[Section], dict[str, Figure]]:
    """Return all the sections, and the figures by file name. `tick` is called with what comes next."""
    v = policy.task.vehicle
    n, states = (QUICK_SEQUENCES, QUICK_STATES) if quick else (SEQUENCES, STATES)
    starts = landing_starts.clear(policy.task, landing_starts.grid())[:: QUICK_STARTS if quick else 1]

    def within(text):
        return lambda: tick(text)

    tick("command sequences")
    flights = sequences.all_sequences(v, n, seed, policy)
    by_label = {s.label: s for s in flights}
    full, recorded = by_label["full steps, 3-D"], by_label["recorded, 2-D"]
    tick("three levels")
    level, gaps = levels.section(v, flights, states, seed, within("three levels"))
    tick("single terms")
    alone = isolated.section(v, states // 2, seed)
    tick("native twin")
    native = twin.section(v, by_label["full steps, 2-D"].commands)
    tick("motor function")
    motors, thrust = motor.section(v, seed)
    tick("convergence")
    order, errors = convergence.section(v, full.commands, within("convergence"))
    tick("bandwidth")
    loop, found = bandwidth.section(v, full, recorded, within("bandwidth"))
    tick("closed loop")
    closed, flown = closed_loop.section(policy, starts, within("closed loop"))
    tick("inconsistencies")
    odd, shown = inconsistencies.section(v, recorded)
    drawn = {
        "levels.png": figures.levels(v, gaps),
        "motor.png": figures.motor_figure(thrust),
        "convergence.png": figures.convergence_figure(errors),
        "bandwidth.png": figures.bandwidth_figure(v, found),
        "closed_loop.png": figures.closed_loop_figure(flown),
        "inconsistencies.png": figures.inconsistencies_figure(v, shown),
    }
    return [level, alone, native, motors, order, loop, closed, odd], drawn


def headlines(sections: list[Section]) -> list[Claim]:
    """Return the main claims in plain words; of several the one closest to its tolerance."""
    by = {s.key: s.claims for s in sections}

    def worst(key, part, unit):
        return max(
            (c for c in by[key] if part in c.name and c.unit == unit), key=lambda c: c.measured / c.high
        )

    chosen = {
        "Accelerations at random states, one forward pass": worst("levels", "linear acceleration", "m/s²"),
        "One control step from every state of the flights": worst("levels", "one control step", "m"),
        "6 s of commands, kinematic mode against the paper's equations": worst(
            "levels", "6 s kinematic, full steps", "m"
        ),
        "6 s of commands, rate loop against the extended equations": worst("levels", "6 s rate loop", "m"),
        "6 s beside a twin without plugins": worst("twin", "position", "m"),
        "Order of convergence of RK4": worst("convergence", "RK4, rate loop", "order"),
        "Doubling a large rate-loop bandwidth divides its gap to the paper by": by["bandwidth"][2],
        "The policy's success in MuJoCo and in the paper's equations, difference": next(
            (c for c in by["closed_loop"] if "difference" in c.name), by["closed_loop"][0]
        ),
    }
    return [dataclasses.replace(claim, name=name) for name, claim in chosen.items()]


def as_record(sections: list[Section], **head) -> dict:
    """Return the JSON report."""
    claims = [c for s in sections for c in s.claims]
    return {
        "command": "equivalence",
        **head,
        "passed": all(c.passed for c in claims),
        "claims": len(claims),
        "failed": [c.name for c in claims if not c.passed],
        "sections": {
            s.key: {
                "title": s.title,
                "claims": [c.record() for c in s.claims],
                "tables": [{"caption": t.caption, "heads": t.heads, "rows": t.rows} for t in s.tables],
                "remarks": s.remarks,
                "data": s.data,
            }
            for s in sections
        },
    }


def as_page(sections: list[Section], images: dict[str, bytes], record: dict) -> str:
    """Return the page, figures inside."""
    command = "landing-eval validate equivalence" + (" --quick" if record["quick"] else "")
    policy, seconds = Path(record["policy"]).name, round(record["seconds"])
    return claims_page(
        TITLE,
        "The MuJoCo vehicle, with its native plugins, against the equations of Kooi and Babuska (IROS 2021).",
        sections,
        images,
        headlines=headlines(sections),
        run=f"{command} · seed {record['seed']} · policy {policy} · {seconds} s",
        versions=record["versions"],
    )
