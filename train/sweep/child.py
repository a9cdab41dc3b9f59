"""A program of a sweep, which ends when the process that began it does, however that ends.

    python -m inclined_landing.train.sweep.child MODULE WORDS...

Its standard input is a pipe whose other end that process alone holds and never writes to: the pipe ends with
the process. So no training goes on unseen in a folder in which a later one is resumed.
"""

import os
import runpy
import signal
import sys
import threading


def main() -> None:
    """Run MODULE with WORDS as `python -m` does."""
    pipe = os.dup(0)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    threading.Thread(target=_end_with, args=(pipe,), daemon=True).start()
    module, *sys.argv[1:] = sys.argv[1:]
    runpy.run_module(module, run_name="__main__", alter_sys=True)


def _end_with(pipe: int) -> None:
    """Wait for the end of the pipe, then kill this program and those that it has begun."""
    os.read(pipe, 1)
    os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    main()
