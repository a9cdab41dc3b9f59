"""A measured flight and its simulation with the same commands."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import scipy  # whose submodules are imported when they are used

from inclined_landing.eval.gap.answer.rollout import RolloutWindows, simulate
from inclined_landing.eval.gap.measured.windows import SMOOTHING, MeasuredFlight, prepare
from inclined_landing.eval.logs import FlightLog
from inclined_landing.eval.logs.log import runs
from inclined_landing.eval.replay.recording import MEASURED, SIMULATED, Recording
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.vehicle import Vehicle

SHORTEST = 5  # steps of a part that is left at the end of a stretch of free flight


def from_log(
    log: FlightLog, vehicle: Vehicle, *, platform: bool, horizon: float, plant: str
) -> tuple[list[Recording], list[str]]:
    """Return the measured flight, its simulation if the log is sufficient, and notes on missing columns.

    platform: whether the vehicle file's slab was present. horizon: s after which the simulation begins again
    at the measured state, see `gap.answer.rollout`.
    """
    notes = [f"{log.name}: {note}" for note in log.notes]
    platform = platform or log.contact is not None
    touches = [] if log.contact is None else np.flatnonzero(np.diff(log.contact.astype(int)) == 1) + 1
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
        events=[(float(log.t[row] - log.t[0]), "first touch") for row in touches[:1]],
    )
    try:
        flight = prepare(log, vehicle, platform=platform)
        simulated = _simulated(measured, flight, vehicle, horizon, plant)
    except (UserError, FloatingPointError) as error:
        reason = str(error).removeprefix(f"{log.name}: ")
        return [measured], [*notes, f"no simulation of {log.name}: {reason}"]
    return [measured, simulated], notes


def _velocity(log: FlightLog) -> np.ndarray:
    """Return the derivative of the position (m, 3) [m/s], smoothed over the rows within SMOOTHING."""
    half = max(1, min(round(SMOOTHING * log.rate), (len(log) - 1) // 2))
    # Rows k may be uneven in time: dx/dt = dx/dk / (dt/dk)
    x, t = (scipy.signal.savgol_filter(a, 2 * half + 1, 2, 1, axis=0) for a in (log.position, log.t))
    return x / t[:, None]


def _simulated(
    measured: Recording, flight: MeasuredFlight, vehicle: Vehicle, horizon: float, plant: str
) -> Recording:
    """Return the simulated flight in segments of `horizon` seconds, each from its measured initial state.

    If the obstacles in the arena are unknown, only free flight is simulated, because the vehicle would fall
    through the ground.
    """
    known = measured.inclination is not None
    usable = np.full(flight.samples, True) if known else flight.usable
    segments = _segments(usable, max(1, round(horizon / flight.dt)))
    if not segments:
        raise UserError("the log has no free flight")
    windows: dict[int, np.ndarray] = {}
    for steps in sorted({steps for _, steps in segments}):
        firsts = [first for first, length in segments if length == steps]
        starts = RolloutWindows([flight], np.zeros(len(firsts), int), np.array(firsts), steps, flight.dt)
        windows |= dict(zip(firsts, simulate(starts, vehicle, plant)))
    poses = [windows[first] for first, _ in segments]
    index = np.concatenate([np.arange(first, first + n + 1) for first, n in segments])
    pose = np.concatenate(poses)
    velocity = np.concatenate([np.gradient(part[:, :3], flight.dt, axis=0) for part in poses])
    error = np.linalg.norm(pose[:, :3] - flight.position[index], axis=1)
    ends = np.cumsum([n + 1 for _, n in segments]) - 1
    longest = max(n for _, n in segments)
    final = [error[end] for end, (_, n) in zip(ends, segments) if n == longest]
    typical = math.sqrt(float(np.mean(np.square(final))))
    of = "" if known else " of free flight"
    often = "" if len(segments) == 1 else f", restarted at the measured state every {horizon:g} s{of}"
    return dataclasses.replace(
        measured,
        name=f"{measured.name}, simulated",
        kind=SIMULATED,
        outcome=f"simulated with the measured commands{often}; position error {100 * typical:.1f} cm (RMS) "
        f"after {longest * flight.dt:.3g} s",
        t=flight.t[index],
        position=pose[:, :3],
        attitude=pose[:, 3:],
        velocity=velocity,
        commands=flight.command[index],
        events=[],
        restarts=ends[:-1] + 1,
    )


def _segments(usable: np.ndarray, rows: int) -> list[tuple[int, int]]:
    """Return first row and number of steps, at most `rows`, of each segment of the usable rows (m,)."""
    found = []
    for begin, end in runs(usable).tolist():
        for first in range(begin, end - 1, rows):
            steps = min(rows, end - 1 - first)
            if steps >= min(rows, SHORTEST):
                found.append((first, steps))
    return found
