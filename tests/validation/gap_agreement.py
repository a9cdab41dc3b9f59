"""`gap-agreement`: are flights that contradict the others found, and only these?

In realities of the simulator's families ten flights of one vehicle and day, in which one or half are of
another vehicle or of another day's calibration, are given to `landing-eval identify`, from the paper's
constants.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
import tyro
from msgspec import Meta

from inclined_landing.eval.base.options import Folder, Seed
from inclined_landing.eval.gap.answer.identification import identify
from inclined_landing.eval.gap.result import InconsistentFlights
from inclined_landing.models.parameters import load_vehicle
from tests.validation import simulator
from tests.validation.gap_blind import cases as blind
from tests.validation.gap_blind import generate
from tests.validation.gap_blind.causes import Drawn
from tests.validation.shared import check_known, study, table_of

FLIGHTS = 10
CHARGE = {"battery_voltage": (-0.15, 0.15)}  # V, of every flight
TILT = math.radians(1.5)
# What differs, in the simulator and as (effect, parameter) with its value.
VEHICLE = ({"thrust_scale": 0.85, "attitude_gain_scale": 1.15}, {("attitude_gain", "scale"): 1.15})
CAPTURE = ({"mocap_roll": TILT}, {("mocap_tilt", "roll"): TILT})
TRIM = ({"trim_pitch": TILT}, {("attitude_trim", "pitch"): TILT})
# Name: what differs in how many of the flights.
MIXED = {
    "nothing": (({}, {}), 0),
    "another vehicle, one flight": (VEHICLE, 1),
    "another vehicle, half": (VEHICLE, FLIGHTS // 2),
    "motion capture off by 1.5 deg, one flight": (CAPTURE, 1),
    "motion capture off by 1.5 deg, half": (CAPTURE, FLIGHTS // 2),
    "trim off by 1.5 deg, one flight": (TRIM, 1),
    "trim off by 1.5 deg, half": (TRIM, FLIGHTS // 2),
}


def command(
    out: Folder,
    family: Annotated[str, tyro.conf.arg(metavar="{dev,fresh}")] = "dev",
    cases: Annotated[int, Meta(ge=1, le=1000)] = 6,
    seed: Seed = 0,
    processes: Annotated[int, Meta(ge=1, le=256)] = 2,
) -> None:
    """Flights of another vehicle or day among the others: are they found, and only they (minutes).

    Args:
        out: folder for results.json and table.md; an interrupted run goes on in it.
        family: families of realities to draw from.
        cases: realities; each gives a set of every kind.
        seed: of realities and flights.
        processes: realities at a time.
    """
    check_known("family", [family], ("dev", "fresh"))
    members = blind.SETS[family]
    calls = {f"{family}_{seed}_{k}": (members[k % len(members)], (seed, k)) for k in range(cases)}
    study(out, of_reality, calls, processes, scored, family=family, seed=seed)


def scored(answers: Mapping[str, Sequence[dict]]) -> tuple[str, dict]:
    """Return the table of the answers of all realities, and what results.json has of them."""
    rows = [row for found in answers.values() for row in found]
    return table_of(counted(rows)), {"sets": rows}


def of_reality(family: str, entropy: tuple[int, ...]) -> list[dict]:
    """Return a row of what was said for every kind of MIXED in a reality of a family."""
    rng = np.random.default_rng(entropy)
    reality = simulator.draw(family, rng)

    def fly(world):
        drawn = Drawn(world, {}, spread=CHARGE)
        return generate.logs(generate.fly_all(drawn, rng, reality, count=FLIGHTS))

    usual, rows = fly({}), []
    for kind, ((world, truth), count) in MIXED.items():
        other = {int(k) for k in rng.permutation(FLIGHTS)[:count]}
        flown = fly(world) if other else usual
        logs = [(flown if k in other else usual)[k] for k in range(FLIGHTS)]
        said = identify(logs, load_vehicle()).inconsistent_flights
        names = frozenset(logs[k].name for k in other)
        rows.append({"family": family, "kind": kind, **judged(said, names, truth)})
    return rows


def judged(said: tuple[InconsistentFlights, ...], flights: frozenset[str], truth: dict) -> dict:
    """Return whether these flights were said to contradict the others, how many other groups, and in what.

    inside: whether the interval of each true difference, where it was said, holds it.
    """
    right = [one for one in said if flights in (frozenset(one.flights), frozenset(one.others))]
    inside = []
    for one in right:
        sign = 1.0 if flights == frozenset(one.flights) else -1.0
        for d in one.differences:
            for name, (low, high) in d.ci95.items():
                if (d.effect, name) in truth:
                    value = truth[d.effect, name]
                    factor = value > 0.5  # else it adds to zero
                    expected = value**sign if factor else value * sign
                    inside.append(bool(low <= expected <= high))
    effects = [d.effect for one in right for d in one.differences]
    return {"found": bool(right), "other": len(said) - len(right), "effects": effects, "inside": inside}


def counted(rows: Sequence[dict]) -> list[dict]:
    """Return a line of the table for every kind."""
    lines = []
    for kind in dict.fromkeys(row["kind"] for row in rows):
        same = [row for row in rows if row["kind"] == kind]
        inside = [x for row in same for x in row["inside"]]
        lines.append(
            {
                "differs": kind,
                "sets": len(same),
                "found": sum(row["found"] for row in same) if MIXED[kind][1] else None,
                "other flights reported": sum(row["other"] > 0 for row in same),
                "interval holds the difference": f"{sum(inside)} of {len(inside)}" if inside else None,
            }
        )
    return lines
