"""Types of single options with their limits, and the names of options in sentences."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro
from msgspec import Meta

Seed = Annotated[int, Meta(ge=0, le=2**32 - 1)]
Flag = tyro.conf.FlagCreatePairsOff[bool]
RUN_FOLDER = "run folder"  # marks options whose folder belongs to the command while it runs, see `runs.owned`
RunFolder = Annotated[Path, tyro.conf.arg(metavar="DIR"), RUN_FOLDER]
NewFolder = Annotated[Path | None, tyro.conf.arg(metavar="DIR"), RUN_FOLDER]


def flag_of(name: str) -> str:
    """Return how an option is written on the command line."""
    return "--from" if name == "start_from" else f"--{name.replace('_', '-')}"
