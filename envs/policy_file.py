"""The file of a policy: a zip of plain data with its network and the settings of its training.

inclined_landing.json   metadata: task, task options, origin; "network": activation, limits, number of layers
network/NAME.npy        arrays of floats: centre, scale, and of layer K from 0 weights_K (inputs, outputs) and
                        biases_K

`save_policy` and `landing-train` add these members to the file of Stable-Baselines3, from which training can
continue. Reading requires only NumPy, executes nothing from the file, and uses at most `LARGEST` bytes of
memory for a member.
"""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta, Struct

from inclined_landing.models.base import schema, storage
from inclined_landing.models.base.errors import UserError, shown

ACTIVATIONS = ("Tanh", "ReLU")  # index is the code in the compiled loop of `Policy`
DEEPEST = 16  # layers
METADATA = "inclined_landing.json"
LARGEST = 100_000_000  # bytes of a policy file, and of any member
_LARGEST_TABLE = 10_000_000  # bytes of a member in JSON
_MEMBERS = 4096
_NETWORK = "network"  # entry of the metadata, and folder of the arrays
_Limit = Annotated[float, Meta(gt=0, le=1e300)]
_Word = Annotated[str, Meta(max_length=99)]
_DAMAGED = (
    *(zipfile.BadZipFile, zipfile.LargeZipFile, zlib.error, struct.error),
    *(OSError, EOFError, ValueError, RuntimeError, LookupError, OverflowError),
)


class _Network(schema.Table, frozen=True):
    """The entry "network" of the metadata; see `Policy` for its fields. A missing limit is infinite."""

    layers: Annotated[int, Meta(ge=1, le=DEEPEST)]
    activation: Literal["Tanh", "ReLU"]
    squashed: bool
    limit: _Limit | None = None
    bound: _Limit | None = None


class _Metadata(Struct):
    """The metadata that are used; other entries record the origin of a policy."""

    task: _Word | None = None
    task_options: dict[str, Annotated[float, Meta(gt=-1e9, lt=1e9)] | _Word | bool | None] = {}
    network: _Network | None = None


def write(path: Path, metadata: dict, network: dict[str, Any]) -> None:
    """Add a policy to the zip at `path`; network: the fields of `Policy` that make up its network."""
    layers = len(network["weights"])
    entry = {name: network[name] for name in ("activation", "squashed", "limit", "bound")} | {
        "layers": layers
    }
    flat = [network["centre"], network["scale"]]
    for layer in zip(network["weights"], network["biases"]):
        flat += layer
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(METADATA, storage.to_json(metadata | {_NETWORK: entry}))
        for name, array in zip(_members(layers), flat):
            single = array.astype(np.float32)
            with archive.open(name, "w") as file:
                array = single if np.array_equal(single, array) else array
                np.lib.format.write_array(file, array, allow_pickle=False)


def open_file(path: Path) -> zipfile.ZipFile:
    """Return the zip of a policy file; raises UserError for anything else."""
    return open_zip(storage.read_bytes(path, "policy", LARGEST), f"policy {path}")


def read(archive: zipfile.ZipFile, path: Path) -> tuple[dict, dict[str, Any] | None]:
    """Return the metadata of a policy file (may be empty), and its network in the form that `write` accepts.

    The network is None for a plain file of Stable-Baselines3. Raises UserError for a damaged file.
    """
    metadata = read_table(archive, METADATA, path)
    entry = schema.parse(metadata, _Metadata, f"policy {path}: its {METADATA}: ").network
    metadata.pop(_NETWORK, None)
    if entry is None:
        return metadata, None
    centre, scale, *layers = (_read_array(archive, name, path) for name in _members(entry.layers))
    return metadata, {
        "centre": centre,
        "scale": scale,
        "limit": np.inf if entry.limit is None else entry.limit,
        "weights": tuple(layers[::2]),
        "biases": tuple(layers[1::2]),
        "activation": entry.activation,
        "squashed": entry.squashed,
        "bound": np.inf if entry.bound is None else entry.bound,
    }


def _members(layers: int) -> list[str]:
    """Return the members that contain the arrays of a network."""
    names = ["centre", "scale", *(f"{part}_{k}" for k in range(layers) for part in ("weights", "biases"))]
    return [f"{_NETWORK}/{name}.npy" for name in names]


def _read_array(archive: zipfile.ZipFile, name: str, path: Path) -> np.ndarray:
    """Return an array of floats in float64."""
    content = io.BytesIO(read_member(archive, name, f"policy {path}"))
    try:
        array = np.lib.format.read_array(content, allow_pickle=False)
    except Exception as error:  # whatever NumPy raises for bytes that make no sense
        raise UserError(f"policy {path}: {name} in it is damaged") from error
    if array.dtype not in (np.float32, np.float64):
        raise UserError(f"policy {path}: {name} in it is not an array of floats")
    return np.array(array, np.float64, order="C")


def read_table(archive: zipfile.ZipFile, name: str, path: Path) -> dict:
    """Return a member that is a JSON table; an empty one if it is missing."""
    if name not in archive.namelist():
        return {}
    content = read_member(archive, name, f"policy {path}", _LARGEST_TABLE)
    value = storage.parse_json(content, f"policy {path}: {name} in it")
    if not isinstance(value, dict):
        raise UserError(f"policy {path}: {name} in it is not a table")
    return value


def open_zip(content: bytes, what: str) -> zipfile.ZipFile:
    """Return the zip in `content`; raises UserError, beginning with `what`, unless its members are few and
    their names unique.
    """
    if content.count(b"PK\x01\x02") > _MEMBERS:
        raise UserError(f"{what} has more than {_MEMBERS} members")
    try:
        archive = zipfile.ZipFile(io.BytesIO(content))
    except _DAMAGED as error:
        raise UserError(f"{what} is not a zip file, or is damaged") from error
    names = archive.namelist()
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise UserError(f"{what}: {shown(twice, 60)} appears twice")
    return archive


def read_member(archive: zipfile.ZipFile, name: str, what: str, largest: int = LARGEST) -> bytes:
    """Return a member of a zip; raises UserError, beginning with `what`, if that is impossible."""
    label = f"{what}: {shown(name, 60)} in it"
    if name not in archive.namelist():
        raise UserError(f"{what} lacks {shown(name, 60)}")
    if archive.getinfo(name).compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise UserError(f"{label} uses a compression that policy files do not have")
    try:
        with archive.open(name) as file:
            content = file.read(largest + 1)
    except _DAMAGED as error:
        raise UserError(f"{label} is damaged") from error
    if len(content) > largest:
        raise UserError(f"{label} has more than {largest} bytes")
    return content
