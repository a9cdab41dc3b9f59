"""The log of a flight: the documented CSV of eval/logs, written as it goes and named when it is finished.

Every measurement and every command is a row of its own time; cells of what was not measured then are empty,
as the format allows. Until it is finished the file is called NAME.unfinished.csv: what a killed process
leaves is a log too.
"""

from __future__ import annotations

import contextlib
import csv
import math
import os
from pathlib import Path

import numpy as np

from inclined_landing.models import storage
from inclined_landing.models.errors import UserError

COLUMNS = (
    *("t", "x", "y", "z", "roll", "pitch", "yaw"),
    *("cmd_thrust_pwm", "cmd_roll", "cmd_pitch", "cmd_yaw_rate", "vbat", "contact"),
)
LATEST = 0.5  # s that a row may come after one of a later time: rows are written in order of their times


class FlightLog:
    """A log at `path` that begins at `start` [s of the pilot's clock]; use as a context.

    Raises UserError where the file is there already or cannot be written.
    """

    def __init__(self, path: Path, start: float):
        self.path = Path(path)
        self.unfinished = self.path.with_suffix(".unfinished.csv")
        self._start = start
        self._waiting: dict[float, dict[str, float | None]] = {}
        self._written = -math.inf
        for file in (self.path, self.unfinished):
            if os.path.lexists(file):
                raise UserError(f"the log {file} is there already; choose another folder")
        storage.check_file(self.path)
        try:
            self._file = self.unfinished.open("x", newline="", encoding="utf-8", buffering=1)
        except OSError as error:
            raise UserError(f"cannot write {self.unfinished}: {storage.reason(error)}") from error
        self._rows = csv.DictWriter(self._file, COLUMNS)
        self._rows.writeheader()

    def __enter__(self) -> FlightLog:
        return self

    def __exit__(self, *_) -> None:
        self.finish()

    def pose(self, time: float, position: np.ndarray, contact: bool) -> None:
        """A position (3,) [m] of motion capture, and whether the vehicle stands on something."""
        if np.isfinite(position).all():
            self._add(time, dict(zip("xyz", map(float, position))) | {"contact": float(contact)})

    def attitude(self, time: float, roll: float, pitch: float, yaw: float) -> None:
        """The vehicle's attitude [rad], the house's angles."""
        self._add(time, {"roll": roll, "pitch": pitch, "yaw": yaw})

    def voltage(self, time: float, voltage: float) -> None:
        """The battery's [V]."""
        self._add(time, {"vbat": voltage})

    def command(self, time: float, command: np.ndarray) -> None:
        """What was sent: PWM, roll, pitch [rad], yaw rate [rad/s]."""
        names = ("cmd_thrust_pwm", "cmd_roll", "cmd_pitch", "cmd_yaw_rate")
        self._add(time, dict(zip(names, map(float, command))))

    def finish(self) -> None:
        """Write what waits, and give the file its name; again, nothing."""
        if self._file.closed:
            return
        with contextlib.closing(self._file):
            self._write(math.inf)
            self._file.flush()
            os.fsync(self._file.fileno())
        os.replace(self.unfinished, self.path)

    def _add(self, time: float, cells: dict[str, float]) -> None:
        t = round(time - self._start, 6)
        if not all(map(math.isfinite, (t, *cells.values()))) or t <= self._written:
            return
        self._waiting.setdefault(t, {}).update(cells)
        self._write(t - LATEST)

    def _write(self, until: float) -> None:
        for t in sorted(t for t in self._waiting if t <= until):
            cells = self._waiting.pop(t)
            words = {name: f"{value:.10g}" for name, value in cells.items()}
            if "contact" in words:
                words["contact"] = f"{cells['contact']:.0f}"
            self._rows.writerow({"t": f"{t:.6f}", **words})
            self._written = t
