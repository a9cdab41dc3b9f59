"""`flight-table`: the paper's starts, or every fault, through the whole chain of a flight."""

from __future__ import annotations

import logging
from typing import Annotated

import tyro
from msgspec import Meta

from inclined_landing.envs.shared import runs, tables
from inclined_landing.eval.base.options import Flag, NewFolder, Seed
from inclined_landing.models import storage
from tests.proof.shared import progress

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
    from tests.proof.flight_table import faults as trouble
    from tests.proof.flight_table import table

    if out is not None:
        runs.check_new_run(out)
    loaded, settings = table.read(policies, vehicles)
    logging.getLogger("cflib").setLevel(logging.CRITICAL)  # it reports lost links, which are meant here
    count = flights * (len(trouble.CASES) if faults else len(policies) * len(vehicles) * 3)
    with progress() as bar:
        task = bar.add_task("flights", total=count)

        def done() -> None:
            bar.advance(task)

        if faults:
            first = loaded[policies[0]], settings[vehicles[0]]
            records = trouble.fly_cases(*first, flights, seed, done)
        else:
            records = [row.record() for row in table.fly_table(loaded, settings, flights, seed, done)]
    tables.printer().print(trouble.on_pose(records) if faults else table.on_pose(records))
    if out is not None:
        with runs.staged_run(out) as folder:
            kind = "faults" if faults else "starts"
            asked = {"kind": kind, "policies": list(policies), "vehicles": list(vehicles), "seed": seed}
            storage.write_json(folder / "results.json", asked | {"flights": flights, "rows": records})
        print(out)
    return 3 if faults and any(row["safe"] < row["met"] for row in records) else 0
