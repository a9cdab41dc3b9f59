"""The clock of flights that are real, or as slow as real ones."""

from __future__ import annotations

import time


class RealClock:
    """The machine's monotonic clock [s]."""

    def now(self) -> float:
        """Return the present time [s]."""
        return time.monotonic()

    def wait_until(self, moment: float) -> None:
        """Sleep until `moment` [s]."""
        left = moment - time.monotonic()
        if left > 0.0:
            time.sleep(left)
