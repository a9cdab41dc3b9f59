"""What is done as other packages are imported: OpenGL that does not load, a place for compiled functions."""

import os
import sys
import tempfile
import types

import numba
import pytest

from inclined_landing.models.base import imports
from inclined_landing.models.base.errors import UserError


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """A temporary folder that is this user's alone, and nothing known of another."""
    tmp_path.chmod(0o700)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    imports.private_folder.cache_clear()
    yield tmp_path
    imports.private_folder.cache_clear()


def test_an_opengl_that_does_not_load_is_an_error_of_contexts_alone(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.delenv("PYOPENGL_PLATFORM", raising=False)
    monkeypatch.setattr(sys, "modules", sys.modules.copy())
    module = types.ModuleType("gl_context")

    def execute(module):
        os.environ["PYOPENGL_PLATFORM"] = "osmesa"
        sys.modules["OpenGL.half"] = types.ModuleType("OpenGL.half")
        raise AttributeError("'NoneType' object has no attribute 'glGetError'")

    imports._with_or_without_opengl(execute, module)
    assert "PYOPENGL_PLATFORM" not in os.environ and "OpenGL.half" not in sys.modules
    with pytest.raises(ImportError, match=r"MUJOCO_GL=osmesa does not load: .*glGetError"):
        module.GLContext(64, 48)


@pytest.mark.parametrize("writable", ["package", "home", "none"])
def test_compiled_functions_go_to_the_temporary_folder_in_the_end(temporary, monkeypatch, writable):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.setattr(imports, "_BESIDE", str(temporary / "p") if writable == "package" else "/proc/p")
    monkeypatch.setenv("XDG_CACHE_HOME", str(temporary / "cache") if writable == "home" else "~")
    imports.adapt()
    ours = str(temporary / f"inclined-landing-{os.geteuid()}")
    assert numba.config.CACHE_DIR == (ours if writable == "none" else "")


def test_the_private_folder_is_one_and_closed_to_others(temporary):
    folder = imports.private_folder()
    assert folder == str(temporary / f"inclined-landing-{os.geteuid()}")
    assert os.stat(folder).st_mode & 0o777 == 0o700
    imports.private_folder.cache_clear()
    assert imports.private_folder() == folder


@pytest.mark.parametrize("planted", ["open folder", "link", "file", "folder that others can rename in"])
def test_a_folder_that_others_can_write_is_not_used(temporary, planted):
    name = temporary / f"inclined-landing-{os.geteuid()}"
    (temporary / "elsewhere").mkdir(mode=0o700)
    if planted == "link":
        name.symlink_to(temporary / "elsewhere")
    elif planted == "file":
        name.touch(0o600)
    elif planted == "open folder":
        name.mkdir()
        name.chmod(0o777)
    else:
        temporary.chmod(0o777)
    folder = imports.private_folder()
    assert folder != str(name) and os.stat(folder).st_mode & 0o777 == 0o700
    os.rmdir(folder)


def test_no_place_at_all_is_one_sentence(temporary, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", "/proc")
    with pytest.raises(UserError, match="set NUMBA_CACHE_DIR to a writable folder"):
        imports.private_folder()
