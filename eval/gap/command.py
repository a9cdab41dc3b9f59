"""`landing-eval gap`: logs in; report, vehicle file and a few sentences out."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import tyro

from inclined_landing.eval.base.options import Flat, FlightSource, RunFolder


def command(
    source: Flat[FlightSource],
    out: RunFolder,
    reference: Annotated[tuple[str, ...], tyro.conf.arg(metavar="LOG [LOG ...]")] = (),
) -> None:
    """Name the effects that the model lacks, from flights, and write the corrected model.

    Takes a minute or two. The model's uncertainty is read from the posterior that identify wrote next to the
    vehicle file; without one, from the uncertainties in the vehicle file.

    Args:
        reference: logs of the reference vehicle. It is identified from these first, and gap names what has
            changed since.
        out: new folder for report.html, report.json, gap.png, vehicle.toml and landing.xml, and in reference/
            the vehicle that the flights were compared with, unless it is the shipped one.
    """
    from inclined_landing.eval.gap.measured.usable import begin_reading
    from inclined_landing.models.parameters import load_vehicle

    given = load_vehicle(source.vehicle)
    began = time.monotonic()
    reading = begin_reading(source, reference)

    # Meanwhile everything else is imported, also what only functions import that are called later.
    import matplotlib.figure  # noqa: F401
    import scipy.signal  # noqa: F401

    from inclined_landing.envs.shared import runs
    from inclined_landing.envs.shared.progress import stages
    from inclined_landing.eval.gap import diagnose
    from inclined_landing.eval.gap.answer.identification import identify
    from inclined_landing.eval.gap.model.reference import read_reference
    from inclined_landing.eval.gap.report import files, page, words
    from inclined_landing.eval.gap.result import REFERENCE
    from inclined_landing.models import plants  # noqa: F401

    with stages(source.count + len(reference) + 4) as tick:  # every log, and the four ticks below
        flights = reading(tick)
        notes, identification = [*flights.notes], None
        tick("identifying the reference vehicle" if flights.reference else "reading the vehicle file")
        if flights.reference:
            identification = identify(flights.reference, given, platform=source.platform)
            vehicle = files.as_written(identification)
            known = identification.reference
            notes += identification.notes
        else:
            vehicle = given
            known, ignored = read_reference(source.vehicle, given)
            notes += [ignored] if ignored else []
        tick("searching for missing effects")
        d = diagnose(
            flights.logs,
            vehicle,
            reference=known,
            heldout=flights.heldout,
            platform=source.platform or None,
            plants=("analytic", "mujoco"),
        )
        tick("drawing figures")
        versions, track = runs.versions(), page.shown_flight(d, vehicle, flights)
        images = page.figures(d, track)
        html = page.page(d, track, images, versions=versions, notes=notes)
        tick("writing files")
    written: Path | None = None
    try:
        with runs.staged_run(out) as folder:
            base = files.write_reference(folder / REFERENCE, identification, source.vehicle)
            files.write_corrected(d, vehicle, folder, base=base)
            answer = d.to_json() | {"summary": words.how_much(d)}
            page.write_report(folder, "gap", html, answer, source, began, versions, images)
        written = out
    finally:  # after any error too: a full disk costs the files, not the answer
        page.show(d, notes, written)
