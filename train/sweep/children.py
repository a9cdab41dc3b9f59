"""The processes of a sweep: started, measured, and ended with it."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence

from inclined_landing.train.sweep import child

PROGRAMS = {"landing-train": "inclined_landing.train", "landing-eval": "inclined_landing.eval"}
# Libraries that otherwise start a thread for each core.
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_PATIENCE = 20.0  # s until processes that were asked to end are killed


class Stopped(Exception):
    """The sweep ends: nothing more is started."""


@dataclasses.dataclass(frozen=True)
class Ended:
    """How a process ended, and what it took."""

    code: int
    cpu_seconds: float  # of it and of the processes it waited for
    wall_seconds: float
    load: float  # of the machine in the last minute of it


class Children:
    """Processes that end when this one is told to; `run` may be called by several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running: set[subprocess.Popen] = set()
        self._stopped = False

    def run(self, words: Sequence[str], log: int, threads: int) -> Ended:
        """Run `landing-train ...` or `landing-eval ...` to its end, or to that of this process.

        log: descriptor of the file for what it prints. threads: that its libraries may start. Raises Stopped
        when the sweep has ended.
        """
        # Unbuffered, so that the last line of the log is the last that was said; without the present folder
        # among those that are imported from, as the programs themselves are started.
        command = [sys.executable, "-u", "-P", "-m", child.__name__, PROGRAMS[words[0]], *words[1:]]
        environment = os.environ | dict.fromkeys(_THREADS, str(threads))
        began = time.monotonic()
        with self._lock:
            if self._stopped:
                raise Stopped
            process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,  # ends with this process, and the program with it
                stdout=log,
                stderr=subprocess.STDOUT,
                env=environment,
                start_new_session=True,  # Ctrl-C reaches this process alone, which ends the others
            )
            self._running.add(process)
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
        with self._lock:  # its number is its own until it is waited for
            _, status, used = os.wait4(process.pid, 0)
            self._running.discard(process)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.stdin is not None:
            process.stdin.close()
        seconds = time.monotonic() - began
        return Ended(process.returncode, used.ru_utime + used.ru_stime, seconds, os.getloadavg()[0])

    def stop(self) -> None:
        """Ask all processes to end, as Ctrl-C would, and kill those that do not."""
        with self._lock:
            self._stopped = True
        self._send(signal.SIGTERM)
        until = time.monotonic() + _PATIENCE
        while self._running and time.monotonic() < until:
            time.sleep(0.05)
        self._send(signal.SIGKILL)

    def _send(self, number: int) -> None:
        with self._lock:
            for process in self._running:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, number)
