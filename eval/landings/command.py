"""`landing-eval landings`: a study from its file to a folder with results, figures and a page."""

from __future__ import annotations

import shutil
from typing import Annotated

import tyro

from inclined_landing.eval.base.options import Flag, Folder, VehicleFile
from inclined_landing.models.base.errors import UserError


def command(
    study: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="STUDY.toml")],
    /,
    out: Folder,
    vehicle: VehicleFile = None,
    engine: Annotated[str, tyro.conf.arg(metavar="{local,ray}")] = "local",
    address: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT")] = None,
    resume: Flag = False,
) -> None:
    """Run a landing study: simulate and classify thousands of touchdowns over friction, speeds ...

    Args:
        study: study file, or the name of a shipped study (paper_landing, steep_landing).
        out: new folder for results (Parquet), statistics (JSON), figures (PNG) and page (HTML).
        vehicle: vehicle file (TOML) or name of a shipped vehicle (default: Crazyflie 2.1).
        engine: run in this process, or on a Ray cluster.
        address: address of a running Ray cluster (default: start Ray on this machine).
        resume: continue the study that was interrupted in this folder.
    """
    from inclined_landing.envs.shared import pool, runs
    from inclined_landing.envs.shared.tables import say
    from inclined_landing.eval.landings import report
    from inclined_landing.eval.landings.run import PARTS, RECORD, begin_study, landings_of
    from inclined_landing.eval.landings.study import read_study
    from inclined_landing.eval.study.show import document, show, write
    from inclined_landing.models.parameters import load_vehicle

    pool.check(engine, address, "--engine")
    wanted = read_study(study, load_vehicle(vehicle))
    if resume and not (out / RECORD).is_file():
        raise UserError(f"nothing to resume: {out} contains no {RECORD}")
    with runs.owned(out, RECORD if resume else None):
        wanted = begin_study(wanted, out, resume)
        table = landings_of(wanted, out, engine, address)
        results = [report.count(wanted, table.to_pandas())]
        write(out, results, document("landings", results), flights=False)
        shutil.rmtree(out / PARTS, ignore_errors=True)
    show(results)
    say(f"The page is {out / 'index.html'}.")
