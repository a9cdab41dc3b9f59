"""What every case of the campaign is judged by.

A case is an input (a file, a folder, an option) and something that takes it. Taking it ends in one of
two ways: it works, and what was read then flies and stays finite; or it is refused in one sentence: one
printable line of at most 300 characters that names the file, no traceback, exit code 2, nothing new on
disk, nothing changed, within bounded time and memory.

To add a kind of input, write a module `test_<kind>.py` beside this one with

1. a generator of `Case`s: loops over fields and `EVIL` values, or over seeded `mutations` of a good
   file; never a list written by hand;
2. one test over them, with the marks of `parametrised`: a fixed sample runs by default, the rest with
   `-m slow`.

        def cases():
            for name, value in EVIL.items():
                yield Case(
                    f"study seed {name}",
                    make=lambda folder: write(folder / "study.toml", f"seed = {toml(value)}"),
                    take=lambda path: study.read(path),
                    works=lambda study: fly(study),
                )

        @parametrised(cases(), sample=20)
        def test_studies_are_flown_or_refused(case, tmp_path):
            judge(case, tmp_path)

`take` calls the reader itself where it can (fast); `command(main, [...])` and `process([...])` run a
whole command and turn exit code 2 with its sentence into a UserError, everything else into an error.
Import as `from campaign.judge import Case, judge`; `mutations` damages the bytes of a good file.
Loop variables are bound by default arguments (`value=value`).
"""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import hashlib
import io
import math
import os
import random
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import pytest

from inclined_landing.models.errors import UserError

whole = True  # are slow cases wanted; `conftest.py` knows
LONGEST_SENTENCE = 300  # characters, the path of the case not counted
SECONDS = 20.0  # of processor time for taking a case, at most; first calls compile
MEMORY = 3 * 2**30  # bytes of address space on top of what the test process has

# One of each kind of wrong value; generators spell them as TOML, JSON or options.
EVIL: dict[str, object] = {
    "nan": math.nan,
    "infinite": math.inf,
    "minus infinite": -math.inf,
    "zero": 0,
    "minus zero": -0.0,
    "minus one": -1,
    "tiny": 1e-300,
    "denormal": 5e-324,
    "huge": 1e300,
    "million": 1e6,
    "minus million": -1e6,
    "2^63": 2**63,
    "400 digits": int("9" * 400),
    "true": True,
    "text": "heavy",
    "empty text": "",
    "number as text": "1.0",
    "long text": "x" * 2000,
    "control characters": "a\nb\x1b[31m\u202e",
    "date": datetime.date(2020, 1, 1),
    "empty list": [],
    "list of one": [1.0],
    "list of two": [1.0, 2.0],
    "list of three": [1.0, 2.0, 3.0],
    "list of four": [1.0, 2.0, 3.0, 4.0],
    "list with text": [1.0, "x"],
    "list with nan": [math.nan, math.nan, math.nan],
    "huge list": [0.5] * 500,
    "list of lists": [[1.0, 2.0], [3.0, 4.0]],
    "nested": [[[[[[[[[[1.0]]]]]]]]]],
    "empty table": {},
    "table": {"value": 1.0},
}


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


def parametrised(cases: Iterable[Case], sample: int, seed: int = 0):
    """The mark for a test over `case`: a fixed sample of them by default, the rest marked slow.

    Where no slow test is asked for they are left out: making 20 000 of them takes 20 s.
    """
    cases = list(cases)
    names = [case.name for case in cases]
    assert len(set(names)) == len(names), "names of cases must differ"
    chosen = set(random.Random(seed).sample(range(len(cases)), min(sample, len(cases))))
    return pytest.mark.parametrize(
        "case",
        [
            pytest.param(case, marks=() if k in chosen else pytest.mark.slow, id=case.name)
            for k, case in enumerate(cases)
            if k in chosen or whole
        ],
    )


def command(main: Callable[[list[str]], int], arguments: list[str]) -> str:
    """Standard output of a command's `main` called in this process; exit code 2 becomes a UserError."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(arguments)
        except SystemExit as stop:
            code = stop.code
    return _ended(code, out.getvalue(), err.getvalue())


def process(arguments: list[str], seconds: float = 60.0) -> str:
    """Standard output of `python ARGUMENTS` as a process of its own; exit code 2 becomes a UserError."""
    limit = MEMORY + 2**33  # libraries reserve much that they never touch
    done = subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        timeout=seconds,
        stdin=subprocess.DEVNULL,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)),
        check=False,
    )
    return _ended(done.returncode, done.stdout.decode("utf-8"), done.stderr.decode("utf-8"))


def mutations(content: bytes, number: int, seed: int = 0) -> Iterator[tuple[str, bytes]]:
    """Seeded damages of a file's bytes, (name, content): cut, flipped, doubled, dropped and swapped parts."""
    rng = random.Random(seed)
    for k in range(number):
        kind = ("cut", "flip", "double", "drop", "noise", "swap", "zeros")[k % 7]
        a, b = sorted(rng.randrange(len(content)) for _ in range(2))
        b = min(b, a + 200) if kind != "cut" else b
        noise = bytes(rng.randrange(256) for _ in range(b - a)) if kind == "noise" else b""
        yield (
            f"{kind} {k}",
            {
                "cut": content[:a],
                "flip": content[:a] + bytes([content[a] ^ (1 << rng.randrange(8))]) + content[a + 1 :],
                "double": content[:b] + content[a:],
                "drop": content[:a] + content[b:],
                "noise": content[:a] + noise + content[b:],
                "swap": content[b:] + content[:b],
                "zeros": content[:a] + bytes(b - a) + content[b:],
            }[kind],
        )


def places(name: str, take: Callable[[Path], object]) -> Iterator[Case]:
    """Cases of what a path may lead to instead of a file called `name`."""

    def there(title, make):
        def made(folder):
            make(folder / name)
            return folder / name

        return Case(title, made, take)

    yield there("nothing there", lambda path: None)
    yield there("a folder", lambda path: path.mkdir())
    yield there("a pipe", os.mkfifo)
    yield there("endless", lambda path: path.symlink_to("/dev/zero"))
    yield there("a loop", lambda path: path.symlink_to(path))
    yield there("a process's memory", lambda path: path.symlink_to("/proc/self/mem"))
    yield there("gigabytes", lambda path: (write(path, ""), os.truncate(path, 2**34)))
    yield there("empty", lambda path: write(path, ""))
    yield Case("below a file", lambda folder: write(folder / "x", "") / name, take)
    yield Case("NUL in the name", lambda folder: folder / "a\0b", take, named="a\\x00b")
    yield Case("long name", lambda folder: folder / ("x" * 300), take, named="x" * 50)
    yield Case("no UTF-8 in the name", lambda folder: folder / os.fsdecode(b"v\xff.x"), take, named="v\\xff")


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


def somewhere(name: str, folder: Path) -> list[str]:
    """Options that a `landing-eval` command of this name needs to write into a folder, or to begin at all."""
    more = {"view": [], "export": ["--format", "c"], "fly": ["--simulated"]}.get(name, [])
    file = {"video": "out.mp4", "replay": "out.html"}.get(name, "out.png")
    return more if name == "view" else [*more, "--out", str(folder / file)]


def _ended(code, out: str, err: str) -> str:
    if code in (0, None):
        return out
    if code == 2 and err.endswith("\n") and err[:-1].isprintable():
        raise UserError(err[:-1])
    raise Wrong(f"exit code {code}: {err[-1500:]}")


def _check_sentence(sentence: str, case: Case, path: Path, folder: Path) -> None:
    plain = sentence.replace(str(folder), "").replace(path.name, "")
    if not sentence.isprintable() or not sentence.strip():
        raise Wrong(f"{case.name}: not one printable line: {sentence[:500]!r}")
    if len(plain) > LONGEST_SENTENCE:
        raise Wrong(f"{case.name}: {len(plain)} characters: {plain}")
    named = case.named if case.named is not None else path.name
    if named not in sentence:
        raise Wrong(f"{case.name}: does not name {named}: {sentence}")


def _listing(folder: Path) -> dict[str, str]:
    """Everything below a folder with a digest of its first megabyte."""
    found = {}
    for place, folders, files in os.walk(folder):
        for name in folders:
            found[os.path.join(place, name)] = ""
        for name in files:
            path = Path(place, name)
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
