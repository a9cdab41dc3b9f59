"""A measured flight, and beside it what the model makes of the same commands."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from inclined_landing.eval.gap.flights.windows import MeasuredFlight, prepare
from inclined_landing.eval.gap.search.rollout import RolloutWindows, simulate
from inclined_landing.eval.logs import FlightLog
from inclined_landing.eval.replay.recording import MEASURED, SIMULATED, Recording
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import Vehicle

SHORTEST = 5  # steps of a part that is left at the end of a stretch of free flight


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
        reason = str(error).removeprefix(f"{log.name}: ")
        return [measured], [*notes, f"no simulation of {log.name}: {reason}"]
    return [measured, simulated], notes


def _velocity(log: FlightLog) -> np.ndarray:
    """As logged, or the differences of the measured position (m, 3) [m/s]."""
    return log.velocity if log.velocity is not None else np.gradient(log.position, log.t, axis=0)


def _touch(log: FlightLog) -> list[tuple[float, str]]:
    if log.contact is None:
        return []
    begins = np.flatnonzero(np.diff(log.contact.astype(int)) == 1) + 1
    return [(float(log.t[begins[0]] - log.t[0]), "first touch")] if len(begins) else []


def _simulated(
    measured: Recording, flight: MeasuredFlight, vehicle: Vehicle, anew: float, plant: str
) -> Recording:
    """The model's flight in parts of `anew` seconds, each from the measured state at its beginning.

    Where nothing is known to stand in the arena only free flight is simulated: the vehicle would fall through
    the ground that it stands on.
    """
    known = measured.inclination is not None
    parts = _parts(np.full(flight.samples, True) if known else flight.usable, max(1, round(anew / flight.dt)))
    if not parts:
        raise UserError("no free flight in it")
    windows = {}
    for steps in sorted({steps for _, steps in parts}):
        firsts = [first for first, own in parts if own == steps]
        windows |= dict(zip(firsts, _flown(flight, firsts, steps, vehicle, plant)))
    poses = [windows[first] for first, _ in parts]
    index = np.concatenate([np.arange(first, first + n + 1) for first, n in parts])
    pose = np.concatenate(poses)
    velocity = np.concatenate([np.gradient(part[:, :3], flight.dt, axis=0) for part in poses])
    apart = np.linalg.norm(pose[:, :3] - flight.position[index], axis=1)
    ends = np.cumsum([n + 1 for _, n in parts]) - 1
    longest = max(n for _, n in parts)
    reached = [apart[end] for end, (_, n) in zip(ends, parts) if n == longest]
    typical = math.sqrt(float(np.mean(np.square(reached))))
    often = "once" if len(parts) == 1 else f"anew every {anew:g} s" + ("" if known else " of free flight")
    return dataclasses.replace(
        measured,
        name=f"{measured.name}, simulated",
        kind=SIMULATED,
        outcome=f"simulated {often} with the measured commands; {100 * typical:.1f} cm (root mean square) "
        f"from the measured position after {longest * flight.dt:.3g} s",
        t=flight.t[index],
        position=pose[:, :3],
        attitude=pose[:, 3:],
        velocity=velocity,
        commands=flight.command[index],
        events=[],
        anew=ends[:-1] + 1,
    )


def _parts(usable: np.ndarray, rows: int) -> list[tuple[int, int]]:
    """First row and number of steps, at most `rows`, of the parts that usable rows (m,) are cut into."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], usable, [False]]).astype(int)))
    found = []
    for begin, end in zip(edges[::2], edges[1::2]):
        for first in range(begin, end - 1, rows):
            steps = min(rows, end - 1 - first)
            if steps >= min(rows, SHORTEST):
                found.append((first, steps))
    return found


def _flown(flight: MeasuredFlight, firsts: list[int], steps: int, vehicle: Vehicle, plant: str) -> np.ndarray:
    """Simulated poses (k, steps + 1, 6) from the k rows `firsts`."""
    starts = RolloutWindows([flight], np.zeros(len(firsts), int), np.array(firsts), steps, flight.dt)
    return simulate(starts, vehicle, plant)
