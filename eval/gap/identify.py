"""`landing-eval identify`: logs in; a vehicle file, its report and a few sentences out."""

from __future__ import annotations

import time
from pathlib import Path

from inclined_landing.eval.base.options import Flat, FlightSource, RunFolder


def command(source: Flat[FlightSource], out: RunFolder) -> None:
    """Identify thrust, lags, delays, attitude loops and drag, and write a vehicle file.

    Takes seconds.

    Args:
        out: new folder for vehicle.toml, vehicle.posterior.json (posterior covariance, read by gap),
            report.html and report.json.
    """
    from inclined_landing.eval.gap.measured.usable import begin_reading
    from inclined_landing.models.parameters import load_vehicle

    nominal = load_vehicle(source.vehicle)
    began = time.monotonic()
    reading = begin_reading(source)

    # Meanwhile everything else is imported, also what only functions import that are called later.
    import scipy.signal  # noqa: F401

    from inclined_landing.envs.shared import runs
    from inclined_landing.envs.shared.progress import stages
    from inclined_landing.eval.gap.answer.identification import identify
    from inclined_landing.eval.gap.report import files, identified, page

    with stages(source.count + 2) as tick:
        flights = reading(tick)
        tick("fitting the vehicle")
        identification = identify(flights.logs, nominal, heldout=flights.heldout, platform=source.platform)
        tick("writing the report")
        versions = runs.versions()
        heldout = [log.name for log in flights.heldout]
        html = identified.page(identification, heldout=heldout, versions=versions, notes=flights.notes)
    written: Path | None = None
    try:
        with runs.staged_run(out) as folder:
            files.write_identified(identification, folder, base=source.vehicle)
            page.write_report(folder, "identify", html, identification.to_json(), source, began, versions)
        written = out / files.VEHICLE
    finally:
        identified.show(identification, flights.notes, written)
