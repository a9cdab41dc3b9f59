"""The C export compiled for this machine."""

from __future__ import annotations

import ctypes
import os
import shlex
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from inclined_landing.models.base.errors import UserError

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wshadow")
_COMPILERS = ("cc", "gcc", "clang")


def compiler() -> list[str] | None:
    """Return the C compiler named by CC or found under its usual names; None where there is none."""
    named = shlex.split(os.environ.get("CC", ""))
    if named:
        return named if shutil.which(named[0]) else None
    found = next(filter(None, map(shutil.which, _COMPILERS)), None)
    return None if found is None else [found]


def build(sources: Sequence[Path], out: Path, *flags: str) -> Path:
    """Compile sources into `out` as C99 without warnings; raise UserError with the compiler's first error."""
    found = compiler()
    if found is None:
        raise UserError("no C compiler was found; install one (on Debian and Ubuntu: apt install gcc)")
    words = [*found, *STRICT, *map(str, sources), *flags, "-o", str(out)]
    done = subprocess.run(words, capture_output=True, text=True)
    if done.returncode:
        reason = next((line for line in done.stderr.splitlines() if "error" in line), "no message")
        raise UserError(f"{found[0]} refused {sources[0]}: {reason}")
    return out


class Library:
    """The compiled policy of a C export; `folder` is one, `scratch` an empty folder to compile in."""

    def __init__(self, folder: Path, scratch: Path, *flags: str):
        source = folder / "src"
        sources = [source / "landing_policy.c", Path(__file__).with_name("c_code") / "rows.c"]
        path = build(sources, scratch / "policy.so", f"-I{source}", "-shared", "-fPIC", *(flags or ("-O2",)))
        self._library = ctypes.CDLL(str(path))

    def infer(self, inputs: np.ndarray, actions: int) -> np.ndarray:
        """Return actions (n, a) for inputs (n, i), history included; raise ValueError where the C code
        refuses.
        """
        inputs = np.ascontiguousarray(inputs, np.float32)
        result = np.zeros((len(inputs), actions), np.float32)
        code = self._library.landing_policy_infer_rows(_pointer(inputs), _pointer(result), len(inputs))
        if code:
            raise ValueError(f"landing_policy_infer returned {code}")
        return result

    def call(self, name: str, *arrays: np.ndarray) -> int:
        """Return the result of a function of the header for arrays that it reads or writes."""
        return getattr(self._library, name)(*map(_pointer, arrays))


def _pointer(array: np.ndarray) -> ctypes.c_void_p:
    assert array.flags.c_contiguous
    return ctypes.c_void_p(array.ctypes.data)
