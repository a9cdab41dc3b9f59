"""A held-out flight with open-loop predictions from every second of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from inclined_landing.eval.gap.answer import rollout
from inclined_landing.eval.gap.flights.windows import NEAR, prepare
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.vehicle import Vehicle

EVERY = 1.0  # s between two predictions


@dataclasses.dataclass(frozen=True)
class Track:
    """Measured positions of one flight and open-loop predictions along it."""

    flight: str
    held_out: bool  # of the fit
    seconds: float  # how far each prediction goes
    t: np.ndarray  # (m,) s
    position: np.ndarray  # (m, 3) m, measured
    times: tuple[np.ndarray, ...]  # of every prediction, (k,) s
    before: tuple[np.ndarray, ...]  # (k, 3) m, nominal vehicle
    after: tuple[np.ndarray, ...]  # (k, 3) m, corrected vehicle

    @property
    def worst_axis(self) -> int:
        """Return the coordinate (0, 1, 2) of the largest errors of the nominal vehicle."""
        missed = np.zeros(3)
        for t, p in zip(self.times, self.before):
            end = [np.interp(t[-1], self.t, self.position[:, k]) for k in range(3)]
            missed += (p[-1] - end) ** 2
        return int(np.argmax(missed))


def of(
    log: FlightLog, before: Vehicle, after: Vehicle, *, held_out: bool, platform: bool = False
) -> Track | None:
    """Return predictions along a flight; None when no stretch of it is long enough.

    Raises UserError when the flight cannot be used at all.
    """
    flight = prepare(log, before, platform=platform)
    try:
        starts = rollout.RolloutWindows.of([flight], every=EVERY)
    except UserError:
        return None
    poses = [rollout.simulate(starts, vehicle)[..., :3] for vehicle in (before, after)]
    shown = slice(starts.first[0], starts.first[-1] + starts.rows + 1)
    return Track(
        flight=log.name,
        held_out=held_out,
        seconds=round(starts.rows * starts.dt, 3),
        t=flight.t[shown],
        position=flight.position[shown],
        times=tuple(flight.t[a : a + starts.rows + 1] for a in starts.first),
        before=tuple(poses[0]),
        after=tuple(poses[1]),
    )


def most_varied_flight(logs: Sequence[FlightLog]) -> FlightLog:
    """Return the flight with the largest range of heights, of those near the floor if there are any."""

    def key(log: FlightLog) -> tuple[bool, float]:
        height = log.position[:, 2]
        return bool(np.nanmin(height) < NEAR), float(np.ptp(height))

    return max(logs, key=key)
