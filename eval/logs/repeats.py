"""Repeated values: measurements that a logger writes repeatedly, and placeholders for missing ones.

Many loggers write the last known value into every row, or zeros before there is one. A quantity that is
measured less often than it is written repeats for one of its own steps. A value that stays longer, to the
last digit, and then jumps by more than the resolution is a placeholder for missing measurements.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping

import numpy as np

from inclined_landing.eval.logs.channels import Channel
from inclined_landing.eval.logs.log import (
    FIELDS,
    GAP_SECONDS,
    MOTORS_OFF,
    VOLTAGE_BRIDGED,
    longest_bridged,
    runs,
)
from inclined_landing.eval.logs.units import QUATERNION, ROTOR_SPEEDS

REWRITTEN = 0.2  # share of repeats in motion above which a quantity was measured less often than written
# m or rad, by which a pose in motion changes within AHEAD (s); that of a vehicle that stands never does.
MOVES, AHEAD = 0.02, 0.1
RESOLUTION = 0.01  # quantile of the changes of a quantity: one digit of it, if it is rounded
ONE_DIGIT = 2.5  # resolutions by which a rounded value at rest changes at most
BEFORE = 10  # changes before a value that stays to the end
DEPARTS = 5  # changes after a value that stays: of noise, one way and ever larger in one case of 40 000
_POSITION = FIELDS["position"]


def without_repeats(
    channels: Mapping[str, Channel], attitude: tuple[str, ...], notes: list[str], *, as_one: bool
) -> dict[str, Channel]:
    """Return the channels without placeholders, and without repeats of a pose that was written too often.

    attitude: names of its channels. as_one: whether these are one measurement, whose numbers can only be
    missing together. Columns and shares of the omitted values are noted.
    """
    thrust = channels["cmd_thrust_pwm"]
    groups = [_POSITION, attitude, *((key,) for key in (*ROTOR_SPEEDS, "vbat"))]
    groups += [("cmd_thrust_pwm",)] * thrust.measured
    result, columns = dict[str, Channel](), dict[str, list[str]]()
    for group in groups:
        parts = {key: channels[key] for key in group if key in channels}
        for t in _clocks(parts.values()):
            together = {key: part for key, part in parts.items() if np.array_equal(part.t, t)}
            value = np.stack([part.value for part in together.values()], axis=1)
            last = np.maximum(np.searchsorted(thrust.t, t, side="right") - 1, 0)
            flown = ~(thrust.value[last] <= MOTORS_OFF)
            held = _held(together, value, flown, as_one and group == attitude)
            kept = ~held
            if group in (_POSITION, attitude) and len(together) == len(parts):
                measured, share = measured_rows(t, value, held.any(axis=1))
                if share > REWRITTEN:
                    kept &= measured[:, None]
                    notes.append(
                        f"{'position' if group == _POSITION else 'attitude'} repeats its last value in "
                        f"{percent(share)} of the rows in motion: it was measured less often than written, "
                        "and only new values are used"
                    )
            for (key, part), rows, none in zip(together.items(), kept.T, held.T):
                if none.any():
                    name = key if key == part.column else f"{part.column} ({key})"
                    start, stop = runs(none).T
                    extent = f"{(t[stop - 1] - t[start]).max():.2g} s, in {percent(none.mean())} of the rows"
                    columns.setdefault(extent, []).append(name)
                if not rows.all():
                    result[key] = dataclasses.replace(part, t=t[rows], value=part.value[rows])
    notes += [
        f"{', '.join(names)} keep{'s' * (len(names) == 1)} one value to the last digit for up to {extent}, "
        "while the vehicle moves: not measured there, and left out"
        for extent, names in columns.items()
    ]
    return result


def _held(parts: Mapping[str, Channel], value: np.ndarray, flown: np.ndarray, as_one: bool) -> np.ndarray:
    """Return a mask of the values (m, k) of channels with the same clock that are placeholders.

    flown: (m,) rows with the motors on. as_one: whether the channels are one measurement.
    """
    t = next(iter(parts.values())).t
    longest = VOLTAGE_BRIDGED if "vbat" in parts else longest_bridged(t[repeat_starts(value)])
    moves = np.inf if parts.keys().isdisjoint((*_POSITION, *QUATERNION, "roll", "pitch", "yaw")) else MOVES
    wraps = np.array([part.wraps for part in parts.values()])
    if as_one:
        held = np.tile(placeholders(t, value, flown, longest, moves, wraps)[:, None], value.shape[1])
    else:
        each = np.split(value, value.shape[1], axis=1)
        held = [placeholders(t, one, flown, longest, moves, wrap) for one, wrap in zip(each, wraps)]
        held = np.stack(held, axis=1)
    if "vbat" in parts and value.any():  # whatever writes a log has a battery
        held |= value == 0.0
    return held


def percent(share: float) -> str:
    """Return a share as text, never as 0 %."""
    return f"{100 * share:.0f} %" if share >= 0.01 else f"{100 * share:.1g} %"


def _clocks(parts: Iterable[Channel]) -> list[np.ndarray]:
    """Return the times (m,) of some channels, only once if several share them."""
    clocks: list[np.ndarray] = []
    for part in parts:
        if len(part.t) > 1 and not any(np.array_equal(part.t, t) for t in clocks):
            clocks.append(part.t)
    return clocks


def repeat_starts(value: np.ndarray) -> np.ndarray:
    """Return the rows (n,) at which any column of `value` (m, k) differs from the row before."""
    return np.flatnonzero(np.r_[True, (np.diff(value, axis=0) != 0.0).any(axis=1)])


def placeholders(
    t: np.ndarray, value: np.ndarray, flown: np.ndarray, longest: float, moves: float, wraps: np.ndarray
) -> np.ndarray:
    """Return the rows (m,) in which a measurement of one or several numbers is a placeholder.

    t: (m,). value: (m, k). flown: (m,) rows with the motors on. longest: time [s] for which a measurement may
    repeat. moves: change that never occurs while the vehicle is at rest. wraps: (k,) whether it is modulo a
    turn.
    """
    found = np.zeros(len(t), bool)
    start = repeat_starts(value)
    if len(start) < 2:  # it never changes: there is nothing to compare with
        return found
    stop = np.append(start[1:], len(t))
    lasting = np.flatnonzero(t[stop - 1] - t[start] > longest)
    if not len(lasting):
        return found
    level = value[start]
    step = np.diff(level, axis=0)
    step = np.where(wraps, (step + np.pi) % (2.0 * np.pi) - np.pi, step)
    for k, resolution in zip(lasting, _resolutions(level, step, lasting)):
        rows = slice(start[k], stop[k])
        in_flight = flown[rows].mean() > 0.5
        if k == len(step):  # the last value: a number that is not rounded changed with every measurement
            usual = np.median(np.abs(step[-BEFORE:]).max(axis=1))
            found[rows] = in_flight and usual > ONE_DIGIT * resolution
            continue
        jump = np.abs(step[k]).max()
        if in_flight:
            found[rows] = jump > ONE_DIGIT * resolution and not _departs(step[k : k + DEPARTS])
        else:
            found[rows] = jump > moves
    return found


def _departs(step: np.ndarray) -> bool:
    """Return whether changes (DEPARTS, k) are those of a vehicle that starts to move, ever faster."""
    one = step[:, np.argmax(np.abs(step[0]))]
    return len(one) == DEPARTS and len(set(np.sign(one))) == 1 and bool((np.diff(np.abs(one)) >= 0.0).all())


def _resolutions(level: np.ndarray, step: np.ndarray, lasting: np.ndarray) -> np.ndarray:
    """Return the resolution of a measurement at some of its successive values level[lasting], (n, k).

    step: (n - 1, k) from one value to the next.
    """
    # The resolution of floating-point numbers grows with them: compared are those at least half as large.
    size, near = np.abs(step).max(axis=1), np.r_[lasting, lasting - 1]
    usual = np.ones(len(size), bool)
    usual[near[(near >= 0) & (near < len(size))]] = False
    usual = usual if usual.any() else ~usual
    largest = np.abs(level).max(axis=1)
    power = np.where(largest > 0.0, np.frexp(largest)[1], np.iinfo(np.int32).min)
    larger = np.maximum(power[1:], power[:-1])
    result = np.empty(len(lasting))
    for p in np.unique(power[lasting]):
        alike = usual & (larger + 1 >= p)
        result[power[lasting] == p] = np.quantile(size[alike if alike.any() else usual], RESOLUTION)
    return result


def measured_rows(t: np.ndarray, value: np.ndarray, held: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the rows (m,) in which a pose was measured again, and the share of repeats in motion.

    For a vehicle at rest, rows half a gap apart count as measured.
    t: (m,). value: (m, k). held: (m,) rows with placeholders.
    """
    start = repeat_starts(value)
    new = np.zeros(len(t), bool)
    new[start] = True
    ahead = max(10, round(AHEAD / float(np.median(np.diff(t)))))
    if len(t) <= 2 * ahead:
        return new, 0.0
    moving = np.abs(value[ahead:] - value[:-ahead]).max(axis=1) > MOVES
    moving &= ~held[:-ahead]
    share = float((moving & ~new[1 : len(moving) + 1]).sum() / max(moving.sum(), 1))
    longest = longest_bridged(t[start])
    stop = np.append(start[1:], len(t))
    long = t[np.minimum(stop, len(t) - 1)] - t[start] > longest
    for a, b in zip(start[long], stop[long]):
        new[a:b] |= np.diff((t[a:b] - t[a]) // (0.5 * GAP_SECONDS), prepend=0.0) > 0.0
    return new, share
