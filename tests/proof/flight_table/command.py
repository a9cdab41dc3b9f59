"""`flight-table`: the paper's three starts, or every fault, through the whole chain of a flight."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Annotated

import tyro
from msgspec import Meta

from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.statistics import proportion, spread
from inclined_landing.envs.shared.tables import share_cell, spread_cell
from inclined_landing.envs.tasks.landing import PAPER_RESULTS
from inclined_landing.eval.base.options import Flag, NewFolder, Seed
from inclined_landing.eval.flying.fly import FlightOptions
from inclined_landing.eval.flying.plan import FlightPlan
from inclined_landing.eval.flying.simulated.body import named_vehicle
from inclined_landing.eval.flying.simulated.world import Setting
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError
from tests.proof.shared import progress, table_of

from . import faults as trouble
from .chain import Flown, Loaded, flight_record, fly_once, seeds_of

Names = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME [NAME ...]")]


def command(
    policies: Names = ("landing-nominal", "landing"),
    vehicles: Names = ("nominal", "hidden"),
    flights: Annotated[int, Meta(ge=1, le=1000)] = 10,
    faults: Flag = False,
    seed: Seed = 0,
    out: NewFolder = None,
) -> int:
    """Flights of the simulated Crazyflie as they truly went: the paper's starts or every fault (minutes).

    A flight is the whole of `landing-eval fly`: radio, motion capture, Kalman filter, 50 Hz of commands. With
    faults the exit code is 3 where any of them was not met by motors off in the stated time and place.

    Args:
        policies: for the task landing.
        vehicles: nominal, hidden (gaps that no policy was told), or vehicle files.
        flights: from each start; with --faults, of each fault.
        faults: instead of the table, every fault with the first policy on the first vehicle.
        seed: of everything drawn.
        out: new folder for results.json.
    """
    if out is not None:
        runs.check_new_run(out)
    if not policies or not vehicles:
        raise UserError("name at least one policy and one vehicle")
    settings = {name: Setting(named_vehicle(name)) for name in vehicles}
    loaded = {name: FlightOptions(name).load() for name in policies}
    count = flights * (len(trouble.CASES) if faults else len(policies) * len(vehicles) * 3)
    with progress() as bar:
        task = bar.add_task("flights", total=count)

        def done() -> None:
            bar.advance(task)

        if faults:
            first = loaded[policies[0]], settings[vehicles[0]]
            records = trouble.fly_cases(*first, flights, seed, done)
        else:
            records = fly_table(loaded, settings, flights, seed, done)
    print(table_of([(trouble.shown if faults else shown)(record) for record in records]))
    if not faults:
        first, scattered = (100 * one["share"] for one in PAPER_RESULTS)
        print(f"The paper's, real: goal box in {first:.1f} %, from scattered starts {scattered:.1f} %.")
    if out is not None:
        with runs.staged_run(out) as folder:
            kind = "faults" if faults else "starts"
            asked = {"kind": kind, "policies": list(policies), "vehicles": list(vehicles), "seed": seed}
            storage.write_json(folder / "results.json", asked | {"flights": flights, "rows": records})
        print(out)
    return 3 if faults and any(row["safe"] < row["met"] for row in records) else 0


def fly_table(
    policies: Mapping[str, Loaded],
    vehicles: Mapping[str, Setting],
    flights: int,
    seed: int,
    done: Callable[[], None],
) -> list[dict]:
    """Return a row for every policy on every vehicle: `flights` from each of the paper's starts.

    done: called after each flight. The seeds are the same for every policy and vehicle, so that they meet the
    same noise.
    """
    rows = []
    for policy, (landing, hover, starts) in policies.items():
        for vehicle, setting in vehicles.items():
            flown = []
            for start, own in zip(starts, seeds_of(seed, len(starts), flights)):
                for number in own:
                    flown.append(fly_once(FlightPlan(landing, hover, start), setting, int(number)))
                    done()
            rows.append({"policy": policy, "vehicle": vehicle} | counted(flown))
    return rows


def counted(flown: list[Flown]) -> dict:
    """Return shares, times and every flight as plain values."""
    landing = [f.report.landing_time for f in flown if f.report.landing_time is not None]
    speeds = [math.hypot(*f.truth.speed) for f in flown if f.truth.speed is not None]
    down = [bool(f.truth.rests) and f.truth.outside == 0.0 for f in flown]
    return {
        "reported": proportion(sum(f.report.landed for f in flown), len(flown)),
        "strict": proportion(sum(f.truth.strict for f in flown), len(flown)),
        "rests": proportion(sum(f.truth.landed for f in flown), len(flown)),
        "safe": proportion(sum(down), len(flown)),
        "landing_time": spread(landing),
        "goal_speed": spread(speeds),
        "flights": [flight_record(one) for one in flown],
    }


def shown(row: dict) -> dict:
    """Return a line of the table: shares in percent with Wilson's 95 % interval, medians with quantiles."""
    return {
        "policy": row["policy"],
        "vehicle": row["vehicle"],
        "goal box, seen by the pilot": share_cell(row["reported"]),
        "truly, before a touch": share_cell(row["strict"]),
        "at rest on its feet": share_cell(row["rests"]),
        "down, never outside": share_cell(row["safe"]),
        "landing [s]": spread_cell(row["landing_time"]),
        "speed in the box [m/s]": spread_cell(row["goal_speed"]),
    }
