"""How policies are named on the command line, and what they are called in tables and figures."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path

from inclined_landing.envs.policy import SHIPPED
from inclined_landing.models.errors import UserError, shown

MOST_SEEDS, LONGEST_LABEL = 100, 40  # policies that count as one; characters of their name


@dataclasses.dataclass(frozen=True)
class Entry:
    """Policies that count as one, such as three seeds of a training."""

    label: str
    policies: tuple[str, ...]
    vehicle: str | None = None  # the only one that they are flown on; None: all, and the drawn ones


def parse_entry(text: str) -> Entry:
    """Return what LABEL=POLICY+POLICY, LABEL@VEHICLE=POLICY+POLICY or POLICY says.

    A POLICY is a file, a shipped policy or a run folder. Raises UserError for anything else.
    """
    head, _, files = text.partition("=")
    if not _labelled(text):
        file = policy_file(text)
        label = Path(text).name if file != text else text.rpartition("/")[2].removesuffix(".zip")
        return Entry(label, (file,))
    label, at, vehicle = head.partition("@")
    policies = tuple(map(policy_file, files.split("+")))
    if not (label and all(policies) and (vehicle or not at)):
        raise UserError(
            f"policies are written LABEL=POLICY+POLICY or LABEL@VEHICLE=POLICY, not {shown(repr(text), 60)}"
        )
    if len(label) > LONGEST_LABEL or not label.isprintable():
        raise UserError(f"label {shown(label, 40)}: at most {LONGEST_LABEL} printable characters are read")
    if len(policies) > MOST_SEEDS:
        raise UserError(f"{label} has {len(policies)} policies; at most {MOST_SEEDS} count as one")
    if len(set(policies)) < len(policies):
        raise UserError(f"{label} has a policy twice; each counts once")
    return Entry(label, policies, vehicle or None)


def parse_entries(texts: Sequence[str]) -> list[Entry]:
    """Return an entry for each text; files of the same name are told apart by their folders.

    Raises UserError where two policies without a LABEL could still not be told apart.
    """
    entries = [parse_entry(text) for text in texts]
    plain = [not _labelled(text) for text in texts]
    labels = [entry.label for entry in entries]
    for k, entry in enumerate(entries):
        if plain[k] and labels.count(entry.label) > 1:
            folder = Path(entry.policies[0]).parent.name
            entries[k] = dataclasses.replace(
                entry, label=f"{folder}/{entry.label}" if folder else entry.label
            )
        if plain[k] and entries[k].label in [other.label for other in entries[:k]]:
            raise UserError(f"policy {shown(entries[k].label, 100)} is named twice")
    return entries


def _labelled(text: str) -> bool:
    """Return whether this is LABEL=POLICY, and not a file with such a name."""
    return "=" in text and not os.path.exists(text)


def policy_file(policy: str) -> str:
    """Return the final policy of a run folder; anything else as it is."""
    final = Path(policy) / "final.zip"
    return str(final) if policy and policy not in SHIPPED and final.is_file() else policy
