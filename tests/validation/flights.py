"""`flights`: where public flights are, and under which licence."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path


@dataclasses.dataclass(frozen=True)
class PublicSet:
    """A set of flights that others published, whose files a shipped mapping reads."""

    title: str
    repository: str
    commit: str
    files: str  # of the repository, as a shell would find them
    licence: str
    cite: str

    @property
    def folder(self) -> str:
        """Return the name of a clone."""
        return self.repository.rpartition("/")[2]


@cache
def public_sets() -> Mapping[str, PublicSet]:
    """Return the known sets by name."""
    table = tomllib.loads(Path(__file__).with_name("public_sets.toml").read_text("utf-8"))
    return {name: PublicSet(**entry) for name, entry in table.items()}


def command() -> None:
    """List public sets of measured flights: where they are, their licences, and how they are read."""
    for name, known in public_sets().items():
        clone = f"git clone {known.repository} && git -C {known.folder} checkout {known.commit[:7]}"
        print(f"{name}: {known.title}\n  {clone}\n  landing-eval logs {known.folder}/{known.files}")
        print(f"  licence: {known.licence}\n  cite: {known.cite}\n")
    print(f"{len(public_sets())} sets of measured flights are available: {', '.join(public_sets())}.")
