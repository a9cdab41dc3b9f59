"""Code of the user, a task named as `module:Class` or `file.py:Class`.

Code is imported, and so executed, only if the user names it, never because a policy file or a run folder
does.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
import traceback
from pathlib import Path
from types import ModuleType
from typing import Any

from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError, shown

_FILES: dict[str, str] = {}  # names of imported objects as users gave them, by file


def import_named(path: str) -> Any:
    """Import and return the object named by `module:Class` or `file.py:Class`; None if the module lacks it.

    Raises UserError if the code cannot be imported.
    """
    source, _, name = path.rpartition(":") if isinstance(path, str) else ("", "", "")
    if not (source and name.isidentifier()):
        raise UserError(f"write a custom task as module:Class or file.py:Class, not {shown(path, 60)}")
    if source.endswith(".py"):
        storage.read_bytes(source, "task file")  # no pipe, which has no end
    try:
        module = _from_file(Path(source)) if source.endswith(".py") else _from_module(source)
    except (Exception, SystemExit) as error:  # whatever the code does
        said = f"{type(error).__name__}: {shown(error, 120)}"
        raise UserError(f"task {shown(path, 60)} cannot be imported: {said}") from error
    if file := getattr(module, "__file__", None):
        _FILES[file] = f"task {shown(path, 60)}"
    return getattr(module, name, None)


def blame(error: BaseException) -> str | None:
    """Return a sentence with the line of a custom module that raised an error; None if none did."""
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if frame.filename in _FILES:
            said = f"{type(error).__name__}{f': {shown(error, 120)}' if str(error) else ''}"
            return f"{_FILES[frame.filename]}: {frame.name} raised {said} (line {frame.lineno})"
    return None


def _from_file(path: Path) -> ModuleType:
    name = f"_own_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path.resolve(strict=True))
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look themselves up there
    spec.loader.exec_module(module)
    return module


def _from_module(name: str) -> ModuleType:
    here = str(Path.cwd())
    if here not in sys.path:  # as python -m has it
        sys.path.insert(0, here)
    return importlib.import_module(name)
