"""`landing-eval contact-truth`: all measurements as a page, a JSON file and figures."""

from __future__ import annotations

from collections.abc import Callable
from importlib import resources
from pathlib import Path

import jinja2
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from inclined_landing.eval.base import runs
from inclined_landing.eval.base.style import save_figure
from inclined_landing.eval.pictures.figures import contact as figures
from inclined_landing.eval.truth.contact_truth import touchdowns
from inclined_landing.eval.truth.contact_truth.checks import Finding
from inclined_landing.eval.truth.contact_truth.laws import FINDINGS, setting
from inclined_landing.models import storage
from inclined_landing.models.parameters import load_vehicle

TITLE = "Contact: what can be believed"


def run(
    out: Path,
    flights: Path | None = None,
    *,
    friction: float | None = None,
    restitution: float | None = None,
    contact_time: float | None = None,
) -> None:
    """Measure, and write contact.html, contact.json and the figures into the new folder `out`.

    flights: folder of measured NanoBench flights. friction, restitution, contact_time [s]: a setting of the
    user, measured besides the default. Raises UserError before anything is measured when the
    folder for the results or that of the flights cannot be used.
    """
    runs.check_new_run(out)
    if flights is not None:
        touchdowns.read_flights(flights)
    chosen = (friction, restitution, contact_time)
    own = [] if chosen == (None, None, None) else [setting(*chosen)]
    console = Console(stderr=True)
    with Progress(console=console, transient=True) as progress:
        bar = progress.add_task("", total=len(FINDINGS) + (flights is not None))
        findings = own + measure(flights, lambda name: progress.update(bar, description=name, advance=1))
    out = runs.new_run(out)
    write(findings, out)
    table = Table("check", "measured", "asked for", "unit", "")
    for finding in findings:
        for check in finding.checks:
            verdict = "met" if check.met else "[bold]not met[/bold]"
            table.add_row(check.name, f"{check.measured:.3g}", check.asked, check.unit, verdict)
    Console().print(table)
    print(out / "contact.html")


def measure(flights: Path | None = None, tick: Callable[[str], None] = lambda name: None) -> list[Finding]:
    """Every finding; `tick` is called with the name of each before it is measured."""
    findings = []
    for name, measurement in FINDINGS.items():
        tick(name)
        findings.append(measurement())
    if flights is not None:
        tick("touchdowns")
        findings.append(touchdowns.finding(flights))
    return findings


def write(findings: list[Finding], out: Path) -> None:
    """contact.html, contact.json and one PNG for each finding that has a figure."""
    drawn = [finding.key for finding in findings if finding.key in figures.DRAW]
    for finding in findings:
        if finding.key in drawn:
            save_figure(figures.DRAW[finding.key](finding.data), out / f"{finding.key}.png")
    versions = runs.versions()
    storage.write_json(
        out / "contact.json",
        {
            "findings": {
                f.key: {"checks": [check.record() for check in f.checks], "data": f.data} for f in findings
            },
            "versions": versions,
        },
    )
    vehicle = load_vehicle()
    template = (
        resources.files("inclined_landing.eval.truth.contact_truth")
        .joinpath("report.html.j2")
        .read_text("utf-8")
    )
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    checks = [check for finding in findings for check in finding.checks]
    page = environment.from_string(template).render(
        title=TITLE,
        setting=f"friction {vehicle.contact_friction:g}, solref {vehicle.contact_solref[0]:g} s, "
        f"{vehicle.contact_solref[1]:g}",
        findings=findings,
        figures=drawn,
        met=sum(check.met for check in checks),
        total=len(checks),
        versions=versions,
    )
    storage.write_text(out / "contact.html", page)
