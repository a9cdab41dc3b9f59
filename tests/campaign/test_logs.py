"""Flight logs and mapping files with evil columns, clocks, bytes, sizes and names."""

import gzip
import io
import os
import shutil
import zipfile
from pathlib import Path

import numpy as np
from log_files import a_log, firmware_values, sd_card, write_bag

from campaign.judge import EVIL, Case, command, judge, mutations, parametrised, toml, write
from inclined_landing.eval import cli
from inclined_landing.eval.logs import FlightLog, motion, read_log
from inclined_landing.eval.logs.log import COMMANDS, MEASURED
from inclined_landing.models.errors import shown

ROWS = 400
COLUMNS = ("t", *MEASURED, *COMMANDS, "vx", "vy", "vz", "vbat", "contact")
CELLS = (
    *("nan", "inf", "-inf", "1e300", "-1e300", "1e999", "5e-324", "0", "-1", "65536", "9" * 400),
    *("", " ", "text", "None", "1,5", "1;5", '"', "0x10", "1_000", "１２", "TRUE", "1+2j", "2020-01-01"),
    "x" * 2_000_000,
)
NAMES = (
    *(
        "a$b$c",
        "$\\frac{$",
        "{{7*7}}",
        "{0}",
        "%s%n",
        "new\nline",
        "quote\"'",
        "a b\t",
        "-x",
        "a+b",
        "~",
        "🚁",
    ),
    *("<script>alert(1)", "[bold]b[red]", "\x1b[31mred", "\u202eltr", os.fsdecode(b"\xff\xfe"), "x" * 240),
)


def a_flight() -> dict[str, np.ndarray]:
    """Columns of a flight in a circle that the checks let pass."""
    t = np.arange(ROWS) / 100
    x, y, z = 0.3 * np.cos(2 * t), 0.3 * np.sin(2 * t), 1 + 0.1 * np.sin(3 * t)
    pitch, roll = -1.2 * np.cos(2 * t) / 9.81, 1.2 * np.sin(2 * t) / 9.81
    pwm = 38000 * (1 - 0.9 * np.sin(3 * t) / 9.81)
    values = [t, x, y, z, roll, pitch, 0 * t, pwm, roll, pitch, 0 * t]
    values += [np.gradient(p, t) for p in (x, y, z)] + [4.1 - 0.01 * t, 0 * t]
    return dict(zip(COLUMNS, values))


def text(columns: dict) -> str:
    rows = zip(
        *([cell if isinstance(cell, str) else repr(float(cell)) for cell in c] for c in columns.values())
    )
    return "\n".join([",".join(columns), *map(",".join, rows)]) + "\n"


def changed(column: str, rows, cell) -> str:
    columns = a_flight()
    columns[column] = list(columns[column])
    for row in range(ROWS)[rows] if isinstance(rows, slice) else [rows]:
        columns[column][row] = cell
    return text(columns)


def fly(log: FlightLog) -> None:
    """What is read is a flight: finite where it was logged, with an even grid of bounded size."""
    assert np.isfinite(log.position).all() and len(log) < 10_000
    for part in motion.motion(log):
        assert np.isfinite(part.pushed).all() and len(part.pushed) < 100_000


def case(name: str, content, suffix: str = ".csv", **options) -> Case:
    def make(folder: Path) -> Path:
        path = folder / f"log{suffix}"
        if callable(content):
            return content(path) or path
        return write(path, content)

    return Case(f"{name}{suffix}", make, read_log, fly, **options)


def pack(path: Path, content: bytes, times: int) -> None:
    """`content` as often as that, packed in so many parts, as gzip files may be."""
    part = gzip.compress(content, 1)
    with path.open("wb") as file:
        for _ in range(times):
            file.write(part)


def columns_with_evil_cells():
    for column in COLUMNS:
        for k, cell in enumerate(CELLS):
            for where, rows in (("one", 200), ("all", slice(None)), ("last", -1)):
                if where == "all" and len(cell) > 500:
                    continue

                def make(path: Path, column=column, rows=rows, cell=cell) -> None:
                    write(path, changed(column, rows, cell))

                yield case(f"{column} {where} {k} {cell[:8]}", make)
        rest = {key: value for key, value in a_flight().items() if key != column}
        yield case(f"without {column}", text(rest))
        yield case(f"{column} alone", text({column: a_flight()[column]}))


def evil_clocks():
    t = a_flight()["t"]
    clocks = {
        "epoch seconds": t + 1.7e9,
        "epoch ms": 1e3 * (t + 1.7e9),
        "epoch ns": 1e9 * (t + 1.7e9),
        "ns": 1e9 * t,
        "1e300": 1e300 * t,
        "to 1e300": np.r_[t[:-1], 1e300],
        "gap": np.where(t > 2, t + 1e6, t),
        "gaps": 1e6 * t,
        "ten gaps": t + 1e3 * np.floor(3 * t),
        "hours": 3600 * t,
        "constant": 0 * t,
        "back": t[::-1],
        "twice": np.r_[t[:200], t[:200]],
        "duplicates": np.repeat(t[::2], 2),
        "one duplicate": np.r_[t[:200], t[199:-1]],
        "tiny": 1e-12 * t,
        "denormal": np.arange(ROWS) * 5e-324,
        "negative": t - 1e6,
        "slow": 10 * t,
        "very slow": 100 * t,
        "jitter": np.sort(np.random.default_rng(0).uniform(0, 4, ROWS)),
    }
    for name, clock in clocks.items():
        yield case(f"clock {name}", text(a_flight() | {"t": clock}))
    for rows in (0, 1, 2, 3, 20):
        yield case(f"{rows} rows", text({key: value[:rows] for key, value in a_flight().items()}))


def evil_tables():
    good = text(a_flight())
    head, body = good.split("\n", 1)
    yield case("good", good)
    for name, content in {
        "header of megabytes": "a" * 5_000_000 + "\n" + body,
        "many columns": ",".join(f"c{k}" for k in range(300_000)) + "\n" + body,
        "same column often": ",".join(["t"] * 200_000) + "\n" + body,
        "row of megabytes": good + "1," * 3_000_000 + "\n",
        "rows of megabytes": head + "\n" + ("1" * 3_000_000 + "\n") * 5,
        "zero bytes": good.replace("1.", "\0."),
        "zero bytes at the end": good + "\0" * 4096,
        "windows": good.replace("\n", "\r\n"),
        "old mac": good.replace("\n", "\r"),
        "mark of order": "\ufeff" + good,
        "utf-16": good.encode("utf-16"),
        "utf-16 big": b"\xfe\xff" + good.encode("utf-16-be"),
        "utf-16 cut": good.encode("utf-16")[:-1],
        "utf-16 without mark": good.encode("utf-16-le"),
        "utf-32": good.encode("utf-32"),
        "latin": good.replace("vbat", "Spännung").encode("latin-1"),
        "semicolons": good.replace(",", ";"),
        "german": good.replace(",", ";").replace(".", ","),
        "tabs": good.replace(",", "\t"),
        "spaces": good.replace(",", " "),
        "spaces after": good.replace(",", ", "),
        "commas at the end": good.replace("\n", ",\n"),
        "two commas at the end": good.replace("\n", ",,\n"),
        "quoted": "\n".join(",".join(f'"{c}"' for c in line.split(",")) for line in good.split("\n") if line),
        "open quote": good.replace("0.01,", '"0.01,', 1),
        "comment": "# a flight\n" + good,
        "empty lines": good.replace("\n", "\n\n"),
        "lines of blanks": "\n" * 100_000,
        "units": head + "\n" + "s,m,m,m,rad,rad,rad,PWM,rad,rad,rad/s,m/s,m/s,m/s,V,1\n" + body,
        "units wrong": head + "\n" + ",".join(["parsec"] * len(COLUMNS)) + "\n" + body,
        "units few": head + "\ns,m\n" + body,
        "units evil": head + "\n" + ",".join(["\x1b[31m" + "x" * 9000] * len(COLUMNS)) + "\n" + body,
        "names evil": head.replace("vbat", "\x1b[31m\u202e") + "\n" + body,
        "unknown names": ",".join("x" * 40 + str(k) for k in range(3000)) + "\n" + body,
        "header alone": head + "\n",
        "header without end": head,
        "empty": "",
        "one byte": "t",
        "html": "<!DOCTYPE html><html><body>404</body></html>",
        "json": '{"t": [0, 1, 2]}',
        "noise": np.random.default_rng(0).bytes(50_000),
        "noise of text": bytes(np.random.default_rng(0).integers(32, 127, 50_000, np.uint8)),
        "million cells of quotes": '"' * 1_000_001,
        "million commas": "," * 1_000_000 + "\n" + "," * 1_000_000,
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


def other_things():
    def link(target):
        return lambda path: path.symlink_to(target)

    yield case("missing", lambda path: None)
    yield case("folder", lambda path: path.mkdir())
    yield case("pipe", lambda path: os.mkfifo(path))
    yield case("zero", link("/dev/zero"))
    yield case("null", link("/dev/null"))
    yield case("random", link("/dev/urandom"))
    yield case("terminal", link("/dev/tty"))
    yield case("loop", lambda path: path.symlink_to(path))
    yield case("memory", link("/proc/self/mem"))
    yield case("hole", lambda path: write(path, "") and os.truncate(path, 2**40))
    yield case("pipe", lambda path: os.mkfifo(path), ".bag")
    yield case("zero", link("/dev/zero"), ".mcap")
    yield Case("over-long name", lambda folder: folder / ("x" * 300), read_log, fly, named="xxx")
    yield Case("zero in name", lambda folder: folder / "a\0b", read_log, fly, named="a\\x00b")
    for joined in ("+", "log.csv+", "+log.csv", "log.csv+none.csv", "log.csv+log.csv", "a+" * 2000 + "b"):
        yield Case(
            f"joined {joined[:30]}",
            lambda folder: write(folder / "log.csv", text(a_flight())).parent,
            lambda folder, joined=joined: read_log(
                "+".join(part and f"{folder}/{part}" for part in joined.split("+"))
            ),
            named="",
        )


def binary_logs():
    log = a_log(ROWS, position=np.stack([a_flight()[a] for a in "xyz"], axis=1))
    card = sd_card(firmware_values(log), log.t, 2, {"pm.state": 1.0})
    yield case("card", card, "", named="log")
    begin = card[:400]
    damaged = [
        *mutations(card, 40),
        *((f"header {name}", bad + card[400:]) for name, bad in mutations(begin, 60, 1)),
    ]
    for name, bad in damaged:
        yield case(f"card {name}", bad, "", named="log")
    for count in (0, 1, 65535):
        bad = card[:3] + count.to_bytes(2, "little")
        yield case(f"card of {count} events", bad + card[5:], "", named="log")
        yield case(f"card of {count} events cut", bad, "", named="log")
        yield case(f"card of {count} empty events", bad + b"\1\0a\0\0\0" * count, "", named="log")


def bags():
    def damage(path: Path, ros: int, file: str | None, bad: bytes):
        write_bag(path, a_log(60), ros)
        write(path / file if file else path, bad)

    for ros, suffix in ((1, ".bag"), (2, "")):
        folder = Path(os.environ.get("TMPDIR", "/tmp")) / f"campaign-bag-{os.getpid()}-{ros}"
        path = write_bag(folder.with_suffix(suffix), a_log(60), ros)
        files = {None: path.read_bytes()} if ros == 1 else {p.name: p.read_bytes() for p in path.iterdir()}
        path.unlink() if ros == 1 else shutil.rmtree(path)
        for file, content in files.items():
            file = file and ("log.db3" if file.endswith(".db3") else file)
            for name, bad in [*mutations(content, 35), ("empty", b""), ("noise", b"\xff" * 5000)]:

                def make(path: Path, ros=ros, file=file, bad=bad) -> None:
                    damage(path, ros, file, bad)

                yield case(f"ros{ros} {file} {name}", make, suffix, named="log")


def mappings():
    keys = ("description", "detect", "inherit", "euler", "notes", "refuse", "columns", "unknown")
    fields = ("column", "mean", "sum", "unit", "sign", "add", "late", "unknown")
    good = "[columns]\n" + "".join(
        f'{c} = "{c}"\n' for c in ("t", "y", "z", "roll", "pitch", "cmd_thrust_pwm")
    )
    texts = {}
    for name, value in EVIL.items():
        for key in keys:
            if key == "refuse" and len(str(value)) > 200:
                continue  # is repeated as it stands
            texts[f"{key} {name}"] = f"{toml(key)} = {toml(value)}\n" + (
                good + 'x = "x"\n' if key != "columns" else ""
            )
        for key in fields:
            base = "" if key in ("column", "mean", "sum") else 'column = "x", '
            texts[f"x {key} {name}"] = good + f"x = {{ {base}{key} = {toml(value)} }}\n"
        texts[f"x {name}"] = good + f"x = {toml(value)}\n"
        texts[f"x list {name}"] = good + f"x = [{toml(value)}]\n"
        texts[f"t late {name}"] = (
            good.replace('"t"', f'{{ column = "t", late = {toml(value)} }}') + 'x = "x"\n'
        )
        texts[f"evil column {name}"] = good + f'{toml(str(value))} = "x"\n'
    texts |= {
        "good": good + 'x = "x"',
        "empty": "",
        "itself": 'inherit = "{self}"\n',
        "none": 'inherit = "/none/such.toml"\n' + good,
        "folder": 'inherit = "/"\n' + good,
        "device": 'inherit = "/dev/zero"\n' + good,
        "shipped": 'inherit = "documented"\n',
        "nested": "x = " + "[" * 100_000,
        "nested tables": "x = " + "{a=" * 10_000,
        "dotted": "[" + ".".join("a" * 50_000) + "]",
        "huge": "# " + "x" * 30_000_000,
        "many": good + "".join(f'c{k} = "x"\n' for k in range(50_000)),
        "twice": good + 't = "t"',
        "zero": "\0",
        "stars": good + f'x = "{"*" * 5000}"',
        "brackets": good + f'x = "*{"[" * 5000}"',
        "long": good + f'x = "{"x" * 100_000}"',
    }
    for name, content in texts.items():

        def make(folder: Path, content=content) -> Path:
            write(folder / "log.csv", text(a_flight()))
            return write(folder / "map.toml", content.replace("{self}", str(folder / "map.toml")))

        yield Case(
            f"mapping {name}",
            make,
            lambda path: read_log(path.with_name("log.csv"), mapping=path),
            fly,
            named=""
            if name.startswith(
                ("x", "inherit", "none", "folder", "device", "refuse", "stars", "brackets", "long")
            )
            else None,
        )
    for name, raw in mutations((good + 'x = "x"').encode(), 42):

        def make(folder: Path, raw=raw) -> Path:
            write(folder / "log.csv", text(a_flight()))
            return write(folder / "map.toml", raw)

        take = lambda path: read_log(path.with_name("log.csv"), mapping=path)  # noqa: E731
        yield Case(f"mapping {name}", make, take, fly, named="")

    def loop(folder: Path) -> Path:
        write(folder / "log.csv", text(a_flight()))
        for k in range(30):
            write(folder / f"m{k}.toml", f'inherit = "{folder}/m{(k + 1) % 30}.toml"\n')
        return folder / "m0.toml"

    yield Case("mapping loop", loop, lambda path: read_log(path.with_name("log.csv"), mapping=path))


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


def cases():
    for generate in (
        columns_with_evil_cells,
        evil_clocks,
        evil_tables,
        packed_tables,
        other_things,
        binary_logs,
        bags,
        mappings,
        names_and_units,
    ):
        yield from generate()


@parametrised(cases(), sample=60)
def test_logs_and_mappings_are_used_or_refused(case, tmp_path):
    judge(case, tmp_path)
