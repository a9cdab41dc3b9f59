"""Loader of the native plugins (`plugin/README.md`).

`import mujoco` calls :func:`load` through the entry point group `mujoco.plugins`; call it yourself before
compiling a model if entry points may be disabled. This module imports nothing heavy.
"""

import ctypes
import functools
import json
import sys
import tomllib
from importlib import resources
from pathlib import Path

NAMES = ("inclined_landing.rotors", "inclined_landing.attitude")
_LIBRARIES = ("libinclined_landing.so", "libinclined_landing.dylib")
_REMEDY = "run `make` in the repository, or reinstall the package in this environment"

_handle: ctypes.CDLL | None = None


@functools.cache
def fields() -> dict[str, dict[str, str]]:
    """Plugin -> attribute -> the field of :class:`Vehicle` that fills it (`plugin/attributes.toml`)."""
    text = resources.files(__package__).joinpath("plugin/attributes.toml").read_text("utf-8")
    return {
        plugin: {name: line["entry"].replace(".", "_") for name, line in lines.items() if "entry" in line}
        for plugin, lines in tomllib.loads(text).items()
    }


def load() -> None:
    """Register the plugins with MuJoCo; does nothing the second time.

    Raises ImportError when the library is missing or was built for another MuJoCo version.
    """
    global _handle
    if _handle is not None:
        return
    import mujoco  # may be half initialised: this is also called by `import mujoco`

    if _handle is not None:  # a first import of mujoco has just called load()
        return
    library, build = _find()
    if library is None:
        raise ImportError(
            "the native plugins of inclined_landing are not built (a C++17 compiler is needed); " + _REMEDY
        )
    running = mujoco.mj_versionString()
    if build["mujoco"] != running:
        raise ImportError(
            f"the native plugins of inclined_landing were built for MuJoCo {build['mujoco']}, but "
            f"MuJoCo {running} is installed; {_REMEDY}"
        )
    _handle = ctypes.CDLL(str(library))


def stop_profile() -> None:
    """Stop MuJoCo's reading of the clock in every stage of a step, which takes a seventh of its time.

    It only fills the profile `mjData.timer`. Call this once `import mujoco` has finished.
    """
    load()
    assert _handle is not None
    ctypes.c_void_p.in_dll(_handle, "mjcb_time").value = None


def loaded() -> tuple[list[str], Path | None, dict]:
    """Return the plugins of this package that MuJoCo knows, their library, and the record of its build.

    The record holds the version of MuJoCo, and of each plugin the attributes' defaults.
    """
    names: list[str] = []
    if _handle is not None:
        _handle.mjp_getPlugin.restype = ctypes.c_void_p
        _handle.mjp_getPlugin.argtypes = (ctypes.c_char_p, ctypes.POINTER(ctypes.c_int))
        names = [n for n in NAMES if _handle.mjp_getPlugin(n.encode(), None)]
    return names, *_find()


def _find() -> tuple[Path | None, dict]:
    """Return the library and its build record, which an editable install keeps outside the sources."""
    package = sys.modules[__package__]
    for folder in map(Path, package.__path__):
        for name in _LIBRARIES:
            record = folder / "_build.json"
            if (folder / name).exists() and record.exists():
                return folder / name, json.loads(record.read_text("utf-8"))
    return None, {}
