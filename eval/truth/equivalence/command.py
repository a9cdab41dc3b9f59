"""`landing-eval validate equivalence`: every measurement, one page, one JSON file and the figures."""

from __future__ import annotations

import math
import time
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from inclined_landing.envs.policy import load_policy
from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.tables import say
from inclined_landing.eval.base.claims import Claim, number, verdict_words
from inclined_landing.eval.base.page import png
from inclined_landing.eval.truth.equivalence import report
from inclined_landing.models import storage
from inclined_landing.models.parameters import load_vehicle


def command(out: Path, policy: str, vehicle: Path | None, seed: int, quick: bool) -> int:
    """Write report.html, report.json and the figures into a new folder; return 1 when a claim fails, else 0.

    See `validate.Equivalence` for the options.
    """
    runs.check_new_run(out)
    loaded = load_policy(policy, "landing", vehicle=None if vehicle is None else load_vehicle(vehicle))
    began = time.monotonic()
    console = Console(stderr=True)
    columns = (TextColumn("{task.description:18}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=report.TICKS)
        sections, drawn = report.measure(
            loaded, seed=seed, quick=quick, tick=lambda text: bar.update(task, advance=1, description=text)
        )
        images = {name: png(figure) for name, figure in drawn.items()}
    record = report.as_record(
        sections,
        policy=str(loaded.path),
        vehicle=str(vehicle) if vehicle is not None else "crazyflie.toml",
        seed=int(seed),
        quick=quick,
        seconds=round(time.monotonic() - began, 1),
        versions=runs.versions(),
    )
    page = report.as_page(sections, images, record)
    with runs.staged_run(out) as folder:
        for name, data in images.items():
            storage.write_bytes(folder / name, data)
        storage.write_json(folder / "report.json", record)
        storage.write_text(folder / "report.html", page)
    failed = [c for s in sections for c in s.claims if not c.passed]
    say(*(f"fails: {c.name}: {_measured(c)}, tolerance {c.tolerance}" for c in failed))
    verdict = verdict_words([c for s in sections for c in s.claims])
    say(f"{verdict} It took {record['seconds']:.0f} s; the page is {out / 'report.html'}.")
    return 1 if failed else 0


def _measured(claim: Claim) -> str:
    return f"{number(claim.measured)} {claim.unit}" if math.isfinite(claim.measured) else "not a number"
