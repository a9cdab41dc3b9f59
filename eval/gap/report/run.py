"""The record of a run of `gap` or `identify`."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path

from inclined_landing.eval.base.options import FlightSource
from inclined_landing.models.base import storage


def write(
    folder: Path, command: str, page: str, answer: dict, source: FlightSource, began: float, versions: dict
) -> None:
    """Write report.html, report.json and run.json: the command, its options, its time, the versions."""
    storage.write_text(folder / "report.html", page)
    storage.write_json(folder / "report.json", answer)
    statistics = {"seconds": round(time.monotonic() - began, 1), "versions": versions}
    storage.write_json(folder / "run.json", {"command": command, **dataclasses.asdict(source), **statistics})
