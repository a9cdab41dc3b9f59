"""`landing-eval validate contact`: all measurements as a page, a JSON file and figures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rich.console import Console
from rich.progress import Progress
from rich.text import Text

from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.tables import new_table, say, show_table
from inclined_landing.eval.base.claims import Section, verdict_words
from inclined_landing.eval.truth.contact_truth import touchdowns
from inclined_landing.eval.truth.contact_truth.laws import FINDINGS, setting
from inclined_landing.eval.truth.contact_truth.report import write
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.vehicle import Vehicle


def command(
    out: Path,
    flights: Path | None,
    vehicle: Path | None,
    friction: float | None,
    restitution: float | None,
    contact_time: float | None,
) -> None:
    """Write contact.html, contact.json and the figures into a new folder, and print the claims.

    See `validate.Contact` for the options.
    """
    runs.check_new_run(out)
    dropped = load_vehicle(vehicle)
    if flights is not None:
        touchdowns.read_flights(flights)
    chosen = (friction, restitution, contact_time)
    own = [] if chosen == (None, None, None) else [setting(dropped, *chosen)]
    console = Console(stderr=True)
    with Progress(console=console, transient=True) as progress:
        bar = progress.add_task("", total=len(FINDINGS) + (flights is not None))
        findings = own + measure(
            dropped, flights, lambda name: progress.update(bar, description=name, advance=1)
        )
    with runs.staged_run(out) as folder:
        write(findings, folder, dropped)
    table = new_table(None, "claim", "measured", "tolerance", "unit", "")
    for finding in findings:
        for claim in finding.claims:
            verdict = "met" if claim.passed else Text("not met", "bold")
            table.add_row(claim.name, f"{claim.measured:.3g}", claim.tolerance, claim.unit, verdict)
    show_table(table)
    claims = [claim for finding in findings for claim in finding.claims]
    say(f"{verdict_words(claims)} The page is {out / 'contact.html'}.")


def measure(
    vehicle: Vehicle, flights: Path | None = None, tick: Callable[[str], None] = lambda name: None
) -> list[Section]:
    """Return every finding; `tick` is called with the name of each before it is measured."""
    findings = []
    for name, measurement in FINDINGS.items():
        tick(name)
        findings.append(measurement(vehicle))
    if flights is not None:
        tick("touchdowns")
        findings.append(touchdowns.finding(flights, vehicle))
    return findings
