"""Policy files: refused in one sentence, or flown; nothing in them is run, and torch is not needed."""

import base64
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
from collections.abc import Callable
from importlib import resources

import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest
import torch
from hypothesis import given

from inclined_landing.envs.flights import record_flights
from inclined_landing.envs.policy import METADATA, load_policy
from inclined_landing.envs.policy import tensors as tensors_of
from inclined_landing.envs.tasks.base import hover_states
from tests import ROOT
from tests.campaign.judge import (
    Case,
    Wrong,
    contents,
    damaged,
    examples,
    judged,
    places,
    respelt,
    spoilt,
    write,
)

GOOD = (resources.files("inclined_landing.envs") / "shipped" / "landing.zip").read_bytes()
with zipfile.ZipFile(io.BytesIO(GOOD)) as archive:
    MEMBERS = {name: archive.read(name) for name in archive.namelist()}
TABLES, DATA = json.loads(MEMBERS[METADATA]), json.loads(MEMBERS["data"])
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


def case(name: str, content: Callable[[], bytes]) -> Case:
    """A policy file of the bytes that `content` makes."""
    return Case(name, lambda folder: write(folder / "p.zip", content()), load_policy, flies)


def zipped(members, kind=zipfile.ZIP_STORED) -> bytes:
    """A zip of (name, content) pairs or a table of them; names may come twice."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", kind) as target, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # names twice are meant
        for name, content in members.items() if isinstance(members, dict) else members:
            target.writestr(zipfile.ZipInfo(name), content, kind)
    return out.getvalue()


def with_member(name: str, content: bytes) -> bytes:
    return zipped(MEMBERS | {name: content})


def headers(member: str) -> st.SearchStrategy[Case]:
    """The metadata or SB3's header with an entry wrong, or another text in its place."""
    good = MEMBERS[member]
    deep = b', "x": ' + b"[" * 500 + b"]" * 500 + b"}"
    more = {
        "options nested": b'{"task_options": ' + b'{"a":' * 20_000 + b"1" + b"}" * 20_001,
        "lists nested": good.rstrip()[:-1] + deep,
        "many digits": b'{"task": ' + b"9" * 5000 + b"}",
        "UTF-16": good.decode().encode("utf-16"),
        "Latin 1": b'{"task": "\xe9"}',
        "huge": good.rstrip()[:-1] + b', "x": "' + b"y" * 20_000_000 + b'"}',
    }
    texts = contents(good, {name: lambda text=text: text for name, text in more.items()})
    entries = spoilt(json.loads(good)).map(lambda s: (s[0], lambda: respelt(good, s[1])))
    return (entries | texts).map(lambda s: case(f"{member} {s[0]}", lambda: with_member(member, s[1]())))


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
    "a huge stride": lambda t: t.as_strided((1, *t.shape), (2**62, *t.stride())),
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


HIDDEN = "mlp_extractor.policy_net."
MANY = {f"{HIDDEN}{2 * k}.weight": torch.eye(64) for k in range(100)}
MANY |= {f"{HIDDEN}{2 * k}.bias": torch.zeros(64) for k in range(100)}
TABLES = {  # what may stand in the place of all tensors
    **{
        f"layer {k[:3]!r}": TENSORS | {f"{HIDDEN}{k}.weight": torch.eye(64)}
        for k in ("-1", "x", "٣", "9" * 400, "")
    },
    "a hundred layers": MANY | TENSORS,
    "a list": list(TENSORS.values()),
    "a tensor": TENSORS["log_std"],
    "a module": torch.nn.Linear(5, 2),
    "empty": {},
    "numbers as names": dict(enumerate(TENSORS.values())),
}


def network(name: str, tensors: Callable[[], object]) -> Case:
    """A policy with other tensors; none where torch has no such one."""

    def content() -> bytes:
        out = io.BytesIO()
        try:
            torch.save(tensors(), out)
        except (RuntimeError, NotImplementedError, TypeError, ValueError):
            hypothesis.reject()
        return with_member(WEIGHTS, out.getvalue())

    return case(f"tensor {name}", content)


def tensor(name: str, way: str) -> Case:
    """A tensor with another shape, type or value, missing or renamed."""
    rest = {other: t for other, t in TENSORS.items() if other != name}
    if way == "missing":
        return network(f"{name} missing", lambda: rest)
    if way == "renamed":
        return network(f"{name} renamed", lambda: rest | {name.replace(".", ".x."): TENSORS[name]})
    return network(f"{name} {way}", lambda: rest | {name: SHAPES[way](TENSORS[name])})


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
    assert tensors_of(path)
    assert not (tmp_path / "harm").exists()


def test_nothing_is_called_that_executes_what_a_file_holds():
    """In the source: readers of others that unpickle, and shells."""
    wrong = re.compile(
        r"\b(PPO|SAC|TD3|torch|joblib|cloudpickle|pickle|marshal|shelve)\.(load|loads|open)\("
        r"|allow_pickle=True|read_pickle|yaml\.(unsafe_|full_)?load\(|shell=True"
    )
    found = [
        f"{file.relative_to(ROOT)}: {match[0]}"
        for package in ("models", "envs", "eval", "train")
        for file in (ROOT / package).rglob("*.py")
        for match in wrong.finditer(file.read_text("utf-8"))
    ]
    assert not found
    assert wrong.search("PPO.load(path)") and wrong.search("torch.load(path)")


# Instructions that torch never writes.
PICKLES = {
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
with zipfile.ZipFile(io.BytesIO(MEMBERS[WEIGHTS])) as source:
    INNER = {name: source.read(name) for name in source.namelist()}
PICKLED = "archive/data.pkl"


def inner(title: str, name: str, content: Callable[[], bytes]) -> Case:
    """A policy in whose weights one of the members that torch wrote is replaced."""
    return case(f"{name} {title}", lambda: with_member(WEIGHTS, zipped(INNER | {name: content()})))


def reordered(seed: int) -> bytes:
    """The pickle with more of the instructions that torch writes, in any order."""
    rng, good = random.Random(seed), INNER[PICKLED]
    cut = rng.randrange(2, len(good))
    noise = bytes(rng.choice(b"()}]Nt\x85\x86\x87RQsub0.\x88\x89") for _ in range(rng.randrange(1, 30)))
    return good[:cut] + noise + good[cut:]


def in_directory(content: bytes, name: str, offset: int, value: bytes) -> bytes:
    """A zip with `value` written into the entry of `name` in its central directory."""
    begin = content.rindex(b"PK\x01\x02", 0, content.rindex(name.encode()))
    return content[: begin + offset] + value + content[begin + offset + len(value) :]


def bomb() -> bytes:
    return zipped(MEMBERS | {WEIGHTS: bytes(300_000_000)}, zipfile.ZIP_DEFLATED)


PAIRS = list(MEMBERS.items())
CHANGED = {  # what may become of a member
    "left out": lambda name: [pair for pair in PAIRS if pair[0] != name],
    "twice": lambda name: [*PAIRS, (name, MEMBERS[name])],
    "empty": lambda name: MEMBERS | {name: b""},
    "halved": lambda name: MEMBERS | {name: MEMBERS[name][: len(MEMBERS[name]) // 2]},
    "noise": lambda name: MEMBERS | {name: random.Random(7).randbytes(5000)},
}
ENTRIES = {  # of the central directory: offset and other bytes
    "encrypted": (8, b"\x01\x00"),
    "compressed in another way": (10, b"\x63\x00"),
    "of gigabytes": (24, struct.pack("<I", 2**32 - 2)),
    "packed in gigabytes": (20, struct.pack("<I", 2**32 - 2)),
    "of no size": (24, bytes(4)),
    "with another sum": (16, bytes(4)),
    "somewhere else": (42, struct.pack("<I", 40)),
}
FILES = {
    "deflated": lambda: zipped(MEMBERS, 8),
    "bzip2": lambda: zipped(MEMBERS, 12),
    "lzma": lambda: zipped(MEMBERS, 14),
    "bomb": bomb,
    "bomb that says it is small": lambda: in_directory(bomb(), WEIGHTS, 24, struct.pack("<I", 1000)),
    "of many members": lambda: zipped([*PAIRS, *((f"x{k}", b"") for k in range(20_000))]),
    "behind something": lambda: b"#!/bin/sh\n" * 100 + GOOD,
    "before something": lambda: GOOD + b"x" * 1000,
    "in a zip": lambda: zipped({"p.zip": GOOD}),
    "none": lambda: b"PK" * 1000,
    "a pickle": lambda: pickle.dumps(Runs()),
}


def member(name: str, way: str) -> Case:
    """A member of the zip, or its entry in the directory, changed."""
    if way in CHANGED:
        return case(f"{name} {way}", lambda: zipped(CHANGED[way](name)))
    return case(f"{name} {way}", lambda: in_directory(GOOD, name, *ENTRIES[way]))


STORAGES = st.tuples(st.integers(3, 14), st.sampled_from((0, 6, 1_000_000)))
KINDS = {
    "metadata": headers(METADATA),
    "header": headers("data"),
    "tensors": st.builds(
        tensor, st.sampled_from(list(TENSORS)), st.sampled_from([*SHAPES, "missing", "renamed"])
    )
    | st.sampled_from(list(TABLES)).map(lambda name: network(name, lambda: TABLES[name])),
    "pickles": st.one_of(
        st.sampled_from(list(PICKLES)).map(lambda name: inner(name, PICKLED, lambda: PICKLES[name])),
        damaged(INNER[PICKLED]).map(lambda s: inner(s[0], PICKLED, s[1])),
        st.integers(0, 9999).map(lambda seed: inner(f"order {seed}", PICKLED, lambda: reordered(seed))),
        st.sampled_from((b"big", b"", b"x" * 1000)).map(
            lambda b: inner(f"{b[:3]}", "archive/byteorder", lambda: b)
        ),
        STORAGES.map(lambda s: inner(f"{s[1]} bytes", f"archive/data/{s[0]}", lambda: bytes(s[1]))),
    ),
    "zips": st.one_of(
        st.builds(member, st.sampled_from(list(MEMBERS)), st.sampled_from([*CHANGED, *ENTRIES])),
        st.sampled_from(list(FILES)).map(lambda name: case(f"zip {name}", FILES[name])),
        damaged(GOOD).map(lambda s: case(f"zip {s[0]}", s[1])),
        damaged(MEMBERS[WEIGHTS]).map(
            lambda s: case(f"weights {s[0]}", lambda: with_member(WEIGHTS, s[1]()))
        ),
        places("p.zip", load_policy),
    ),
}


@pytest.mark.parametrize("kind", KINDS)
@examples(5)
@given(data=st.data())
def test_policies_are_flown_or_refused(kind, data):
    judged(data.draw(KINDS[kind]))


def test_policies_are_read_without_torch():
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "from inclined_landing.envs.policy import load_policy\n"
        "for name in ('landing', 'setpoint', 'touchdown'): load_policy(name)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
