"""A program of a sweep, which ends when the process that began it does, however that ends.

    python -m inclined_landing.train.sweep.child PARENT MODULE WORDS...

PARENT: the number of that process. Linux kills the program with it, so that no training goes on unseen in a
folder in which a later one is resumed.
"""

import ctypes
import os
import runpy
import signal
import sys

_PR_SET_PDEATHSIG = 1  # <linux/prctl.h>


def main() -> None:
    """Run MODULE with WORDS as `python -m` does."""
    parent, module, *words = sys.argv[1:]
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != int(parent):  # it ended before
        sys.exit("the sweep has ended")
    sys.argv[1:] = words
    runpy.run_module(module, run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
