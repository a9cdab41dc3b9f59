"""Imports at first use, and workarounds for installations without OpenGL or a writable cache.

MuJoCo continues if OpenGL does not load (by an import hook, because MuJoCo has no setting), and numba caches
compiled functions in the temporary folder if neither the package nor the home folder is writable. Neither is
imported here.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import importlib
import importlib.util
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

from inclined_landing.models.base.errors import UserError

Execute = Callable[[ModuleType], None]
_BESIDE = str(Path(__file__).with_name("__pycache__"))  # numba's first choice for compiled functions


def at_first_use(package: str, modules: dict[str, str]) -> Callable[[str], Any]:
    """Return the `__getattr__` of a package whose names are imported on first access.

    modules: the module in the package of each name.
    """

    def find(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(importlib.import_module(f"{package}.{modules[name]}"), name)

    return find


def around_import(name: str, around: Callable[[Execute, ModuleType], None]) -> None:
    """Run a module's code through `around(execute, module)` at its import, or now if it is already imported.

    Does nothing the second time.
    """
    if name in sys.modules:
        around(lambda module: None, sys.modules[name])
    elif not any(isinstance(finder, _Waiting) and finder.name == name for finder in sys.meta_path):
        sys.meta_path.insert(0, _Waiting(name, around))


class _Waiting:
    """Import hook for one module, which removes itself once the module has been found."""

    def __init__(self, name: str, around: Callable[[Execute, ModuleType], None]):
        self.name, self._around = name, around

    def find_spec(self, name, path=None, target=None):
        if name != self.name or self not in sys.meta_path:
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        if spec is not None and spec.loader is not None:
            execute = functools.partial(self._around, spec.loader.exec_module)
            spec.loader.exec_module = execute  # type: ignore[method-assign]
        return spec


def adapt() -> None:
    """Make MuJoCo and numba work in every installation, regardless of which is imported later."""
    around_import("mujoco.rendering.classic.gl_context", _with_or_without_opengl)
    _cache_somewhere()


def _with_or_without_opengl(execute: Execute, module: ModuleType) -> None:
    """Run MuJoCo's module that loads OpenGL; if that fails, only creating a context is an error."""
    before = os.environ.get("PYOPENGL_PLATFORM")
    try:
        return execute(module)
    except Exception as error:  # whatever the libraries raise; MuJoCo itself survives ImportError alone
        reason = f"MUJOCO_GL={os.environ.get('MUJOCO_GL')} does not load: {error}"

    class _MissingGLContext:  # the counterpart of MuJoCo's
        def __init__(self, *_, **__):
            raise ImportError(reason)

    module.GLContext = _MissingGLContext  # type: ignore[attr-defined]
    # Half-loaded modules are forgotten: another OpenGL may be requested.
    os.environ.pop("PYOPENGL_PLATFORM", None)
    if before is not None:
        os.environ["PYOPENGL_PLATFORM"] = before
    for name in [name for name in sys.modules if name.partition(".")[0] == "OpenGL"]:
        del sys.modules[name]


def _cache_somewhere() -> None:
    """Set a folder for numba's compiled functions if it can write to neither of its default ones."""
    home = os.environ.get("XDG_CACHE_HOME", os.path.expanduser("~/.cache"))
    if "NUMBA_CACHE_DIR" in os.environ or _can_write(_BESIDE):
        return
    # Without a home numba would take a folder "~" below the current one.
    if not os.path.isabs(home) or not _can_write(os.path.join(home, "numba")):
        os.environ["NUMBA_CACHE_DIR"] = private_folder()
        if "numba" in sys.modules:
            sys.modules["numba"].config.reload_config()


def _can_write(folder: str) -> bool:
    """Return whether a file can be written, by trying, as numba does: permissions alone do not show it."""
    try:
        os.makedirs(folder, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


@functools.cache
def private_folder() -> str:
    """Return a folder in the temporary folder that only this user can write, because its files are executed.

    It is the same for all processes of a user. If another user owns a folder of this name, a new one is made
    and removed at the end of the process. Raises UserError if there is no temporary folder.
    """
    try:
        temporary = tempfile.gettempdir()
        folder = os.path.join(temporary, f"inclined-landing-{os.geteuid()}")
        with contextlib.suppress(FileExistsError):
            os.mkdir(folder, 0o700)
        if _is_own(os.lstat(folder)) and _keeps_names(os.stat(temporary)):
            return folder
        folder = tempfile.mkdtemp(prefix="inclined-landing-")
    except OSError as error:
        raise UserError(
            "compiled functions cannot be cached: the package's folder, the home and the temporary folder "
            "are not writable; set NUMBA_CACHE_DIR to a writable folder"
        ) from error
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _is_own(found: os.stat_result) -> bool:
    """Return whether this folder belongs to this user and is inaccessible to all others."""
    return stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid() and not found.st_mode & 0o077


def _keeps_names(found: os.stat_result) -> bool:
    """Return whether only their owners can rename or replace the files in this folder."""
    sticky, writable = found.st_mode & stat.S_ISVTX, found.st_mode & 0o022  # by others
    return found.st_uid in (0, os.geteuid()) and bool(sticky or not writable)
