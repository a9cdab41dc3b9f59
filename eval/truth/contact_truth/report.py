"""Findings about contact as a page, a JSON file and figures."""

from __future__ import annotations

import inspect
from pathlib import Path

from inclined_landing.envs.shared import runs
from inclined_landing.eval.base.claims import Claim, Section
from inclined_landing.eval.base.page import claims_page
from inclined_landing.eval.base.style import save_figure
from inclined_landing.eval.pictures.figures import contact as figures
from inclined_landing.models import storage
from inclined_landing.models.vehicle import Vehicle


def write(findings: list[Section], out: Path, vehicle: Vehicle) -> None:
    """Write contact.html, contact.json and one PNG for each finding that has a figure."""
    images = {}
    for finding in findings:
        if finding.key in figures.DRAW:
            draw = figures.DRAW[finding.key]
            file = save_figure(draw(finding.data), out / f"{finding.key}.png")
            finding.figures = {file.name: inspect.getdoc(draw) or ""}
            images[file.name] = file.read_bytes()
    versions = runs.versions()
    record = {f.key: {"checks": [_plain(c) for c in f.claims], "data": f.data} for f in findings}
    storage.write_json(out / "contact.json", {"findings": record, "versions": versions})
    setting = (
        f"friction {vehicle.contact_friction:g}, solref {vehicle.contact_solref[0]:g} s, "
        f"{vehicle.contact_solref[1]:g}"
    )
    page = claims_page(
        "Contact: what can be believed",
        f"The vehicle of this package in MuJoCo, contact setting {setting}, RK4 at 4 ms unless a line says "
        "otherwise. What is not met is a limit to know about, and stays in the table.",
        findings,
        images,
        verdicts={True: ("met", "are met"), False: ("not met", "are not met")},
        run="landing-eval validate contact",
        versions=versions,
    )
    storage.write_text(out / "contact.html", page)


def _plain(claim: Claim) -> dict:
    """Return the entry of contact.json."""
    return {
        "name": claim.name,
        "measured": claim.measured,
        "unit": claim.unit,
        "high": claim.high,
        "note": claim.why,
        "low": claim.low,
        "met": claim.passed,
    }
