"""Flight logs with evil columns, clocks, bytes, sizes and names; mapping files are in `test_toml.py`."""

import functools
import gzip
import re
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from inclined_landing.eval import cli
from inclined_landing.eval.logs import FlightLog, read_log
from inclined_landing.models.errors import UserError, shown
from tests.campaign.commands import NAMES
from tests.campaign.flights import COLUMNS, ROWS, a_flight, fly, text
from tests.campaign.judge import Case, Wrong, command, contents, damaged, examples, judged, places, write
from tests.log_files import a_log, firmware_values, sd_card, write_bag

CELLS = (
    *("nan", "inf", "-inf", "1e300", "-1e300", "1e999", "5e-324", "0", "-1", "65536", "9" * 400),
    *("", " ", "text", "None", "1,5", "1;5", '"', "0x10", "1_000", "１２", "TRUE", "1+2j", "2020-01-01"),
    "x" * 2_000_000,
)


def changed(column: str, rows, cell) -> str:
    columns = a_flight()
    columns[column] = list(columns[column])
    for row in range(ROWS)[rows] if isinstance(rows, slice) else [rows]:
        columns[column][row] = cell
    return text(columns)


def case(name: str, content, suffix: str = ".csv", take=read_log, **options) -> Case:
    """A log that holds `content`; or what `content(path)` returns, or has made there itself."""

    def make(folder: Path) -> Path:
        path = folder / f"log{suffix}"
        made = content(path) if callable(content) else content
        return write(path, made) if isinstance(made, (str, bytes)) else path

    return Case(f"{name}{suffix}", make, take, fly, **options)


def table(name: str, **columns) -> Case:
    """A good log with other columns, which functions of the time column make; None: without it."""

    def make(_) -> str:
        good = a_flight()
        made = {key: column and column(good["t"]) for key, column in columns.items()}
        return text({key: column for key, column in (good | made).items() if column is not None})

    return case(name, make)


def pack(path: Path, content: bytes, times: int) -> None:
    """`content` as often as that, packed in so many parts, as gzip files may be."""
    part = gzip.compress(content, 1)
    with path.open("wb") as file:
        for _ in range(times):
            file.write(part)


def without_doubt_about_units(path: Path) -> FlightLog:
    """Read a log in which one number is wrong: it says nothing about the unit of the column."""
    try:
        return read_log(path)
    except UserError as error:
        if re.search("unit|millimet|degrees|millivolt", str(error)):
            raise Wrong(f"one wrong number: {error}") from error
        raise


def cells(column: str, cell: str, where: str) -> Case:
    """A log with an evil cell in one row, the last or all rows of a column."""
    rows = {"one": 200, "all": slice(None), "last": -1}[where if len(cell) < 500 else "one"]
    take = without_doubt_about_units if where == "one" and column != "t" else read_log
    return case(f"{column} {where} {cell[:8]!r}", lambda _: changed(column, rows, cell), take=take)


def columns(column: str, alone: bool) -> Case:
    """A log without a column, or of one alone."""
    return table(f"{column} {alone}", **{other: None for other in COLUMNS if (other != column) == alone})


CLOCKS = {
    "epoch seconds": lambda t: t + 1.7e9,
    "epoch ms": lambda t: 1e3 * (t + 1.7e9),
    "epoch ns": lambda t: 1e9 * (t + 1.7e9),
    "ns": lambda t: 1e9 * t,
    "1e300": lambda t: 1e300 * t,
    "to 1e300": lambda t: np.r_[t[:-1], 1e300],
    "gap": lambda t: np.where(t > 2, t + 1e6, t),
    "gaps": lambda t: 1e6 * t,
    "ten gaps": lambda t: t + 1e3 * np.floor(3 * t),
    "hours": lambda t: 3600 * t,
    "constant": lambda t: 0 * t,
    "back": lambda t: t[::-1],
    "twice": lambda t: np.r_[t[:200], t[:200]],
    "one back": lambda t: np.r_[t[:200], 0.0, t[201:]],
    "one ahead": lambda t: np.r_[t[:200], 1e3, t[201:]],
    "duplicates": lambda t: np.repeat(t[::2], 2),
    "one duplicate": lambda t: np.r_[t[:200], t[199:-1]],
    "tiny": lambda t: 1e-12 * t,
    "denormal": lambda t: np.arange(ROWS) * 5e-324,
    "negative": lambda t: t - 1e6,
    "slow": lambda t: 10 * t,
    "very slow": lambda t: 100 * t,
    "jitter": lambda t: np.sort(np.random.default_rng(0).uniform(0, 4, ROWS)),
}


def evil_tables() -> dict[str, object]:
    """Texts that are no good log, or odd ones, by name."""
    good = text(a_flight())
    head, body = good.split("\n", 1)
    return {
        "good": good,
        **{f"{n} rows": text({c: v[:n] for c, v in a_flight().items()}) for n in (0, 1, 2, 3, 20)},
        "header of megabytes": lambda _: "a" * 5_000_000 + "\n" + body,
        "many columns": lambda _: ",".join(f"c{k}" for k in range(300_000)) + "\n" + body,
        "same column often": lambda _: ",".join(["t"] * 200_000) + "\n" + body,
        "row of megabytes": lambda _: good + "1," * 3_000_000 + "\n",
        "rows of megabytes": lambda _: head + "\n" + ("1" * 3_000_000 + "\n") * 5,
        "zero bytes": lambda _: good.replace("1.", "\0."),
        "zero bytes at the end": lambda _: good + "\0" * 4096,
        "windows": lambda _: good.replace("\n", "\r\n"),
        "old mac": lambda _: good.replace("\n", "\r"),
        "mark of order": lambda _: "\ufeff" + good,
        "utf-16": lambda _: good.encode("utf-16"),
        "utf-16 big": lambda _: b"\xfe\xff" + good.encode("utf-16-be"),
        "utf-16 cut": lambda _: good.encode("utf-16")[:-1],
        "utf-16 without mark": lambda _: good.encode("utf-16-le"),
        "utf-32": lambda _: good.encode("utf-32"),
        "latin": lambda _: good.replace("vbat", "Spännung").encode("latin-1"),
        "semicolons": lambda _: good.replace(",", ";"),
        "german": lambda _: good.replace(",", ";").replace(".", ","),
        "tabs": lambda _: good.replace(",", "\t"),
        "spaces": lambda _: good.replace(",", " "),
        "spaces after": lambda _: good.replace(",", ", "),
        "commas at the end": lambda _: good.replace("\n", ",\n"),
        "two commas at the end": lambda _: good.replace("\n", ",,\n"),
        "quoted": lambda _: re.sub("[^,\n]+", lambda cell: f'"{cell[0]}"', good),
        "open quote": lambda _: good.replace("0.01,", '"0.01,', 1),
        "comment": lambda _: "# a flight\n" + good,
        "empty lines": lambda _: good.replace("\n", "\n\n"),
        "lines of blanks": lambda _: "\n" * 100_000,
        "units": lambda _: head + "\n" + "s,m,m,m,rad,rad,rad,PWM,rad,rad,rad/s,m/s,m/s,m/s,V,1\n" + body,
        "units wrong": lambda _: head + "\n" + ",".join(["parsec"] * len(COLUMNS)) + "\n" + body,
        "units few": lambda _: head + "\ns,m\n" + body,
        "units evil": lambda _: head + "\n" + ",".join(["\x1b[m" + "x" * 9000] * len(COLUMNS)) + "\n" + body,
        "names evil": lambda _: head.replace("vbat", "\x1b[31m\u202e") + "\n" + body,
        "unknown names": lambda _: ",".join("x" * 40 + str(k) for k in range(3000)) + "\n" + body,
        "header alone": lambda _: head + "\n",
        "header without end": lambda _: head,
        "one byte": "t",
        "html": "<!DOCTYPE html><html><body>404</body></html>",
        "json": lambda _: '{"t": [0, 1, 2]}',
        "noise": lambda _: np.random.default_rng(0).bytes(50_000),
        "noise of text": lambda _: bytes(np.random.default_rng(0).integers(32, 127, 50_000, np.uint8)),
        "million cells of quotes": lambda _: '"' * 1_000_001,
        "million commas": lambda _: "," * 1_000_000 + "\n" + "," * 1_000_000,
    }  # fmt: skip


def packed_tables() -> dict[str, object]:
    """Packed logs, those that are none, and bombs."""
    good = text(a_flight())
    packed = gzip.compress(good.encode())
    return {
        "good": packed,
        "not packed": good,
        "cut": packed[:-20],
        "cut early": packed[:15],
        "rest": packed + b"rest",
        "twice": packed + packed,
        "packed twice": gzip.compress(packed),
        "bomb of zeros": lambda path: pack(path, bytes(2**20), 4000),
        "bomb of rows": lambda path: pack(path, b"0,0,0\n" * 2**18, 1000),
        "bomb of a line": lambda path: pack(path, b"1" * 2**20, 4000),
        "empty": b"",
    }


def zipped(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("log.csv", text(a_flight()))


LINKS = {"null": "/dev/null", "random": "/dev/urandom", "terminal": "/dev/tty", "zero": "/dev/zero"}
JOINED = ("+", "log.csv+", "+log.csv", "log.csv+none.csv", "log.csv+log.csv", "a+" * 2000 + "b")


def joined(names: str) -> Case:
    """Several logs of one flight, of which some are not there."""

    def take(folder: Path) -> FlightLog:
        return read_log("+".join(part and f"{folder}/{part}" for part in names.split("+")))

    return Case(f"joined {names[:30]}", flight, take, named="")


def flight(folder: Path, name: str = "log.csv") -> Path:
    return write(folder / name, text(a_flight())).parent


@functools.cache
def a_card() -> bytes:
    log = a_log(ROWS, position=np.stack([a_flight()[a] for a in "xyz"], axis=1))
    return sd_card(firmware_values(log), log.t, 2, {"pm.state": 1.0})


def card(part: int, damage) -> Case:
    """A micro-SD card's log of which the first `part` bytes are damaged."""
    name, make = damage
    return case(f"card {part} {name}", lambda _: make() + a_card()[part:], "", named="log")


def events(count: int, rest: int) -> Case:
    """A card's log that says it has so many kinds of events."""
    more = (a_card()[5:], b"", b"\1\0a\0\0\0" * count)[rest]
    content = lambda _: a_card()[:3] + count.to_bytes(2, "little") + more  # noqa: E731
    return case(f"card of {count} events {rest}", content, "", named="log")


@functools.cache
def a_bag(ros: int) -> dict[str | None, bytes]:
    """The files of a bag by name; None: the bag is the file."""
    with tempfile.TemporaryDirectory() as place:
        path = write_bag(Path(place, f"log{'.bag' if ros == 1 else ''}"), a_log(60), ros)
        return {None: path.read_bytes()} if ros == 1 else {p.name: p.read_bytes() for p in path.iterdir()}


def bag(ros: int, file: str | None, damage) -> Case:
    """A bag of ROS 1 or 2 with one of its files damaged."""
    name, make = damage

    def made(path: Path) -> None:
        for other, content in a_bag(ros).items():
            if other:
                path.mkdir(exist_ok=True)
            write(path / other if other else path, make() if other == file else content)

    return case(f"ros{ros} {file} {name}", made, ".bag" if ros == 1 else "", named="log")


def bags(part: tuple[int, str | None]) -> st.SearchStrategy[Case]:
    return contents(lambda: a_bag(part[0])[part[1]]).map(lambda damage: bag(*part, damage))


def called(name: str, there: bool, json: bool) -> Case:
    """`landing-eval logs` of a log with an evil name, or of none."""
    words = ["logs", "--json"] if json else ["logs"]
    make = lambda folder: flight(folder, f"{name}.csv") / f"{name}.csv" if there else folder / name  # noqa: E731
    named = "" if there or "+" in name else shown(name[:30])
    return Case(f"name {name!r}", make, lambda path: command(cli.main, [*words, str(path)]), named=named)


def unit(words: str) -> Case:
    take = lambda folder: command(cli.main, ["logs", f"{folder}/log.csv", f"--unit={words}"])  # noqa: E731
    return Case(f"unit {words[:30]!r}", flight, take, named="")


UNITS = (*NAMES, "roll", "roll=", "=deg", "roll=deg", "roll=roll=deg", "x=deg", "q=1", "x=" * 5000)
PARTS = ((1, None), (2, "metadata.yaml"), (2, "log.db3"))


def named(found: Callable[[], dict], suffix: str = ".csv") -> st.SearchStrategy[Case]:
    """Draw one of the contents that a function has by name."""
    found = functools.cache(found)
    return st.deferred(lambda: st.sampled_from(list(found()))).map(lambda n: case(n, found()[n], suffix))


KINDS = {
    "cells": st.builds(
        *(cells, st.sampled_from(COLUMNS), st.sampled_from(CELLS)), st.sampled_from(("one", "all", "last"))
    ),
    "columns": st.builds(columns, st.sampled_from(COLUMNS), st.booleans()),
    "clocks": st.sampled_from(list(CLOCKS)).map(lambda name: table(f"clock {name}", t=CLOCKS[name])),
    "texts": named(evil_tables)
    | contents(lambda: text(a_flight()).encode()).map(lambda s: case(f"text {s[0]}", s[1]())),
    "packed": named(packed_tables, ".csv.gz")
    | st.sampled_from([".zip", ".csv"]).map(lambda suffix: case("zip", zipped, suffix)),
    "elsewhere": st.one_of(
        places("log.csv", read_log),
        st.sampled_from(list(LINKS)).map(lambda to: case(to, lambda path: path.symlink_to(LINKS[to]))),
        st.sampled_from(JOINED).map(joined),
    ),
    "cards": st.builds(card, st.sampled_from((400, 10**9)), damaged(lambda: a_card()[:400]))
    | st.builds(events, st.sampled_from((0, 1, 65535)), st.integers(0, 2)),
    "bags": st.sampled_from(PARTS).flatmap(bags),
    "names": st.builds(called, st.sampled_from(NAMES), st.booleans(), st.booleans())
    | st.sampled_from(UNITS).map(unit),
}


@pytest.mark.parametrize("kind", KINDS)
@examples(3)
@given(data=st.data())
def test_logs_are_used_or_refused(kind, data):
    judged(data.draw(KINDS[kind]))
