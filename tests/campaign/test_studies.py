"""Study files with evil entries, and studies resumed from damaged folders."""

import functools
import json
import shutil
import tomllib
from pathlib import Path

import numpy as np

from campaign.judge import EVIL, Case, judge, mutations, parametrised, toml, write
from inclined_landing.eval.landings import command, design, engines
from inclined_landing.eval.landings.study import Levels, Study, known_parameters, read_study

STUDY = """
title = "small"
question = "none"
sampling = "latin-hypercube"
samples = 12
seed = 5
maps = [["inclination", "mass"]]

[simulation]
duration = 0.4
timestep = 0.004

[parameters]
inclination = { from = 10, to = 40, unit = "deg" }
friction = { values = [0.5, 1.0], unit = "1" }
mass = { mean = 33, deviation = 3, from = 28, to = 42, unit = "g", distribution = "normal" }
thrust = { from = 0.1, to = 1, unit = "1", distribution = "log-uniform" }
"""
FACTORIAL = """
sampling = "factorial"

[parameters]
inclination = { from = 10, to = 40, count = 3, unit = "deg" }
friction = { value = 0.5, unit = "1" }
"""
FIELDS = ("value", "values", "from", "to", "count", "mean", "deviation", "distribution", "unit", "unknown")


def spelt(data: dict) -> str:
    return "\n".join(f"{toml(key)} = {toml(value)}" for key, value in data.items())


def can_be_flown(study: Study) -> None:
    """Drawn, every parameter lies within its bounds."""
    assert 1 <= design.total(study) <= 5_000_000
    if design.total(study) > 100_000:
        return
    known = known_parameters()
    drawn, start = design.design(study)
    assert len(start) == design.total(study)
    for p in study.parameters:
        values = drawn[p.name]
        assert np.isfinite(values).all() and known[p.name].low <= values.min()
        assert values.max() <= known[p.name].high
        assert isinstance(p, Levels) or np.ptp(values) > 0 or design.total(study) == 1


def file_case(name: str, content) -> Case:
    return Case(
        name,
        lambda folder: write(folder / "study.toml", content() if callable(content) else content),
        read_study,
        can_be_flown,
    )


def evil_entries():
    for base, text in (("hypercube", STUDY), ("factorial", FACTORIAL)):
        data = tomllib.loads(text)
        keys = ("title", "question", "sampling", "samples", "seed", "maps", "start", "simulation", "unknown")
        for name, value in EVIL.items():
            for key in (*keys, "parameters"):
                yield file_case(f"{base} {key} {name}", spelt(data | {key: value}))
            for key in ("duration", "timestep", "unknown"):
                yield file_case(f"{base} simulation {key} {name}", spelt(data | {"simulation": {key: value}}))
            yield file_case(f"{base} policy {name}", spelt(data | {"start": {"policy": value}}))
            yield file_case(f"{base} map {name}", spelt(data | {"maps": [["inclination", value]]}))
            yield file_case(f"{base} entry {name}", spelt(data | {"parameters": {"mass": value}}))
            for field in FIELDS:
                for parameter, entry in data["parameters"].items():
                    changed = data["parameters"] | {parameter: entry | {field: value}}
                    text = spelt(data | {"parameters": changed})
                    yield file_case(f"{base} {parameter} {field} {name}", text)
    for name in known_parameters():
        for unit in ("1", "m", "deg", "s", "kg", "parsec"):
            for low, high in ((-1e300, 1e300), (0, 5e-324), (1, 1), (2, 1), (1e-300, 1)):
                entry = {"from": low, "to": high, "unit": unit}
                content = spelt({"sampling": "latin-hypercube", "samples": 3, "parameters": {name: entry}})
                yield file_case(f"{name} {unit} {low} {high}", content)


def evil_files():
    yield file_case("good", STUDY)
    yield file_case("one sample", STUDY.replace("samples = 12", "samples = 1"))
    for count in (10**6, 10**7, 10**12, 10**30):
        yield file_case(f"samples {count}", STUDY.replace("samples = 12", f"samples = {count}"))
        yield file_case(f"count {count}", FACTORIAL.replace("count = 3", f"count = {count}"))
    for name, content in mutations(STUDY.encode(), 49):
        yield file_case(name, content)
    for name, content in {
        "empty": "",
        "nested": "maps = " + "[" * 50_000,
        "nested table": "start = " + "{a=" * 20_000,
        "many values": lambda: FACTORIAL.replace(
            "value = 0.5", f"values = {[k / 1e4 for k in range(40_000)]}"
        ),
        "many maps": STUDY.replace('["inclination", "mass"]', '["inclination", "mass"],' * 5000),
        "huge": lambda: "# " + "x" * 20_000_000,
        "twice": STUDY + 'mass = { value = 1, unit = "g" }\n',
        "zero bytes": STUDY.replace("small", "\0"),
        "utf-16": STUDY.encode("utf-16"),
        "no utf-8": STUDY.encode().replace(b"small", b"\xff"),
    }.items():
        yield file_case(f"file {name}", content)
    for name, make in {
        "missing": lambda path: None,
        "folder": lambda path: path.mkdir(),
        "zero": lambda path: path.symlink_to("/dev/zero"),
        "loop": lambda path: path.symlink_to(path),
    }.items():

        def made(folder: Path, make=make) -> Path:
            make(folder / "study.toml")
            return folder / "study.toml"

        yield Case(f"file {name}", made, read_study)
    yield Case("over-long name", lambda folder: folder / ("x" * 300), read_study, named="xxx")


@functools.cache
def begun() -> dict[str, bytes]:
    """Files of a study that was interrupted after its last landing but one chunk."""
    import tempfile

    with tempfile.TemporaryDirectory() as place:
        study = read_study(write(Path(place) / "study.toml", STUDY))
        out = Path(place) / "out"
        command._begin(study, out, 5)
        for chunk, table in engines.local(study, [0, 1], 5):
            command._write(table, command._part(out, chunk))
        return {str(p.relative_to(out)): p.read_bytes() for p in out.rglob("*") if p.is_file()}


def resumptions():
    names = ("study.json", "parts/00000.parquet", "results.parquet", "parts/00007.parquet", "parts")
    contents = [
        ("empty", b""),
        ("noise", b"\xff" * 999),
        ("text", b"{}"),
        ("list", b"[1]"),
        ("null", b"null"),
    ]
    contents += [("nested", b"[" * 100_000), ("nothing", None), ("folder", ...)]
    for name in names:
        for what, content in contents:
            yield resumption(f"{name} {what}", name, lambda old, content=content: content)
    for k in range(28):
        for name in names[:2]:
            yield resumption(f"{name} damage {k}", name, lambda old, k=k: list(mutations(old, k + 1))[k][1])
    for name, value in EVIL.items():
        for key in ("study", "chunk", "fingerprint", "landings"):

            def change(old: bytes, key=key, value=value) -> bytes:
                return json.dumps(json.loads(old) | {key: value}, default=str).encode()

            yield resumption(f"record {key} {name}", "study.json", change)
        for key in ("starts", "parameters", "maps", "seed", "unknown"):

            def change(old: bytes, key=key, value=value) -> bytes:
                record = json.loads(old)
                record["study"][key] = value
                return json.dumps(record, default=str).encode()

            yield resumption(f"record study {key} {name}", "study.json", change)


def resumption(name: str, file: str, change) -> Case:
    def make(folder: Path) -> Path:
        write(folder / "study.toml", STUDY)
        for path, content in begun().items():
            (folder / "out" / path).parent.mkdir(parents=True, exist_ok=True)
            write(folder / "out" / path, content)
        path = folder / "out" / file
        content = change(begun().get(file, b"PAR1"))
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
        if content is ...:
            path.mkdir()
        elif content is not None:
            write(path, content)
        return folder / "out"

    def resume(out: Path) -> dict:
        command.command(out.parent / "study.toml", out, resume=True, chunk=5)
        return json.loads((out / "summary.json").read_text("utf-8"))

    def as_uninterrupted(summary: dict) -> None:
        assert sum(entry["count"] for entry in summary["outcomes"].values()) == 12

    return Case(f"resume {name}", make, resume, as_uninterrupted, named="out", seconds=60)


@parametrised([*evil_entries(), *evil_files()], sample=60)
def test_studies_are_flown_or_refused(case, tmp_path):
    judge(case, tmp_path)


@parametrised(resumptions(), sample=3)
def test_studies_go_on_or_say_why_not(case, tmp_path):
    judge(case, tmp_path)
