"""checkpoint.pt: all that a continuation needs, in one zip that appears whole and holds data only.

state.json   numbers and words: progress, random generators, curriculum, histories
NAME.npy     arrays: network, optimizer, vehicles, episodes, random states
best.zip     the policy of the best evaluation so far, if there was one

Reading runs nothing from the file. Entries are not compressed, so that it takes no more memory than the
file has bytes, and zip's checksums find a damaged byte.
"""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown

FORMAT = 1
_LARGEST = 2**30  # bytes


class Checkpoint(NamedTuple):
    """What a checkpoint holds."""

    state: dict  # JSON types, NaN allowed
    arrays: dict[str, np.ndarray]
    best: bytes | None


def write(path: Path, saved: Checkpoint) -> None:
    """Write a checkpoint, whole or not at all."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("state.json", json.dumps({"format": FORMAT} | saved.state))
        for name, array in saved.arrays.items():
            with archive.open(f"{name}.npy", "w") as file:
                np.lib.format.write_array(file, array, allow_pickle=False)
        if saved.best is not None:
            archive.writestr("best.zip", saved.best)
    storage.write_bytes(path, buffer.getvalue())


def read(path: Path) -> Checkpoint:
    """Read a checkpoint; raises UserError for a file that is damaged or none."""
    content = storage.read_bytes(path, "checkpoint", _LARGEST)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            entries = archive.infolist()
            names = [entry.filename for entry in entries]
            if len(set(names)) < len(names) or any(entry.compress_type for entry in entries):
                raise ValueError("entries are compressed or twice there")
            read = {name: archive.read(name) for name in names}
        state = json.loads(read.pop("state.json"))
        best = read.pop("best.zip", None)
        arrays = {name.removesuffix(".npy"): _array(data) for name, data in read.items()}
    except Exception as error:  # whatever zipfile, json and numpy raise for damaged bytes
        raise refused(path, f"is damaged or none ({_first_line(error)})") from error
    if not isinstance(state, dict) or state.pop("format", None) != FORMAT:
        raise refused(path, "was written by another version of this package")
    return Checkpoint(state, arrays, best)


def refused(path: Path, why: str) -> UserError:
    """Return the error for a checkpoint that cannot be continued."""
    return UserError(f"checkpoint {path} {shown(why, 120)}; begin a new run with another --out")


def check_array(array: np.ndarray, like: np.ndarray, name: str) -> None:
    """Raise UserError unless an array has the shape and type of `like`, and finite numbers if it has."""
    if array.shape != like.shape or array.dtype != like.dtype:
        raise UserError(f"{name} is {array.dtype} {array.shape}, not {like.dtype} {like.shape}")
    if array.dtype.kind == "f" and np.isfinite(like).all() and not np.isfinite(array).all():
        raise UserError(f"{name} holds NaN or infinity")


def check_names(found: dict, needed, what: str) -> None:
    """Raise UserError unless `found` is a table with exactly the names in `needed`."""
    if not isinstance(found, dict):
        raise UserError(f"{what} is not a table")
    for wrong, verb in ((set(needed) - set(found), "lacks"), (set(found) - set(needed), "has an unknown")):
        if wrong:
            raise UserError(f"{what} {verb} {shown(min(wrong, key=str), 60)!r}")


def check_number(value, name: str, low: float, high: float, whole: bool = True):
    """Return `value`; raises UserError unless it is a (whole) number from `low` to `high`."""
    kinds = int if whole else (int, float)
    if isinstance(value, bool) or not isinstance(value, kinds) or not low <= value <= high:
        raise UserError(f"{name} is {shown(repr(value), 40)}, not a number from {low:g} to {high:g}")
    return value


def _array(data: bytes) -> np.ndarray:
    file = io.BytesIO(data)
    array = np.lib.format.read_array(file, allow_pickle=False)
    if file.read(1):
        raise ValueError("an array is longer than it says")
    return array


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0] or type(error).__name__
