"""The flights of a command: read, checked, and those that can be used cut into windows.

Nothing is computed with crashes, touches of what no model has, and failed sensors: they are set aside by
name.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.flights.distinct import DIFFERENT, check_unused, distinct, fingerprint
from inclined_landing.eval.gap.flights.windows import IDLE, MeasuredFlight, prepare_all
from inclined_landing.eval.gap.result import SetAside
from inclined_landing.eval.logs import FlightLog, read_log
from inclined_landing.eval.logs.checks import check_fleet
from inclined_landing.eval.logs.log import as_logs
from inclined_landing.eval.logs.values import failed_speed_sensors
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError, first_of, shown
from inclined_landing.models.vehicle import Vehicle

MOMENT = 0.1  # s: a vehicle that hits something stops within
AFTER_THRUST = 1.0  # s after the last commanded thrust in which a vehicle may still fall over


@dataclasses.dataclass(frozen=True)
class ReadFlights:
    """The flights of a command."""

    logs: list[FlightLog]  # to fit
    heldout: list[FlightLog]
    reference: list[FlightLog]  # of the vehicle before, to identify it
    notes: tuple[str, ...]  # on limits that the flights of a group have in common


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
        unknown = [1.0, np.nan, np.nan, 1.0]
        logs, heldout = (
            [dataclasses.replace(log, command=log.command * unknown) for log in some]
            for some in (self.logs, self.heldout)
        )
        fitted, _ = prepare_all(logs, vehicle, self.platform)
        judged, _ = prepare_all(heldout, vehicle, self.platform) if heldout else ([], ())
        return dataclasses.replace(self, fitted=fitted, judged=judged)


def usable_flights(
    flights: Sequence[FlightLog], heldout: Sequence[FlightLog], vehicle: Vehicle, platform: bool | None
) -> UsableFlights:
    """Return the flights that can be used, and the others, each with the reason why not.

    platform: the slab of the vehicle file stands in the arena; None: where a log has contacts.
    Copies and parts of a flight count once. Raises UserError when none can be used, of those to fit or of
    those held out, and when a held-out flight is fitted.
    """
    if platform is None:
        platform = any(log.contact is not None and log.contact.any() for log in as_logs(flights))
    logs, aside = set_aside(as_logs(flights), vehicle, platform)
    kept, kept_aside = set_aside(as_logs(heldout), vehicle, platform)
    logs, kept, copies, shared = distinct(logs, kept)
    fitted, notes = prepare_all(logs, vehicle, platform)
    judged, kept_notes = prepare_all(kept, vehicle, platform) if kept else ([], ())
    notes, left_out = (*notes, *kept_notes, *shared), (*aside, *kept_aside, *copies)
    return UsableFlights(logs, kept, fitted, judged, left_out, notes, platform)


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
    """Return how far from every surface of the model a vehicle touches something; empty where it is none."""
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
