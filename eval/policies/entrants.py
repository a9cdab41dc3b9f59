"""How policies are named on the command line, and what they are called in tables and figures."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path

from inclined_landing.models.errors import UserError, shown


@dataclasses.dataclass(frozen=True)
class Entrant:
    """Policies that count as one, such as three seeds of a training."""

    label: str
    policies: tuple[str, ...]
    vehicle: str | None = None  # the only one that they are flown on; None: all, and the drawn ones

    @property
    def only(self) -> str:
        """Return the one policy; raises UserError where it has several."""
        if len(self.policies) > 1:
            raise UserError(f"{self.label}: several policies, A+B, count as one with --over vehicles alone")
        return self.policies[0]


def parse_entrant(text: str) -> Entrant:
    """Return what LABEL=POLICY+POLICY, LABEL@VEHICLE=POLICY+POLICY or POLICY says.

    A POLICY is a file, a shipped policy or a run folder. Raises UserError for anything else.
    """
    if not _labelled(text):
        return Entrant(Path(text).name.removesuffix(".zip"), (text,))
    head, _, files = text.partition("=")
    label, at, vehicle = head.partition("@")
    policies = tuple(files.split("+"))
    well_written = label and all(policies) and (vehicle or not at) and len(set(policies)) == len(policies)
    if not (well_written and label.isprintable()):
        raise UserError(
            "policies are written LABEL=POLICY+POLICY or LABEL@VEHICLE=POLICY, each policy once, not "
            f"{shown(repr(text), 60)}"
        )
    return Entrant(label, policies, vehicle or None)


def parse_entrants(texts: Sequence[str]) -> list[Entrant]:
    """Return an entrant for each text; files of the same name are told apart by their folders.

    Entrants with the same LABEL may be of different vehicles. Raises UserError where two policies without a
    LABEL could still not be told apart.
    """
    entrants = [parse_entrant(text) for text in texts]
    labels = [entrant.label for entrant in entrants]
    for k, (text, entrant) in enumerate(zip(texts, entrants)):
        if _labelled(text):
            continue
        folder = Path(text).parent.name
        if labels.count(entrant.label) > 1 and folder:
            entrants[k] = dataclasses.replace(entrant, label=f"{folder}/{entrant.label}")
        if entrants[k].label in [other.label for other in entrants[:k]]:
            raise UserError(f"policy {shown(entrants[k].label, 100)} is named twice")
    return entrants


def _labelled(text: str) -> bool:
    """Return whether this is LABEL=POLICY, and not a file with such a name."""
    return "=" in text and not os.path.exists(text)
