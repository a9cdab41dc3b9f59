"""One direction of the radio link: packets arrive late, in order, and not always."""

from __future__ import annotations

import dataclasses

import numpy as np


@dataclasses.dataclass(frozen=True)
class LinkQuality:
    """Latency and losses of the radio, the same in both directions.

    The Crazyradio sends a packet again until it is acknowledged, so what goes wrong on the air is mostly a
    delay. The figures are estimates: bitcraze's own measurements give round trips of 4 to 10 ms at 2 Mbit/s.
    """

    latency: float = 0.003  # s, from call to arrival, when the first attempt succeeds
    jitter: float = 0.001  # s, mean of an exponential on top
    failing: float = 0.05  # share of the attempts that fail
    again: float = 0.002  # s per further attempt
    attempts: int = 100  # after which cflib's radio driver gives the link up (`_nr_of_retries`)
    lost: float = 0.005  # share of the packets lost for good, in full queues


class LinkDirection:
    """One direction of the link. down: nothing gets through; storm: share of packets lost on top."""

    def __init__(self, link: LinkQuality, random: np.random.Generator):
        self.link = link
        self.down = False
        self.storm = 0.0
        self._random = random
        self._last = 0.0

    def arrival(self, time: float) -> float | None:
        """Return the arrival time of a packet sent at `time` [s]; None when it is lost."""
        link, random = self.link, self._random
        lost = random.random() < link.lost + self.storm
        failed = random.geometric(1.0 - link.failing) - 1
        delay = link.latency + random.exponential(link.jitter) + failed * link.again
        if self.down or lost or failed >= link.attempts:
            return None
        self._last = max(self._last, time + delay)
        return self._last
