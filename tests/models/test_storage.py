"""Files that appear whole or not at all, and names that words can hold."""

import json
import os

import pytest

from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError, first_of, shown


def test_names_are_shown_in_one_printable_line():
    name = "a\nb\u202e\x1b[31m" + os.fsdecode(b"\xff") + "é🚁$<b>"
    assert shown(name) == "a\\nb\\u202e\\x1b[31m\\xffé🚁$<b>"
    assert len(shown("x" * 100_000)) < 400
    assert str(UserError(f"no file {name}")) == f"no file {shown(name)}"


def test_sentences_stay_short():
    many = [f"flight_{k}.csv: too short" for k in range(100)]
    assert first_of(many).endswith("flight_7.csv: too short; and 92 more")
    assert [first_of(many[:k]) for k in range(3)] == ["", many[0], f"{many[0]}; {many[1]}"]
    for name in ("/".join(["folder"] * 500), "word " * 1000, "x" * 5000):
        assert len(str(UserError(f"{name} is not {name}"))) < 410


@pytest.mark.parametrize("path", [3, None, b"x", [], 1.5])
def test_an_argument_that_is_not_a_path_is_refused(path):
    """The number of a file that is open, too: 0 would be read for ever."""
    for call in (storage.read_text, storage.read_json):
        with pytest.raises(UserError, match="study must be a path, not"):
            call(path, "study")
    for call in (storage.check_file, storage.check_folder, lambda path: storage.write_text(path, "")):
        with pytest.raises(UserError, match="output must be a path, not"):
            call(path)


def test_a_path_is_made_real_where_it_can_be(tmp_path):
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "link").symlink_to(tmp_path)
    assert storage.real(tmp_path / "link" / "a") == tmp_path.resolve() / "a"
    assert storage.real(tmp_path / "loop").name == "loop" and storage.real("a\0b").name == "a\0b"


def test_folders_made_for_a_file_go_with_it(tmp_path):
    (tmp_path / "there").mkdir()
    for folder in (tmp_path / "there" / "a" / "b", tmp_path / "c", tmp_path / "there"):
        with pytest.raises(RuntimeError), storage.made(folder):
            assert folder.is_dir()
            raise RuntimeError
        assert [path.name for path in tmp_path.rglob("*")] == ["there"]
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match="cannot create the folder"), storage.made(tmp_path / "file" / "a"):
        pass


def test_text_survives_names_that_are_no_utf8(tmp_path):
    value = {"file": os.fsdecode(b"\xff.csv")}
    path = tmp_path / os.fsdecode(b"out\xfe.json")
    storage.write_json(path, value)
    assert os.fsencode(path) in [os.fsencode(p) for p in tmp_path.iterdir()]
    assert json.loads(path.read_text("utf-8")) == value


def test_checks_leave_nothing_behind(tmp_path):
    storage.check_file(tmp_path / "new" / "folder" / "file.png")
    storage.check_folder(tmp_path / "new" / "folder")
    storage.write_text(tmp_path / ("é" * 120 + ".txt"), "long names are no hindrance")
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"a = " + b"[\n" * 100_000, "nested too deeply"),
        (b"a" + b".a" * 100_000 + b" = 1", "thousands of dots"),
        (b"a = " + b"9" * 5000, "is not TOML"),
        (b"a = 1\na = 2", "is not TOML"),
        (b"\xff\xfe", "is not UTF-8 text"),
        (b"a" * 20_000_000, "has 20000000 bytes"),
        (None, "does not exist"),
    ],
)
def test_settings_that_cannot_be_read(tmp_path, content, said):
    path = tmp_path / "file.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(UserError, match=rf"vehicle file .*file\.toml .*{said}"):
        storage.read_toml(path, "vehicle file")
