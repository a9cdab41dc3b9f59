"""Installations that are not a developer's: read-only, without a home, with variables as guides set them."""

import os
import shutil
import subprocess
import sys

import pytest

from tests import ROOT

SUCCESS = ["-m", "inclined_landing.eval", "success", "landing-nominal", "--plant", "analytic"]
LANDED = "reached the goal box in "
BARE = {name: os.environ[name] for name in ("PATH", "LANG", "LC_ALL") if name in os.environ}


def run(arguments, *, before=(), cwd=None, **variables):
    """Run Python with these arguments and variables in an otherwise empty environment."""
    words = [*before, sys.executable, *arguments]
    return subprocess.run(words, capture_output=True, text=True, env=BARE | variables, cwd=cwd, timeout=600)


@pytest.mark.slow
@pytest.mark.parametrize("value", ["egl", "osmesa", "nvidia", "EGL", ""])
def test_no_command_needs_the_opengl_that_mujoco_gl_names(value, tmp_path):
    done = run(SUCCESS, MUJOCO_GL=value, HOME=str(tmp_path))
    assert done.returncode == 0 and LANDED in done.stdout, done.stderr
    done = run(["-m", "inclined_landing.eval", "doctor"], MUJOCO_GL=value, HOME=str(tmp_path))
    assert done.returncode == 0 and "Traceback" not in done.stderr


@pytest.mark.slow
def test_figures_are_ours_whatever_a_matplotlibrc_says(tmp_path):
    (tmp_path / "matplotlibrc").write_text("backend: TkAgg\ntext.usetex: True\nsavefig.dpi: 11\n")
    done = run(
        ["-m", "inclined_landing.eval", "figure", "landing-nominal", "--out", "f"],
        cwd=tmp_path,
        HOME=str(tmp_path),
    )
    assert done.returncode == 0, done.stderr
    assert all(path.stat().st_size > 10_000 for path in (tmp_path / "f").glob("*.png"))  # not of 11 dpi
    assert list((tmp_path / "f").glob("*.png"))


@pytest.fixture
def read_only():
    """The words before a command that sees the installation read-only."""
    if os.geteuid() or shutil.which("unshare") is None:
        pytest.skip("needs root and unshare")
    shown = f'mount --bind {ROOT} {ROOT} && mount -o remount,bind,ro {ROOT} && exec "$@"'
    words = ["unshare", "-m", "bash", "-c", shown, "bash"]
    if subprocess.run([*words, "true"], capture_output=True).returncode:
        pytest.skip("no mounts can be made here")
    return words


@pytest.mark.slow
@pytest.mark.parametrize("user", [None, "65534"], ids=["this user", "another user"])
@pytest.mark.parametrize("home", [{}, {"HOME": "/proc/nohome", "XDG_CACHE_HOME": "/proc/nohome"}])
def test_a_read_only_installation_works(read_only, user, home):
    reads = "-all,+dac_read_search"  # wherever Python lies; writing is what the test is about
    as_user = [] if user is None else [
        *("setpriv", f"--reuid={user}", f"--regid={user}", "--clear-groups"),
        *(f"--inh-caps={reads}", f"--ambient-caps={reads}", f"--bounding-set={reads}"),
    ]  # fmt: skip
    if user and subprocess.run([*as_user, sys.executable, "-c", ""], capture_output=True).returncode:
        pytest.skip("no command can be run as another user here")
    done = run(SUCCESS, before=[*read_only, *as_user], cwd="/", **home)
    assert done.returncode == 0 and LANDED in done.stdout, done.stderr
    assert "Traceback" not in done.stderr and "cache" not in done.stderr
