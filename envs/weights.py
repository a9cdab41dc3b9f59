"""Reader of a policy file: metadata, header, tensors, without torch and without running anything from it.

Stable-Baselines3 keeps the network as a zip that torch writes: `data.pkl`, a pickle that says how tensors
lie in storages, and one member for each storage. The pickle is not loaded: the few instructions that torch
writes for a table of dense float tensors are carried out here, everything else is refused. Sizes are
compared with what the zip says before anything is read, so that no file takes more memory than `LARGEST`.
"""

from __future__ import annotations

import io
import math
import pickletools
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown

METADATA = "inclined_landing.json"  # member: what the policy was trained for; a plain SB3 file has none
LARGEST = 100_000_000  # bytes of a policy file, and of any member
_LARGEST_TABLE = 10_000_000  # bytes of the header and of the metadata
_HEADER, _NETWORK = "data", "policy.pth"  # members that Stable-Baselines3 writes
_PICKLE = 1_000_000  # bytes of data.pkl
_MEMBERS = 4096  # of a file, those of zips inside it counted too
_DIMENSIONS = 8
_FLOATS = {"torch FloatStorage": "<f4", "torch DoubleStorage": "<f8"}
_DAMAGED = (
    *(zipfile.BadZipFile, zipfile.LargeZipFile, zlib.error, struct.error),
    *(OSError, EOFError, ValueError, RuntimeError, KeyError, IndexError, OverflowError),
)


class PolicyFile(NamedTuple):
    """What a policy file holds, unchecked but for the tensors, which are finite."""

    metadata: dict
    header: dict
    tensors: dict[str, np.ndarray]


def read_file(path: Path) -> PolicyFile:
    """Return the content of a policy file; raises UserError where it is none or damaged."""
    with open_policy(path) as archive:
        metadata, header = _read_table(archive, METADATA, path), _read_table(archive, _HEADER, path)
        content = read_member(archive, _NETWORK, f"policy {path}")
    tensors = read_tensors(content, f"policy {path}: {_NETWORK} in it")
    if not all(np.isfinite(array).all() for array in tensors.values()):
        raise UserError(f"policy {path} has weights that are NaN or infinite")
    return PolicyFile(metadata, header, tensors)


def read_metadata(path: Path) -> dict:
    """Return the metadata of a policy file; empty for a plain Stable-Baselines3 file."""
    with open_policy(path) as archive:
        return _read_table(archive, METADATA, path)


def open_policy(path: Path) -> zipfile.ZipFile:
    """Return the zip of a policy file; raises UserError where it is none."""
    archive = open_zip(storage.read_bytes(path, "policy", LARGEST), f"policy {path}")
    missing = {_HEADER, _NETWORK} - set(archive.namelist())
    if missing:
        raise UserError(
            f"policy {path} is not a Stable-Baselines3 policy: the zip lacks " + " and ".join(sorted(missing))
        )
    return archive


def _read_table(archive: zipfile.ZipFile, name: str, path: Path) -> dict:
    """Return a member that is a table of JSON; empty where it is missing."""
    if name not in archive.namelist():
        return {}
    content = read_member(archive, name, f"policy {path}", _LARGEST_TABLE)
    value = storage.parse_json(content, f"policy {path}: {name} in it")
    if not isinstance(value, dict):
        raise UserError(f"policy {path}: {name} in it is not a table")
    return value


def open_zip(content: bytes, what: str) -> zipfile.ZipFile:
    """Return the zip in `content`; raise UserError, beginning with `what`, for anything but plain unique
    members.
    """
    if content.count(b"PK\x01\x02") > _MEMBERS:
        raise UserError(f"{what} has more than {_MEMBERS} members")
    try:
        archive = zipfile.ZipFile(io.BytesIO(content))
    except _DAMAGED as error:
        raise UserError(f"{what} is not a zip file, or a damaged one") from error
    members = archive.infolist()
    names = [member.filename for member in members]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise UserError(f"{what}: {shown(twice, 60)} is in it twice")
    if sum(member.compress_size for member in members) > len(content):
        raise UserError(f"{what} is damaged: its members overlap")
    return archive


def read_member(archive: zipfile.ZipFile, name: str, what: str, largest: int = LARGEST) -> bytes:
    """Return one member; raise UserError, beginning with `what`, if damaged, encrypted or above `largest`."""
    member = archive.getinfo(name)
    label = f"{what}: {shown(name, 60)} in it"
    if member.flag_bits & 1:
        raise UserError(f"{label} is encrypted")
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise UserError(f"{label} is compressed in a way that Stable-Baselines3 does not use")
    if member.file_size > largest:
        raise UserError(f"{label} has {member.file_size} bytes; at most {largest} are read")
    try:
        with archive.open(member) as file:
            content = file.read(member.file_size + 1)
    except _DAMAGED as error:
        raise UserError(f"{label} is damaged") from error
    if len(content) != member.file_size:
        raise UserError(f"{label} is damaged")
    return content


def read_tensors(content: bytes, what: str) -> dict[str, np.ndarray]:
    """Return the tensors by name, in float64, of a table of dense float tensors that torch saved.

    what: the file, as sentences begin. Raises UserError for anything else.
    """
    archive = open_zip(content, what)
    pickles = [name for name in archive.namelist() if name.count("/") == 1 and name.endswith("/data.pkl")]
    if len(pickles) != 1:
        raise UserError(f"{what} is not a file that torch saved: it lacks data.pkl")
    folder = pickles[0].removesuffix("data.pkl")
    order = f"{folder}byteorder"
    if order in archive.namelist() and read_member(archive, order, what, 100) != b"little":
        raise UserError(f"{what} has numbers in another byte order than little-endian")
    table = _Pickle(read_member(archive, pickles[0], what, _PICKLE), what).table
    storages: dict[_Storage, np.ndarray] = {}
    result = {}
    for name, tensor in table.items():
        label = f"{what}: its tensor {shown(name, 60)}"
        if not isinstance(tensor, _Tensor):
            raise UserError(f"{label} is not a tensor")
        if tensor.storage not in storages:
            storages[tensor.storage] = _read_storage(archive, folder, tensor.storage, what)
        result[name] = _array(tensor, storages[tensor.storage], label)
    return result


class _Storage(NamedTuple):
    """The storage of a tensor's numbers."""

    kind: str  # key of _FLOATS
    key: str  # name of the member
    numbers: int


class _Tensor(NamedTuple):
    """A tensor as the pickle describes it, unchecked."""

    storage: _Storage
    offset: Any
    size: Any
    stride: Any


class _Pickle:
    """Interpreter of a pickle's instructions for plain values, tensors and storages only."""

    def __init__(self, content: bytes, what: str):
        self._what = what
        self._stack: list = []
        self._marks: list[list] = []
        self._memo: dict = {}
        self.table: dict[str, object] = {}
        try:
            for opcode, argument, _ in pickletools.genops(content):
                if opcode.name == "STOP":
                    break
                act = _ACTIONS.get(opcode.name)
                if act is None:
                    raise UserError(f"{what} holds more than tensors: {opcode.name.lower()} in its pickle")
                act(self, argument)
            found = self._stack.pop()
        except UserError:
            raise
        except (*_DAMAGED, TypeError, AttributeError) as error:
            raise UserError(f"{what} is damaged: its pickle makes no sense") from error
        if self._stack or self._marks or not isinstance(found, dict):
            raise UserError(f"{what} is not a table of tensors")
        self.table = found

    def push(self, value) -> None:
        self._stack.append(value)

    def mark(self, _) -> None:
        self._marks.append(self._stack)
        self._stack = []

    def to_mark(self) -> list:
        found, self._stack = self._stack, self._marks.pop()
        return found

    def tuple(self, _) -> None:
        found = self.to_mark()
        self.push(tuple(found))

    def last(self, count: int) -> list:
        found = [self._stack.pop() for _ in range(count)]
        return found[::-1]

    def put(self, index) -> None:
        self._memo[index] = self._stack[-1]

    def get(self, index) -> None:
        self.push(self._memo[index])

    def name(self, argument: str) -> None:
        if argument not in (*_FLOATS, "collections OrderedDict", "torch._utils _rebuild_tensor_v2"):
            name = shown(argument.replace(" ", "."), 60)
            raise UserError(f"{self._what} holds {name}, where only dense tensors of floats are read")
        self.push(_Name(argument))

    def storage(self, _) -> None:
        word, kind, key, _place, count = self._stack.pop()
        if word != "storage" or not isinstance(kind, _Name) or kind not in _FLOATS:
            raise ValueError("no storage of floats")
        if not isinstance(key, str) or type(count) is not int:
            raise TypeError("storage of a wrong type")
        self.push(_Storage(str(kind), key, count))

    def call(self, _) -> None:
        function, arguments = self.last(2)
        if not isinstance(function, _Name) or not isinstance(arguments, tuple):
            raise TypeError("not a call")
        if function == "collections OrderedDict" and arguments == ():
            self.push({})
        elif function == "torch._utils _rebuild_tensor_v2":
            storage, offset, size, stride = arguments[:4]
            if not isinstance(storage, _Storage):
                raise TypeError("a tensor without a storage")
            self.push(_Tensor(storage, offset, size, stride))
        else:
            raise ValueError("a call with wrong arguments")

    def set(self, items: list) -> None:
        table = self._stack[-1]
        if not isinstance(table, dict) or len(items) % 2:
            raise TypeError("not a table")
        for key, value in zip(items[::2], items[1::2]):
            if not isinstance(key, str):
                raise TypeError("a name that is no text")
            table[key] = value

    def build(self, _) -> None:
        """Ignore attributes of the table, which are torch's versions of its modules."""
        if not isinstance(self._stack.pop(), dict):
            raise TypeError("not attributes")


class _Name(str):
    """An allowed class or function named by the pickle; never imported."""


_ACTIONS: dict[str, Callable[[_Pickle, Any], None]] = {
    "PROTO": lambda pickle, argument: None,
    "MARK": _Pickle.mark,
    "NONE": lambda pickle, argument: pickle.push(None),
    "NEWTRUE": lambda pickle, argument: pickle.push(True),
    "NEWFALSE": lambda pickle, argument: pickle.push(False),
    **dict.fromkeys(("BININT", "BININT1", "BININT2", "LONG1", "BINUNICODE"), _Pickle.push),
    "EMPTY_DICT": lambda pickle, argument: pickle.push({}),
    "EMPTY_TUPLE": lambda pickle, argument: pickle.push(()),
    "TUPLE1": lambda pickle, argument: pickle.push(tuple(pickle.last(1))),
    "TUPLE2": lambda pickle, argument: pickle.push(tuple(pickle.last(2))),
    "TUPLE3": lambda pickle, argument: pickle.push(tuple(pickle.last(3))),
    "TUPLE": _Pickle.tuple,
    "BINPUT": _Pickle.put,
    "LONG_BINPUT": _Pickle.put,
    "BINGET": _Pickle.get,
    "LONG_BINGET": _Pickle.get,
    "GLOBAL": _Pickle.name,
    "BINPERSID": _Pickle.storage,
    "REDUCE": _Pickle.call,
    "SETITEM": lambda pickle, argument: pickle.set(pickle.last(2)),
    "SETITEMS": lambda pickle, argument: pickle.set(pickle.to_mark()),
    "BUILD": _Pickle.build,
}


def _read_storage(archive: zipfile.ZipFile, folder: str, storage: _Storage, what: str) -> np.ndarray:
    """Return the numbers (count,) of a storage."""
    name, kind = f"{folder}data/{storage.key}", np.dtype(_FLOATS[storage.kind])
    label = f"{what}: {shown(name, 60)} in it"
    if name not in archive.namelist():
        raise UserError(f"{label} is missing")
    member = archive.getinfo(name)
    if member.compress_type != zipfile.ZIP_STORED:
        raise UserError(f"{label} is compressed; torch does not do that")
    if member.file_size != storage.numbers * kind.itemsize:
        raise UserError(f"{label} has {member.file_size} bytes for {storage.numbers} numbers")
    return np.frombuffer(read_member(archive, name, what), kind)


def _array(tensor: _Tensor, numbers: np.ndarray, label: str) -> np.ndarray:
    """Return a tensor's numbers in its shape, float64, contiguous."""
    size, stride, offset = tensor.size, tensor.stride, tensor.offset
    valid = (
        isinstance(size, tuple)
        and isinstance(stride, tuple)
        and len(size) == len(stride) <= _DIMENSIONS
        and all(type(k) is int and 0 <= k <= LARGEST for k in (*size, *stride, offset))
    )
    if not valid:
        raise UserError(f"{label} has a shape that is none")
    if 0 in size:
        raise UserError(f"{label} is empty")
    last = offset + sum((n - 1) * k for n, k in zip(size, stride))
    if math.prod(size) > len(numbers) or last >= len(numbers):
        raise UserError(f"{label} reaches beyond its numbers")
    view = np.lib.stride_tricks.as_strided(
        numbers[offset:], size, [numbers.itemsize * k for k in stride], writeable=False
    )
    return np.array(view, np.float64, order="C")
