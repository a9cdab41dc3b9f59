"""`landing-eval gap` and `landing-eval identify`: logs in; report, vehicle file and a few sentences out."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from inclined_landing.eval.base import runs
from inclined_landing.eval.base.style import save_figure, styled
from inclined_landing.eval.gap import diagnose
from inclined_landing.eval.gap.answer.identify import identify as identify_vehicle
from inclined_landing.eval.gap.flights.reading import read_flights
from inclined_landing.eval.gap.report import figures, identified, model, terminal, tracks
from inclined_landing.eval.gap.report.page import page
from inclined_landing.models import storage
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
    given = {key: value for key, value in locals().items() if key != "out"}
    runs.check_new_run(out)
    nominal = load_vehicle(vehicle)
    began = time.monotonic()
    with _progress(len(files) + len(heldout) + 3) as tick:
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
    try:  # a full disk costs the files, not the answer
        with runs.staged_run(out) as folder:
            storage.write_text(folder / "report.html", html)
            storage.write_json(folder / "report.json", d.to_json())
            save_figure(picture, folder / "gap.png")
            model.write(d, nominal, folder, base=vehicle)
            _write_run(folder, "gap", began, versions, given)
    finally:
        terminal.show(d, notes)
    print(out / "report.html")


def identify(
    files: Sequence[str],
    out: Path,
    *,
    heldout: Sequence[str] = (),
    vehicle: Path | None = None,
    mapping: str | None = None,
    units: Sequence[str] = (),
    platform: bool = False,
) -> None:
    """Fit the vehicle's own constants and write the new folder `out`; arguments and errors as for `run`."""
    given = {key: value for key, value in locals().items() if key != "out"}
    runs.check_new_run(out)
    nominal = load_vehicle(vehicle)
    began = time.monotonic()
    with _progress(len(files) + len(heldout) + 2) as tick:
        logs, kept, notes = read_flights(files, heldout, mapping=mapping, units=units, tick=tick)
        tick("fit")
        found = identify_vehicle(logs, nominal, heldout=kept, platform=platform)
        tick("page")
        versions = runs.versions()
        html = identified.page(
            found,
            heldout=[log.name for log in kept],
            seconds=time.monotonic() - began,
            versions=versions,
            notes=notes,
        )
    try:
        with runs.staged_run(out) as folder:
            storage.write_text(folder / "report.html", html)
            storage.write_json(folder / "report.json", found.to_json())
            identified.write(found, folder, base=vehicle)
            _write_run(folder, "identify", began, versions, given)
    finally:
        identified.show(found, notes)
    print(out / model.VEHICLE)


@contextlib.contextmanager
def _progress(total: int) -> Iterator[Callable[[str], None]]:
    """A bar of `total` parts; calling what it gives names the next one."""
    console = Console(stderr=True)
    with Progress(*_COLUMNS, console=console, transient=True, disable=not console.is_terminal) as progress:
        bar = progress.add_task("", total=total)
        yield lambda what: progress.update(bar, description=what, advance=1)


def _write_run(folder: Path, command: str, began: float, versions: dict, given: dict) -> None:
    seconds = round(time.monotonic() - began, 1)
    storage.write_json(
        folder / "run.json", {"command": command, **given, "seconds": seconds, "versions": versions}
    )
