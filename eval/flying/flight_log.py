"""The log of a flight: the documented CSV of eval/logs, written continuously and renamed at the end.

Each row is a position from motion capture. The vehicle's attitude is interpolated to its time; commands and
voltage are the last ones sent and received, held for as long as the reader bridges gaps, except that stopped
motors stay stopped. During gaps of the motion capture, commands have rows without a position. Until it is
finished the file is called NAME.unfinished.csv, so that a killed process leaves a usable log.
"""

from __future__ import annotations

import collections
import contextlib
import csv
import itertools
import math
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from inclined_landing.eval.flying import frames
from inclined_landing.eval.logs.log import GAP_SECONDS, VOLTAGE_BRIDGED
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError

COLUMNS = (
    *("t", "x", "y", "z", "roll", "pitch", "yaw"),
    *("cmd_thrust_pwm", "cmd_roll", "cmd_pitch", "cmd_yaw_rate", "vbat", "contact"),
)
_COMMANDS = ("cmd_thrust_pwm", "cmd_roll", "cmd_pitch", "cmd_yaw_rate")
REORDER_WINDOW = 0.5  # s that a measurement may come after a later one: rows are in order of their times


class FlightLogWriter:
    """Writer of the log at `path`; a context, in which `begin` starts it. A log that never begins is removed.

    Raises UserError if the file already exists, and if it cannot be written: once, and again from `finish`.
    Data added in between are ignored.
    """

    def __init__(self, path: Path):
        self.path = Path(path)
        self.unfinished = self.path.with_suffix(".unfinished.csv")
        self._start, self.begun = math.nan, False
        self._error: UserError | None = None
        kinds = ("pose", "attitude", "voltage", "command")
        self._tracks: dict[str, collections.deque] = {kind: collections.deque() for kind in kinds}
        self._newest = self._written = self._posed = -math.inf
        for file in (self.path, self.unfinished):
            if os.path.lexists(file):
                raise UserError(f"the log {file} already exists; choose another folder")
        storage.check_file(self.path)
        with self._told():
            self._file = self.unfinished.open("x", newline="", encoding="utf-8", buffering=1)
            self._rows = csv.DictWriter(self._file, COLUMNS)
            self._rows.writeheader()

    def __enter__(self) -> FlightLogWriter:
        return self

    def __exit__(self, *_) -> None:
        self.finish()

    def begin(self, start: float) -> None:
        """Begin the log at `start` [s of the pilot's clock]."""
        self._start, self.begun = start, True

    def pose(self, time: float, position: np.ndarray, contact: bool) -> None:
        """Add a position (3,) [m] of motion capture, and whether the vehicle is in contact."""
        if np.isfinite(position).all():
            self._note("pose", time, (*map(float, position), float(contact)))

    def attitude(self, time: float, roll: float, pitch: float, yaw: float) -> None:
        """Add the vehicle's attitude [rad], R = Rz(yaw) Rx(roll) Ry(pitch)."""
        self._note("attitude", time, (roll, pitch, yaw))

    def voltage(self, time: float, voltage: float) -> None:
        """Add the battery voltage [V]."""
        self._note("voltage", time, (voltage,))

    def command(self, time: float, command: np.ndarray) -> None:
        """Add a command as sent: PWM, roll, pitch [rad], yaw rate [rad/s]."""
        self._note("command", time, tuple(map(float, command)))

    def finish(self) -> None:
        """Write the remaining rows and give the file its final name; does nothing the second time."""
        if self._file.closed:
            return
        if not self.begun:
            self._file.close()
            self.unfinished.unlink(missing_ok=True)
            return
        if self._error is not None:
            with contextlib.suppress(OSError):
                self._file.close()
            raise self._error
        with self._told(), contextlib.closing(self._file):
            self._write(math.inf)
            self._file.flush()
            os.fsync(self._file.fileno())
            os.replace(self.unfinished, self.path)

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        """Raise UserError, naming the file, if it cannot be written."""
        try:
            yield
        except OSError as error:
            self._error = UserError(f"cannot write {self.unfinished}: {storage.reason(error)}")
            raise self._error from error

    def _note(self, kind: str, time: float, values: tuple[float, ...]) -> None:
        t = round(time - self._start, 6)
        track = self._tracks[kind]
        finite = all(map(math.isfinite, (t, *values)))
        if self._error is not None or not finite or (track and t <= track[-1][0]):
            return
        track.append((t, values))
        self._newest = max(self._newest, t)
        with self._told():
            self._write(self._newest - REORDER_WINDOW)

    def _write(self, until: float) -> None:
        """Write the rows up to `until`, and discard data that no later row needs."""
        tracks = self._tracks
        if self._written == -math.inf and tracks["command"]:
            # The log begins with the first command.
            self._written = self._posed = tracks["command"][0][0] - 1e-6
        poses = [(t, True) for t, _ in tracks["pose"] if self._written < t <= until]
        commands = [(t, False) for t, _ in tracks["command"] if self._written < t <= until]
        last = max([*poses, *commands], default=None) if until == math.inf else None
        for t, seen in sorted(poses + commands):
            if not seen and t - self._posed < GAP_SECONDS and (t, seen) != last:
                continue  # the next pose's row shows it
            self._rows.writerow({"t": f"{t:.6f}"} | self._cells(t, seen))
            self._written = t
            self._posed = t if seen else self._posed
        for track in tracks.values():
            while len(track) > 1 and track[1][0] <= min(until, self._written):
                track.popleft()

    def _cells(self, t: float, seen: bool) -> dict[str, str]:
        """Return the cells of the row at t: measured at that time, or held."""
        cells: dict[str, float] = {}
        if seen:
            position = next(values for time, values in self._tracks["pose"] if time == t)
            cells |= dict(zip(("x", "y", "z", "contact"), position))
        angles = self._between("attitude", t)
        if angles is not None:
            cells |= dict(zip(("roll", "pitch", "yaw"), angles))
        for kind, names, longest in (
            ("command", _COMMANDS, GAP_SECONDS),
            ("voltage", ("vbat",), VOLTAGE_BRIDGED),
        ):
            before = [(time, values) for time, values in self._tracks[kind] if time <= t]
            stopped = kind == "command" and before and before[-1][1][0] == 0.0  # motors stay off
            if before and (stopped or t - before[-1][0] <= longest):
                cells |= dict(zip(names, before[-1][1]))
        return {name: f"{value:.10g}" for name, value in cells.items()}

    def _between(self, kind: str, t: float) -> tuple[float, ...] | None:
        """Return a track interpolated at t, between neighbours at most GAP_SECONDS apart."""
        for (t0, a), (t1, b) in itertools.pairwise(self._tracks[kind]):
            if t0 <= t <= t1 and t1 - t0 <= GAP_SECONDS:
                share = (t - t0) / (t1 - t0)  # a + share (b - a), the short way round
                return tuple(frames.wrapped(x + share * frames.wrapped(y - x)) for x, y in zip(a, b))
        return None
