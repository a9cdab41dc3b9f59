"""constraints.txt goes together on every supported Python, from the very first release of the oldest."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests import ROOT

OLDEST, NEWEST = "3.11.0", "3.14"
# What people install; `mocap` has no wheel for the newest Python.
EXTRAS = ("test-all", "wheel")
SOURCES_ONLY = "moviepy"  # the last version that goes with today's pillow has no wheel


def uv(*words, cwd=ROOT) -> subprocess.CompletedProcess:
    """`uv pip compile WORDS`, from the package index."""
    program = shutil.which("uv", path=str(Path(sys.executable).parent))
    done = subprocess.run(
        [program, "pip", "compile", "--no-config", *words], capture_output=True, text=True, cwd=cwd
    )
    if "Failed to fetch" in done.stderr:
        pytest.skip("the package index is not reached from here")
    return done


def resolve(python: str, constraints: Path) -> subprocess.CompletedProcess:
    """All of EXTRAS on Linux with that Python, from wheels alone."""
    extras = (word for extra in EXTRAS for word in ("--extra", extra))
    wheels = ("--only-binary", ":all:", "--no-binary", SOURCES_ONLY, "--no-header", "--no-annotate")
    where = ("--python-version", python, "--python-platform", "x86_64-manylinux_2_28")
    return uv("pyproject.toml", *extras, *where, *wheels, "-c", str(constraints))


@pytest.mark.slow  # what does not go together for this Python is not installed by `make` either
@pytest.mark.parametrize("python", [OLDEST, NEWEST])
def test_it_goes_together(python):
    done = resolve(python, ROOT / "constraints.txt")
    assert done.returncode == 0, done.stderr  # names the package
    pinned = {line.split(";")[0].strip() for line in (ROOT / "constraints.txt").read_text().splitlines()}
    assert set(done.stdout.splitlines()) <= pinned, "something is not pinned: run `make lock`"


def test_the_oldest_python_is_that_of_the_package():
    assert f"OLDEST := {OLDEST}\n" in (ROOT / "Makefile").read_text()
    assert f'requires-python = ">={OLDEST.removesuffix(".0")}"' in (ROOT / "pyproject.toml").read_text()
