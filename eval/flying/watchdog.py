"""A thread that notices when the control loop hangs."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable


class Watchdog:
    """Calls `stop` once, from its own thread, when `feed` was not called for `limit` s of real time.

    Use as a context; `triggered` says whether it did. No thread gets past a hang inside cflib's own lock:
    then the vehicle stops by itself, 1 s after the last notice.
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
