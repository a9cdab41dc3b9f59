"""What every case of the campaign is judged by.

A case is an input (a file, a folder, an option) and something that takes it. Taking it ends in one of
two ways: it works, and what was read then flies and stays finite; or it is refused in one sentence: one
printable line of at most 300 characters that names the file and leaks no words of Python, no traceback,
exit code 2, nothing new on disk, nothing changed, within bounded time and memory.

To add a kind of input:

- a TOML file: an entry of `READERS` in `test_toml.py`, a good file and what reads it. Nothing else.
- a folder that something goes on in: an entry of `FOLDERS` in `test_folders.py`.
- a command or an option: its words in `NEEDED` of `commands.py`, where it cannot begin without any.
- anything else: a module `test_<kind>.py` beside this one, with a strategy of `Case`s made of `spoilt`
  tables, `contents` of files, `places` or tables of evil things, and one test over it:

        def cells(name: str) -> Case:
            return Case(name, lambda folder: write(folder / "a.csv", f"x\n{EVIL[name]}\n"), read_log, fly)

        @examples(10)
        @given(case=st.sampled_from(list(EVIL)).map(cells))
        def test_logs_are_used_or_refused(case):
            judged(case)

By default as many cases are drawn as `examples` says, where slow tests are wanted MORE times as many, with
CAMPAIGN=N in the environment N times. What takes time is done in `make`, which writes the input, or in
`take`.

`take` calls the reader itself where it can (fast); `command(main, [...])` runs a whole command and turns exit
code 2 with its sentence into a UserError, everything else into an error.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import datetime
import functools
import hashlib
import io
import itertools
import json
import math
import os
import random
import re
import resource
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import hypothesis
import hypothesis.strategies as st

from inclined_landing.models.errors import UserError

whole = True  # are slow tests wanted; `conftest.py` knows
MORE = 30
LONGEST_SENTENCE = 300  # characters, the path of the case not counted
LEAKS = re.compile(
    r"Traceback|literal for|could not convert|instantiated|<class|NoneType|object at 0x|\[Errno|: None$"
)
SECONDS = 20.0  # of processor time for taking a case, at most; first calls compile
MEMORY = 3 * 2**30  # bytes of address space on top of what the test process has

# One of each kind of wrong value; generators spell them as TOML, JSON or options.
EVIL: dict[str, object] = {
    "nan": math.nan, "infinite": math.inf, "minus infinite": -math.inf, "zero": 0, "minus zero": -0.0,
    "minus one": -1, "tiny": 1e-300, "denormal": 5e-324, "huge": 1e300, "million": 1e6, "minus million": -1e6,
    "2^63": 2**63, "400 digits": int("9" * 400), "true": True, "date": datetime.date(2020, 1, 1),
    "text": "heavy", "empty text": "", "number as text": "1.0", "long text": "x" * 2000,
    "control characters": "a\nb\x1b[31m\u202e",
    "empty list": [], "list of one": [1.0], "list of two": [1.0, 2.0], "list of three": [1.0, 2.0, 3.0],
    "list of four": [1.0, 2.0, 3.0, 4.0], "list with text": [1.0, "x"], "list with nan": [math.nan] * 3,
    "huge list": [0.5] * 500, "list of lists": [[1.0, 2.0], [3.0, 4.0]], "nested": [[[[[[[[[[1.0]]]]]]]]]],
    "empty table": {}, "table": {"value": 1.0},
}  # fmt: skip
# What a text file may hold that is neither TOML nor JSON of the right kind.
TEXTS: dict[str, bytes] = {
    "empty": b"", "white": b"\n" * 1000, "noise": b"\xff" * 999, "zero bytes": bytes(999), "list": b"[1]",
    "null": b"null", "number": b"1", "table": b"{}", "nested": b"[" * 100_000,
    "nested tables": b'{"a":' * 20_000, "XML": b"<mujoco/>",
}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Case:
    """One input and what takes it."""

    name: str
    make: Callable[[Path], Path]  # writes the input into an empty folder and returns its path
    take: Callable[[Path], object]  # reads it; raises UserError for a refusal
    works: Callable[[object], None] = lambda result: None  # what then must hold of what `take` returned
    named: str | None = None  # what the sentence must name; None: the file
    seconds: float = SECONDS


class Wrong(AssertionError):
    """The case ended in neither of the two right ways."""


def judge(case: Case, folder: Path) -> str:
    """Run one case in an empty folder; returns "works" or the sentence, raises Wrong for anything else."""
    path = case.make(folder)
    before = _listing(folder)
    started = time.process_time()
    try:
        with _bounded_memory():
            result = case.take(path)
    except UserError as error:
        sentence = str(error)
        _check_sentence(sentence, case, path, folder)
    except (Exception, SystemExit) as error:
        raise Wrong(f"{case.name}: {type(error).__name__}: {str(error)[:500]}") from error
    else:
        sentence = "works"
    seconds = time.process_time() - started
    if seconds > case.seconds:
        raise Wrong(f"{case.name}: took {seconds:.1f} s")
    if sentence == "works":
        case.works(result)
    elif _listing(folder) != before:
        raise Wrong(f"{case.name}: was refused, and left {sorted(set(_listing(folder)) ^ set(before))}")
    return sentence


def judged(case: Case) -> str:
    """Run one case in a folder of its own, as `judge`."""
    with tempfile.TemporaryDirectory() as folder:
        return judge(case, Path(folder))


def examples(few: int) -> hypothesis.settings:
    """Return settings of a test over drawn cases: by default so many, the same ones each time."""
    times = int(os.environ.get("CAMPAIGN", MORE if whole else 1))
    return hypothesis.settings(
        max_examples=few * times,
        phases=(hypothesis.Phase.generate,),
        database=None,
        suppress_health_check=list(hypothesis.HealthCheck),
    )


def command(main: Callable[[list[str]], int], arguments: list[str]) -> str:
    """Standard output of a command's `main` called in this process; exit code 2 becomes a UserError."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(arguments)
        except SystemExit as stop:
            code = stop.code
    said = err.getvalue()
    if code in (0, None):
        return out.getvalue()
    if code == 2 and said.endswith("\n") and said[:-1].isprintable():
        raise UserError(said[:-1])
    raise Wrong(f"exit code {code}: {said[-1500:]}")


def damaged(content: bytes | Callable[[], bytes]) -> st.SearchStrategy[tuple[str, Callable[[], bytes]]]:
    """Draw (name, what makes the bytes) of a file of which a part is cut, flipped, doubled ..."""

    def damage(kind: str, seed: int) -> tuple[str, Callable[[], bytes]]:
        made = lambda: _damaged(content() if callable(content) else content, kind, seed)  # noqa: E731
        return f"{kind} {seed}", made

    kinds = st.sampled_from(["cut", "flip", "double", "drop", "noise", "swap", "zeros"])
    return st.builds(damage, kinds, st.integers(0, 9999))


def contents(good: bytes | Callable[[], bytes], more: dict | None = None):
    """Draw (name, what makes the bytes) of a file: other texts, `more` of them, and a good file damaged."""
    texts = {name: (lambda text=text: text) for name, text in TEXTS.items()} | (more or {})
    return st.sampled_from(list(texts.items())) | damaged(good)


def _damaged(content: bytes, kind: str, seed: int) -> bytes:
    rng = random.Random(seed)
    a, b = sorted(rng.randrange(len(content)) for _ in range(2))
    b = min(b, a + 200) if kind != "cut" else b
    return {
        "cut": lambda: content[:a],
        "flip": lambda: content[:a] + bytes([content[a] ^ (1 << rng.randrange(8))]) + content[a + 1 :],
        "double": lambda: content[:b] + content[a:],
        "drop": lambda: content[:a] + content[b:],
        "noise": lambda: content[:a] + rng.randbytes(b - a) + content[b:],
        "swap": lambda: content[b:] + content[:b],
        "zeros": lambda: content[:a] + bytes(b - a) + content[b:],
    }[kind]()


def spoilt(
    good: dict | list, where: Callable[[tuple], bool] = lambda keys: True
) -> st.SearchStrategy[tuple[str, Callable[[dict], dict]]]:
    """Draw a way to spoil one entry of tables that are like `good`, (name, what returns a spoilt copy).

    An entry at any depth, of lists the first one, gets an evil value, is left out or gets another name; or a
    table gets one more. where: of the keys that lead to an entry, whether it may be this one.
    """
    ways = [
        (keys, way)
        for keys in filter(where, _entries(good))
        for way in (*EVIL, *(("missing", "misspelt") if keys[-1] != "unknown" else ()))
    ]

    def change(chosen: tuple[tuple, str]) -> tuple[str, Callable[[dict], dict]]:
        keys, way = chosen
        name = f"{'.'.join(map(str, keys))} {way}"
        if way != "misspelt" or not isinstance(keys[-1], str):
            return name, functools.partial(changed, keys=keys, value=EVIL.get(way, ...))

        def renamed(tables: dict) -> dict:
            value = functools.reduce(lambda inner, key: inner[key], keys, tables)
            return changed(changed(tables, keys, ...), (*keys[:-1], keys[-1] + keys[-1][-1]), value)

        return name, renamed

    return st.sampled_from(ways).map(change)


def _entries(table: dict | list) -> Iterator[tuple]:
    for key, value in table.items() if isinstance(table, dict) else enumerate(table[:1]):
        yield (key,)
        if isinstance(value, (dict, list)):
            yield from ((key, *rest) for rest in _entries(value))
    if isinstance(table, dict):
        yield ("unknown",)


def changed(tables: dict, keys: tuple, value: object) -> dict:
    """A copy of tables with another value (...: none) at the end of `keys`."""
    result = inner = copy.deepcopy(tables)
    for key in keys[:-1]:
        inner = inner[key]
    if value is ...:
        del inner[keys[-1]]
    else:
        inner[keys[-1]] = value
    return result


def respelt(old: bytes, change: Callable[[dict], dict]) -> bytes:
    """The bytes of a JSON file after a change of what it holds."""
    return json.dumps(change(json.loads(old)), default=str).encode()


def places(name: str, take: Callable[[Path], object]) -> st.SearchStrategy[Case]:
    """Draw a case of what a path may lead to instead of a file called `name`."""
    there = {
        "nothing there": lambda path: None,
        "a folder": lambda path: path.mkdir(),
        "a pipe": os.mkfifo,
        "endless": lambda path: path.symlink_to("/dev/zero"),
        "a loop": lambda path: path.symlink_to(path),
        "a process's memory": lambda path: path.symlink_to("/proc/self/mem"),
        "gigabytes": lambda path: (write(path, ""), os.truncate(path, 2**34)),
        "nothing in it": lambda path: write(path, ""),
    }
    cases = [
        Case(title, lambda folder, make=make: (make(folder / name), folder / name)[1], take)
        for title, make in there.items()
    ]
    cases += [
        Case("below a file", lambda folder: write(folder / "x", "") / name, take),
        Case("NUL in the name", lambda folder: folder / "a\0b", take, named="a\\x00b"),
        Case("long name", lambda folder: folder / ("x" * 300), take, named="x" * 50),
        Case("no UTF-8 in the name", lambda folder: folder / os.fsdecode(b"v\xff.x"), take, named="v\\xff"),
    ]
    return st.sampled_from(cases)


def toml(value) -> str:
    """A value spelt in TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + "".join(f"\\u{ord(c):04x}" if c < " " or c in '"\\' else c for c in value) + '"'
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml(k)} = {toml(v)}" for k, v in value.items()) + "}"
    return str(value)  # numbers and dates; nan and inf are TOML's own words


def write(path: Path, content: str | bytes) -> Path:
    """Write a file and return its path."""
    path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8", "surrogateescape"))
    return path


def _check_sentence(sentence: str, case: Case, path: Path, folder: Path) -> None:
    plain = sentence.replace(str(folder), "").replace(path.name, "")
    plain = re.sub("x{50,}", "", plain)  # of a long name
    if not sentence.isprintable() or not sentence.strip():
        raise Wrong(f"{case.name}: not one printable line: {sentence[:500]!r}")
    if len(plain) > LONGEST_SENTENCE:
        raise Wrong(f"{case.name}: {len(plain)} characters: {plain}")
    if LEAKS.search(re.sub(r" (raised \w+:|returned) .*", "", plain)):  # by code of others, and quoted
        raise Wrong(f"{case.name}: leaks words of Python: {sentence}")
    named = case.named if case.named is not None else path.name
    if named not in sentence:
        raise Wrong(f"{case.name}: does not name {named}: {sentence}")


def _listing(folder: Path) -> dict[str, str]:
    """Everything below a folder with a digest of its first megabyte; Python's own cache aside."""
    found = {}
    for place, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if name != "__pycache__"]
        for path in map(Path(place).joinpath, itertools.chain(folders, files)):
            found[str(path)] = ""
            if path.is_file() and not path.is_symlink():
                with path.open("rb") as file:
                    head = hashlib.blake2b(file.read(2**20)).hexdigest()
                found[str(path)] = f"{path.stat().st_size} {head}"
    return found


@contextlib.contextmanager
def _bounded_memory():
    """What would take gigabytes raises MemoryError."""
    with open("/proc/self/statm") as file:
        used = int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
