"""The policy flown from the frozen grid in both plants: success, time to land and final state."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from inclined_landing.envs.flights import Flight, record_flights
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.shared.statistics import proportion
from inclined_landing.envs.tasks import hover_states
from inclined_landing.eval.base.claims import Claim, Section, Table
from inclined_landing.eval.truth.equivalence import flying
from inclined_landing.eval.truth.equivalence.flying import WORDS
from inclined_landing.models.attitude import PITCH, VX, VZ, X, Z
from inclined_landing.models.plants import AnalyticPlant, MujocoPlant

QUANTITIES = ("time", "x", "z", "vx", "vz", "pitch")
UNITS = ("s", "m", "m", "m/s", "m/s", "deg")
_COLUMNS = [X, Z, VX, VZ, PITCH]
# The plants by the name the report gives them.
PAPER, EXTENDED = "equations (paper)", "equations with rate loop"
KINEMATIC, VEHICLE = "MuJoCo, kinematic", "MuJoCo, rate loop"
COMPARED = ((PAPER, KINEMATIC), (EXTENDED, VEHICLE), (PAPER, VEHICLE))  # two of the same model, one across
FEWEST = 10  # landings in both plants, for a comparison


def fly(policy: Policy, starts: np.ndarray) -> dict[str, list[Flight]]:
    """Return the policy's flights from `starts` (k, 2), by plant."""
    states = hover_states(starts, policy.task.vehicle)
    n, v = len(states), policy.task.vehicle
    plants = {
        PAPER: AnalyticPlant(n, v),
        EXTENDED: AnalyticPlant(n, v, attitude="rate_loop", substeps=flying.FINE),
        KINEMATIC: MujocoPlant(n, v, attitude="kinematic"),
        VEHICLE: MujocoPlant(n, v),
    }
    return {name: record_flights(policy, plant, states) for name, plant in plants.items()}


def quantities(flights: list[Flight]) -> np.ndarray:
    """Return time to land [s] and final x, z, vx, vz, pitch [deg] of the flights, (k, 6)."""
    rows = np.array([[f.duration, *f.state[-1, _COLUMNS]] for f in flights])
    rows[:, -1] = np.degrees(rows[:, -1])
    return rows


def compare(flown: dict[str, list[Flight]], first: str, second: str) -> dict[str, Any] | None:
    """Return the comparison of two plants; None if fewer than FEWEST flights succeed in both.

    `same`: share of starts with the same outcome. Of the flights that succeed in both, `steps` (k,): control
    steps that the second takes longer; `period` [s] of one; `final`: largest distance [m] of the final
    positions of flights of equal length.
    """
    both = list(zip(flown[first], flown[second]))
    pairs = [(a, b) for a, b in both if a.success and b.success]
    if len(pairs) < FEWEST:
        return None
    equal = [(p, q) for p, q in pairs if len(p.t) == len(q.t)]
    return {
        "first": first,
        "second": second,
        "same": float(np.mean([a.success == b.success and a.touched == b.touched for a, b in both])),
        "steps": np.array([len(q.t) - len(p.t) for p, q in pairs]),
        "period": float(pairs[0][0].t[1]),
        "final": float(
            max((np.linalg.norm(p.state[-1, :3] - q.state[-1, :3]) for p, q in equal), default=np.nan)
        ),
    }


def claims(flown: dict[str, list[Flight]], twins: list[dict[str, Any]]) -> list[Claim]:
    """Return the claims: the same model gives the same flights, and equal success in both plants."""
    result = []
    for c in twins:
        claim = functools.partial(WORDS.claim, "closed_loop", name=f"{c['second']} and {c['first']}")
        equal = float(np.mean(c["steps"] == 0))
        result += [claim("outcome", c["same"]), claim("time", equal), claim("final", c["final"])]
    share = {name: np.mean([f.strict for f in flights]) for name, flights in flown.items()}
    return [*result, WORDS.claim("closed_loop", "success", abs(share[VEHICLE] - share[PAPER]))]


def section(policy: Policy, starts: np.ndarray) -> Section:
    """Return the section over flights from `starts` (k, 2)."""
    flown = fly(policy, starts)
    compared = [c for pair in COMPARED if (c := compare(flown, *pair)) is not None]
    rows, summary = [], {}
    for name, flights in flown.items():
        landed = [f for f in flights if f.success]
        share = proportion(sum(f.strict for f in flights), len(flights))
        middle = np.median(quantities(landed), axis=0) if landed else np.full(6, np.nan)
        summary[name] = {"strict": share, "median": dict(zip(QUANTITIES, middle))}
        rows.append(
            (name, f"{len(landed)} of {len(flights)}", f"{share['count']} of {len(flights)}", *middle)
        )
    if len(compared) < len(COMPARED):
        fewest = min(sum(f.success for f in fs) for fs in flown.values())
        found = [WORDS.claim("closed_loop", "few", fewest)]
        remarks = ["Too few landings for a comparison."]
    else:
        *twins, cross = compared
        found = claims(flown, twins)
        early, middle, late = np.quantile(cross["steps"] * cross["period"], [0.05, 0.5, 0.95])
        remarks = [
            f"From the same start, {cross['second']} lands {middle:+.2f} s later than {cross['first']} "
            f"(median; 90 % of the starts: {early:+.2f} to {late:+.2f} s). A different rate loop flies a "
            "different path to the same goal."
        ]
    heads = ("plant", "success", "without touching", *(f"{q} [{u}]" for q, u in zip(QUANTITIES, UNITS)))
    return WORDS.section(
        "closed_loop",
        found,
        {"policy": policy.path.name, "starts": len(starts)},
        tables=[Table("Landings and medians at the goal box", heads, rows)],
        remarks=remarks,
        data={"plants": summary, "comparisons": compared},
    )
