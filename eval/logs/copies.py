"""Detection of one signal under two names: a set-point as a measurement, or a motor logged as another.

A measurement never equals its command to the last digit, and two motors never have the same command, except
in flights about one axis, in which pairs of motors are equal.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Mapping

import numpy as np

from inclined_landing.eval.logs.channels import Channel
from inclined_landing.eval.logs.log import MEASURED, Finding, FlightLog, refuse
from inclined_landing.eval.logs.record import Record
from inclined_landing.eval.logs.repeats import percent
from inclined_landing.eval.logs.units import COMMANDED_QUATERNION, QUATERNION, REQUESTS, ROTOR_SPEEDS
from inclined_landing.models.base.errors import UserError, shown

SAME = 0.9  # share of the changes after which two columns are equal
FEWEST = 20  # changes, to tell
_COMMANDED = ("cmd_roll", "cmd_pitch", "cmd_yaw", *COMMANDED_QUATERNION)
_SET_POINT = re.compile(
    r"(?:^|[^a-z])(?:cmd|command(?:ed)?|set_?points?|sp|des(?:ired)?|ref(?:erence)?|(?:ctrl)?target|goal)(?:[^a-z]|$)"
)


def same_share(a: np.ndarray, b: np.ndarray) -> float:
    """Return the share of changes after which two columns (m,) are equal up to the sign; 0 for few."""
    known = np.isfinite(a) & np.isfinite(b)
    a, b = np.abs(a[known]), np.abs(b[known])
    changes = (np.diff(a) != 0.0) | (np.diff(b) != 0.0)
    if changes.sum() < FEWEST:
        return 0.0
    return float(np.isclose(a[1:], b[1:], rtol=1e-6, atol=1e-9)[changes].mean())


def check_columns(record: Record, channels: Mapping[str, Channel]) -> None:
    """Raise UserError for a measurement that equals a set-point in another column of its file.

    channels: those of the record, by canonical name. A column is a set-point if a command is read from it or
    its name says so.
    """
    commands = {channels[key].column for key in _COMMANDED if key in channels}
    set_points = commands | {name for name in record.columns if _SET_POINT.search(name.lower())}
    for key in MEASURED + QUATERNION:
        if key not in channels or channels[key].column not in record.columns:
            continue
        name = channels[key].column
        if name in commands:
            raise UserError(
                f"{record.path}: column {shown(name)} is read as {key} and as a command; it cannot be both"
            )
        for other in sorted(set_points & record.columns.keys() - {name}):
            if record.times and not np.array_equal(record.times[name], record.times[other]):
                continue
            share = same_share(record.columns[name], record.columns[other])
            if share > SAME:
                raise UserError(f"{record.path}: {_sentence(name, other, share)}")


def check(log: FlightLog) -> Iterator[Finding]:
    """Yield findings about angles that equal their commands, and motors that equal one another."""
    for (name, angle), (command, sent) in itertools.product(
        zip(("roll", "pitch"), log.attitude.T), zip(("cmd_roll", "cmd_pitch"), log.command.T[1:3])
    ):
        share = same_share(angle, sent)
        if share > SAME:
            yield refuse(f"{name}, {command}", _sentence(name, command, share))
    for names, values in ((REQUESTS, log.requests), (ROTOR_SPEEDS, log.rotor_speed)):
        if values is None:
            continue
        pairs = itertools.combinations(range(4), 2)
        equal = {(i, j): share for i, j in pairs if (share := same_share(values[:, i], values[:, j])) > SAME}
        if len(equal) == 2 and len({motor for pair in equal for motor in pair}) == 4:
            continue  # a flight of one axis
        for (i, j), share in equal.items():
            yield refuse(f"{names[i]}, {names[j]}", _sentence(names[i], names[j], share))


def _sentence(one: str, other: str, share: float) -> str:
    return (
        f"columns {shown(one)} and {shown(other)} hold the same numbers in {percent(share)} of the rows "
        "in which they change: one of them is not what it is called"
    )
