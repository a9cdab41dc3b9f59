"""How functions are compiled: with numba, once, cached, and without a check of divisors.

Most of the compilation is numba's own work on every statement, and some 10 ms for every way to call a
function. So what kernels call is compiled once and inlined by LLVM, where numba's own inlining would compile
it again at every call; and what only kernels call has no compiled entry for Python, which runs it as it
stands.
"""

import numba
from numba.extending import register_jitable

_OPTIONS = {"cache": True, "error_model": "numpy", "no_cfunc_wrapper": True}

kernel = numba.njit(**_OPTIONS)  # called from Python
unlocked = numba.njit(**_OPTIONS, nogil=True)  # also by several threads at once
formula = numba.njit(**_OPTIONS, forceinline=True)  # called from Python and by kernels
inlined = register_jitable(**_OPTIONS, forceinline=True)  # called by kernels
inner = register_jitable(**_OPTIONS)  # the same, too large to be inlined
