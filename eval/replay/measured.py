"""A measured flight, and beside it what the model makes of the same commands."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from inclined_landing.eval.gap.flights.windows import Measured, prepare
from inclined_landing.eval.gap.search.rollout import Starts, simulate
from inclined_landing.eval.logs import FlightLog
from inclined_landing.eval.replay.recording import MEASURED, SIMULATED, Recording
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import Vehicle


def of_log(
    log: FlightLog, vehicle: Vehicle, *, platform: bool, anew: float, plant: str
) -> tuple[list[Recording], list[str]]:
    """The measured flight and, where the log tells enough, its simulation; and sentences on what lacks.

    platform: the vehicle file's slab stood there. anew: s after which the simulation begins again at the
    measured state, see `gap.search.rollout`.
    """
    notes = [f"{log.name}: {note}" for note in log.notes]
    platform = platform or log.contact is not None
    measured = Recording(
        name=log.name,
        kind=MEASURED,
        outcome=f"{log.duration:.2f} s measured at {log.rate:.0f} rows per second",
        vehicle=vehicle,
        inclination=vehicle.platform_inclination if platform else None,
        t=log.t - log.t[0],
        position=log.position,
        attitude=log.attitude,
        velocity=_velocity(log),
        commands=log.command,
        events=_touch(log),
    )
    try:
        flight = prepare(log, vehicle, platform=platform)
        simulated = _simulated(measured, flight, vehicle, anew, plant)
    except (UserError, FloatingPointError) as error:
        return [measured], [*notes, f"no simulation of {log.name}: {error}"]
    return [measured, simulated], notes


def _velocity(log: FlightLog) -> np.ndarray:
    """As logged, or the differences of the measured position (m, 3) [m/s]."""
    return log.velocity if log.velocity is not None else np.gradient(log.position, log.t, axis=0)


def _touch(log: FlightLog) -> list[tuple[float, str]]:
    if log.contact is None:
        return []
    begins = np.flatnonzero(np.diff(log.contact.astype(int)) == 1) + 1
    return [(float(log.t[begins[0]] - log.t[0]), "first touch")] if len(begins) else []


def _simulated(measured: Recording, flight: Measured, vehicle: Vehicle, anew: float, plant: str) -> Recording:
    """The model's flight in parts of `anew` seconds, each from the measured state at its beginning."""
    last = flight.samples - 1
    rows = min(max(1, round(anew / flight.dt)), last)
    firsts = np.arange(0, last - rows + 1, rows)
    parts = [_part(flight, firsts, rows, vehicle, plant)]
    left = last - firsts[-1] - rows
    if left:
        parts.append(_part(flight, firsts[-1:] + rows, left, vehicle, plant))
    begins = [*firsts, *([firsts[-1] + rows] if left else [])]
    lengths = [rows + 1] * len(firsts) + ([left + 1] if left else [])
    pose = np.concatenate([window for part in parts for window in part])
    index = np.concatenate([np.arange(a, a + n) for a, n in zip(begins, lengths)])
    velocity = np.concatenate(
        [np.gradient(window[:, :3], flight.dt, axis=0) for part in parts for window in part]
    )
    apart = np.linalg.norm(pose[:, :3] - flight.position[index], axis=1)
    ends = np.cumsum(lengths) - 1
    typical = math.sqrt(float(np.mean(apart[ends[: len(firsts)]] ** 2)))
    every = "from the start" if len(begins) == 1 else f"anew every {rows * flight.dt:g} s"
    return dataclasses.replace(
        measured,
        name=f"{measured.name}, simulated",
        kind=SIMULATED,
        outcome=f"simulated {every} with the measured commands; {100 * typical:.1f} cm (root mean square) "
        f"from the measured position after {rows * flight.dt:.3g} s",
        t=flight.t[index],
        position=pose[:, :3],
        attitude=pose[:, 3:],
        velocity=velocity,
        commands=flight.command[index],
        events=[],
        anew=ends[:-1] + 1,
    )


def _part(flight: Measured, firsts: np.ndarray, rows: int, vehicle: Vehicle, plant: str) -> np.ndarray:
    """Simulated poses (k, rows + 1, 6) from the rows `firsts` (k,)."""
    starts = Starts([flight], np.zeros(len(firsts), int), firsts, rows, flight.dt)
    return simulate(starts, vehicle, plant)
