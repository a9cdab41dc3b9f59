"""The paper's table flown through the whole chain: its three starts, ten flights each."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

import numpy as np

from inclined_landing.envs.policy import Policy
from inclined_landing.envs.shared import statistics, tables
from inclined_landing.envs.tasks.landing import PAPER_RESULTS
from inclined_landing.eval.flying.fly import FlightOptions
from inclined_landing.eval.flying.plan import FlightPlan
from inclined_landing.eval.flying.simulated.body import named_vehicle
from inclined_landing.eval.flying.simulated.world import Setting
from inclined_landing.models.errors import UserError
from tests.proof.flight_table.chain import Flown, fly_once

# The landing policy, the set-point policy, the starts x, z [m].
Loaded: TypeAlias = tuple[Policy, Policy, list[tuple[float, float]]]


@dataclasses.dataclass(frozen=True)
class Row:
    """Flights of one policy on one vehicle; `flights[k]` those from start k."""

    policy: str
    vehicle: str
    starts: tuple[tuple[float, float], ...]
    flights: tuple[tuple[Flown, ...], ...]

    def record(self) -> dict:
        """Plain numbers for the JSON file."""
        every = [flown for flights in self.flights for flown in flights]
        landing = [f.report.landing_time for f in every if f.report.landing_time is not None]
        speeds = [math.hypot(*f.truth.speed) for f in every if f.truth.speed is not None]
        return {
            "policy": self.policy,
            "vehicle": self.vehicle,
            "reported": statistics.proportion(sum(f.report.landed for f in every), len(every)),
            "strict": statistics.proportion(sum(f.truth.strict for f in every), len(every)),
            "rests": statistics.proportion(sum(f.truth.landed for f in every), len(every)),
            "safe": statistics.proportion(sum(is_down(f) for f in every), len(every)),
            "landing_time": statistics.spread(landing),
            "goal_speed": statistics.spread(speeds),
            "by_start": [
                {
                    "start": list(start),
                    "reported": statistics.proportion(sum(f.report.landed for f in own), len(own)),
                    "strict": statistics.proportion(sum(f.truth.strict for f in own), len(own)),
                    "rests": statistics.proportion(sum(f.truth.landed for f in own), len(own)),
                }
                for start, own in zip(self.starts, self.flights)
            ],
            "flights": [flight_record(flown) for flown in every],
        }


def is_down(flown: Flown) -> bool:
    """At rest somewhere with its motors off, and never outside the arena."""
    return bool(flown.truth.rests) and flown.truth.outside == 0.0


def flight_record(flown: Flown) -> dict:
    """One flight in plain values."""
    report = flown.report
    return {
        "seed": flown.seed,
        "outcome": report.outcome,
        "retreat": report.retreat.name if report.retreat else None,
        "error": report.error,
        "landing_time": report.landing_time,
        "faults": [list(fault) for fault in flown.faults],
        "truth": dataclasses.asdict(flown.truth),
    }


def seeds_of(seed: int, starts: int, flights: int) -> np.ndarray:
    """(starts, flights) seeds: the same for every policy and vehicle, so that they meet the same noise."""
    return np.random.SeedSequence(seed).generate_state(starts * flights).reshape(starts, flights)


def read(policies: Sequence[str], vehicles: Sequence[str]) -> tuple[dict[str, Loaded], dict[str, Setting]]:
    """Policies with what flies them to their starts, and vehicles. Raises UserError where one is none."""
    if not policies or not vehicles:
        raise UserError("name at least one policy and one vehicle")
    settings = {name: Setting(named_vehicle(name)) for name in vehicles}
    return {name: FlightOptions(name).load() for name in policies}, settings


def fly_table(
    policies: Mapping[str, Loaded],
    vehicles: Mapping[str, Setting],
    flights: int,
    seed: int,
    done: Callable[[], None] = lambda: None,
) -> list[Row]:
    """Every policy on every vehicle, `flights` from each of the paper's starts; done: called after each."""
    rows = []
    for policy, (landing, hover, starts) in policies.items():
        for vehicle, setting in vehicles.items():
            flown = []
            for start, own in zip(starts, seeds_of(seed, len(starts), flights)):
                flown.append([])
                for number in own:
                    flown[-1].append(fly_once(FlightPlan(landing, hover, start), setting, int(number)))
                    done()
            rows.append(Row(policy, vehicle, tuple(starts), tuple(map(tuple, flown))))
    return rows


def on_pose(records: Sequence[dict]):
    """The table for the terminal, the paper's row first."""
    share = tables.share_cell
    table = tables.new_table(
        "Three starts, the whole chain [%, 95 % Wilson interval]",
        *(
            "policy",
            "vehicle",
            "goal box, seen by the pilot",
            "truly, before a touch",
            "at rest on its feet",
        ),
        *("down, never outside", "landing [s]", "speed in the box [m/s]"),
        left=2,
    )
    first, scattered = PAPER_RESULTS
    paper = f"{100 * first['share']:.1f} and {100 * scattered['share']:.1f}"
    table.add_row("the paper's", "real", paper, "-", "-", "-", "-", "-")
    for row in records:
        table.add_row(
            *(row["policy"], row["vehicle"]),
            *(share(row[key]) for key in ("reported", "strict", "rests", "safe")),
            tables.spread_cell(row["landing_time"]),
            tables.spread_cell(row["goal_speed"]),
        )
    return table
