"""The clock of flights that are real, or as slow as real ones."""

from __future__ import annotations

import time


class RealClock:
    """Seconds of the machine's monotonic clock."""

    def now(self) -> float:
        """The present time [s]."""
        return time.monotonic()

    def wait_until(self, moment: float) -> None:
        """Sleep until then [s]."""
        left = moment - time.monotonic()
        if left > 0.0:
            time.sleep(left)
