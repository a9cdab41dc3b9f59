"""`landing-eval gap`: logs in; report, vehicle file and a few sentences out."""

from __future__ import annotations

import time

from inclined_landing.eval.base import runs
from inclined_landing.eval.base.options import Flat, FlightSource, Folder
from inclined_landing.eval.base.style import save_figure, styled
from inclined_landing.eval.gap import diagnose
from inclined_landing.eval.gap.report import figures, model, run, terminal, tracks, words
from inclined_landing.eval.gap.report.page import page
from inclined_landing.models.parameters import load_vehicle


def command(source: Flat[FlightSource], out: Folder) -> None:
    """Where simulation and flights disagree, which effect is missing, the corrected model.

    Takes seconds.

    Args:
        out: new folder for report.html, report.json, gap.png, vehicle.toml and landing.xml.
    """
    runs.check_new_run(out)
    nominal = load_vehicle(source.vehicle)
    began = time.monotonic()
    with run.flown(source, parts=3) as (logs, kept, notes, tick):
        tick("diagnosis")
        d = diagnose(
            logs, nominal, heldout=kept, platform=source.platform or None, plants=tuple(words.PLANTS)
        )
        tick("figures")
        flown = tracks.most_telling(kept or logs)
        with_slab = source.platform or any(log.contact is not None and log.contact.any() for log in logs)
        track = tracks.of(flown, nominal, d.corrected, left_out=bool(kept), platform=with_slab)
        versions = runs.versions()
        html = page(d, track, versions=versions, notes=notes)
        with styled():
            picture = figures.overview(d, track)
        tick("files")
    try:  # a full disk costs the files, not the answer
        with runs.staged_run(out) as folder:
            save_figure(picture, folder / "gap.png")
            model.write(d, nominal, folder, base=source.vehicle)
            run.write(folder, "gap", html, d.to_json(), source, began, versions)
    finally:
        terminal.show(d, notes)
    print(out / "report.html")
