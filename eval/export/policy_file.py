"""The policy file: a network with its contract, for firmware that is not compiled anew.

All numbers are little-endian, integers of 32 bits, floats of 32 bits. `c/landing_policy_file.c.j2` reads it.

| bytes | what it is |
|---|---|
| 8 | `MAGIC` |
| 4 | `VERSION` |
| 4 | size of the file |
| 4 | length of the contract's text, a multiple of 4 |
| 4 | bit 0: tanh between the layers, otherwise ReLU; bit 1: tanh at the end |
| 4, 4 | limit of scaled inputs, and bound of what the last tanh takes; 0: none |
| 4, 4 | number of test pairs t, number of layers |
| 4 each | outputs of each layer |
| text | the contract, one line for each of `SUBJECTS`, padded with line ends |
| 4 each | centres and spans of the a actions |
| 4 each | centres and scales of the i inputs; of each layer the biases, and the weights input by input |
| 4 t (i + a) | test pairs: an input, and the policy's action |
| 32 | SHA-256 of everything before |

The contract's text holds what is compiled into the firmware: another text is refused. Not in it are the
centres and spans of actions, which come with the file, and the constants of the vehicle's model but for its
frame: a policy trained on the identified model of the same vehicle is what such a file is for.
"""

from __future__ import annotations

import enum
import hashlib
import struct

import numpy as np

from inclined_landing.eval.export.network import Network
from inclined_landing.eval.export.vectors import Vectors
from inclined_landing.models.attitude import COMMAND_NAMES
from inclined_landing.models.errors import UserError
from inclined_landing.models.vehicle import Vehicle

NAME = "policy.bin"
MAGIC = b"ILPOLICY"
VERSION = 1
HEADER = 40  # bytes before the outputs of the layers
HASH = 32  # bytes at the end
PAIRS = 8  # test pairs, of all test vectors
# What the lines of the contract are about, in their order.
SUBJECTS = ("task", "slope", "goal", "arena", "period", "vehicle", "observations", "history", "actions")


class Answer(enum.IntEnum):
    """What the firmware answers to a policy file."""

    OK = 0
    TOO_LARGE = 16
    NO_POLICY = 17
    VERSION = 18
    LENGTH = 19
    CORRUPT = 20
    LAYOUT = 21
    NUMBERS = 22
    SELF_TEST = 23
    FLYING = 24
    NO_UPLOAD = 25
    OTHER_TASK = 32
    OTHER_SLOPE = 33
    OTHER_GOAL = 34
    OTHER_ARENA = 35
    OTHER_PERIOD = 36
    OTHER_VEHICLE = 37
    OTHER_OBSERVATIONS = 38
    OTHER_HISTORY = 39
    OTHER_ACTIONS = 40


WORDS = {
    Answer.OK: "the policy is loaded",
    Answer.TOO_LARGE: "the file is larger than this firmware has memory for",
    Answer.NO_POLICY: "this is not a policy file",
    Answer.VERSION: "the file has another format version than this firmware reads",
    Answer.LENGTH: "the file is shorter or longer than it says",
    Answer.CORRUPT: "the file is damaged: its SHA-256 is another one",
    Answer.LAYOUT: "the network has more layers, wider layers or other ends than this firmware has room for",
    Answer.NUMBERS: "a number in the file is NaN, infinite or outside of its range",
    Answer.SELF_TEST: "the self test failed: this processor answers differently from the policy",
    Answer.FLYING: "no policy is loaded while the vehicle flies",
    Answer.NO_UPLOAD: "no file has arrived in full",
    Answer.OTHER_TASK: "the policy is for another task",
    Answer.OTHER_SLOPE: "the policy is for another slope",
    Answer.OTHER_GOAL: "the policy has another goal",
    Answer.OTHER_ARENA: "the policy is for another arena",
    Answer.OTHER_PERIOD: "the policy has another control period",
    Answer.OTHER_VEHICLE: "the policy is for a vehicle with another frame",
    Answer.OTHER_OBSERVATIONS: "the policy has other observations",
    Answer.OTHER_HISTORY: "the policy takes another number of past steps",
    Answer.OTHER_ACTIONS: "the policy's actions command something else, or have other limits",
}


def encode(contract: dict, vehicle: Vehicle, network: Network, vectors: Vectors) -> bytes:
    """Return the policy file of a network with its contract and test vectors."""
    text = contract_text(contract, vehicle).encode("ascii")
    text += b"\n" * (-len(text) % 4)
    rows = np.linspace(0, len(vectors.inputs) - 1, min(PAIRS, len(vectors.inputs))).astype(int)
    numbers = [
        [entry[name] for entry in contract["action"]] for name in ("centre", "span")
    ] + [network.centre, network.scale]  # fmt: skip
    for weight, bias in zip(network.weights, network.biases):
        numbers += [bias, weight.ravel()]
    pairs = np.hstack([vectors.inputs[rows], vectors.actions[rows]])
    content = b"".join(np.asarray(part, "<f4").tobytes() for part in (*numbers, pairs.ravel()))
    sizes = network.sizes
    head = struct.pack(
        f"<IIffII{len(sizes)}I",
        len(text),
        (network.activation == "Tanh") | network.squashed << 1,
        none_as_zero(network.limit),
        none_as_zero(network.bound),
        len(rows),
        len(sizes),
        *sizes,
    )
    size = len(MAGIC) + 8 + len(head) + len(text) + len(content) + HASH
    file = MAGIC + struct.pack("<II", VERSION, size) + head + text + content
    return file + hashlib.sha256(file).digest()


def contract_text(contract: dict, vehicle: Vehicle) -> str:
    """Return what a policy and the firmware around it must agree on: one line for each of SUBJECTS."""
    task, spread = contract["task"], contract["task"]["goal_half_widths"]
    goal = [
        f"{name} {_number(value)}" + ("" if spread is None else f" +- {_number(spread[name])}")
        for name, value in (task["goal"] or {}).items()
    ]
    actions = [
        f"{entry['name']} as {COMMAND_NAMES[entry['column']]} "
        f"{_number(entry['low'])} to {_number(entry['high'])}"
        + ("" if entry["idle"] is None else f", 0 up to action {_number(entry['idle'])}")
        for entry in contract["action"]
    ]
    lines = (
        task["name"],
        "none or observed" if task["inclination"] is None else f"{_number(task['inclination'])} rad",
        ", ".join(goal) + (", motors cut" if task["motors_cut_at_goal"] else "") or "none",
        ", ".join(f"{axis} {' to '.join(map(_number, ends))}" for axis, ends in contract["arena"].items()),
        f"{_number(contract['control_period'])} s",
        f"arms of {_number(vehicle.rotor_arm)} m, rotors of {_number(vehicle.rotor_radius)} m",
        ", ".join(entry["name"] for entry in contract["observation"]),
        str(contract["input"]["history"]["steps"]),
        "; ".join(actions),
    )
    return "".join(f"{subject} {_ascii(line)}\n" for subject, line in zip(SUBJECTS, lines))


def check(file: bytes, name: str) -> None:
    """Raise UserError unless the bytes are an undamaged policy file of this version; `name` names them."""
    if file[: len(MAGIC)] != MAGIC or len(file) < len(MAGIC) + 8 + HASH:
        raise UserError(f"{name}: {WORDS[Answer.NO_POLICY]}")
    version, size = struct.unpack_from("<II", file, len(MAGIC))
    if version != VERSION:
        raise UserError(f"{name}: the file has format version {version}, not {VERSION}")
    if size != len(file):
        raise UserError(f"{name}: {WORDS[Answer.LENGTH]}")
    if hashlib.sha256(file[:-HASH]).digest() != file[-HASH:]:
        raise UserError(f"{name}: {WORDS[Answer.CORRUPT]}")


def none_as_zero(value: float) -> float:
    """Return a limit as the file and the C code hold it."""
    return 0.0 if np.isinf(value) else value


def c_strings(text: str) -> list[str]:
    """Return the lines of a text as C string literals."""
    # With ? escaped: C99 could read two of them as a trigraph.
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("?", "\\?")
    return [f'"{line}\\n"' for line in escaped.splitlines()]


def _number(value: float) -> str:
    """Return a number in the fewest digits that reproduce its float32."""
    return str(np.float32(value))


def _ascii(text: str) -> str:
    return (
        "".join(c if c.isprintable() else f"\\x{ord(c):x}" for c in text)
        .encode("ascii", "backslashreplace")
        .decode()
    )
