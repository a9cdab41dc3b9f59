"""Assembly of channels, each with its own clock, to one FlightLog on the clock of the position."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterator, Mapping

import numpy as np
from scipy.ndimage import median_filter
from scipy.spatial.transform import Rotation

from inclined_landing.eval.logs.channels import Channel
from inclined_landing.eval.logs.limits import LARGEST_VALUE
from inclined_landing.eval.logs.log import COMMANDS, FIELDS, VOLTAGE_BRIDGED, FlightLog, longest_bridged
from inclined_landing.eval.logs.repeats import percent, without_repeats
from inclined_landing.eval.logs.units import COMMANDED_QUATERNION, QUATERNION
from inclined_landing.models.base.errors import UserError, shown

_POSITION, _EULER = FIELDS["position"], FIELDS["attitude"]
_COMMANDED_TILT = ("cmd_roll", "cmd_pitch")
# What no flight exceeds, in SI units. A column beyond that throughout has another unit, which the checks say;
# a few values that are beyond alone were not measured.
_PLAUSIBLE = {
    **dict.fromkeys(_POSITION, (-200.0, 200.0)),
    **dict.fromkeys(("roll", "pitch"), (-np.pi - 0.01, np.pi + 0.01)),
    **dict.fromkeys(("cmd_roll", "cmd_pitch"), (-np.pi / 2, np.pi / 2)),
    "yaw": (-100.0, 100.0),
    **dict.fromkeys((*QUATERNION, *COMMANDED_QUATERNION), (-1.1, 1.1)),
    "cmd_thrust_pwm": (-0.5, 65535.5),
    "cmd_yaw_rate": (-15.0, 15.0),
    "vbat": (-1.0, 100.0),
}
_OUTLIER_SHARE = 0.005  # of the rows


def assemble(
    name: str, path: str, channels: Mapping[str, Channel], euler: str, notes: list[str]
) -> FlightLog:
    """Return one flight from its channels.

    Rows are at the times of x. Placeholders are omitted. Other measurements are interpolated between
    neighbours at most `longest_bridged` apart, commands and contact are held for the same time; other rows
    are dropped. All changes are noted. euler: convention of the angles, "ZXY" or "ZYX".

    Raises UserError if position, attitude or thrust command are missing.
    """
    notes = list(notes)
    for key in _EULER[:2] + _COMMANDED_TILT:
        if key in channels:
            channels = {**channels, key: _without_turns(key, channels[key], notes)}
    channels = {key: _clean(path, key, channel, notes) for key, channel in channels.items()}
    quaternion = all(key in channels for key in QUATERNION)
    if quaternion:
        channels |= _rotations(path, channels, QUATERNION, notes)
    if all(key in channels for key in COMMANDED_QUATERNION):
        channels |= _rotations(path, channels, COMMANDED_QUATERNION, notes)
        channels |= _commanded_angles(channels, euler)
    _require_columns(path, channels, quaternion)
    for key in ("roll", "pitch", "yaw", "cmd_roll", "cmd_pitch"):
        if key in channels:
            _check_angle(path, key, channels[key])

    turning = QUATERNION if quaternion else _EULER
    channels |= without_repeats(channels, turning, notes, as_one=quaternion)
    t = channels["x"].t
    pose, near = _at(t, channels, (*_POSITION, *turning), _interpolate)
    commands, started = _at(t, channels, (*COMMANDS, "contact"), _hold)
    complete = near & started
    if complete.sum() < 2:
        why = f" ({notes[-1]})" if notes else ""
        raise UserError(f"{path}: pose and commands are never logged at the same time{why}")
    notes += _describe_rows(channels, t, complete)
    optional = _optional(t[complete], channels, notes)
    if "contact" in commands:
        optional["contact"] = commands["contact"][complete] > 0.5
    if "cmd_yaw" in channels and "cmd_yaw_rate" not in channels:
        notes.append("yaw is commanded as an angle; there is no yaw rate command, and none is derived")

    nothing = np.full(len(t), np.nan)
    command = np.stack([commands.get(key, nothing)[complete] for key in COMMANDS], axis=1)
    attitude = np.stack([pose.get(key, nothing)[complete] for key in turning], axis=1)
    if quaternion:
        attitude = _zxy(_rotation(attitude))
    if euler == "ZYX":
        if not quaternion:
            attitude = _zyx_to_zxy(attitude, "attitude", notes)
        command[:, 1:3] = _zyx_to_zxy(np.c_[command[:, 1:3], np.zeros(len(command))], "command", notes)[:, :2]
    attitude[:, 2] = np.unwrap(attitude[:, 2])
    return FlightLog(
        name=name,
        t=t[complete] - t[complete][0],
        position=np.stack([pose[key][complete] for key in _POSITION], axis=1),
        attitude=attitude,
        command=command,
        **optional,
        thrust_is_measured=channels["cmd_thrust_pwm"].measured,
        from_quaternion=quaternion,
        notes=tuple(dict.fromkeys(notes)),
    )


def _commanded_angles(channels: Mapping[str, Channel], euler: str) -> dict[str, Channel]:
    """Return roll and pitch commands from a commanded quaternion, in the mapping's own convention."""
    parts = [channels[key] for key in COMMANDED_QUATERNION]
    held = [_hold(part, parts[0].t) for part in parts]
    known = np.all([usable for _, usable in held], axis=0)
    rotation = _rotation(np.stack([value[known] for value, _ in held], axis=1))
    if euler == "ZYX":
        _, pitch, roll = rotation.as_euler("ZYX").T
    else:
        roll, pitch, _ = _zxy(rotation).T
    named = (("cmd_roll", roll), ("cmd_pitch", pitch))
    return {key: Channel(parts[0].t[known], angle, parts[0].column) for key, angle in named}


def _rotations(
    path: str, channels: Mapping[str, Channel], keys: tuple[str, ...], notes: list[str]
) -> dict[str, Channel]:
    """Return quaternions w, x, y, z of continuous sign, without the zeros that loggers write for missing
    ones.

    A position of zeros with a quaternion of zeros is also missing. Raises UserError for other numbers.
    """
    parts = [channels[key] for key in keys]
    t = parts[0].t
    if any(not np.array_equal(part.t, t) for part in parts):
        return {}
    value = np.stack([part.value for part in parts], axis=1)
    length = np.linalg.norm(value, axis=1)
    named, none, wrong = ", ".join(keys), length < 0.05, np.abs(length - 1.0) > 0.05
    wrong &= ~none
    if none.all() or wrong.mean() > 0.01:
        worst = length[np.argmax(np.abs(length - 1.0) * (wrong | none.all()))]
        raise UserError(f"{path}: {named} have length {worst:.3g} instead of 1; not a quaternion")
    left = ~(none | wrong)
    if not left.all():
        share = f"{percent(1.0 - left.mean())} of the rows"
        notes.append(f"{named} are zeros or no rotation in {share}: not measured, and left out")
    # q and -q are the same rotation; between them, no number is.
    value = value[left]
    value[1:] *= np.cumprod(np.where((value[1:] * value[:-1]).sum(axis=1) < 0.0, -1.0, 1.0))[:, None]
    found = {
        key: dataclasses.replace(part, t=t[left], value=column)
        for key, part, column in zip(keys, parts, value.T)
    }
    if keys == QUATERNION and none.any():
        axes = [channels[key] for key in _POSITION if key in channels]
        if all(np.array_equal(axis.t, t) for axis in axes):
            seen = ~(none & np.all([axis.value == 0.0 for axis in axes], axis=0))
            found |= {
                key: dataclasses.replace(axis, t=t[seen], value=axis.value[seen])
                for key, axis in zip(_POSITION, axes)
            }
    return found


def _at(
    t: np.ndarray, channels: Mapping[str, Channel], keys: tuple[str, ...], method: Callable
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the values at t (m,) of the `keys` that were logged, and a mask of the rows that have them all.

    method: `_interpolate` or `_hold`.
    """
    values, complete = {}, np.ones(len(t), bool)
    for key in keys:
        if key in channels:
            values[key], usable = method(channels[key], t)
            complete &= usable
    return values, complete


def _optional(t: np.ndarray, channels: Mapping[str, Channel], notes: list[str]) -> dict[str, np.ndarray]:
    """Return the optional fields of a `FlightLog` at t (m,) that are logged throughout; note the others."""
    found = {}
    for field, what, method in (
        ("voltage", "battery voltage", functools.partial(_interpolate, longest=VOLTAGE_BRIDGED)),
        ("requests", "requests", _hold),
        ("rotor_speed", "rotor speed", _interpolate),
    ):
        values, usable = _at(t, channels, FIELDS[field], method)
        columns = list(values.values())
        if len(columns) == len(FIELDS[field]) and usable.all():
            found[field] = columns[0] if len(columns) == 1 else np.stack(columns, axis=1)
        elif len(columns) == len(FIELDS[field]):
            notes.append(f"{what} is not logged throughout and is not used")
    return found


def _describe_rows(channels: Mapping[str, Channel], t: np.ndarray, complete: np.ndarray) -> Iterator[str]:
    """Yield notes on dropped rows, and on columns resampled to the clock of x."""
    inside = np.flatnonzero(complete)
    span = inside[-1] - inside[0] + 1
    if span > len(inside):
        yield f"{span - len(inside)} rows inside the flight lack part of the pose and were dropped"
    if len(t) > span:
        rows = int(len(t) - span)
        yield f"{rows} row{'s' * (rows > 1)} at the ends lack{'s' * (rows == 1)} pose or commands"
    clocks = [channels[key] for key in (*_POSITION, *COMMANDS) if key in channels]
    if any(len(c.t) != len(t) or not np.array_equal(c.t, t) for c in clocks):
        yield "channels have different clocks; measurements are interpolated and commands held on that of x"


def _require_columns(path: str, channels: Mapping[str, Channel], quaternion: bool) -> None:
    """Raise UserError if position, attitude or thrust command are missing."""
    missing = [key for key in _POSITION if key not in channels]
    if missing:
        raise UserError(
            f"{path}: no position column {', '.join(missing)}; a flight cannot be used without it"
        )
    attitude = QUATERNION if any(key in channels for key in QUATERNION) else _EULER
    if not quaternion and not any(key in channels for key in ("roll", "pitch")):
        lacking = ", ".join(key for key in attitude if key not in channels)
        raise UserError(
            f"{path}: no attitude column {lacking}; roll, pitch, yaw or qw, qx, qy, qz are needed; if they "
            'have other names, a mapping file assigns them, for example qw = "q.3"'
        )
    if "cmd_thrust_pwm" not in channels:
        raise UserError(
            f"{path}: no thrust command column cmd_thrust_pwm; the model cannot be simulated without it"
        )


def _check_angle(path: str, key: str, channel: Channel) -> None:
    """Raise UserError for angles in degrees, before a conversion wraps them into plausible radians."""
    largest = np.abs(channel.value).max(initial=0.0)
    if key == "yaw":
        begin = np.abs(channel.value[:1]).max(initial=0.0)
        degrees = begin > 2 * np.pi or np.abs(np.diff(channel.value)).max(initial=0.0) > 100.0
    else:
        degrees = largest > np.pi + 0.01
    if degrees:
        t = channel.t[np.argmax(np.abs(channel.value))]
        raise UserError(
            f"{path}: column {channel.column} ({key}) reaches {largest:.3g} rad at t = {t:.6g} s: "
            + (
                f"is its unit, {shown(channel.unit, 40)}, right?"
                if channel.unit
                else "these look like degrees; state the unit in a row of units, a mapping or --unit"
            )
        )


def _without_turns(key: str, channel: Channel, notes: list[str]) -> Channel:
    """Return angles that are logged from 0 to 2 pi in the range from -pi to pi, with a note."""
    value = channel.value[np.isfinite(channel.value)]
    low, high = value.min(initial=0.0), value.max(initial=0.0)
    jumps = np.abs(np.diff(value)) > np.pi
    if low < 0.0 or not np.pi < high < 2.0 * np.pi + 0.01 or not jumps.any():
        return channel
    notes.append(f"column {channel.column} ({key}) runs from 0 to 360 deg; read as -180 to 180 deg")
    return dataclasses.replace(channel, value=(channel.value + np.pi) % (2.0 * np.pi) - np.pi)


def _clean(path: str, key: str, channel: Channel, notes: list[str]) -> Channel:
    """Return a channel without invalid rows and isolated outliers, and with one value per instant."""
    finite = np.abs(channel.value) < LARGEST_VALUE
    lost = int((~finite).sum())
    if lost == len(finite):
        raise UserError(f"{path}: column {channel.column} ({key}) contains no usable number")
    if lost:
        share = f"{lost} of {len(finite)} rows"
        notes.append(f"column {channel.column} ({key}) is empty or not a number in {share}")
    outliers = _find_outliers(channel.value, finite, _PLAUSIBLE.get(key, (-np.inf, np.inf)))
    if len(outliers):
        where = f"row {outliers[0] + 1} of the data (t = {channel.t[outliers[0]]:.6g} s)"
        often = where if len(outliers) == 1 else f"{len(outliers)} rows, first in {where}"
        holds = f"column {channel.column} ({key}) holds {channel.value[outliers[0]]:.4g}"
        notes.append(f"{holds}, which is impossible in flight, in {often}: left out")
        finite[outliers] = False
    t, value = channel.t[finite], channel.value[finite]
    later = np.r_[True, np.diff(t) > 0]
    differing = np.flatnonzero(~later & np.r_[False, np.diff(value) != 0.0])
    if len(differing) > max(1, _OUTLIER_SHARE * len(t)):
        often = (
            f"{len(differing)} of {len(t)} rows of column {channel.column} ({key}) differ from the row before"
        )
        step = np.median(np.diff(t[later])) if later.sum() > 1 else 0.0
        raise UserError(
            f"{path}: {often} at the same instant, first at t = {t[differing[0]]:.6g} s: a clock in steps of "
            f"{step:.3g} s is too coarse, or the rows are those of several vehicles"
        )
    if not later.all():
        notes.append(f"{int((~later).sum())} rows of {channel.column} repeat an instant and were dropped")
    wraps = key in ("roll", "yaw")
    return dataclasses.replace(channel, t=t[later], value=value[later], wraps=wraps)


def _find_outliers(value: np.ndarray, finite: np.ndarray, possible: tuple[float, float]) -> np.ndarray:
    """Return the rows of implausible values among plausible ones; none if there are more than a few."""
    low, high = possible
    rows = np.flatnonzero(finite)
    beyond = (value[rows] < low) | (value[rows] > high)
    if not 0 < beyond.sum() <= max(1, _OUTLIER_SHARE * len(rows)):
        return rows[:0]
    usual = median_filter(value[rows], size=5, mode="nearest")
    return rows[beyond & (low <= usual) & (usual <= high)]


def _interpolate(channel: Channel, t: np.ndarray, longest: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return the values at t, and a mask of those whose neighbours are near enough; (m,) each."""
    if len(channel.t) == len(t) and np.array_equal(channel.t, t):
        return channel.value, np.ones(len(t), bool)
    if len(channel.t) < 2:
        return np.full(len(t), np.nan), np.zeros(len(t), bool)
    right = np.clip(np.searchsorted(channel.t, t, side="left"), 1, len(channel.t) - 1)
    step = channel.t[right] - channel.t[right - 1]
    exact = np.isin(t, channel.t)
    inside = (t >= channel.t[0]) & (t <= channel.t[-1])
    near = exact | (inside & (step <= max(longest, longest_bridged(channel.t))))
    value = np.unwrap(channel.value) if channel.wraps else channel.value
    return np.interp(t, channel.t, value), near


def _hold(channel: Channel, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the last value sent at or before t, and a mask of those that are near enough; (m,) each."""
    if not len(channel.t):
        return np.full(len(t), np.nan), np.zeros(len(t), bool)
    last = np.searchsorted(channel.t, t + 1e-9, side="right") - 1
    age = t - channel.t[np.maximum(last, 0)]
    return channel.value[np.maximum(last, 0)], (last >= 0) & (age <= longest_bridged(channel.t))


def _rotation(quaternion: np.ndarray) -> Rotation:
    """Return rotations from numbers w, x, y, z (m, 4) that are nearly quaternions."""
    length = np.linalg.norm(quaternion, axis=1, keepdims=True)
    return Rotation.from_quat(quaternion / length, scalar_first=True)


def _zxy(rotation: Rotation) -> np.ndarray:
    yaw, roll, pitch = rotation.as_euler("ZXY").T
    return np.stack([roll, pitch, yaw], axis=1)


def _zyx_to_zxy(angles: np.ndarray, what: str, notes: list[str]) -> np.ndarray:
    """Return roll, pitch, yaw (m, 3) of Rz Rx Ry from those of Rz Ry Rx; a column of NaN stays one."""
    if np.isnan(angles[:, :2]).any():
        if not np.isnan(angles[:, :2]).all():
            notes.append(
                f"only one tilt angle of the {what} is logged; it is used unchanged, though the conventions "
                "differ in second order"
            )
        return angles
    yaw = np.nan_to_num(angles[:, 2])
    result = _zxy(Rotation.from_euler("ZYX", np.stack([yaw, angles[:, 1], angles[:, 0]], axis=1)))
    if np.isnan(angles[:, 2]).any():
        result[:, 2] = np.nan
    return result
