"""Decorators that compile functions with numba: once, cached, and without checks for division by zero.

Most of the compilation time is numba's own work on every statement, plus some 10 ms for every way to call a
function. Functions that kernels call are therefore compiled once and inlined by LLVM, whereas numba's own
inlining would compile them again at every call. Functions that only kernels call have no compiled entry point
for Python, which runs the uncompiled source. Python's cyclic garbage collector is off while numba compiles,
because it would take a tenth of the time.

Numba's cache looks at a function's own file only, not at those of the functions it calls. In a clone, where
files change one by one, compiled functions that are older than what may be compiled into them are removed.
"""

import contextlib
import gc
import os
from pathlib import Path

import numba
from numba.core import event
from numba.extending import register_jitable


class _CollectLater(event.Listener):
    """Disables the garbage collector during compilations: nested ones, by numba's lock in one thread."""

    depth, enabled = 0, False

    def on_start(self, event) -> None:
        if self.depth == 0:
            self.enabled = gc.isenabled()
            gc.disable()
        self.depth += 1

    def on_end(self, event) -> None:
        self.depth -= 1
        if self.depth == 0 and self.enabled:
            if gc.get_freeze_count() == 0:
                gc.freeze()  # What numba has made becomes old without a collection that looks at all of it.
                gc.unfreeze()
            gc.enable()


event.register("numba:compile", _CollectLater())


def remove_outdated(root: Path) -> None:
    """Remove compiled functions below `root` that are older than a source they may be compiled from."""
    newest = 0.0
    for floor in ("models", "envs", "train", "eval"):  # each imports only from itself and those before it
        indices = []
        for folder, _, names in os.walk(root / floor):
            for path in (os.path.join(folder, name) for name in names):
                if path.endswith(".nbi"):
                    indices.append(Path(path))
                elif path.endswith(".py"):
                    source = Path(path).read_bytes()
                    if b"compiled import" in source or b"import numba" in source:
                        newest = max(newest, os.stat(path).st_mtime)
        for index in indices:
            if index.stat().st_mtime < newest:
                index.unlink(missing_ok=True)


_ROOT = Path(__file__).parents[1]
if (_ROOT / "pyproject.toml").is_file() and "NUMBA_CACHE_DIR" not in os.environ:
    with contextlib.suppress(OSError):  # another process removes them, or nothing can be cached in the clone
        remove_outdated(_ROOT)

_OPTIONS = {"cache": True, "error_model": "numpy", "no_cfunc_wrapper": True}

kernel = numba.njit(**_OPTIONS)  # called from Python
unlocked = numba.njit(**_OPTIONS, nogil=True)  # also by several threads at once
formula = numba.njit(**_OPTIONS, forceinline=True)  # called from Python and by kernels
inlined = register_jitable(**_OPTIONS, forceinline=True)  # called by kernels
inner = register_jitable(**_OPTIONS)  # the same, too large to be inlined
