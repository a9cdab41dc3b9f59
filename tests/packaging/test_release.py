"""What a release needs: workflows, agreeing versions, notices of what is not ours, exact constraints."""

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import PurePosixPath

import pytest
import yaml

from tests import ROOT

WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
NOTICES = (ROOT / "THIRD_PARTY_NOTICES.md").read_text("utf-8")
# What is written, drawn, trained or measured here. Anything else in the tree must be named in the notices.
OURS = set(
    ".py .cc .c .h .j2 .css .toml .xml .md .yml .cff .txt .json .csv .ipynb .png .gif .svg .zip".split()
)
OUR_SCRIPTS = "eval/replay/player/"  # JavaScript elsewhere is taken for somebody else's
OUR_NAMES = {"LICENSE", "Makefile", "run", ".gitignore"}
FOREIGN = re.compile(
    rb"@license|SPDX-License-Identifier|Copyright \(c\)|Permission is hereby granted", re.IGNORECASE
)
OLDEST = "3.11.0"


def workflow(name: str) -> dict:
    return yaml.safe_load((ROOT / ".github" / "workflows" / f"{name}.yml").read_text("utf-8"))


def test_only_publishing_may_do_more_than_read_and_only_on_a_tag():
    for path in WORKFLOWS:
        whole = workflow(path.stem)
        assert whole["permissions"] == {"contents": "read"} and whole["concurrency"]
        allowed = {name: job["permissions"] for name, job in whole["jobs"].items() if "permissions" in job}
        assert allowed == ({"publish": {"id-token": "write"}} if path.stem == "release" else {})
    publish = workflow("release")["jobs"]["publish"]
    assert publish["if"] == "github.event_name == 'push' && github.ref_type == 'tag'"
    assert publish["environment"]["name"] == "pypi"
    assert {"version", "wheels", "sdist"} <= set(publish["needs"])
    assert workflow("release")[True] == {"push": {"tags": ["v*"]}, "workflow_dispatch": None}  # YAML's `on`


def test_actions_are_pinned():
    used = re.findall(r"uses: (\S+)", "".join(path.read_text("utf-8") for path in WORKFLOWS))
    assert used and all(re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40}", name) for name in used), used
    assert len({name.partition("@")[0] for name in used}) == len(set(used))  # one version of each


def test_the_plugins_are_built_for_the_mujoco_that_is_installed():
    pins = [*PROJECT["build-system"]["requires"], *PROJECT["project"]["dependencies"]]
    pins += (ROOT / "constraints.txt").read_text("utf-8").splitlines()
    found = re.findall(r"^mujoco(-core)?==(\S+)$", "\n".join(pins), re.MULTILINE)
    assert len(found) == 4 and len({version for _, version in found}) == 1, found


def test_the_version_is_cited_and_its_tag_needs_a_section_of_the_changelog(tmp_path):
    files = ("pyproject.toml", "CITATION.cff", "CHANGELOG.md")
    for name in (*files, ".ci/release.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    version = PROJECT["project"]["version"]

    def outcome() -> tuple[int, str]:
        words = [sys.executable, tmp_path / ".ci/release.py", "--tag", f"v{version}"]
        done = subprocess.run(words, capture_output=True, text=True)
        return done.returncode, done.stdout

    (tmp_path / "CHANGELOG.md").write_text(f"# Changelog\n\n## [{version}]\n", "utf-8")
    assert outcome()[0] == 0
    (tmp_path / "CHANGELOG.md").write_text("# Changelog\n\n## [Unreleased]\n", "utf-8")
    code, said = outcome()
    assert code == 1 and f'no section "## [{version}]"' in said
    (tmp_path / "CITATION.cff").write_text("version: 0.0.9\n", "utf-8")
    code, said = outcome()
    assert code == 1 and f"pyproject.toml has version {version}, CITATION.cff 0.0.9." in said


# --- what is not ours


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
    about = {"THIRD_PARTY_NOTICES.md", "tests/packaging/test_release.py", "LICENSE"}
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


# --- constraints.txt


def test_the_oldest_python_is_that_of_the_package():
    assert f"OLDEST := {OLDEST}\n" in (ROOT / "Makefile").read_text()
    assert f'requires-python = ">={OLDEST.removesuffix(".0")}"' in (ROOT / "pyproject.toml").read_text()
