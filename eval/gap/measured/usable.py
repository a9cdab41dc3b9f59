"""The flights of a command: read, checked, and those that can be used cut into windows.

Nothing is computed with crashes, touches of what no model has, and failed sensors: they are set aside by
name. So are copies and cut-outs of one flight, recognised by the measured poses: two flights never agree in a
measured pose to the last digit while they move.
"""

from __future__ import annotations

import dataclasses
import functools
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas

from inclined_landing.envs.shared.pool import in_fork
from inclined_landing.eval.base.options import FlightSource
from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.measured.windows import IDLE, MeasuredFlight, prepare_all
from inclined_landing.eval.gap.result import SetAside
from inclined_landing.eval.logs import FlightLog, read_log
from inclined_landing.eval.logs.checks import check_fleet
from inclined_landing.eval.logs.log import as_logs
from inclined_landing.eval.logs.repeats import percent
from inclined_landing.eval.logs.values import SHORTEST, failed_speed_sensors
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError, first_of, shown
from inclined_landing.models.vehicle import Vehicle

MOMENT = 0.1  # s: a vehicle that hits something stops within
DIGIT = 1e-4  # m or rad, to which poses are compared: a file may have been written again with fewer digits
NUMBER_BITS = 53  # of the number of a pose: the most that a JSON reader with floats keeps exactly
SAMPLED = 16  # of so many rows, one is kept to recognise a flight by
SAME = 0.5  # common share of poses above which two logs are one flight
DIFFERENT = "fitting and evaluation need different flights"
AFTER_THRUST = 1.0  # s after the last commanded thrust in which a vehicle may still fall over


@dataclasses.dataclass(frozen=True)
class ReadFlights:
    """The flights of a command."""

    logs: list[FlightLog]  # to fit
    heldout: list[FlightLog]
    reference: list[FlightLog]  # of the vehicle before, to identify it
    notes: tuple[str, ...]  # on limits that the flights of a group have in common


def begin_reading(source: FlightSource, reference: Sequence[str] = ()) -> Callable[..., ReadFlights]:
    """Begin `read_flights` in a forked process; returns a function of a tick that waits for the flights.

    Meanwhile this process may import what comes next.
    """
    read = functools.partial(read_flights, **source.options())
    return in_fork(read, source.files, source.heldout, reference, ticks=True)


def read_flights(
    files: Sequence[str],
    heldout: Sequence[str] = (),
    reference: Sequence[str] = (),
    *,
    tick: Callable[[str], None] = lambda name: None,
    **options: Any,
) -> ReadFlights:
    """Return the flights of some files.

    tick: called with the name of each file before it is read. options: of `read_log`.
    Raises UserError, naming the file, for a log that cannot be used, a file given twice, a flight of the
    reference among the others, and flights of different vehicles.
    """
    check_apart(files, heldout, reference)
    before, before_notes = _read(reference, tick, options)
    logs, notes = _read([*files, *heldout], tick, options)
    check_unused(logs, {log.name: fingerprint(log) for log in before}, "of the reference")
    return ReadFlights(logs[: len(files)], logs[len(files) :], before, (*before_notes, *notes))


def _read(
    files: Sequence[str], tick: Callable[[str], None], options: Mapping[str, Any]
) -> tuple[list[FlightLog], tuple[str, ...]]:
    """Return flights of one vehicle, and notes on their common limits; arguments as of `read_flights`."""
    logs = []
    stems = [shown(Path(file).name).removesuffix(".gz").removesuffix(".csv") for file in files]
    for file, stem in zip(files, stems):
        name = stem if stems.count(stem) == 1 else f"{shown(Path(file).parent.name)}/{stem}"
        tick(name)
        logs.append(read_log(file, **options, name=name))
    together = check_fleet(logs) if logs else []
    for finding in together:
        if finding.decision == "refuse":
            raise UserError(finding.text)
    return logs, tuple(finding.text for finding in together if finding.decision == "limit")


def check_apart(*groups: Sequence[str]) -> None:
    """Raise UserError for a file that is given more than once."""
    every = [file for group in groups for file in group]
    where = [storage.real(file) for file in every]
    for file, path in zip(every, where):
        if where.count(path) > 1:
            raise UserError(f"{file} is given more than once; {DIFFERENT}")


@dataclasses.dataclass(frozen=True)
class UsableFlights:
    """Flights to fit and flights to judge on, as logs and cut into windows, and those that cannot be used."""

    logs: list[FlightLog]
    heldout: list[FlightLog]
    fitted: list[MeasuredFlight]  # of `logs`, but those too short
    judged: list[MeasuredFlight]  # of `heldout`
    set_aside: tuple[SetAside, ...]
    notes: tuple[str, ...]
    platform: bool  # the slab of the vehicle file stands in the arena

    def without_angle_commands(self, vehicle: Vehicle) -> UsableFlights:
        """Return the flights as if their attitude commands were not known."""
        fitted, _ = prepare_all(list(map(_without_angle_commands, self.logs)), vehicle, self.platform)
        heldout = list(map(_without_angle_commands, self.heldout))
        judged, _ = prepare_all(heldout, vehicle, self.platform) if heldout else ([], ())
        return dataclasses.replace(self, fitted=fitted, judged=judged)


def _without_angle_commands(log: FlightLog) -> FlightLog:
    """Return a log as if its commands of roll and pitch had not been recorded."""
    command = np.array(log.command, float)
    command[:, 1:3] = np.nan
    return dataclasses.replace(log, command=command)


def usable_flights(
    flights: Sequence[FlightLog], heldout: Sequence[FlightLog], vehicle: Vehicle, platform: bool | None
) -> UsableFlights:
    """Return the flights that can be used, and the others, each with the reason why not.

    Both are in the order of their names, whatever order they are given in: bootstrap samples are drawn by
    place, and the answer is to follow from the flights alone.
    platform: the slab of the vehicle file stands in the arena; None: where a log has contacts.
    Copies and parts of a flight count once. Raises UserError when none can be used, of those to fit or of
    those held out, and when a held-out flight is fitted.
    """
    if platform is None:
        platform = any(log.contact is not None and log.contact.any() for log in as_logs(flights))
    to_fit, aside = set_aside(sorted(as_logs(flights), key=_by_name), vehicle, platform)
    to_judge, aside_held_out = set_aside(sorted(as_logs(heldout), key=_by_name), vehicle, platform)
    once = distinct(to_fit, to_judge)
    fitted, notes = prepare_all(once.logs, vehicle, platform)
    judged, notes_held_out = prepare_all(once.heldout, vehicle, platform) if once.heldout else ([], ())
    return UsableFlights(
        logs=once.logs,
        heldout=once.heldout,
        fitted=fitted,
        judged=judged,
        set_aside=(*aside, *aside_held_out, *once.set_aside),
        notes=(*notes, *notes_held_out, *once.notes),
        platform=platform,
    )


def _by_name(log: FlightLog) -> list[str | int]:
    """Return what flights are ordered by: their names, in which numbers count as such (2 before 10)."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", log.name)]


def set_aside(
    logs: Sequence[FlightLog], vehicle: Vehicle, platform: bool
) -> tuple[list[FlightLog], tuple[SetAside, ...]]:
    """Return the flights that can be used, and the others, each with the reason why not.

    platform: the slab of the vehicle file stands in the arena.
    Raises UserError when there are flights and none can be used.
    """
    why = [_why(log, vehicle, platform) for log in logs]
    aside = tuple(SetAside(log.name, reason) for log, reason in zip(logs, why) if reason)
    if aside and len(aside) == len(logs):
        raise UserError(first_of([f"{one.flight}: {one.reason}" for one in aside]))
    return [log for log, reason in zip(logs, why) if not reason], aside


def _why(log: FlightLog, vehicle: Vehicle, platform: bool) -> str:
    """Return why a flight cannot be used, a sentence; empty if it can."""
    if log.thrust_is_measured and (failed := failed_speed_sensors(log)):
        return " ".join(failed.values())
    return _crash(log, vehicle) or _strange_touch(log, vehicle, platform)


def _crash(log: FlightLog, vehicle: Vehicle) -> str:
    """Return where a vehicle turns over or hits something, a sentence; empty where it does neither."""
    step = float(np.median(np.diff(log.t)))
    flown = np.flatnonzero(log.command[:, 0] >= IDLE * vehicle.hover_pwm)
    if not len(flown):
        return ""
    live = slice(int(flown[0]), int(flown[-1]) + 1 + round(AFTER_THRUST / step))
    t, position = log.t[live], log.position[live]
    upright = np.cos(log.attitude[live, 0]) * np.cos(log.attitude[live, 1])  # of the thrust's direction
    over = np.flatnonzero(upright < np.cos(thresholds.TURNED_OVER))  # NaN: not logged
    if len(over) * step >= 0.5 * MOMENT:
        return f"the vehicle turns over {t[over[0]] - log.t[0]:.1f} s into the log."
    rows = max(1, round(MOMENT / step))
    if len(t) > 2 * rows:
        speed = np.linalg.norm(position[rows:] - position[:-rows], axis=1) / (t[rows:] - t[:-rows])
        lost = speed[:-rows] - speed[rows:]
        if np.any(lost > thresholds.CRASH_SPEED):
            k = int(np.nanargmax(lost))
            after = t[k + rows] - log.t[0]
            return f"the vehicle hits something at {speed[k]:.1f} m/s, {after:.1f} s into the log."
    return ""


def _strange_touch(log: FlightLog, vehicle: Vehicle, platform: bool) -> str:
    """Return where a vehicle touches what the model does not have, a sentence; empty where it does not."""
    if log.contact is None:
        return ""
    for k in np.flatnonzero(np.diff(log.contact.astype(int)) == 1) + 1:
        x, y, z = log.position[k]
        away = z
        if platform:
            tilt = vehicle.platform_inclination
            above = (z - vehicle.platform_surface_height) * np.cos(tilt) + x * np.sin(tilt)
            beside = abs(x) - 0.5 * vehicle.platform_width, abs(y) - 0.5 * vehicle.platform_depth
            away = min(away, float(np.linalg.norm(np.maximum([above, *beside], 0.0))))
        if away > thresholds.STRANGE_TOUCH + 2.0 * vehicle.rotor_arm:
            where = "slab and floor" if platform else "the floor"
            after = log.t[k] - log.t[0]
            return f"the vehicle touches something {away:.1f} m from {where}, {after:.1f} s into the log."
    return ""


def poses(log: FlightLog) -> np.ndarray:
    """Return a number (m,) of NUMBER_BITS for the pose of every row, the same for the same pose."""
    turned = np.arctan2(np.sin(log.attitude), np.cos(log.attitude))
    cells = np.round(np.nan_to_num(np.hstack([log.position, turned])) / DIGIT).astype(np.int64)
    hashes = pandas.util.hash_pandas_object(pandas.DataFrame(cells), index=False).to_numpy()  # of 64 bits
    return hashes >> np.uint64(64 - NUMBER_BITS)


def fingerprint(log: FlightLog) -> tuple[int, ...]:
    """Return some of the numbers of a flight's poses, by which it and parts of it are recognised."""
    found = np.unique(poses(log))
    return tuple(map(int, found[found % SAMPLED == 0]))


def check_unused(logs: Iterable[FlightLog], used: Mapping[str, Sequence[int]], where: str) -> None:
    """Raise UserError for a flight among `logs` of which `used` has the fingerprint, by name."""
    for log in logs:
        own = np.array(fingerprint(log), np.int64)
        for name, known in used.items():
            if np.isin(own, known).sum() > max(SAME * min(len(own), len(known)), 1):
                raise UserError(f"{log.name} holds the same flight as {name} {where}; {DIFFERENT}")


class DistinctFlights(NamedTuple):
    """Flights of which no row is also one of an earlier flight."""

    logs: list[FlightLog]
    heldout: list[FlightLog]
    set_aside: tuple[SetAside, ...]  # flights of which nothing new is left
    notes: tuple[str, ...]  # on flights of which a part is left


class _Kept(NamedTuple):
    """The part of a flight that is kept."""

    log: FlightLog
    poses: np.ndarray  # (m,) of its rows: see `poses`
    held_out: bool


def distinct(flights: Sequence[FlightLog], heldout: Sequence[FlightLog]) -> DistinctFlights:
    """Return flights and held-out flights without the rows of an earlier one.

    Raises UserError for a held-out flight that is fitted.
    """
    aside, notes = list[SetAside](), list[str]()
    kept: list[_Kept] = []
    for k, log in enumerate([*flights, *heldout]):
        held_out = k >= len(flights)
        own = _Kept(log, poses(log), held_out)  # less and less of it, as its rows turn up in earlier flights
        for earlier in kept:
            again = np.isin(own.poses, earlier.poses)
            common = len(np.unique(own.poses[again]))
            # Poses may agree by chance. A short flight has most of its poses in common with its copy; a long
            # one need only have a stretch in common that would be long enough to be used.
            if common <= min(SAME * len(np.unique(own.poses)), SHORTEST * own.log.rate):
                continue
            new, name = _lasting(own.log.t, ~again), earlier.log.name
            if held_out and not earlier.held_out and not new.any():
                raise UserError(f"{log.name} holds the same flight as {name}; {DIFFERENT}")
            if not new.any():
                aside.append(SetAside(log.name, f"it is the same flight as {name}."))
                break
            notes.append(
                f"{log.name}: {percent((~new).mean())} of its rows are those of {name}: they count once"
            )
            own = _Kept(own.log.rows(new), own.poses[new], held_out)
        else:
            kept.append(own)
    return DistinctFlights(
        logs=[one.log for one in kept if not one.held_out],
        heldout=[one.log for one in kept if one.held_out],
        set_aside=tuple(aside),
        notes=tuple(notes),
    )


def _lasting(t: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the stretches of `rows` (m,) bool that last long enough to be used."""
    result = np.zeros(len(rows), bool)
    for a, b in np.flatnonzero(np.diff(np.r_[False, rows, False])).reshape(-1, 2):
        result[a:b] = t[b - 1] - t[a] >= SHORTEST
    return result
