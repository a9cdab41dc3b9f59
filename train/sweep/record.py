"""A result written back into its recipe, whose comments and order stay."""

from __future__ import annotations

import os
from pathlib import Path

from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown


def check(path: Path) -> None:
    """Raise UserError where `write` could not write."""
    storage.check_file(path)
    if not os.access(path, os.W_OK):
        raise UserError(f"--record: {shown(path, 200)} cannot be written")


def write(path: Path, result: dict) -> None:
    """Put `result` into the recipe as its table [result]."""
    import tomlkit

    document = tomlkit.parse(storage.read_text(path, "recipe"))
    table = tomlkit.table()
    for name, value in result.items():
        table.add(name, _rows(value) if name in ("measured", "runs") else _plain(value))
    document.pop("result", None)
    text = tomlkit.dumps(document).rstrip("\n")
    document = tomlkit.parse(text + "\n\n")
    document.add("result", table)
    storage.write_text(path, tomlkit.dumps(document))


def _rows(entries: list[dict]):
    """Return a list with a table in each line."""
    import tomlkit

    array = tomlkit.array()
    for entry in entries:
        row = tomlkit.inline_table()
        row.update({key: _plain(value) for key, value in entry.items()})
        array.add_line(row)
    array.add_line(indent="")
    return array


def _plain(value):
    """Return numbers with six digits, the noise of clocks and loads left out."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    return value
