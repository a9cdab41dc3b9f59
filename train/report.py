"""After a training run: what the final policy does, as tables, figures and a video."""

from __future__ import annotations

from pathlib import Path


def report(folder: Path, metrics: dict) -> None:
    """Write success table, figures and the landing video of `final.zip` into the run folder."""
