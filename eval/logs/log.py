"""The in-memory representation of a measured flight, and of what a check finds about one."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable
from typing import Any

import numpy as np

from inclined_landing.eval.logs.units import REQUESTS, ROTOR_SPEEDS
from inclined_landing.models.base.errors import UserError, shown

# Arrays of a `FlightLog` with a value per row, and the canonical names of their columns; (m,) if it is one.
FIELDS = {
    "t": ("t",),
    "position": ("x", "y", "z"),
    "attitude": ("roll", "pitch", "yaw"),
    "command": ("cmd_thrust_pwm", "cmd_roll", "cmd_pitch", "cmd_yaw_rate"),
    "voltage": ("vbat",),
    "contact": ("contact",),
    "requests": REQUESTS,
    "rotor_speed": ROTOR_SPEEDS,
}
MEASURED, COMMANDS = FIELDS["position"] + FIELDS["attitude"], FIELDS["command"]
_HELD = ("command", "contact", "requests")

# A gap in the record is a step in time this many times the usual one, and longer than the first time (s). A
# step beyond the second time is a gap however seldom a quantity was logged.
GAP_STEPS = 5.0
GAP_SECONDS = 0.1
ALWAYS_GAP = 0.5
VOLTAGE_BRIDGED = 1.5  # s, of the battery's voltage, which changes slowly
MOTORS_OFF = 10_000.0  # PWM


def longest_bridged(t: np.ndarray) -> float:
    """Return the longest step (s) of a record with rows at t (m,) that is not a gap.

    Measurements are interpolated, and commands held, over at most this time.
    """
    step = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    return min(max(GAP_SECONDS, GAP_STEPS * step), ALWAYS_GAP)


def runs(mask: np.ndarray) -> np.ndarray:
    """Return the first row and the row after the last of every stretch (k, 2) in which a mask is true."""
    return np.flatnonzero(np.diff(np.r_[False, mask, False])).reshape(-1, 2)


@dataclasses.dataclass(frozen=True)
class FlightLog:
    """Pose, commands and, where logged, battery voltage and contact of one flight.

    Attitude is roll, pitch, yaw of R = Rz(yaw) Rx(roll) Ry(pitch): positive pitch tilts the thrust
    towards +x, positive roll towards -y. Yaw is continuous (no jumps of 2 pi). A column that was not
    logged is NaN throughout; a column that was logged has no NaN.

    Raises UserError if shapes disagree or time does not increase strictly.
    """

    name: str
    t: np.ndarray  # (m,) s, strictly increasing
    position: np.ndarray  # (m, 3) m
    attitude: np.ndarray  # (m, 3) rad: roll, pitch, yaw
    # (m, 4): PWM, roll rad, pitch rad, yaw rate rad/s, as sent at t, held until the next row
    command: np.ndarray
    voltage: np.ndarray | None = None  # (m,) V
    contact: np.ndarray | None = None  # (m,) bool
    # (m, 4) PWM that the controller asked of motors M1 to M4, before battery compensation
    requests: np.ndarray | None = None
    rotor_speed: np.ndarray | None = None  # (m, 4) rad/s of rotors M1 to M4, as measured
    # Whether the thrust command is that of the measured rotor speeds, which lag behind no command.
    thrust_is_measured: bool = False
    from_quaternion: bool = False  # whether the attitude was logged as a quaternion
    notes: tuple[str, ...] = ()  # notes of reader and checks for the user

    def __post_init__(self):
        m = len(self.t)
        for field, names in FIELDS.items():
            value, shape = getattr(self, field), (m,) if len(names) == 1 else (m, len(names))
            if value is None:
                continue
            value = np.asarray(value, bool if field == "contact" else float)
            if value.shape != shape:
                raise UserError(f"{self.name}: {field} has shape {value.shape}, expected {shape}")
            object.__setattr__(self, field, value)
        if m < 2:
            raise UserError(f"{self.name}: {m} rows; a flight needs at least two")
        if not np.all(np.diff(self.t) > 0):
            row = int(np.argmin(np.diff(self.t) > 0)) + 1
            raise UserError(f"{self.name}: time does not increase at row {row} (t = {self.t[row]:g} s)")

    def __len__(self) -> int:
        return len(self.t)

    @property
    def duration(self) -> float:
        """Seconds from the first row to the last."""
        return float(self.t[-1] - self.t[0])

    @property
    def rate(self) -> float:
        """Typical rows per second: one over the median time step."""
        return float(1.0 / np.median(np.diff(self.t)))

    def columns(self) -> dict[str, np.ndarray]:
        """Return the columns (m,) by their canonical names, without optional ones that were not logged."""
        return {
            name: column
            for field, names in FIELDS.items()
            if (value := getattr(self, field)) is not None
            for name, column in zip(names, value.reshape(len(self), -1).T)
        }

    @property
    def missing(self) -> tuple[str, ...]:
        """Names of the columns of pose and command that were not logged."""
        columns = self.columns()
        return tuple(name for name in MEASURED + COMMANDS if np.isnan(columns[name]).any())

    @property
    def gap_starts(self) -> np.ndarray:
        """Rows (k,) after which the record has a gap."""
        return np.flatnonzero(np.diff(self.t) > longest_bridged(self.t))

    def rows(self, selection) -> FlightLog:
        """Return the rows of a slice, an index array or a mask."""
        changed = {f: getattr(self, f)[selection] for f in FIELDS if getattr(self, f) is not None}
        return dataclasses.replace(self, **changed)

    def pieces(self, shortest: float = 0.0) -> tuple[FlightLog, ...]:
        """Return the stretches between gaps that last at least `shortest` seconds and two rows."""
        ends = [0, *(self.gap_starts + 1), len(self)]
        return tuple(
            self.rows(slice(a, b))
            for a, b in itertools.pairwise(ends)
            if b - a >= 2 and self.t[b - 1] - self.t[a] >= shortest
        )

    def resampled(self, rate: float) -> FlightLog:
        """Return the flight on an even grid of `rate` rows per second from the first row on.

        Measurements are interpolated linearly, commands and contact held. Gaps are bridged like any other
        step; if that matters, use `pieces` first.
        """
        t = self.t[0] + np.arange(int(np.floor(self.duration * rate + 1e-6)) + 1) / rate
        t[-1] = min(t[-1], self.t[-1])
        latest = np.clip(np.searchsorted(self.t, t + 1e-9, side="right") - 1, 0, len(self) - 1)

        changed = {"t": t}
        for field in FIELDS:
            value = getattr(self, field)
            if field in _HELD and value is not None:
                changed[field] = value[latest]
            elif field != "t" and value is not None:
                # x(t) = x_k + (t - t_k) / (t_k+1 - t_k) (x_k+1 - x_k)
                columns = [np.interp(t, self.t, column) for column in value.reshape(len(self), -1).T]
                changed[field] = np.stack(columns, axis=1).reshape(len(t), *value.shape[1:])
        return dataclasses.replace(self, **changed)

    def noted(self, *notes: str) -> FlightLog:
        """Return the same flight with more notes, without duplicates."""
        new = tuple(note for note in dict.fromkeys(notes) if note not in self.notes)
        return dataclasses.replace(self, notes=self.notes + new)


@dataclasses.dataclass(frozen=True)
class Finding:
    """The result of one check.

    decision: "refuse" (the flight cannot be used), "limit" (it is used, and this is noted) or "info".
    channel: the column or columns concerned.
    text: a sentence for the user.
    without: the optional field of the log ("voltage") that is therefore omitted.
    rows: the rows that are therefore omitted.
    """

    decision: str
    channel: str
    text: str
    without: str | None = None
    rows: tuple[int, ...] = ()


def refuse(channel: str, text: str) -> Finding:
    """Return a finding that the flight cannot be used."""
    return Finding("refuse", channel, text)


def limit(channel: str, text: str, *, without: str | None = None, rows: tuple[int, ...] = ()) -> Finding:
    """Return a finding that the flight is used with this limitation."""
    return Finding("limit", channel, text, without, rows)


def info(channel: str, text: str) -> Finding:
    """Return a finding that has no consequence."""
    return Finding("info", channel, text)


def as_logs(flights: object) -> list[FlightLog]:
    """Return flights as a list; raises UserError unless all are `FlightLog`s."""
    found: list[Any] = (
        list(flights) if isinstance(flights, Iterable) and not isinstance(flights, str) else [flights]
    )
    for one in found:
        if not isinstance(one, FlightLog):
            raise UserError(
                f"flights must be FlightLogs, as read_log returns them, not {shown(repr(one), 40)}"
            )
    return found
