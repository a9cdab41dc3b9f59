"""How functions are compiled: with numba, once, cached, and without a check of divisors.

Most of the compilation is numba's own work on every statement, and some 10 ms for every way to call a
function. So a part is compiled once and inlined by LLVM, where numba's own inlining would compile it again at
every call; and what only kernels call has no entry for Python.
"""

import functools

import numba

_compiled = functools.partial(numba.njit, cache=True, error_model="numpy", no_cfunc_wrapper=True)

kernel = _compiled()  # called from Python
unlocked = _compiled(nogil=True)  # also by several threads at once
inlined = _compiled(forceinline=True, no_cpython_wrapper=True)  # called by kernels alone
formula = _compiled(forceinline=True)  # called by kernels, and from Python
