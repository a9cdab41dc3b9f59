"""Reader of a policy file: metadata, header, tensors, without torch and without running anything from it.

Stable-Baselines3 keeps the network as a zip that torch writes: `data.pkl`, a pickle that says how tensors
lie in storages, and one member for each storage. Only the few pickle instructions and names
that torch writes for a table of dense float tensors are accepted, and nothing is imported for them. Sizes are
checked against the zip before anything is read, so that no file takes more memory than `LARGEST`.
"""

from __future__ import annotations

import io
import math
import pickle
import pickletools
import re
import struct
import zipfile
import zlib
from collections import OrderedDict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown

ACTIVATIONS = ("Tanh", "ReLU")  # index is the code in the compiled loop of `Policy`
LARGEST_WEIGHT = 1e6  # beyond, sums of products could overflow
NORMALISATION = "normalisation"  # entry of the metadata: what a VecNormalize did, or null if nothing
_LIMIT = 10.0  # of `features.ScaledObservation`
METADATA = "inclined_landing.json"  # member: what the policy was trained for; a plain SB3 file has none
LARGEST = 100_000_000  # bytes of a policy file, and of any member
_LARGEST_TABLE = 10_000_000  # bytes of the header and of the metadata
_HEADER, _NETWORK = "data", "policy.pth"  # members that Stable-Baselines3 writes
_PICKLE = 1_000_000  # bytes of data.pkl
_MEMBERS = 4096  # of a file, those of zips inside it counted too
_DIMENSIONS = 8
_FLOATS = ("<f4", "<f8")
_DAMAGED = (
    *(zipfile.BadZipFile, zipfile.LargeZipFile, zlib.error, struct.error),
    *(OSError, EOFError, ValueError, RuntimeError, KeyError, IndexError, OverflowError),
)


class PolicyFile(NamedTuple):
    """The content of a policy file, unchecked except that tensors are finite."""

    metadata: dict
    header: dict
    tensors: dict[str, np.ndarray]


def read_file(path: Path) -> PolicyFile:
    """Return the content of a policy file; raises UserError for a damaged or foreign file."""
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
    """Return the zip of a policy file; raises UserError for anything else."""
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
        raise UserError(f"{what} is not a zip file, or is damaged") from error
    members = archive.infolist()
    names = [member.filename for member in members]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise UserError(f"{what}: {shown(twice, 60)} appears twice")
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
        raise UserError(f"{label} uses a compression that Stable-Baselines3 does not write")
    if member.file_size > largest:
        raise UserError(f"{label} has {member.file_size} bytes; the limit is {largest}")
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
        raise UserError(f"{what} is not in little-endian byte order")
    table = _table(read_member(archive, pickles[0], what, _PICKLE), what)
    storages: dict[_Storage, np.ndarray] = {}
    result = {}
    for name, tensor in table.items():
        label = f"{what}: its tensor {shown(name, 60)}"
        if not isinstance(name, str) or not isinstance(tensor, _Tensor):
            raise UserError(f"{label} is not a tensor")
        if tensor.storage not in storages:
            storages[tensor.storage] = _read_storage(archive, folder, tensor.storage, what)
        result[name] = _array(tensor, storages[tensor.storage], label)
    return result


class _Storage(NamedTuple):
    """The storage of a tensor's numbers."""

    kind: str  # one of _FLOATS
    key: str  # name of the member
    numbers: int


class _Tensor(NamedTuple):
    """A tensor as the pickle describes it, unchecked."""

    storage: _Storage
    offset: Any
    size: Any
    stride: Any


def _tensor(storage: _Storage, offset: Any, size: Any, stride: Any, *_: Any) -> _Tensor:
    """Stand for `torch._utils._rebuild_tensor_v2`."""
    if not isinstance(storage, _Storage):
        raise TypeError("a tensor without a storage")
    return _Tensor(storage, offset, size, stride)


class _Unpickler(pickle.Unpickler):
    """Builds plain values, tensors and storages; imports nothing, so that no code can be run."""

    def __init__(self, content: bytes, what: str):
        super().__init__(io.BytesIO(content))
        self._what = what
        for opcode, argument, _ in pickletools.genops(content):
            far = opcode.name == "LONG_BINPUT" and int(argument or 0) > len(content)
            if opcode.name not in _OPCODES or far:
                raise UserError(f"{what} holds more than tensors: {opcode.name.lower()} in its pickle")

    def find_class(self, module: str, name: str) -> object:
        """Return the replacement of one of the few names that torch writes."""
        if (module, name) not in _STAND_INS:
            named = shown(f"{module}.{name}", 60)
            raise UserError(f"{self._what} holds {named}; only dense tensors of floats are supported")
        return _STAND_INS[module, name]

    def persistent_load(self, reference: Any) -> _Storage:
        """Return the storage that a tensor refers to."""
        word, kind, key, _place, count = reference
        if word != "storage" or kind not in _FLOATS or type(key) is not str or type(count) is not int:
            raise ValueError("not a storage of floats")
        return _Storage(kind, key, count)


_STAND_INS: dict[tuple[str, str], object] = {
    ("collections", "OrderedDict"): OrderedDict,
    ("torch._utils", "_rebuild_tensor_v2"): _tensor,
    ("torch", "FloatStorage"): "<f4",
    ("torch", "DoubleStorage"): "<f8",
}
# The instructions of a pickle that torch writes for a table of tensors.
_OPCODES = {
    *("PROTO", "STOP", "MARK", "NONE", "NEWTRUE", "NEWFALSE", "BININT", "BININT1", "BININT2", "LONG1"),
    *("BINUNICODE", "EMPTY_DICT", "EMPTY_TUPLE", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3", "BINPUT"),
    *("LONG_BINPUT", "BINGET", "LONG_BINGET", "GLOBAL", "BINPERSID", "REDUCE", "SETITEM", "SETITEMS"),
    "BUILD",
}


def _table(content: bytes, what: str) -> dict:
    """Return the table that a pickle describes; raises UserError for instructions foreign to torch."""
    try:
        found = _Unpickler(content, what).load()
    except UserError:
        raise
    except Exception as error:  # whatever bytes that make no sense raise
        raise UserError(f"{what} is damaged: its pickle is inconsistent") from error
    if not isinstance(found, dict):
        raise UserError(f"{what} is not a table of tensors")
    return dict(dict.items(found))


def _read_storage(archive: zipfile.ZipFile, folder: str, storage: _Storage, what: str) -> np.ndarray:
    """Return the numbers (count,) of a storage."""
    name, kind = f"{folder}data/{storage.key}", np.dtype(storage.kind)
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
        raise UserError(f"{label} has an invalid shape")
    if 0 in size:
        raise UserError(f"{label} is empty")
    last = offset + sum((n - 1) * k for n, k in zip(size, stride))
    if math.prod(size) > len(numbers) or last >= len(numbers):
        raise UserError(f"{label} exceeds its storage")
    view = np.lib.stride_tricks.as_strided(
        numbers[offset:], size, [numbers.itemsize * k for k in stride], writeable=False
    )
    return np.array(view, np.float64, order="C")


# What Stable-Baselines3's header may name, so that the network is what its tensors say: modules of policies,
# features extractors, activations, and the bounds of actions.
_POLICIES = (
    r"stable_baselines3\.(common|sac|td3|ppo|a2c|ddpg)\.policies|sb3_contrib\.(common|tqc|trpo)\.policies"
)
_EXTRACTORS = (
    r"<class '(stable_baselines3\.[\w.]+\.FlattenExtractor|inclined_landing\.[\w.]+\.ScaledObservation)'>"
)
_ACTIVATION = "<class 'torch.nn.modules.activation."
_BOUNDS = {"low": r"-1(\.0*)?", "high": r"1(\.0*)?"}
# Tensors that are read, or that no action without noise depends on.
_TENSORS = (
    r"((pi_|vf_)?features_extractor|mlp_extractor\.(policy|value)_net|action_net|value_net|log_std"
    r"|actor(_target)?\.(features_extractor|latent_pi|mu|log_std)|critic(_target)?)(\.|$)"
)


def read_network(file: PolicyFile, path: Path) -> dict[str, Any]:
    """Return the fields of `Policy` that make up its network; raises UserError for one it cannot evaluate."""
    _check_header(file.header, file.metadata, path)
    network = _actor(file.tensors, file.header, path)
    return network | _normalisation(file.metadata, network["limit"], path)


def _check_header(header: dict, metadata: dict, path: Path) -> None:
    """Raise UserError if SB3's header describes a computation that the tensors do not contain."""

    def entry(name: str) -> dict:
        value = header.get(name)
        return value if isinstance(value, dict) else {}

    # Algorithms with a replay buffer write a last observation in any case.
    on_policy = "gae_lambda" in header
    if on_policy and header.get("_last_original_obs") is not None and NORMALISATION not in metadata:
        raise UserError(
            f"policy {path} was trained with VecNormalize, whose statistics are not in the file; load the "
            "model with env=VecNormalize.load(statistics, env), and save it with save_policy(model, path)"
        )
    module = entry("policy_class").get("__module__")
    if module is not None and not re.fullmatch(_POLICIES, str(module)):
        raise UserError(
            f"policy {path} is of a class in {shown(module, 60)}, which cannot be evaluated; only "
            "Stable-Baselines3's MlpPolicy classes can"
        )
    extractor = entry("policy_kwargs").get("features_extractor_class")
    if extractor is not None and not re.fullmatch(_EXTRACTORS, str(extractor)):
        raise UserError(
            f"policy {path} has the features extractor {shown(extractor, 80)}, which cannot be evaluated; "
            "only FlattenExtractor and this package's ScaledObservation can"
        )
    space = entry("observation_space").get(":type:")
    if space is not None and not str(space).endswith(".Box'>"):
        raise UserError(f"policy {path} observes a {shown(space, 60)}; only a Box is supported")
    for end, one in _BOUNDS.items():
        bounds = str(entry("action_space").get(end, "")).strip("[]").split()
        if not all(re.fullmatch(one, bound) for bound in bounds):
            raise UserError(
                f"policy {path} was trained with actions outside [-1, 1]; use the actions of the task"
            )


def _normalisation(metadata: dict, limit: float, path: Path) -> dict:
    """Return the fields of `Policy` that stand for the statistics of a VecNormalize, where there was one.

    limit: that of the network's own scaling; infinite without one.
    """
    statistics = metadata.get(NORMALISATION)
    if statistics is None:
        return {}
    if limit < np.inf:
        raise UserError(
            f"policy {path} scales its observations twice, with VecNormalize and with its extractor"
        )
    try:
        centre, scale = (np.array(statistics[name], float) for name in ("centre", "scale"))
        limit = np.inf if statistics["limit"] is None else float(statistics["limit"])
    except (TypeError, KeyError, ValueError, OverflowError) as error:
        raise UserError(
            f"policy {path}: {NORMALISATION} in its {METADATA} lacks a centre, scale or limit"
        ) from error
    return {"centre": centre, "scale": scale, "limit": limit}


# Which tensors make up the actor that answers without noise: of PPO and A2C, of SAC, of TD3 and DDPG.
_KINDS = (
    # begin of the marker, extractor, hidden layers, output, activation by default, squashed
    ("log_std", "features_extractor.", "mlp_extractor.policy_net.", "action_net", "Tanh", False),
    ("actor.log_std", "actor.features_extractor.", "actor.latent_pi.", "actor.mu", "ReLU", True),
    ("actor.mu.0.weight", "actor.features_extractor.", "actor.mu.", None, "ReLU", True),
)
_CLIP_MEAN = 2.0  # SAC's default limit of the mean with state-dependent exploration, before tanh


def _actor(tensors: dict[str, np.ndarray], header: dict, path: Path) -> dict:
    """Return the fields of `Policy` that make up the network."""
    refused = UserError(
        f"policy {path} is not a PPO, SAC or TD3 policy with a plain network and continuous actions"
    )
    kind = next((kind for kind in _KINDS if any(name.startswith(kind[0]) for name in tensors)), None)
    if kind is None:
        raise refused
    _, scaling, hidden, output, activation, squashed = kind
    unknown = next((name for name in tensors if not re.match(_TENSORS, name)), None)
    if unknown is not None:
        raise UserError(
            f"policy {path} has {shown(unknown, 60)} in its network; only dense layers are supported"
        )
    options = header.get("policy_kwargs") or {}
    if not isinstance(options, dict):
        raise UserError(f"policy {path}: its policy_kwargs are not a table")
    bound = np.inf
    if output is not None and f"{output}.0.weight" in tensors:
        output, bound = f"{output}.0", options.get("clip_mean", _CLIP_MEAN)
        if not (isinstance(bound, (int, float)) and 0 < bound <= LARGEST_WEIGHT):
            raise UserError(f"policy {path}: its policy_kwargs have an invalid clip_mean, {shown(bound, 40)}")
    numbers = {name.removeprefix(hidden).split(".")[0] for name in tensors if name.startswith(hidden)}
    extractor = {name.removeprefix(scaling) for name in tensors if name.startswith(scaling)}
    plain = all(re.fullmatch("[0-9]{1,3}", number) for number in numbers)
    layers = [f"{hidden}{k}" for k in sorted(numbers, key=int)] if plain else []
    layers += [output] if output is not None and plain else []
    complete = plain and all(f"{layer}.{part}" in tensors for layer in layers for part in ("weight", "bias"))
    if not complete or extractor not in (set(), {"centre", "scale"}):
        raise refused
    matrices = tuple(np.ascontiguousarray(tensors[f"{layer}.weight"].T) for layer in layers)
    inputs, scaled = len(matrices[0]) if matrices[0].ndim else 0, bool(extractor)
    return {
        "centre": tensors[f"{scaling}centre"] if scaled else np.zeros(inputs),
        "scale": tensors[f"{scaling}scale"] if scaled else np.ones(inputs),
        "limit": _LIMIT if scaled else np.inf,
        "weights": matrices,
        "biases": tuple(tensors[f"{layer}.bias"] for layer in layers),
        "activation": _activation(options.get("activation_fn"), activation, path),
        "squashed": squashed or options.get("squash_output") is True,  # of PPO with `use_sde`
        "bound": float(bound),
    }


def _activation(named: Any, usual: str, path: Path) -> str:
    """Return the activation named in SB3's header, one of those that `Policy` evaluates."""
    activation = usual if named is None else str(named).removeprefix(_ACTIVATION).removesuffix("'>")
    if activation not in ACTIVATIONS:
        raise UserError(
            f"policy {path} has a network this package cannot evaluate "
            f"(activation {shown(named, 80)}; it evaluates {' and '.join(ACTIVATIONS)})"
        )
    return activation
