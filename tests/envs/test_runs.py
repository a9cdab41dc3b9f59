"""Run folders and files that appear whole or not at all."""

import errno
import json
import os
import pathlib
import subprocess
import sys

import numpy as np
import pytest

from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.pool import in_fork
from inclined_landing.eval import cli
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError


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


def test_a_new_run_refuses_what_is_there(tmp_path):
    (tmp_path / "a" / "b").mkdir(parents=True)
    runs.check_new_run(tmp_path / "a" / "b")  # empty: still new
    (tmp_path / "a" / "file").touch()
    with pytest.raises(UserError, match="exists and is not empty"):
        runs.check_new_run(tmp_path / "a")
    with pytest.raises(UserError, match="not a folder"):
        runs.check_new_run(tmp_path / "a" / "file")
    with pytest.raises(UserError, match="cannot write"):
        runs.check_new_run(tmp_path / "a" / "file" / "c")


def test_a_run_folder_is_owned_by_one_process(tmp_path):
    """A second lock in this process stands for another process: locks belong to open files."""
    for out in (tmp_path / "new", tmp_path / "there"):
        if out.name == "there":
            out.mkdir()
        with runs.owned(out) as fresh, runs.owned(out) as again:
            assert fresh is again is (out.name == "new")
            with pytest.raises(UserError, match="another process is using the run folder"), runs.locked(out):
                pass
            (out / "x").touch()
        with pytest.raises(UserError, match="not empty"), runs.owned(out):
            pass
        with runs.owned(out, resumable="x") as fresh:
            assert not fresh
    with runs.locked(tmp_path / "new"), pytest.raises(UserError, match="another process"):
        with runs.owned(tmp_path / "new", resumable="x"):
            pass
    with runs.owned(tmp_path / "deep" / "empty"):
        pass
    assert not (tmp_path / "deep" / "empty").exists()


def test_a_command_owns_its_run_folder_from_the_beginning(tmp_path, capsys):
    out = tmp_path / "out"
    with runs.locked(tmp_path), runs.owned(out):
        runs._owned.clear()  # as another process sees it
        assert cli.main(["success", "landing-nominal", "--out", str(out)]) == 2
        runs._owned[out] = True
    assert "another process is using the run folder" in capsys.readouterr().err


def test_temporary_files_of_killed_processes_go(tmp_path):
    """Not those that are locked, nor recent ones, whose owner may be a machine that does not see the lock."""
    names = {"old": ".x.1234.part.json", "folder": ".x.0123abcd.part.json", "used": ".x.0123abce.part.json"}
    kept = {"young": ".x.0123abcf.part.json", "other": ".y.0123abcf.part.json", "theirs": ".x.json"}
    for name in (names | kept).values():
        (tmp_path / name).mkdir() if name == names["folder"] else (tmp_path / name).touch()
        if name != kept["young"]:
            os.utime(tmp_path / name, (0, 0))
    with open(tmp_path / names["used"]) as used:
        assert storage.lock(used.fileno())
        with storage.scratch(tmp_path / "x.json") as part, storage.scratch(tmp_path / "x.json") as other:
            assert part.exists() and other.exists() and part != other
        assert {path.name for path in tmp_path.iterdir()} == {names["used"], *kept.values()}
        storage.remove_parts(tmp_path)
        assert {path.name for path in tmp_path.iterdir()} == {names["used"], kept["theirs"]}


def test_a_staged_run_appears_whole_or_not_at_all(tmp_path):
    with runs.staged_run(tmp_path / "deep" / "run") as folder:
        (folder / "x").write_text("1")
        assert not os.listdir(tmp_path / "deep" / "run")
    assert [p.name for p in (tmp_path / "deep").iterdir()] == ["run"]
    with pytest.raises(UserError, match="not empty"), runs.staged_run(tmp_path / "deep" / "run"):
        pass
    with pytest.raises(UserError, match="no space left"), runs.staged_run(tmp_path / "other") as folder:
        (folder / "x").write_text("half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert [p.name for p in tmp_path.iterdir()] == ["deep"]


def test_an_empty_folder_that_is_there_gets_the_files_and_stays(tmp_path, monkeypatch):
    """An empty working directory or mount point must not be replaced."""
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
    assert sorted(os.listdir(".")) == ["figures", "y"] and os.stat(tmp_path).st_ino == before
    with pytest.raises(UserError, match="not empty"), runs.staged_run("."):
        pass
    with pytest.raises(UserError, match="leads through a folder that does not exist"):
        runs.check_new_run("new/..")


def test_a_call_in_a_fork_returns_raises_or_is_missed():
    assert in_fork(divmod, 7, 2)() == (3, 1)
    with pytest.raises(ZeroDivisionError):
        in_fork(divmod, 7, 0)()
    with pytest.raises(UserError, match="was killed"):
        in_fork(os._exit, 1)()

    def counted(last, tick):
        for k in range(last):
            tick(str(k))
        return last

    said: list[str] = []
    assert in_fork(counted, 3, ticks=True)(said.append) == 3 and said == ["0", "1", "2"]


def test_a_call_in_a_fork_ends_with_a_command_that_does_not_wait_for_it():
    """Also if it has more to say than a pipe holds, and the command has handlers of signals."""
    program = (
        "import sys\n"
        "from inclined_landing.envs.shared.command_line import exit_code\n"
        "from inclined_landing.envs.shared.pool import in_fork\n"
        "from inclined_landing.models.base.errors import UserError\n"
        "def work():\n"
        "    result = in_fork(bytes, 10**7)\n"
        "    raise UserError('something else failed')\n"
        "sys.exit(exit_code('test', work))\n"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert (ended.returncode, ended.stdout, ended.stderr) == (2, "", "test: something else failed\n")
