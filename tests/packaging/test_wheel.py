"""What is in a wheel and a source distribution, and that an installed wheel flies without a compiler."""

import fnmatch
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from tests import ROOT

pytestmark = pytest.mark.slow
PACKAGES = ("models", "envs", "eval", "train")
# What the plugins and three.js are built from, and figures of the documentation.
LEFT_OUT = ("models/plugin/*.cc", "models/plugin/*.h", "models/plugin/*.py", "models/plugin/CMakeLists.txt",
            "eval/replay/three/*.json", "eval/replay/three/build.sh", "eval/replay/three/entry.js",
            "eval/landings/results/*", "*/__pycache__/*")  # fmt: skip
GENERATED = {"inclined_landing/__init__.py", "inclined_landing/py.typed"}
LARGEST_WHEEL = 5_000_000  # bytes


def build(hook: str, out: Path, settings: dict[str, str] | None = None) -> Path:
    """What a build hook of the backend leaves in `out`."""
    code = f"from scikit_build_core.build import {hook}; print({hook}({str(out)!r}, {settings or {}!r}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return out / done.stdout.split()[-1]


@pytest.fixture(scope="module")
def sources() -> set[str]:
    """Files of the packages, relative to the repository."""
    files = (path for package in PACKAGES for path in (ROOT / package).rglob("*") if path.is_file())
    names = {str(path.relative_to(ROOT)) for path in files}
    return {name for name in names if not fnmatch.fnmatch(name, "*/__pycache__/*")}


def test_a_wheel_holds_every_file_of_the_packages_and_nothing_else(tmp_path, sources):
    with zipfile.ZipFile(build("build_wheel", tmp_path, {"wheel.cmake": "false"})) as wheel:
        names = {name for name in wheel.namelist() if ".dist-info/" not in name}
        size = sum(info.compress_size for info in wheel.infolist())
    wanted = {name for name in sources if not any(fnmatch.fnmatch(name, form) for form in LEFT_OUT)}
    assert names == {f"inclined_landing/{name}" for name in wanted} | GENERATED
    for kind in ("*.toml", "*.xml", "shipped/*.zip", "*.html.j2", "mappings/*.toml", "shipped/*.csv",
                 "three.min.js", "three/LICENSE"):  # fmt: skip
        assert fnmatch.filter(names, f"*{kind}"), kind
    assert size < LARGEST_WHEEL


def test_a_source_distribution_holds_what_a_build_needs(tmp_path, sources):
    with tarfile.open(build("build_sdist", tmp_path)) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert sources <= names
    assert {"pyproject.toml", "README.md", "LICENSE", "Makefile", "constraints.txt"} <= names
    assert not [name for name in names if name.startswith((".ci", "runs", ".venv", "dist"))]
