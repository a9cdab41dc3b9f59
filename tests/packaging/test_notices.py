"""What is not ours is named: third-party notices, citation, changelog; versions agree."""

import re
import subprocess
import tomllib
from pathlib import PurePosixPath

import pytest

from tests import ROOT

NOTICES = (ROOT / "THIRD_PARTY_NOTICES.md").read_text("utf-8")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
# What is written, drawn, trained or measured here. Anything else in the tree must be named in the notices.
OURS = set(
    ".py .cc .c .h .j2 .css .toml .xml .md .yml .cff .txt .json .csv .ipynb .png .gif .svg .zip".split()
)
OUR_SCRIPTS = "eval/replay/player/"  # JavaScript elsewhere is taken for somebody else's
OUR_NAMES = {"LICENSE", "Makefile", "run", ".gitignore"}
FOREIGN = re.compile(
    rb"@license|SPDX-License-Identifier|Copyright \(c\)|Permission is hereby granted", re.IGNORECASE
)


def tree() -> list[str]:
    """Files of the repository, as git has them."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=False)
    if listed.returncode:
        pytest.skip("no git repository here, whose files could be listed")
    return [name for name in listed.stdout.decode("utf-8").split("\0") if name]


def named(path: str) -> bool:
    """Is a file, or a folder that it is in, named in the notices."""
    return any(
        f"`{place}`" in NOTICES for place in (path, *(f"{parent}/" for parent in PurePosixPath(path).parents))
    )


def test_third_party_files_are_named():
    missing = []
    about = {"THIRD_PARTY_NOTICES.md", "tests/packaging/test_notices.py", "LICENSE"}
    for path in tree():
        file = ROOT / path
        if path in about or not file.is_file():
            continue
        ours = file.suffix in OURS or file.name in OUR_NAMES or path.startswith(OUR_SCRIPTS)
        if not (ours and not FOREIGN.search(file.read_bytes())) and not named(path):
            missing.append(path)
    assert not missing, f"name them in THIRD_PARTY_NOTICES.md: {', '.join(missing)}"


def test_sources_are_named():
    marks = re.findall(r"^#   (\[\w\])  ", (ROOT / "models/crazyflie.toml").read_text("utf-8"), re.MULTILINE)
    assert len(marks) >= 3 and all(mark in NOTICES for mark in marks if mark != "[E]")  # [E]: ours
