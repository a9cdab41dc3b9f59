"""Run folders and files that appear whole or not at all."""

import errno
import json
import os
import pathlib

import numpy as np
import pytest

from inclined_landing.envs.shared import runs
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError


def test_json_holds_plain_values_only(tmp_path):
    value = {"a": np.float32(0.5), "b": np.arange(2), "c": float("nan"), "d": (True, None)}
    storage.write_json(tmp_path / "x.json", value)
    assert json.loads((tmp_path / "x.json").read_text("utf-8")) == {
        "a": 0.5, "b": [0, 1], "c": None, "d": [True, None],
    }  # fmt: skip


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "x.json"
    path.write_text("old")
    with pytest.raises(RuntimeError), storage.atomic(path) as part:
        part.write_text("half")
        raise RuntimeError
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_is_one_sentence(tmp_path, monkeypatch):
    def full(self, data):
        with open(self, "wb") as file:
            file.write(data[:3])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(pathlib.Path, "write_bytes", full)
    with pytest.raises(UserError, match=r"cannot write .*x\.json: no space left on device"):
        storage.write_json(tmp_path / "x.json", {"a": 1})
    assert list(tmp_path.iterdir()) == []


def test_new_run_refuses_what_is_there(tmp_path):
    assert runs.new_run(tmp_path / "a" / "b") == tmp_path / "a" / "b"
    assert runs.new_run(tmp_path / "a" / "b").is_dir()  # empty: still new
    (tmp_path / "a" / "file").touch()
    with pytest.raises(UserError, match="exists and is not empty"):
        runs.new_run(tmp_path / "a")
    with pytest.raises(UserError, match="not a folder"):
        runs.new_run(tmp_path / "a" / "file")
    assert runs.new_run(tmp_path / "a", resumable="file") == tmp_path / "a"
    with pytest.raises(UserError, match="cannot write"):
        runs.new_run(tmp_path / "a" / "file" / "c")


def test_a_staged_run_appears_whole_or_not_at_all(tmp_path):
    with runs.staged_run(tmp_path / "deep" / "run") as folder:
        (folder / "x").write_text("1")
        assert not (tmp_path / "deep" / "run").exists()
    assert [p.name for p in (tmp_path / "deep").iterdir()] == ["run"]
    with pytest.raises(UserError, match="not empty"), runs.staged_run(tmp_path / "deep" / "run"):
        pass
    with pytest.raises(UserError, match="no space left"), runs.staged_run(tmp_path / "other") as folder:
        (folder / "x").write_text("half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert [p.name for p in tmp_path.iterdir()] == ["deep"]


def test_an_empty_folder_that_is_there_gets_the_files_and_stays(tmp_path, monkeypatch):
    """As the one that the shell is in, which must not be replaced under it, and a mounted one."""
    monkeypatch.chdir(tmp_path)
    before = os.stat(".").st_ino
    for out in (".", tmp_path):
        with pytest.raises(UserError, match="gone"), runs.staged_run(out) as folder:
            (folder / "x").write_text("half")
            raise UserError("gone")
        assert not os.listdir(".")
    (tmp_path / ".x.1.part").mkdir()  # of a killed process
    with runs.staged_run(".") as folder:
        (folder / "figures").mkdir()
        (folder / "figures" / "x").write_text("1")
        (folder / "y").write_text("2")
    assert sorted(os.listdir(".")) == [".x.1.part", "figures", "y"] and os.stat(tmp_path).st_ino == before
    with pytest.raises(UserError, match="not empty"), runs.staged_run("."):
        pass
    with pytest.raises(UserError, match="leads through a folder that does not exist"):
        runs.check_new_run("new/..")
