"""`landing-eval gap`: logs in; report, corrected model and a few sentences out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from inclined_landing.eval import runs
from inclined_landing.eval.figures.style import save_figure, styled
from inclined_landing.eval.gap import diagnose
from inclined_landing.eval.gap.reading import read_flights
from inclined_landing.eval.gap.report import figures, model, terminal, tracks
from inclined_landing.eval.gap.report.page import page
from inclined_landing.models.parameters import load_vehicle

_COLUMNS = (TextColumn("{task.description:22}"), BarColumn(), TimeElapsedColumn())
PLANTS = ("analytic", "mujoco")


def run(
    files: Sequence[str],
    out: Path,
    *,
    heldout: Sequence[str] = (),
    vehicle: Path | None = None,
    mapping: str | None = None,
    units: Sequence[str] = (),
    platform: bool = False,
) -> None:
    """Diagnose flights and write the new folder `out`.

    heldout: logs only judged on. platform: the slab of the vehicle file stood there (else only where a log
    has contacts). Raises UserError when a log, the vehicle or the folder cannot be used.
    """
    runs.check_new_run(out)
    nominal = load_vehicle(vehicle)
    began = time.monotonic()
    with Progress(*_COLUMNS, console=Console(stderr=True), transient=True) as progress:
        bar = progress.add_task("", total=len(files) + len(heldout) + 3)

        def tick(what: str) -> None:
            progress.update(bar, description=what, advance=1)

        logs, kept, notes = read_flights(files, heldout, mapping=mapping, units=units, tick=tick)
        tick("diagnosis")
        d = diagnose(logs, nominal, heldout=kept, platform=platform or None, plants=PLANTS)
        tick("figures")
        flown = tracks.most_telling(kept or logs)
        with_slab = platform or any(log.contact is not None and log.contact.any() for log in logs)
        track = tracks.of(flown, nominal, d.corrected, left_out=bool(kept), platform=with_slab)
        versions = runs.versions()
        html = page(d, track, versions=versions, notes=notes)
        with styled():
            picture = figures.overview(d, track)
        tick("files")
    terminal.show(d, notes)  # before anything is written: a full disk costs the files, not the answer
    with runs.staged_run(out) as folder:
        runs.write_text(folder / "report.html", html)
        runs.write_json(folder / "report.json", d.to_json())
        save_figure(picture, folder / "gap.png")
        model.write(d, nominal, folder, base=vehicle)
        runs.write_json(
            folder / "run.json",
            {
                "command": "gap",
                "logs": list(files),
                "heldout": list(heldout),
                "vehicle": vehicle,
                "mapping": mapping,
                "units": list(units),
                "platform": platform,
                "seconds": round(time.monotonic() - began, 1),
                "versions": versions,
            },
        )
    print(out / "report.html")
