"""Stopping of the motors when the control loop hangs, its process dies, or a signal interrupts it.

A thread monitors the loop, and another process monitors this process: after `kill -9`, a crash in a library,
or if the kernel runs out of memory, no code of the pilot runs any more, and the firmware holds the last
thrust until its own watchdog stops it 1 s later. The kernel, however, closes the pipe to the other process at
once. `python -m inclined_landing.eval.flying.watchdog URI` is that process.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator

from inclined_landing.models.base.errors import UserError

STARTING, ENDING = 20.0, 2.0  # s that the other process may take until it listens, and to end
OPENING = 5.0  # s for which it tries the link: the Crazyradio may not yet be free of the dead process
SENDING, PERIOD = 1.0, 0.01  # s for which the stop is sent, and how often: any packet may get lost
# Port, channel, data: stop (`crtp_commander_generic.c`) and emergency stop (`crtp_supervisor.c`, and before
# protocol 12 `crtp_localization_service.c`). None of them needs more than an open link.
STOPS = ((7, 0, b"\x00"), (9, 1, b"\x03"), (6, 1, b"\x03"))
_READY, _OVER = b"ready\n", b"over\n"
# The signals of Ctrl-C, `kill`, a closed terminal, Ctrl-\ and Ctrl-Z, which would stop the pilot in mid-air.
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP)


class Watchdog:
    """Calls `stop` once, from its own thread, when `feed` was not called for `limit` s of real time.

    Use it as a context; `triggered` tells whether it did. No thread can pass a hang inside cflib's own lock;
    in that case the firmware stops the motors 1 s after the last notice.
    """

    def __init__(self, limit: float, stop: Callable[[], None]):
        self.triggered = False
        self._limit, self._stop = limit, stop
        self._last = time.monotonic()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="watchdog", daemon=True)

    def __enter__(self) -> Watchdog:
        self._last = time.monotonic()
        self._thread.start()
        return self

    def __exit__(self, *_) -> None:
        self._over.set()

    def feed(self) -> None:
        """Reset the timer."""
        self._last = time.monotonic()

    def _watch(self) -> None:
        while not self._over.wait(self._limit / 5.0):
            if time.monotonic() - self._last > self._limit:
                self.triggered = True
                self._stop()
                return


class DeadManSwitch:
    """Context in which the motors of the vehicle at `uri` are stopped when this process dies.

    Raises UserError on entering if the other process does not start.
    """

    def __init__(self, uri: str):
        self._uri = uri

    def __enter__(self) -> DeadManSwitch:
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", __name__, self._uri],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # what the terminal sends to the pilot is not meant for it
        )
        output = self._process.stdout
        assert output is not None
        data = select.select([output], [], [], STARTING)[0]
        if not data or output.readline() != _READY:
            self._kill()
            raise UserError(
                "not ready to fly: the watchdog process that would stop the motors has not started"
            )
        return self

    def __exit__(self, *_) -> None:
        with contextlib.suppress(OSError, subprocess.TimeoutExpired):
            self._process.communicate(_OVER, timeout=ENDING)
        self._kill()

    def watches(self) -> bool:
        """Return whether the other process runs: it was neither killed nor stopped."""
        # WNOWAIT leaves the child's state for Popen to collect.
        ended = os.WEXITED | os.WSTOPPED | os.WNOHANG | os.WNOWAIT
        return self._process.returncode is None and os.waitid(os.P_PID, self._process.pid, ended) is None

    def _kill(self) -> None:
        self._process.kill()  # does nothing if it has ended
        with contextlib.suppress(OSError):
            self._process.communicate()


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Make the other signals that a terminal sends raise KeyboardInterrupt as Ctrl-C does."""

    def interrupt(number, frame):
        raise KeyboardInterrupt

    with _handlers(interrupt):
        yield


@contextlib.contextmanager
def uninterruptible() -> Iterator[None]:
    """Ignore a second Ctrl-C while the vehicle is being stopped."""
    with _handlers(signal.SIG_IGN):
        yield


@contextlib.contextmanager
def _handlers(handler) -> Iterator[None]:
    """Set `handler` for the signals of a terminal; outside the main thread do nothing."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number in _SIGNALS}
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)


def stop(uri: str) -> None:
    """Send stop commands to the vehicle at `uri` for a while. Raises cflib's error without a link."""
    import cflib.crtp
    from cflib.crtp.crtpstack import CRTPPacket

    end = time.monotonic() + OPENING
    while True:
        try:
            link = cflib.crtp.get_link_driver(uri, lambda *_: None, lambda *_: None)
            break
        except Exception:
            if time.monotonic() > end:
                raise
            time.sleep(PERIOD)
    end = time.monotonic() + SENDING
    while time.monotonic() < end:
        for port, channel, data in STOPS:
            packet = CRTPPacket(data=data)
            packet.set_header(port, channel)
            link.send_packet(packet)
        time.sleep(PERIOD)


def main(uri: str) -> None:
    """Wait for the end of standard input; stop the motors if it ends without the agreed last word."""
    import cflib.crtp

    cflib.crtp.init_drivers()
    sys.stdout.buffer.write(_READY)
    sys.stdout.buffer.flush()
    if sys.stdin.buffer.read() != _OVER:
        print("the pilot's process is gone: motors off", file=sys.stderr)
        stop(uri)


if __name__ == "__main__":
    main(sys.argv[1])
