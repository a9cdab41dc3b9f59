"""Common parts of both sets of claims: `claims.toml`, measurement, page and JSON."""

from __future__ import annotations

import math
import shlex
import sys
import threading
import tomllib
from collections.abc import Callable, Mapping
from importlib import resources
from pathlib import Path

from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.progress import stages
from inclined_landing.envs.shared.tables import say
from inclined_landing.eval.base.claims import Claim, Section, number
from inclined_landing.eval.base.page import of_sections, png
from inclined_landing.models.base import storage
from inclined_landing.models.threads import in_threads


class Words:
    """The text of the sections and claims of a package: `claims.toml` next to its code.

    A table is a section with `title`, `text` and optionally `remarks` and the caption of its `figure` (a PNG
    file of its name); a table in it is a claim with `claim`, `unit`, `why` and one or both of its bounds
    `low` and `high`. Names in braces are replaced by values.
    """

    def __init__(self, package: str):
        self.tables = tomllib.loads(resources.files(package).joinpath("claims.toml").read_text("utf-8"))

    def claim(self, section: str, key: str, measured: float, **filling) -> Claim:
        """Return a claim with its measured value."""
        entry = self.tables[section][key]
        name, unit, why = (entry[word].format(**filling) for word in ("claim", "unit", "why"))
        return Claim(name, measured, entry.get("high", math.inf), unit, why, entry.get("low", -math.inf))

    def section(self, key: str, measured: dict[str, float] | list[Claim], filling=None, **rest) -> Section:
        """Return a section; measured: values by claim, or the claims themselves; rest: its other fields."""
        filling, entry = filling or {}, self.tables[key]
        if isinstance(measured, dict):
            claims = [self.claim(key, name, value, **filling) for name, value in measured.items()]
        else:
            claims = measured
        remarks = [text.format(**filling) for text in entry.get("remarks", [])]
        figures = {f"{key}.png": entry["figure"]} if "figure" in entry else {}
        fields = {"remarks": remarks, "figures": figures} | rest
        return Section(key, entry["title"], entry["text"].format(**filling), claims, **fields)


def check(
    out: Path, name: str, measurements: Mapping[str, Callable[[], Section]], *, title: str, lead: str
) -> int:
    """Measure all claims; write NAME.html, NAME.json and the figures into the new folder `out`.

    Prints the claims that do not hold. Returns the exit code, which is 1 if there are any.
    """
    sections, images = _measured(measurements)
    claims = [claim for section in sections for claim in section.claims]
    failed = [claim for claim in claims if not claim.passed]
    run, versions = shlex.join(["landing-eval", *sys.argv[1:]]), runs.versions()
    record = {
        "command": run,
        "versions": versions,
        "failed": [claim.name for claim in failed],
        "sections": {section.key: section.record() for section in sections},
    }
    with runs.staged_run(out) as folder:
        for file, image in images.items():
            storage.write_bytes(folder / file, image)
        storage.write_json(folder / f"{name}.json", record)
        page = of_sections(sections, images, title=title, lead=lead, run=run, versions=versions)
        storage.write_text(folder / f"{name}.html", page)
    for claim in failed:
        found = f"{number(claim.measured)} {claim.unit}" if math.isfinite(claim.measured) else "not a number"
        say(f"not met: {claim.name}: {found}, tolerance {claim.tolerance}")
    say(f"{len(claims) - len(failed)} of {len(claims)} claims hold. The page is {out / f'{name}.html'}.")
    return 1 if failed else 0


def _measured(
    measurements: Mapping[str, Callable[[], Section]],
) -> tuple[list[Section], dict[str, bytes]]:
    """Return the section of every measurement, in their order, and the figures as PNG files by name.

    Two are measured and drawn at a time: most of their time is the engine's, which runs without the
    interpreter's lock. After an interruption the second thread ends with the measurement that it has begun.
    """
    found: dict[str, Section] = {}
    images: dict[str, bytes] = {}
    left, drawing = iter(measurements.items()), threading.Lock()
    with stages(len(measurements)) as tick:

        def measure(_: int) -> None:
            for name, measurement in left:
                tick(name)
                found[name] = section = measurement()
                with drawing:  # matplotlib's settings are those of all threads
                    images.update({file: png(section.draw()) for file in section.figures if section.draw})

        try:
            in_threads(measure, range(2))
        finally:
            list(left)  # nothing else begins
    return [found[name] for name in measurements], images
