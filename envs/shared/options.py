"""Types of individual options with their limits, and the names of options in messages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import tyro
from msgspec import Meta

Seed = Annotated[int, Meta(ge=0, le=2**32 - 1)]
Flag = tyro.conf.FlagCreatePairsOff[bool]
RUN_FOLDER = "run folder"  # marks options whose folder belongs to the command while it runs, see `runs.owned`
RunFolder = Annotated[Path, tyro.conf.arg(metavar="DIR"), RUN_FOLDER]
NewFolder = Annotated[Path | None, tyro.conf.arg(metavar="DIR"), RUN_FOLDER]


def flag_of(name: str) -> str:
    """Return the command-line form of an option."""
    return "--from" if name == "start_from" else f"--{name.replace('_', '-')}"


class Only(NamedTuple):
    """Marks an option, or a group of options, that has an effect only with certain values of other options.

    `command_line.parse` refuses it elsewhere.
    """

    holds: Callable[[Mapping[str, Any]], Any]  # from the values of all options by name
    otherwise: str  # goes on after "has no effect"


def only_with(name: str, *choices: str) -> Only:
    """Return the mark of an option that needs another one, or one of some choices among its values."""
    if choices:
        words = f"without {flag_of(name)} {' or '.join(choices)}"
        return Only(lambda values: not set(choices).isdisjoint(values[name]), words)
    return Only(lambda values: values[name], f"without {flag_of(name)}")


def only_without(name: str) -> Only:
    """Return the mark of an option that another one overrules."""
    return Only(lambda values: not values[name], f"with {flag_of(name)}")
