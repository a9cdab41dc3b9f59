"""`make release`: are the files in dist fit to be published?

One line for each check; exit code 1 when one failed. With `--tag v0.1.0`, what the workflow of a release asks
first: is this the tag of this version? For that a bare Python is enough.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
DIST = ROOT / "dist"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
VERSION = PROJECT["version"]
LONGEST = 120  # s from the start of `pip install` to the end of `landing-eval demo`
DEMO = {".mp4", ".gif", ".png", ".html"}  # what the demo leaves


class Failed(Exception):
    """What is wrong, as a sentence."""


def main() -> int:
    """Run the checks; 1 when one failed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--tag", help="check the version alone, and that it is this tag's")
    tag = parser.parse_args().tag
    checks: list[tuple[str, Callable[[], str]]] = [("version", lambda: version(tag))]
    if tag is None:
        checks += [("committed", committed), ("files", files), ("twine", twine), ("auditwheel", auditwheel)]
        checks += [(f"Python {name}", lambda name=name: flies(name)) for name in supported()]
    return 0 if all([passed(*check) for check in checks]) else 1  # a list: each is run


def passed(title: str, check: Callable[[], str]) -> bool:
    """Print the line of one check."""
    try:
        outcome, said = "ok", check()
    except (Failed, subprocess.CalledProcessError, OSError) as error:
        outcome, said = "FAILED", str(error)
        if isinstance(error, subprocess.CalledProcessError):
            last = (error.stderr or error.stdout or "").strip().splitlines()[-3:]
            said = f"{' '.join(map(str, error.cmd))} ended with {error.returncode}: {' '.join(last)}"
    print(f"{outcome:8}{title:14}{said}", flush=True)
    return outcome == "ok"


def run(*words: str | Path, **options) -> str:
    """Standard output of a command; raise CalledProcessError when it fails."""
    return subprocess.run(words, check=True, capture_output=True, text=True, **options).stdout


# --- the repository --------------------------------------------------------------------------------


def version(tag: str | None) -> str:
    """The same version in pyproject.toml and CITATION.cff; with a tag, there and in the changelog too."""
    cited = re.search(r"^version: *(\S+)", (ROOT / "CITATION.cff").read_text("utf-8"), re.MULTILINE)
    if not cited or cited[1] != VERSION:
        raise Failed(f"pyproject.toml has version {VERSION}, CITATION.cff {cited[1] if cited else 'none'}.")
    if tag is not None and tag != f"v{VERSION}":
        raise Failed(f"The tag is {tag}, but pyproject.toml has version {VERSION}: its tag is v{VERSION}.")
    if tag is not None and f"\n## [{VERSION}]" not in (ROOT / "CHANGELOG.md").read_text("utf-8"):
        raise Failed(f'CHANGELOG.md has no section "## [{VERSION}]".')
    return VERSION


def committed() -> str:
    """Nothing here that no commit has: it could be in the files."""
    changed = run("git", "status", "--porcelain", cwd=ROOT).splitlines()
    if changed:
        raise Failed(f"{len(changed)} files are not as committed, {changed[0][3:]} for one.")
    return run("git", "rev-parse", "--short", "HEAD", cwd=ROOT).strip()


# --- the files -------------------------------------------------------------------------------------


def wheel() -> Path:
    """The wheel in dist."""
    found = sorted(DIST.glob("*.whl"))
    if len(found) != 1:
        raise Failed(f"There are {len(found)} wheels in dist, not one: run `make wheel`.")
    return found[0]


def files() -> str:
    """One wheel and one source distribution of this version."""
    name = f"{PROJECT['name'].replace('-', '_')}-{VERSION}"
    source = DIST / f"{name}.tar.gz"
    others = {path.name for path in DIST.iterdir()} - {wheel().name, source.name}
    if others or not source.is_file() or not wheel().name.startswith(f"{name}-"):
        raise Failed(f"dist has {', '.join(sorted(others)) or wheel().name}, not a wheel and {source.name}.")
    return ", ".join(f"{path.name} ({path.stat().st_size / 1e6:.1f} MB)" for path in (wheel(), source))


def twine() -> str:
    """The metadata and the description are what the package index takes."""
    run(sys.executable, "-P", "-m", "twine", "check", "--strict", *sorted(DIST.iterdir()))
    return "metadata and description are what the package index takes"


def auditwheel() -> str:
    """The plugins need no newer C library than the name of the wheel says, and nothing but it and MuJoCo."""
    # Its own verdict counts libmujoco as missing: MuJoCo's wheel brings it, and loads it before the plugins.
    found = json.loads(run(sys.executable, "-P", "-m", "auditwheel", "show", "--json", wheel()))
    foreign = [name for name in found["external_libs"] if not name.startswith("libmujoco.so.")]
    if foreign:
        raise Failed(f"The plugins need {', '.join(foreign)}, which is not everywhere.")
    needed, named = (re.search(r"manylinux_2_(\d+)_", tag) for tag in (found["sym_tag"], wheel().name))
    if not needed or not named or int(needed[1]) > int(named[1]):
        raise Failed(f"The plugins need {found['sym_tag']}, and the wheel is called {wheel().name}.")
    return f"the plugins need glibc 2.{needed[1]}, the wheel's name says 2.{named[1]}"


# --- the wheel in empty environments ---------------------------------------------------------------


def supported() -> Iterator[str]:
    """The Pythons of pyproject.toml that are at hand; the others get their line here."""
    names = [line.rpartition(" ")[2] for line in PROJECT["classifiers"] if ":: Python :: 3." in line]
    for name in names:
        if interpreter(name):
            yield name
        else:
            print(f"{'-':8}{f'Python {name}':14}not at hand, not tried", flush=True)


def interpreter(name: str) -> str | None:
    """A Python by its version: this one, one on the PATH, or one that uv knows."""
    candidates = [sys.executable, f"python{name}"]
    beside = Path(sys.executable).with_name("uv")
    uv = str(beside) if beside.is_file() else shutil.which("uv")
    if uv:
        words = [uv, "python", "find", "--no-project", "--system", "--no-python-downloads", name]
        candidates.append(subprocess.run(words, capture_output=True, text=True).stdout.strip())
    code = "import sys; print('%d.%d' % sys.version_info[:2], sys.executable)"
    for candidate in filter(shutil.which, candidates):
        done = subprocess.run([candidate, "-c", code], capture_output=True, text=True, cwd="/")
        if done.returncode == 0 and done.stdout.split()[0] == name:
            return done.stdout.split(maxsplit=1)[1].strip()
    return None


def flies(name: str) -> str:
    """The wheel, in an empty environment without a compiler: installed, its plugins found, the demo flown."""
    with tempfile.TemporaryDirectory() as folder:
        clean = Path(folder) / "clean"
        run(interpreter(name), "-m", "venv", clean)
        hidden = ("CC", "CXX", "PYTHONPATH", "VIRTUAL_ENV")
        environment = {key: value for key, value in os.environ.items() if key not in hidden}
        environment["PATH"] = str(clean / "bin")  # no compiler
        inside = {"cwd": folder, "env": environment}
        began = time.monotonic()
        run(clean / "bin" / "pip", "install", "-q", "--no-cache-dir", f"{wheel()}[eval]", **inside)
        installed = time.monotonic()
        run(clean / "bin" / "landing-eval", "demo", "--out", "demo", **inside)
        flown = time.monotonic()
        left = {path.suffix for path in (Path(folder) / "demo").iterdir() if path.stat().st_size}
        if not left >= DEMO:
            raise Failed(f"The demo left no {', no '.join(sorted(DEMO - left))} file.")
        doctor = json.loads(run(clean / "bin" / "landing-eval", "doctor", "--json", **inside))
        found = {check["name"]: check for check in doctor["checks"]}
        if not found["native plugins"]["ok"] or str(clean) not in found["native plugins"]["detail"]:
            raise Failed(f"The plugins of the wheel are not found: {found['native plugins']['detail']}.")
    took = (
        f"install {installed - began:.0f} s, demo {flown - installed:.0f} s, together {flown - began:.0f} s"
    )
    if flown - began > LONGEST:
        busy = f"at a load of {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
        raise Failed(f"It flies, but too late: {took}, more than {LONGEST} s, {busy}.")
    return f"plugins found, no compiler; {took}"


if __name__ == "__main__":
    sys.exit(main())
