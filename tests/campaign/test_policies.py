"""Policy files: refused in one sentence, or flown; nothing in them is run, and torch is not needed."""

import base64
import functools
import io
import json
import os
import pickle
import random
import re
import struct
import subprocess
import sys
import warnings
import zipfile
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import torch

from inclined_landing.envs.flights import record_flights
from inclined_landing.envs.policy import STAMP, load_policy
from inclined_landing.envs.policy import tensors as tensors_of
from inclined_landing.envs.tasks.base import hover_states
from inclined_landing.eval.machine import benchmark
from tests.campaign.judge import (
    TEXTS,
    Case,
    Wrong,
    judge,
    mutations,
    parametrised,
    places,
    spoilt,
    write,
)

GOOD = (resources.files("inclined_landing.envs") / "shipped" / "landing.zip").read_bytes()
with zipfile.ZipFile(io.BytesIO(GOOD)) as archive:
    MEMBERS = {name: archive.read(name) for name in archive.namelist()}
STAMPED, DATA = json.loads(MEMBERS[STAMP]), json.loads(MEMBERS["data"])
WEIGHTS = "policy.pth"
TENSORS = torch.load(io.BytesIO(MEMBERS[WEIGHTS]), weights_only=True)


def flies(policy):
    """Actions of any observation, and five steps from a hover, finite."""
    rows = np.random.default_rng(0).normal(scale=10.0, size=(20, len(policy.centre)))
    if not (np.abs(policy.predict(rows)) <= 1.0).all():  # NaN neither
        raise Wrong("an action is no number from -1 to 1")
    states = hover_states(np.array([[1.0, 0.0, 1.9]]), policy.task.vehicle)
    flight = record_flights(policy, "mujoco", states, steps=5)[0]
    if not np.isfinite(flight.state).all():
        raise Wrong("the flight is not finite")


def case(name, content):
    """A policy file of these bytes, or of those that `content` makes."""

    def make(folder):
        return write(folder / "p.zip", content() if callable(content) else content)

    return Case(name, make, load_policy, flies)


def zipped(members, kind=zipfile.ZIP_STORED) -> bytes:
    """A zip of (name, content) pairs or a table of them; names may come twice."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", kind) as target, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # names twice are meant
        for name, content in members.items() if isinstance(members, dict) else members:
            target.writestr(zipfile.ZipInfo(name), content, kind)
    return out.getvalue()


def with_member(name, content) -> bytes:
    return zipped(MEMBERS | {name: content})


def headers(member, table):
    """Every entry of the stamp or of SB3's header with every evil value; and another text in its place."""
    for name, change in spoilt(table):
        text = lambda change=change: json.dumps(change(table), default=str)  # noqa: E731
        yield case(f"{member} {name}", lambda text=text: with_member(member, text()))
    for name, text in {
        **TEXTS,
        "cut": json.dumps(table).encode()[:-1],
        "options nested": b'{"task_options": ' + b'{"a":' * 20_000 + b"1" + b"}" * 20_001,
        "lists nested": json.dumps(table).encode()[:-1] + b', "x": ' + b"[" * 500 + b"]" * 500 + b"}",
        "many digits": b'{"task": ' + b"9" * 5000 + b"}",
        "UTF-16": json.dumps(table).encode("utf-16"),
        "Latin 1": b'{"task": "\xe9"}',
    }.items():
        yield case(f"{member} is {name}", lambda text=text: with_member(member, text))
    huge = lambda: with_member(member, json.dumps(table | {"x": "y" * 20_000_000}))  # noqa: E731
    yield case(f"{member} is huge", huge)


# What a tensor of the network may be replaced with.
SHAPES = {
    "one more axis": lambda t: t[None],
    "one axis less": lambda t: t.flatten()[0] if t.ndim == 1 else t.flatten(),
    "one row more": lambda t: torch.cat([t, t[:1]]) if t.ndim else t.repeat(2),
    "one row less": lambda t: t[:-1].clone() if t.ndim else t[None][:0],
    "transposed": lambda t: t.T,
    "empty": lambda t: torch.zeros(0),
    "many axes": lambda t: t.reshape((1,) * 20 + tuple(t.shape)),
    "expanded": lambda t: t.flatten()[:1].expand(1_000_000_000),
    "a view": lambda t: torch.cat([t.flatten(), t.flatten()])[t.numel() :].reshape(t.shape),
    "strided": lambda t: torch.stack([t, t], -1)[..., 0],
    "double": lambda t: t.double(),
    "half": lambda t: t.half(),
    "bfloat16": lambda t: t.bfloat16(),
    "complex": lambda t: t.to(torch.complex64),
    "integer": lambda t: t.long(),
    "bool": lambda t: t.bool(),
    "sparse": lambda t: t.to_sparse(),
    "quantised": lambda t: torch.quantize_per_tensor(t, 0.1, 0, torch.qint8),
    "meta": lambda t: t.to("meta"),
    "parameter": torch.nn.Parameter,
    "negative": lambda t: -t,
    "conjugate": lambda t: t.to(torch.complex64).conj(),
    "zero": torch.zeros_like,
    "NaN": lambda t: torch.full_like(t, torch.nan),
    "infinite": lambda t: torch.full_like(t, torch.inf),
    "1e30": lambda t: torch.full_like(t, 1e30),
    "1e300": lambda t: torch.full_like(t.double(), 1e300),
    "tiny": lambda t: torch.full_like(t, 1e-38),
    "a number": lambda t: 1.0,
    "a text": lambda t: "x",
    "a list": lambda t: t.tolist(),
    "none": lambda t: None,
    "a table": lambda t: {"a": t},
    "an array": lambda t: t.numpy(),
}


def saved(tensors) -> bytes:
    out = io.BytesIO()
    torch.save(tensors, out)
    return out.getvalue()


def tensors():
    """Every tensor times every shape, type and value; missing, renamed; and other things than a table."""
    for name, tensor in TENSORS.items():
        for evil, change in SHAPES.items():
            yield lazy(f"{name} {evil}", lambda n=name, t=tensor, c=change: TENSORS | {n: c(t)})
        rest = {n: t for n, t in TENSORS.items() if n != name}
        yield lazy(f"{name} missing", lambda rest=rest: rest)
        yield lazy(f"{name} renamed", lambda rest=rest, n=name, t=tensor: rest | {n.replace(".", ".x."): t})
    hidden = "mlp_extractor.policy_net."
    for k in ("-1", "x", "٣", "9" * 400, "00", ""):
        yield lazy(f"layer {k[:3]!r}", lambda k=k: TENSORS | {f"{hidden}{k}.weight": torch.eye(64)})
    many = {
        f"{hidden}{2 * k}.{part}": value
        for k in range(100)
        for part, value in (("weight", torch.eye(64)), ("bias", torch.zeros(64)))
    }
    yield lazy("a hundred layers", lambda: TENSORS | {n: t for n, t in many.items() if n not in TENSORS})
    yield lazy("a list", lambda: list(TENSORS.values()))
    yield lazy("a tensor", lambda: TENSORS["log_std"])
    yield lazy("a module", lambda: torch.nn.Linear(5, 2))
    yield lazy("empty", dict)
    yield lazy("numbers as names", lambda: dict(enumerate(TENSORS.values())))


def lazy(name, make):
    def made(folder):
        try:
            content = saved(make())
        except (RuntimeError, NotImplementedError, TypeError, ValueError) as error:
            pytest.skip(f"torch has no such tensor: {error}")
        return write(folder / "p.zip", with_member(WEIGHTS, content))

    return Case(f"tensor {name}", made, load_policy, flies)


class Runs:
    """A pickle that runs a command where it is loaded."""

    def __reduce__(self):
        return exec, ("raise SystemExit('run')",)


class Harmful:
    """Would leave a folder behind if it were unpickled."""

    def __reduce__(self):
        return os.mkdir, ("harm",)


@pytest.mark.parametrize("key", ["policy_class", "lr_schedule", "policy_kwargs", "anything"])
def test_objects_that_sb3_would_unpickle_are_left_alone(key, tmp_path, monkeypatch):
    """Stable-Baselines3 keeps objects as base64 pickles in its header, and unpickles them in `PPO.load`."""
    monkeypatch.chdir(tmp_path)
    held = {":type:": "<class 'a'>", ":serialized:": base64.b64encode(pickle.dumps(Harmful())).decode()}
    path = write(tmp_path / "p.zip", with_member("data", json.dumps(DATA | {key: held})))
    policy = load_policy(path)
    flies(policy)
    assert tensors_of(path) and benchmark.policy_latency(policy, 2, 0)["policy"] == "p"
    assert not (tmp_path / "harm").exists()


def test_nothing_is_called_that_executes_what_a_file_holds():
    """In the source: readers of others that unpickle, and shells."""
    wrong = re.compile(
        r"\b(PPO|SAC|TD3|torch|joblib|cloudpickle|pickle|marshal|shelve)\.(load|loads|open)\("
        r"|allow_pickle=True|read_pickle|yaml\.(unsafe_|full_)?load\(|shell=True"
    )
    floors = Path(__file__).parents[2]
    found = [
        f"{file.relative_to(floors)}: {match[0]}"
        for floor in ("models", "envs", "eval", "train")
        for file in (floors / floor).rglob("*.py")
        for match in wrong.finditer(file.read_text("utf-8"))
    ]
    assert not found
    assert wrong.search("PPO.load(path)") and wrong.search("torch.load(path)")


@functools.cache
def pickled() -> bytes:
    """The pickle in the weights."""
    with zipfile.ZipFile(io.BytesIO(MEMBERS[WEIGHTS])) as source:
        return source.read("archive/data.pkl")


def inner(name: str, content: bytes) -> bytes:
    """The weights with one of the members that torch wrote replaced."""
    with zipfile.ZipFile(io.BytesIO(MEMBERS[WEIGHTS])) as source:
        members = {n: source.read(n) for n in source.namelist()}
    assert name in members
    return with_member(WEIGHTS, zipped(members | {name: content}))


def pickles():
    """Instructions that torch never writes, and those that it writes in any order."""
    written = {
        "runs code": pickle.dumps(Runs(), 2),
        "runs code inside": pickle.dumps({"a": Runs()}, 2),
        "protocol 0": pickle.dumps({"a": [1]}, 0),
        "protocol 5": pickle.dumps({"a": [1]}, 5),
        "a table": pickle.dumps({"a": 1}, 2),
        "memo at 2^31": b"\x80\x02}r\xff\xff\xff\x7f.",
        "a text of gigabytes": b"\x80\x02X\xff\xff\xff\x7fabc.",
        "a number of megabytes": b"\x80\x02\x8b\xff\xff\xff\x7f1.",
        "digits": b"I" + b"9" * 900_000 + b"\n.",
        "nested": b"\x80\x02" + b")" + b"\x85" * 900_000 + b".",
        "doubling": b"\x80\x02)q\x00" + b"h\x00h\x00\x86q\x00" * 100 + b".",
        "marks": b"\x80\x02" + b"(" * 900_000 + b".",
        "too long": b"\x80\x02" + b"N0" * 2_000_000 + b".",
        "its own element": b"\x80\x02}q\x00X\x01\x00\x00\x00ah\x00s.",
        "empty": b"",
        "stop": b".",
        "extension": b"\x80\x02\x82\x01.",
        "persistent text": b"Pabc\n.",
    }
    for name, content in written.items():
        yield case(f"pickle {name}", lambda c=content: inner("archive/data.pkl", c))
    for name, make in mutations(pickled(), 150):
        yield case(f"pickle {name}", lambda make=make: inner("archive/data.pkl", make()))
    for k in range(60):

        def other(k=k) -> bytes:
            rng, good = random.Random(k), pickled()
            cut = rng.randrange(2, len(good))
            codes = b"()}]Nt\x85\x86\x87RQsub0.\x88\x89"
            noise = bytes(rng.choice(codes) for _ in range(rng.randrange(1, 30)))
            return inner("archive/data.pkl", good[:cut] + noise + good[cut:])

        yield case(f"pickle with other instructions {k}", other)
    for other in (b"big", b"", b"x" * 1000):
        yield case(f"byte order {other[:3]}", lambda other=other: inner("archive/byteorder", other))
    for k in range(3, 15):
        name = f"archive/data/{k}"
        for title, size in {"empty": 0, "short": 6, "long": 1_000_000}.items():
            yield case(f"storage {k} {title}", lambda name=name, size=size: inner(name, bytes(size)))


def zips():
    """The zip itself: its members, their headers and its bytes."""
    pairs = list(MEMBERS.items())
    for name, content in pairs:
        half, noise = content[: len(content) // 2], random.Random(7).randbytes(5000)
        for title, members in {
            f"without {name}": [pair for pair in pairs if pair[0] != name],
            f"with {name} twice": [*pairs, (name, content)],
            f"with an empty {name}": MEMBERS | {name: b""},
            f"with half of {name}": MEMBERS | {name: half},
            f"with noise as {name}": MEMBERS | {name: noise},
        }.items():
            yield case(f"zip {title}", lambda members=members: zipped(members))
        for title, offset, value in (
            ("encrypted", 8, b"\x01\x00"),
            ("compressed in another way", 10, b"\x63\x00"),
            ("of gigabytes", 24, struct.pack("<I", 2**32 - 2)),
            ("packed in gigabytes", 20, struct.pack("<I", 2**32 - 2)),
            ("of no size", 24, bytes(4)),
            ("with another sum", 16, bytes(4)),
            ("somewhere else", 42, struct.pack("<I", 40)),
        ):
            spoil = functools.partial(in_directory, GOOD, name, offset, value)
            yield case(f"zip with {name} {title}", spoil)
    for name, kind in {"deflated": 8, "bzip2": 12, "lzma": 14}.items():
        yield case(f"zip {name}", lambda kind=kind: zipped(MEMBERS, kind))

    def bomb() -> bytes:
        return zipped(MEMBERS | {WEIGHTS: bytes(300_000_000)}, zipfile.ZIP_DEFLATED)

    small = struct.pack("<I", 1000)
    yield case("zip bomb", bomb)
    yield case("zip bomb that says it is small", lambda: in_directory(bomb(), WEIGHTS, 24, small))
    many = [(f"x{k}", b"") for k in range(20_000)]
    yield case("zip with many members", lambda: zipped([*pairs, *many]))
    yield case("zip behind something", b"#!/bin/sh\n" * 100 + GOOD)
    yield case("zip before something", GOOD + b"x" * 1000)
    yield case("zip in a zip", lambda: zipped({"p.zip": GOOD}))
    yield case("no zip", b"PK" * 1000)
    yield case("a pickle", pickle.dumps(Runs()))
    for name, make in mutations(GOOD, 150):
        yield case(f"zip {name}", make)
    for name, make in mutations(MEMBERS[WEIGHTS], 150):
        yield case(f"weights {name}", lambda make=make: with_member(WEIGHTS, make()))


def in_directory(content: bytes, name: str, offset: int, value: bytes) -> bytes:
    """A zip with `value` written into the entry of `name` in its central directory."""
    begin = content.rindex(b"PK\x01\x02", 0, content.rindex(name.encode()))
    return content[: begin + offset] + value + content[begin + offset + len(value) :]


def elsewhere():
    yield from places("p.zip", load_policy)


stamp = functools.partial(headers, STAMP, STAMPED)
header = functools.partial(headers, "data", DATA)


@parametrised(stamp, header, tensors, pickles, zips, elsewhere, each=4)
def test_policies_are_flown_or_refused(case, tmp_path):
    judge(case, tmp_path)


def test_policies_are_read_without_torch():
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "from inclined_landing.envs.policy import load_policy\n"
        "for name in ('landing', 'setpoint', 'touchdown'): load_policy(name)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
