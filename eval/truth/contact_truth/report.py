"""Findings about contact as a page, a JSON file and figures."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import jinja2

from inclined_landing.eval.base import runs
from inclined_landing.eval.base.style import save_figure
from inclined_landing.eval.pictures.figures import contact as figures
from inclined_landing.eval.truth.contact_truth.checks import Finding
from inclined_landing.models import storage
from inclined_landing.models.parameters import Vehicle

TITLE = "Contact: what can be believed"


def write(findings: list[Finding], out: Path, vehicle: Vehicle) -> None:
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
