"""`landing-eval landings`: folders, bits, interruptions, engines, and one sentence for whatever is wrong."""

import errno
import json
import os
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import pyarrow.parquet as pq
import pytest

from inclined_landing.envs.shared import pool, runs
from inclined_landing.eval import cli
from inclined_landing.eval.landings import command, landing, report, run
from inclined_landing.eval.landings.study import read_study
from inclined_landing.eval.study import show
from inclined_landing.models.base.errors import UserError
from tests.pages import EVIL, check_page
from tests.refused import refused

STUDY = f"""
title = {json.dumps("A small one " + EVIL)}
question = {json.dumps(EVIL + " question")}
"""
STUDY += """\
sampling = "latin-hypercube"
samples = 24
seed = 5
maps = [["inclination", "friction"]]
[simulation]
duration = 0.4
[parameters]
inclination = { from = 10, to = 50, unit = "deg" }
friction = { from = 0.2, to = 1.4, unit = "1" }
restitution = { from = 0, to = 0.5, unit = "1" }
contact_time = { value = 15, unit = "ms" }
foot_height = { values = [18, 25], unit = "mm" }
mass = { from = 30, to = 40, unit = "g" }
"""


@pytest.fixture
def study(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(STUDY, "utf-8")
    return path


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """The undisturbed run: its folder."""
    folder = tmp_path_factory.mktemp("reference")
    (folder / "small.toml").write_text(STUDY, "utf-8")
    command.command(folder / "small.toml", folder / "run")
    return folder / "run"


@pytest.fixture(autouse=True)
def chunks_of_ten(monkeypatch):
    """Three chunks make a study here; the reference is one."""
    monkeypatch.setattr(run, "CHUNK", 10)


@pytest.fixture
def no_report(monkeypatch):
    """What is made of the results is left out."""
    monkeypatch.setattr(report, "count", lambda *_: None)
    for name in ("document", "write", "show"):
        monkeypatch.setattr(show, name, lambda *_, **__: None)


def bits(folder):
    return (folder / "results.parquet").read_bytes()


def test_a_run_leaves_results_summary_figures_and_page(reference):
    names = ["index.html", "map_inclination_friction.png"]
    names += ["landings.json", "results.parquet", "study.json"]
    assert sorted(p.name for p in reference.iterdir()) == sorted(names)
    table = pq.read_table(reference / "results.parquet")
    assert table.num_rows == 24 and set(table["outcome"].to_pylist()) <= set(landing.OUTCOMES)
    assert set(landing.RESULTS) < set(table.column_names)
    assert table.schema.field("mass").metadata[b"unit"] == b"kg"
    rows = json.loads((reference / "landings.json").read_text("utf-8"))["rows"]
    assert sum(row["count"] for row in rows if row["measure"] in landing.OUTCOMES) == 24
    assert [row["parameter"] for row in rows if row["measure"] == "index_rests"] == [
        *("inclination", "friction", "restitution", "foot_height", "mass")
    ]
    text = (reference / "index.html").read_text("utf-8")
    assert text.count("data:image/png;base64,") == 1 and "http" not in text
    check_page(text, f"A small one {EVIL}", f"{EVIL} question")


def test_neither_chunks_nor_threads_change_a_bit(study, tmp_path, reference, no_report):
    command.command(study, tmp_path / "other")
    assert bits(tmp_path / "other") == bits(reference)
    read = read_study(study)
    assert run.run_chunk(read, range(10)).slice(5).equals(run.run_chunk(read, range(5, 10)))


def test_an_interrupted_study_goes_on(study, tmp_path, reference, no_report, monkeypatch):
    real = pool.completed

    def interrupted(f, shared, chunks, *on):
        yield from real(f, shared, chunks[:1], *on)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(pool, "completed", interrupted)
        with pytest.raises(KeyboardInterrupt):
            command.command(study, tmp_path / "run")
    part = tmp_path / "run" / "parts" / "00000.parquet"
    assert [p.name for p in part.parent.iterdir()] == [part.name]
    (part.parent / ".00001.77.part.parquet").write_bytes(b"half")
    (part.parent / "00001.parquet").write_bytes(b"half")  # damaged: it is made again
    flown = []
    monkeypatch.setattr(
        pool, "completed", lambda f, shared, chunks, *on: flown.extend(chunks) or real(f, shared, chunks, *on)
    )
    command.command(study, tmp_path / "run", resume=True)
    assert flown == [range(10, 20), range(20, 24)]  # the finished part is kept
    assert bits(tmp_path / "run") == bits(reference)
    assert not (tmp_path / "run" / "parts").exists()
    assert cli.main(["landings", str(study), "--out", str(tmp_path / "run"), "--resume"]) == 0


BAD = [
    ("mass = {", "speed = {", "unknown parameter 'speed'; choose from inclination, friction"),
    ("from = 10, to = 50", "from = 50, to = 50", "parameter inclination: the range is empty"),
    ("from = 0.2, to = 1.4", "from = -0.2, to = 1.4", "friction must be from 0 to 5, not -0.2"),
    ("from = 10, to = 50", "from = 10, to = 60", "inclination must be from 0 to 50 deg, not 60"),
    ("to = 40, ", "to = 40, count = 3, ", "mass needs one of value, values, from and to, or mean"),
    ("values = [18, 25]", "values = [18, 25], from = 3", "foot_height needs one of value, values, from"),
    ('unit = "g"', 'unit = "lb"', "mass needs a unit, kg or g, not 'lb'"),
    ('contact_time = { value = 15, unit = "ms" }', "", "give both restitution and contact_time"),
    ('"latin-hypercube"', '"factorial"', "a Latin hypercube needs samples"),
    ('["inclination", "friction"]', '["inclination", "thrust"]', "needs two parameters that vary"),
    ("duration = 0.4", "timestep = 0.003", "timestep must divide the control period"),
    ("[parameters]", "[start]\npolicy = 'none.zip'\n[parameters]", "inclination cannot be set in a study"),
]


@pytest.mark.parametrize(("old", "new", "sentence"), BAD, ids=[b[2][:30] for b in BAD])
def test_a_wrong_study_is_one_sentence(tmp_path, old, new, sentence):
    path = tmp_path / "bad.toml"
    assert old in STUDY
    path.write_text(STUDY.replace(old, new), "utf-8")
    refused(cli.main, ["landings", str(path), "--out", str(tmp_path / "out")], sentence, tmp_path)


POLICY = (
    'sampling = "factorial"\n[start]\npolicy = "none.zip"\n[parameters]\nfriction = {values=[1, 2], unit="1"}'
)
RAY = ["{study}", "--out", "{out}", "--engine", "ray"]
WRONG = [
    (["none.toml", "--out", "{out}"], "study none.toml does not exist (shipped ones: paper_landing"),
    (["{policy}", "--out", "{out}"], "policy none.zip does not exist"),
    (["{study}", "--out", "{full}"], "exists and is not empty"),
    (["{study}", "--out", "{full}", "--resume"], "nothing to resume"),
    (["{study}", "--out", "{out}", "--resume"], "nothing to resume"),
    (["{study}", "--out", "{out}", "--address", "a:1"], "--address needs --engine ray"),
    (RAY, "pip install 'inclined-landing[ray]'"),
    ([*RAY, "--address", "127.0.0.1:1"], "no Ray cluster answers at 127.0.0.1:1: connection refused"),
    ([*RAY, "--address", "here"], "HOST:PORT"),
]


@pytest.mark.parametrize(("words", "sentence"), WRONG, ids=[w[1][:30] for w in WRONG])
def test_wrong_arguments(study, tmp_path, monkeypatch, words, sentence):
    monkeypatch.setitem(sys.modules, "ray", SimpleNamespace(init=None) if "--address" in words else None)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").touch()
    (tmp_path / "p.toml").write_text(POLICY)
    places = {
        "out": tmp_path / "out",
        "full": tmp_path / "full",
        "study": study,
        "policy": tmp_path / "p.toml",
    }
    refused(cli.main, ["landings", *(word.format(**places) for word in words)], sentence, tmp_path)


def test_a_machine_with_other_packages_is_refused():
    versions = runs.packages()
    assert pool._called(versions, max, 1, 2) == 2
    with pytest.raises(UserError, match=rf"has mujoco {versions['mujoco']}, but this machine has 1\.0; "):
        pool._called(versions | {"mujoco": "1.0"}, max, 1, 2)


def test_a_full_disk_on_the_way_keeps_what_is_finished(study, tmp_path, reference, no_report, monkeypatch):
    real, written = Path.write_bytes, []

    def full(path, data):
        if path.parent.name == "parts":
            written.append(path)
        if len(written) > 1:
            real(path, data[: len(data) // 2])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(path, data)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full)
        with pytest.raises(
            UserError, match="no space left on device; finished chunks are kept, continue with"
        ):
            command.command(study, tmp_path / "out")
    chunk, *others = sorted(p.name for p in (tmp_path / "out").rglob("*"))
    assert re.fullmatch(r"0000\d\.parquet", chunk)  # that of either thread
    assert others == ["parts", "study.json"]
    command.command(study, tmp_path / "out", resume=True)
    assert bits(tmp_path / "out") == bits(reference)


def test_resume_refuses_another_study(study, tmp_path, reference, capsys):
    study.write_text(STUDY.replace("seed = 5", "seed = 6"), "utf-8")
    before = bits(reference)
    assert cli.main(["landings", str(study), "--out", str(reference), "--resume"]) == 2
    assert "was begun with a different study" in capsys.readouterr().err
    assert bits(reference) == before
