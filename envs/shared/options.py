"""Types of single options with their limits, and the names of options in sentences."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro
from msgspec import Meta

Seed = Annotated[int, Meta(ge=0, le=2**32 - 1)]
Flag = tyro.conf.FlagCreatePairsOff[bool]
NewFolder = Annotated[Path | None, tyro.conf.arg(metavar="DIR")]


def flag_of(name: str) -> str:
    """Return how an option is written on the command line."""
    return "--from" if name == "start_from" else f"--{name.replace('_', '-')}"
