"""Decorators that compile functions with numba: once, cached, and without checks for division by zero.

Most of the compilation time is numba's own work on every statement, plus some 10 ms for every way to call a
function. Functions that kernels call are therefore compiled once and inlined by LLVM, whereas numba's own
inlining would compile them again at every call. Functions that only kernels call have no compiled entry point
for Python, which runs the uncompiled source. Python's cyclic garbage collector is off while numba compiles,
because it would take a tenth of the time.
"""

import gc

import numba
from numba.core import event
from numba.extending import register_jitable


class _CollectLater(event.Listener):
    """Disables the garbage collector during compilations, which may be nested but not run in two threads."""

    depth, enabled = 0, False

    def on_start(self, event) -> None:
        if self.depth == 0:
            self.enabled = gc.isenabled()
            gc.disable()
        self.depth += 1

    def on_end(self, event) -> None:
        self.depth -= 1
        if self.depth == 0 and self.enabled:
            gc.enable()


event.register("numba:compile", _CollectLater())

_OPTIONS = {"cache": True, "error_model": "numpy", "no_cfunc_wrapper": True}

kernel = numba.njit(**_OPTIONS)  # called from Python
unlocked = numba.njit(**_OPTIONS, nogil=True)  # also by several threads at once
formula = numba.njit(**_OPTIONS, forceinline=True)  # called from Python and by kernels
inlined = register_jitable(**_OPTIONS, forceinline=True)  # called by kernels
inner = register_jitable(**_OPTIONS)  # the same, too large to be inlined
