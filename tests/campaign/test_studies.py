"""Studies that go on in damaged folders."""

import functools
import json
import shutil
import tempfile
from pathlib import Path

from inclined_landing.eval.landings import command, engines
from inclined_landing.eval.landings.study import read_study
from tests.campaign.judge import TEXTS, Case, judge, mutations, parametrised, respelt, spoilt, write
from tests.campaign.test_toml import STUDY

FILES = ("study.json", "parts/00000.parquet", "results.parquet", "parts/00007.parquet", "parts")


@functools.cache
def begun() -> dict[str, bytes]:
    """Files of a study that was interrupted after its last landing but one chunk."""
    with tempfile.TemporaryDirectory() as place:
        study = read_study(write(Path(place) / "study.toml", STUDY))
        out = Path(place) / "out"
        command._begin(study, out, 5)
        for chunk, table in engines.local(study, [0, 1], 5):
            command._write(table, command._part(out, chunk))
        return {str(p.relative_to(out)): p.read_bytes() for p in out.rglob("*") if p.is_file()}


def case(name: str, file: str, change) -> Case:
    """`change(bytes)` makes new bytes of a file, None for none, ... for a folder."""

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

    return Case(f"{file} {name}", make, resume, as_uninterrupted, named="out", seconds=60)


def other_files():
    for file in FILES:
        for what, content in (TEXTS | {"nothing": None, "folder": ...}).items():
            yield case(what, file, lambda old, content=content: content)
    for file in FILES[:2]:
        for k in range(28):
            yield case(f"damage {k}", file, lambda old, k=k: list(mutations(old, k + 1))[k][1]())


def records():
    """The record of a study that was begun, with an entry wrong."""
    study = dict.fromkeys(("starts", "parameters", "maps", "seed"))
    for name, change in spoilt({"study": study, "chunk": 5, "fingerprint": "", "landings": 12}):
        yield case(name, FILES[0], functools.partial(respelt, change=change))


@parametrised(other_files, records, each=1)
def test_studies_go_on_or_say_why_not(case, tmp_path):
    judge(case, tmp_path)
