"""What a release needs: workflows that run what the README says, versions that agree, checks that fail."""

import re
import shutil
import subprocess
import sys
import tomllib

import yaml

from tests import ROOT

WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))


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
