"""What is in a wheel and a source distribution, and that an installed wheel flies without a compiler."""

import fnmatch
import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import venv
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


@pytest.mark.skipif(shutil.which("cmake") is None, reason="building without the package index needs cmake")
def test_an_installed_wheel_flies_without_a_compiler(tmp_path):
    wheel = build("build_wheel", tmp_path)
    clean = tmp_path / "clean"
    venv.create(clean)
    python = clean / "bin" / "python"
    site = subprocess.run(
        [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"],
        capture_output=True,
        text=True,
    ).stdout.strip()
    install = [sys.executable, "-m", "pip", "--python", str(python), "install", "-q", "--no-deps", str(wheel)]
    subprocess.run(install, check=True)
    import mujoco

    (Path(site) / "dependencies.pth").write_text(
        f"{sysconfig.get_path('purelib')}\n{Path(mujoco.__file__).parents[1]}\n"
    )
    environment = {
        name: value for name, value in os.environ.items() if name not in ("CC", "CXX", "PYTHONPATH")
    }
    environment["PATH"] = str(clean / "bin")  # nothing else, no compiler either
    for words in (["doctor"], ["demo", "--out", "demo", "--starts", "5"]):
        done = subprocess.run(
            [clean / "bin" / "landing-eval", *words],
            capture_output=True, text=True, cwd=tmp_path, env=environment,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        if words[0] == "doctor":
            assert str(clean) in "".join(done.stdout.split()).replace(str(tmp_path), str(tmp_path))
    assert {path.suffix for path in (tmp_path / "demo").iterdir()} >= {".mp4", ".gif", ".png"}
