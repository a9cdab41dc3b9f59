"""Flight logs with evil columns, clocks, bytes, sizes and names; what mapping files alone have."""

import dataclasses
import functools
import gzip
import io
import os
import re
import tempfile
import zipfile
from pathlib import Path

import numpy as np

from inclined_landing.eval import cli
from inclined_landing.eval.logs import FlightLog, read_log
from inclined_landing.models.errors import UserError, shown
from tests.campaign.commands import NAMES
from tests.campaign.flights import COLUMNS, ROWS, a_flight, fly, text
from tests.campaign.judge import TEXTS, Case, Wrong, command, judge, mutations, parametrised, places, write
from tests.campaign.test_toml import case as mapping_case
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


def columns_with_evil_cells():
    for column in COLUMNS:
        for k, cell in enumerate(CELLS):
            for where, rows in (("one", 200), ("all", slice(None)), ("last", -1)):
                if where == "all" and len(cell) > 500:
                    continue
                take = without_doubt_about_units if where == "one" and column != "t" else read_log
                make = lambda _, c=column, r=rows, cell=cell: changed(c, r, cell)  # noqa: E731
                yield case(f"{column} {where} {k} {cell[:8]}", make, take=take)
        yield table(f"without {column}", **{column: None})
        yield table(f"{column} alone", **{other: None for other in COLUMNS if other != column})


def evil_clocks():
    for name, clock in {
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
    }.items():
        yield table(f"clock {name}", t=clock)
    for rows in (0, 1, 2, 3, 20):
        short = lambda _, n=rows: text({key: value[:n] for key, value in a_flight().items()})  # noqa: E731
        yield case(f"{rows} rows", short)


def evil_tables():
    good = text(a_flight())
    head, body = good.split("\n", 1)
    yield case("good", good)
    for name, content in TEXTS.items():
        yield case(f"text {name}", content)
    for name, content in {
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
    }.items():  # fmt: skip
        yield case(name, content)


def packed_tables():
    good = text(a_flight())
    packed = gzip.compress(good.encode())
    for name, content in {
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
    }.items():
        yield case(name, content, ".csv.gz")
    zipped = io.BytesIO()
    with zipfile.ZipFile(zipped, "w") as archive:
        archive.writestr("log.csv", good)
    yield case("zip", zipped.getvalue(), ".zip")
    yield case("zip named", zipped.getvalue(), ".csv")


def elsewhere():
    yield from places("log.csv", read_log)
    for name, target in {"null": "/dev/null", "random": "/dev/urandom", "terminal": "/dev/tty"}.items():
        yield case(name, lambda path, target=target: path.symlink_to(target))
    yield case("pipe", lambda path: os.mkfifo(path), ".bag")
    yield case("zero", lambda path: path.symlink_to("/dev/zero"), ".mcap")
    for joined in ("+", "log.csv+", "+log.csv", "log.csv+none.csv", "log.csv+log.csv", "a+" * 2000 + "b"):
        yield Case(
            f"joined {joined[:30]}",
            lambda folder: write(folder / "log.csv", text(a_flight())).parent,
            lambda folder, joined=joined: read_log(
                "+".join(part and f"{folder}/{part}" for part in joined.split("+"))
            ),
            named="",
        )


@functools.cache
def a_card() -> bytes:
    log = a_log(ROWS, position=np.stack([a_flight()[a] for a in "xyz"], axis=1))
    return sd_card(firmware_values(log), log.t, 2, {"pm.state": 1.0})


def binary_logs():
    card = a_card()
    yield case("card", card, "", named="log")
    for name, make in mutations(card, 40):
        yield case(f"card {name}", lambda _, make=make: make(), "", named="log")
    for name, make in mutations(card[:400], 60):
        yield case(f"card header {name}", lambda _, make=make: make() + card[400:], "", named="log")
    for count in (0, 1, 65535):
        bad = card[:3] + count.to_bytes(2, "little")
        for name, rest in {"": card[5:], " cut": b"", " empty": b"\1\0a\0\0\0" * count}.items():
            yield case(f"card of {count} events{name}", bad + rest, "", named="log")


@functools.cache
def a_bag(ros: int) -> dict[str | None, bytes]:
    """The files of a bag by name; None: the bag is the file."""
    with tempfile.TemporaryDirectory() as place:
        path = write_bag(Path(place, f"log{'.bag' if ros == 1 else ''}"), a_log(60), ros)
        return {None: path.read_bytes()} if ros == 1 else {p.name: p.read_bytes() for p in path.iterdir()}


def bags():
    for ros, suffix, files in ((1, ".bag", (None,)), (2, "", ("metadata.yaml", "log.db3"))):
        for file in files:
            damages = [
                functools.partial(lambda k, old: list(mutations(old, k + 1))[k][1](), k) for k in range(35)
            ]
            damages += [lambda old, content=content: content for content in TEXTS.values()]
            for k, damage in enumerate(damages):

                def make(path: Path, ros=ros, file=file, damage=damage) -> None:
                    for name, content in a_bag(ros).items():
                        if name:
                            path.mkdir(exist_ok=True)
                        write(path / name if name else path, damage(content) if name == file else content)

                yield case(f"ros{ros} {file} {k}", make, suffix, named="log")


def mappings():
    """What no other file of TOML has: inheritance, and patterns of names."""
    good = "[columns]\n" + "".join(
        f'{c} = "{c}"\n' for c in ("t", "y", "z", "roll", "pitch", "cmd_thrust_pwm")
    )
    for name, content in {
        "itself": 'inherit = "{self}"\n',
        "none": 'inherit = "/none/such.toml"\n' + good,
        "inherits a folder": 'inherit = "/"\n' + good,
        "device": 'inherit = "/dev/zero"\n' + good,
        "shipped": 'inherit = "documented"\n',
        "refuses": f'refuse = "{"x" * 100}"\n' + good,
        "twice": good + 't = "t"',
        "stars": good + f'x = "{"*" * 5000}"',
        "brackets": good + f'x = "*{"[" * 5000}"',
        "long": good + f'x = "{"x" * 100_000}"',
    }.items():

        def make(folder: Path, content=content) -> Path:
            path = folder / "mapping.toml"
            return write(path, content.replace("{self}", str(path)))

        yield dataclasses.replace(mapping_case("mapping", name, str), make=make)

    def loop(folder: Path) -> Path:
        for k in range(30):
            write(folder / f"m{k}.toml", f'inherit = "{folder}/m{(k + 1) % 30}.toml"\n')
        return folder / "m0.toml"

    yield dataclasses.replace(mapping_case("mapping", "loop", str), make=loop)


def names_and_units():
    for k, name in enumerate(NAMES):
        for json in ((), ("--json",)):
            yield Case(
                f"name {k} {json}",
                lambda folder, name=name: write(folder / f"{name}.csv", text(a_flight())),
                lambda path, json=json: command(cli.main, ["logs", *json, str(path)]),
                named="",
            )
            yield Case(
                f"name of nothing {k} {json}",
                lambda folder, name=name: folder / name,
                lambda path, json=json: command(cli.main, ["logs", *json, str(path)]),
                named="" if "+" in name else shown(name[:30]),
            )
    for k, unit in enumerate(
        [*NAMES, "roll", "roll=", "=deg", "roll=deg", "roll=roll=deg", "x=deg", "q=1", "x=" * 5000]
    ):
        yield Case(
            f"unit {k}",
            lambda folder: write(folder / "log.csv", text(a_flight())),
            lambda path, unit=unit: command(cli.main, ["logs", str(path), f"--unit={unit}"]),
            named="",
        )


@parametrised(
    columns_with_evil_cells,
    evil_clocks,
    evil_tables,
    packed_tables,
    elsewhere,
    binary_logs,
    bags,
    mappings,
    names_and_units,
    each=2,
)
def test_logs_and_mappings_are_used_or_refused(case, tmp_path):
    judge(case, tmp_path)
