"""Ways to damage a good input, and what must become of it: it is used, or refused in one sentence.

`changes` looks at the content of a file: TOML and JSON get one wrong entry, tables of CSV wrong cells and
columns, texts other encodings, archives a wrong member, and every file wrong bytes. So a new reader costs one
entry of `READERS` in `test_readers.py`; commands and their options are found by `test_commands.py`.

A test draws the same examples each time; CAMPAIGN=N in the environment draws N times as many.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import datetime
import functools
import gzip
import hashlib
import io
import json
import math
import operator
import os
import random
import resource
import shutil
import tomllib
import warnings
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import hypothesis
import hypothesis.strategies as st
import numpy as np

from inclined_landing.models.base.errors import UserError

MEMORY = 3 * 2**30  # bytes of address space that reading may take
# One of each kind of wrong value.
EVIL: dict[str, object] = {
    "nan": math.nan, "infinite": math.inf, "zero": 0, "minus one": -1, "tiny": 1e-300, "huge": 1e300,
    "2^63": 2**63, "400 digits": int("9" * 400), "true": True, "date": datetime.date(2020, 1, 1),
    "text": "heavy", "empty text": "", "number as text": "1.0", "long text": "x" * 2000,
    "control characters": "a\nb\x1b[31m\u202e", "empty list": [], "list of one": [1.0],
    "list of three": [1.0, 2.0, 3.0], "list with text": [1.0, "x"], "list with nan": [math.nan] * 3,
    "huge list": [0.5] * 500, "list of lists": [[1.0, 2.0], [3.0, 4.0]], "nested": [[[[[[[[[[1.0]]]]]]]]]],
    "empty table": {}, "table": {"value": 1.0},
}  # fmt: skip
CELLS = ("nan", "inf", "1e300", "1e999", "5e-324", "-1", "65536", "9" * 400, "", " ", "text", "1,5", "1;5",
         '"', "0x10", "1_000", "１２", "TRUE", "2020-01-01", "é\0", "x" * 2_000_000)  # fmt: skip
# What may become of a column, the time among them.
COLUMNS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "large": lambda x: x + 1.7e9, "in nano": lambda x: 1e9 * x, "1e300": lambda x: 1e300 * x,
    "constant": lambda x: 0 * x, "back": lambda x: x[::-1],
    "twice": lambda x: np.r_[x[::2], x[::2]][: len(x)],
    "one back": lambda x: np.r_[x[:3], x[:1], x[4:]], "one ahead": lambda x: np.r_[x[:3], 1e3, x[4:]],
    "gap": lambda x: np.r_[x[:3], x[3:] + 1e6], "slow": lambda x: 100 * x, "negative": lambda x: -x,
    "steps": lambda x: np.repeat(x[::2], 2)[: len(x)],
}  # fmt: skip
WHOLE = {  # other contents
    "empty": b"", "white": b"\n" * 1000, "noise": b"\xff" * 999, "zero bytes": bytes(999), "list": b"[1]",
    "null": b"null", "nested lists": b"x = " + b"[" * 100_000, "nested tables": b'{"a":' * 20_000,
    "digits": b"x = " + b"9" * 900_000, "XML": b"<mujoco/>", "long line": b"1," * 3_000_000,
}  # fmt: skip
TEXTS: dict[str, Callable[[bytes], bytes]] = {
    "byte order mark": lambda b: b.decode().encode("utf-8-sig"),
    "UTF-16": lambda b: b.decode().encode("utf-16"), "Latin 1": lambda b: b"# \xe9\n" + b,
    "CR LF": lambda b: b.replace(b"\n", b"\r\n"), "CR": lambda b: b.replace(b"\n", b"\r"),
    "semicolons": lambda b: b.replace(b",", b";"), "decimal commas": lambda b: b.replace(b".", b","),
    "spaces": lambda b: b.replace(b",", b" "), "empty lines": lambda b: b.replace(b"\n", b"\n\n"),
    "a line twice": lambda b: b + b.splitlines(keepends=True)[-1], "twice": lambda b: b + b,
    "first line alone": lambda b: b.splitlines(keepends=True)[0], "open quote": lambda b: b'"' + b,
    "many lines": lambda b: b + b"x,1\n" * 300_000, "too long": lambda b: b + b"#" * 30_000_000,
}  # fmt: skip
PLACES: dict[str, Callable[[Path], object]] = {  # what a path may lead to instead of a file
    "nothing": lambda path: None,
    "a folder": lambda path: path.mkdir(),
    "a pipe": os.mkfifo,
    "endless": lambda path: path.symlink_to("/dev/zero"),
    "a loop": lambda path: path.symlink_to(path),
    "a process's memory": lambda path: path.symlink_to("/proc/self/mem"),
    "gigabytes": lambda path: (path.touch(), os.truncate(path, 2**34)),
}


@dataclasses.dataclass(frozen=True)
class Change:
    """A way to change the content of a file."""

    name: str
    of: Callable[[bytes], bytes] = dataclasses.field(repr=False)


def examples(few: int) -> hypothesis.settings:
    """Return settings of a test that draws so many examples, unless CAMPAIGN asks for more."""
    return hypothesis.settings(
        max_examples=few * int(os.environ.get("CAMPAIGN", 1)),
        phases=(hypothesis.Phase.generate,),
        database=None,
        suppress_health_check=list(hypothesis.HealthCheck),
    )


def used_or_refused(folder: Path | None, take: Callable[[], object], works: Callable[[object], None]) -> str:
    """Return "" where `take` reads an input and `works` with it, or the one sentence that refuses it.

    Fails for every other error, and where a refusal leaves or changes anything in `folder`.
    """
    before = _listing(folder)
    try:
        with _bounded_memory():
            result = take()
    except UserError as error:
        assert str(error).strip() and str(error).isprintable(), repr(str(error))
        assert "Traceback" not in str(error) and "object at 0x" not in str(error), error
        assert _listing(folder) == before, f"was refused and changed the folder: {error}"
        return str(error)
    works(result)
    return ""


def command(main: Callable[[list[str]], int], arguments: list[str]) -> str:
    """Return the standard output of a command run in this process; raises UserError for exit code 2."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(arguments)
    if code == 2:
        raise UserError(err.getvalue().removesuffix("\n"))
    assert code in (0, 3), err.getvalue()  # 3: a training that ended without success
    return out.getvalue()


def changes(content: bytes) -> st.SearchStrategy[Change]:
    """Draw a change of a file of this content."""
    found = [_bytes(), st.sampled_from(list(WHOLE)).map(lambda name: Change(name, lambda _: WHOLE[name]))]
    if content[:2] == b"PK":
        found += [_members(content)]
    elif content[:2] == b"\x1f\x8b":
        found += [changes(gzip.decompress(content)).map(_packed)]
        found += [st.just(Change("bomb", lambda _: gzip.compress(bytes(2**20)) * 4000))]
    else:
        with contextlib.suppress(UnicodeDecodeError):
            found += [_structure(content.decode())]
            found += [st.sampled_from(list(TEXTS)).map(lambda name: Change(name, TEXTS[name]))]
    return st.one_of(found)


def _structure(text: str) -> st.SearchStrategy[Change]:
    """Draw a wrong entry of JSON or TOML, or a wrong cell or column of a table."""
    for read, spell in ((json.loads, _json), (tomllib.loads, _toml_file)):
        with contextlib.suppress(ValueError, TypeError):  # a number alone has no entries
            return _entries(read(text)).map(
                lambda c, read=read, spell=spell: Change(
                    c[0], lambda b: spell(c[1](read(b.decode()))).encode()
                )
            )
    if "," not in text.partition("\n")[0]:
        return _bytes()
    rows, where = st.sampled_from((slice(3, 4), slice(None), slice(-1, None))), st.integers(0, 30)
    return st.builds(_cell, where, rows, st.sampled_from(CELLS)) | st.builds(
        _column, where, st.sampled_from(list(COLUMNS))
    )


def _entries(good: dict | list) -> st.SearchStrategy[tuple[str, Callable]]:
    """Draw (name, change of tables): an entry gets an evil value, goes, or one that is unknown comes."""

    def keys(table: dict | list) -> Iterator[tuple]:
        for key, value in table.items() if isinstance(table, dict) else enumerate(table[:1]):
            yield (key,)
            if isinstance(value, (dict, list)):
                yield from ((key, *rest) for rest in keys(value))
        if isinstance(table, dict):
            yield ("unknown",)

    def change(path: tuple, evil: str) -> tuple[str, Callable]:
        def changed(tables):
            tables = copy.deepcopy(tables)
            inner = functools.reduce(operator.getitem, path[:-1], tables)
            if evil in EVIL:
                inner[path[-1]] = EVIL[evil]
            elif path[-1] != "unknown":
                del inner[path[-1]]
            return tables

        return f"{'.'.join(map(str, path))} {evil}", changed

    return st.builds(change, st.sampled_from(list(keys(good))), st.sampled_from((*EVIL, "missing")))


def _json(value) -> str:
    return json.dumps(value, default=str)


def _toml_file(tables: dict) -> str:
    return "\n".join(f"{toml(key)} = {toml(value)}" for key, value in tables.items())


def toml(value) -> str:
    """Return a value as TOML spells it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + "".join(f"\\u{ord(c):04x}" if c < " " or c in '"\\' else c for c in value) + '"'
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml(k)} = {toml(v)}" for k, v in value.items()) + "}"
    return str(value)  # numbers and dates; nan and inf are TOML's own words


def _table(name: str, column: int, of: Callable[[list[str]], list[str]]) -> Change:
    """Return a change of the cells of a column, by what they were."""

    def changed(table: bytes) -> bytes:
        lines = [line.split(",") for line in table.decode().splitlines()]
        k = column % len(lines[0])
        for line, cell in zip(lines[1:], of([line[k] for line in lines[1:]])):
            line[k] = cell
        return ("\n".join(map(",".join, lines)) + "\n").encode()

    return Change(f"column {column} {name}", changed)


def _cell(column: int, rows: slice, cell: str) -> Change:
    def changed(cells: list[str]) -> list[str]:
        chosen = set(range(len(cells))[rows if len(cell) < 500 else slice(3, 4)])
        return [cell if k in chosen else before for k, before in enumerate(cells)]

    return _table(f"rows {rows} {cell[:8]!r}", column, changed)


def _column(column: int, way: str) -> Change:
    return _table(way, column, lambda cells: list(map(repr, COLUMNS[way](np.array(cells, float)).tolist())))


def _bytes() -> st.SearchStrategy[Change]:
    """Draw a part of a file that is cut, flipped, left out, doubled, noise or zero."""

    def change(kind: str, seed: int) -> Change:
        def changed(content: bytes) -> bytes:
            rng = random.Random(seed)
            a = rng.randrange(len(content) + 1)
            b = min(len(content), a + rng.randrange(200))
            if kind == "cut":
                return content[:a]
            if kind == "flip":
                return (
                    content[:a] + bytes(byte ^ 1 << rng.randrange(8) for byte in content[a:b]) + content[b:]
                )
            middle = {
                "drop": b"",
                "double": 2 * content[a:b],
                "noise": rng.randbytes(b - a),
                "zeros": bytes(b - a),
            }
            return content[:a] + middle[kind] + content[b:]

        return Change(f"{kind} {seed}", changed)

    kinds = st.sampled_from(("cut", "flip", "double", "drop", "noise", "zeros"))
    return st.builds(change, kinds, st.integers(0, 9999))


def _packed(inner: Change) -> Change:
    return Change(f"packed {inner.name}", lambda b: gzip.compress(inner.of(gzip.decompress(b)), mtime=0))


def members(content: bytes) -> dict[str, bytes]:
    """Return the members of a zip."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def zipped(pairs: list[tuple[str, bytes]], kind: int = zipfile.ZIP_STORED) -> bytes:
    """Return a zip of (name, content) pairs; names may come twice."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", kind) as target, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        for name, content in pairs:
            target.writestr(zipfile.ZipInfo(name), content, kind)
    return out.getvalue()


def with_member(content: bytes, name: str, change: Callable[[bytes], bytes]) -> bytes:
    """Return a zip in which a member has another content."""
    return zipped([(n, change(b) if n == name else b) for n, b in members(content).items()])


def _members(good: bytes) -> st.SearchStrategy[Change]:
    """Draw a member of a zip that is changed, missing, there twice, a bomb, or packed in another way."""
    whole = {
        "without": lambda b, name: zipped([pair for pair in members(b).items() if pair[0] != name]),
        "twice": lambda b, name: zipped([*members(b).items(), (name, members(b)[name])]),
        "bomb": lambda b, n: zipped([*(members(b) | {n: bytes(110_000_000)}).items()], zipfile.ZIP_DEFLATED),
        "packed": lambda b, _: zipped([*members(b).items()], zipfile.ZIP_LZMA),
        "many": lambda b, _: zipped([*members(b).items(), *((f"x{k}", b"") for k in range(20_000))]),
    }  # fmt: skip

    def inside(name: str) -> st.SearchStrategy[Change]:
        return changes(members(good)[name]).map(
            lambda inner: Change(f"{name}: {inner.name}", lambda b: with_member(b, name, inner.of))
        )

    names = st.sampled_from(list(members(good)))
    return names.flatmap(inside) | st.builds(
        lambda way, name: Change(f"{way} {name}", lambda b: whole[way](b, name)),
        st.sampled_from(list(whole)),
        names,
    )


def replace(path: Path, make: Callable[[Path], object]) -> None:
    """Put something else in the place of a file."""
    shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    make(path)


def _listing(folder: Path | None) -> dict[str, str]:
    """Return everything below a folder, with a digest of the first megabyte of each file."""
    found = {}
    for path in folder.rglob("*") if folder else ():
        found[str(path)] = ""
        if path.is_file() and not path.is_symlink() and "__pycache__" not in path.parts:
            with path.open("rb") as file:
                found[str(path)] = f"{path.stat().st_size} {hashlib.sha1(file.read(2**20)).hexdigest()}"
    return found


@contextlib.contextmanager
def _bounded_memory() -> Iterator[None]:
    """What would take gigabytes raises MemoryError."""
    used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
