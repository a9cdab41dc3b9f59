"""Checks of individual columns: time, gaps, constants, impossible values."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import median_filter

from inclined_landing.eval.logs.limits import FEWEST_PER_SECOND, LEAST_RATE, MOST_PER_SECOND
from inclined_landing.eval.logs.log import (
    COMMANDS,
    GAP_STEPS,
    MEASURED,
    MOTORS_OFF,
    Finding,
    FlightLog,
    limit,
    longest_bridged,
    refuse,
)
from inclined_landing.eval.logs.units import OF_A_FORCE

SHORTEST = 1.0  # s: below, not even one prediction window with room for delays
SHORT_FLIGHT = 5.0  # s
SETTLES = 0.5  # s after which an attitude has settled where it was commanded
FOLLOWS = 0.1  # rad, the least that an attitude moves on that does not follow its command
MOST_JUMPS = 0.02  # of the rows
JUMP = 0.03  # m that a row may lie away from its neighbours besides what LARGEST_ACCELERATION allows
LARGEST_ACCELERATION = 40.0  # m/s2
TURN, LARGEST_TURNING = 0.15, 300.0  # rad, rad/s2: the same of the attitude
LEANS = 0.02  # rad rms by which no vehicle leans that stays in its place
LARGEST_SPEED = 15.0  # m/s
LARGEST_DISTANCE = 200.0  # m
# The largest ratio of a rotor's speed to the median of the other three in lasting flight. Thrust goes with
# its square: beyond, one rotor would give less than 4/9 or more than 9/4 of what the others give, and torques
# would not balance.
SPEED_RATIO = 1.5
FAILED_SHARE = 0.1  # of the rows in flight: manoeuvres pass
_ATTITUDE_COMMANDS = (  # command, the largest in SI units, its unit
    ("cmd_roll", np.pi / 2, "rad"),
    ("cmd_pitch", np.pi / 2, "rad"),
    ("cmd_yaw_rate", 15.0, "rad/s"),
)


def check(log: FlightLog) -> Iterator[Finding]:
    """Yield findings on the individual columns of one flight."""
    yield from _check_time(log)
    yield from _check_finite(log)
    yield from _check_position(log)
    yield from _check_attitude(log)
    yield from _check_thrust(log)
    yield from _check_attitude_commands(log)
    yield from _check_voltage(log)
    for rotor, text in failed_speed_sensors(log).items():
        more = " Thrust by rotor speeds is wrong then" if log.thrust_is_measured else ""
        yield limit(f"m{rotor}_speed", text + more)


def _check_time(log: FlightLog) -> Iterator[Finding]:
    if log.duration < SHORTEST:
        yield refuse("t", f"lasts only {log.duration:.2g} s; at least {SHORTEST:g} s of flight are needed")
        return
    if not FEWEST_PER_SECOND <= log.rate <= MOST_PER_SECOND:
        yield refuse("t", f"has {log.rate:.3g} rows per second: not a flight, or the unit of time is wrong")
        return
    if log.duration < SHORT_FLIGHT:
        yield limit("t", f"lasts only {log.duration:.2g} s: too short for most conclusions")
    if log.rate < LEAST_RATE:
        yield limit("t", f"has only {log.rate:.3g} rows per second: lags and delays cannot be distinguished")
    gaps = log.gap_starts
    if len(gaps):
        steps = np.diff(log.t)[gaps]
        worst = gaps[np.argmax(steps)]
        text = f"{len(gaps)} gap{'s' if len(gaps) > 1 else ''} in time, the longest of {steps.max():.2g} s"
        text += f" at t = {log.t[worst]:.2f} s"
        if not log.pieces(SHORTEST):
            yield refuse("t", f"{text}; between them, no interval is as long as {SHORTEST:g} s")
        else:
            yield limit("t", f"{text}: predictions stop at them")


def _check_finite(log: FlightLog) -> Iterator[Finding]:
    columns = log.columns()
    for name in MEASURED + COMMANDS:
        column = columns[name]
        bad = np.flatnonzero(~np.isfinite(column))
        if 0 < len(bad) < len(log) or np.isinf(column).any():
            yield refuse(
                name, f"column {name} is not a number in {len(bad)} rows, first at t = {log.t[bad[0]]:g} s"
            )
    if log.missing:
        yield limit(", ".join(log.missing), f"not logged: {', '.join(log.missing)}")


def _check_position(log: FlightLog) -> Iterator[Finding]:
    if np.ptp(log.position, axis=0).max() < 1e-6:
        yield refuse("x, y, z", "columns x, y, z never change: not a flight, or not a measurement")
        return
    speed = np.linalg.norm(np.diff(log.position, axis=0), axis=1) / np.maximum(np.diff(log.t), 1 / log.rate)
    # Nearly all rows must show it: a few of them, wherever they lie, are no reason to doubt the unit.
    top, span = np.percentile(speed, 90), np.ptp(np.percentile(log.position, (10, 90), axis=0), axis=0).max()
    if top > LARGEST_SPEED or span > LARGEST_DISTANCE:
        moves = f"move at {top:.3g} m/s" if top > LARGEST_SPEED else f"span {span:.3g} m"
        yield refuse("x, y, z", f"columns x, y, z {moves}: wrong unit (millimetres?), or of time")
        return
    yield from _check_axes(log)
    spikes, jumps = _discontinuities(log)
    if len(spikes) + len(jumps) > MOST_JUMPS * len(log):
        count = len(spikes) + len(jumps)
        yield refuse("x, y, z", f"columns x, y, z jump in {count} of {len(log)} rows: tracking was lost")
        return
    near = _rows_near_jumps(jumps, log)
    rows = np.delete(np.arange(len(log)), np.union1d(spikes, near))
    deviation = np.abs(log.position - np.median(log.position, axis=0)).max(axis=1)
    far = rows[deviation[rows] > LARGEST_DISTANCE]
    if len(far):
        where = f"in {len(far)} rows, first in row {far[0] + 1} (t = {log.t[far[0]]:.2f} s)"
        yield refuse(
            "x, y, z",
            f"columns x, y, z lie {deviation[far[0]]:.3g} m from the flight {where}: tracking was lost",
        )
        return
    if len(spikes):
        at = f"row {spikes[0] + 1} (t = {log.t[spikes[0]]:.2f} s)"
        often = f"{at}: it is" if len(spikes) == 1 else f"{len(spikes)} rows, first in {at}: these are"
        text = f"position jumps away and back in {often} left out"
        yield limit("x, y, z", text, rows=tuple(map(int, spikes)))
    if len(jumps):
        often = "once" if len(jumps) == 1 else f"{len(jumps)} times, first"
        text = f"position jumps for good {often} at t = {log.t[jumps[0]]:.2f} s"
        yield limit("x, y, z", f"{text}: the rows around are left out", rows=tuple(map(int, near)))


def _discontinuities(log: FlightLog) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of isolated outliers in position, and the rows from which it is offset."""
    # A jump is where the step differs from the median velocity times dt by more than a row may from others.
    smooth = JUMP + LARGEST_ACCELERATION / log.rate**2
    spikes = _outliers(log.position, smooth)
    rows = np.delete(np.arange(len(log)), spikes)
    step = np.diff(log.t[rows])[:, None]
    moved = np.diff(log.position[rows], axis=0)
    usual = median_filter(moved / np.maximum(step, 1 / log.rate), size=(5, 1), mode="nearest") * step
    deviation = np.linalg.norm(moved - usual, axis=1)
    unbroken = step[:, 0] < GAP_STEPS / log.rate
    jumps = np.flatnonzero(unbroken & (deviation > max(smooth, 8 * np.median(deviation))))
    return spikes, rows[jumps + 1]


def _outliers(value: np.ndarray, smooth: float) -> np.ndarray:
    """Return the rows of `value` (m, k) that deviate by more than `smooth` from the rows around them."""
    # |x - median_5(x)| > smooth, and 8 times its median
    deviation = np.linalg.norm(value - median_filter(value, size=(5, 1), mode="nearest"), axis=1)
    return np.flatnonzero(deviation > max(smooth, 8 * np.median(deviation)))


def _check_axes(log: FlightLog) -> Iterator[Finding]:
    """Yield a finding on each axis of a position that never changes while the others do."""
    roll, pitch, yaw = np.nan_to_num(log.attitude).T
    # Where the thrust points: Rz(yaw) Rx(roll) Ry(pitch) e_z
    ahead, left = np.sin(pitch), -np.sin(roll) * np.cos(pitch)
    leans = np.cos(yaw) * ahead - np.sin(yaw) * left, np.sin(yaw) * ahead + np.cos(yaw) * left
    for name, column, lean in zip("xyz", log.position.T, (*leans, np.zeros(len(log)))):
        if np.ptp(column) < 1e-9 and np.std(lean) > LEANS:
            yield refuse(
                name, f"column {name} never changes, although the vehicle leans along it: not measured"
            )
        elif np.ptp(column) < 1e-9:
            yield limit(name, f"column {name} never changes: this axis cannot be checked")


def _rows_near_jumps(jumps: np.ndarray, log: FlightLog) -> np.ndarray:
    """Return the rows near jumps; omitting them makes a gap in the record."""
    if not len(jumps):
        return jumps
    width = 0.6 * longest_bridged(log.t)
    before = np.maximum(np.searchsorted(jumps, np.arange(len(log))) - 1, 0)
    after = np.minimum(before + 1, len(jumps) - 1)
    distance = [np.abs(log.t - log.t[jumps[k]]) for k in (before, after)]
    return np.flatnonzero(np.minimum(*distance) <= width)


def _check_attitude(log: FlightLog) -> Iterator[Finding]:
    for name, column in zip(("roll", "pitch"), log.attitude.T):
        if np.isnan(column).all():
            continue
        if np.ptp(column) < 1e-9:
            yield limit(name, f"column {name} never changes: this axis cannot be checked")
        elif np.abs(column).max() > 1.2:
            steepest = np.degrees(np.abs(column).max())
            yield limit(
                name, f"{name} reaches {steepest:.0f} deg: a flip or a crash, which the models do not cover"
            )
    # A vehicle that lies upside down has a pitch of about +-180 deg, whose sign is noise.
    attitude = np.unwrap(np.nan_to_num(log.attitude), axis=0)
    spikes = _outliers(attitude, TURN + LARGEST_TURNING / log.rate**2)
    if len(spikes):
        where = (
            f"{len(spikes)} of {len(log)} rows, first in row {spikes[0] + 1} (t = {log.t[spikes[0]]:.2f} s)"
        )
        text = f"attitude jumps away and back in {where}"
        if len(spikes) > MOST_JUMPS * len(log):
            yield refuse("roll, pitch, yaw", f"{text}: not a measurement")
        else:
            yield limit("roll, pitch, yaw", f"{text}: left out", rows=tuple(map(int, spikes)))
    if np.median(np.cos(np.nan_to_num(log.attitude[:, :2])).prod(axis=1)) < 0.0:
        order = " Is the order of the quaternion x, y, z, w instead of w, x, y, z?" * log.from_quaternion
        yield refuse("roll, pitch", f"the vehicle is upside down in most of the rows.{order}")
    if np.ptp(np.nan_to_num(log.attitude[:, :2]), axis=0).max() < 1e-9:
        yield refuse("roll, pitch", "neither roll nor pitch ever changes: not a measurement")


def _check_thrust(log: FlightLog) -> Iterator[Finding]:
    pwm = log.command[:, 0]
    if np.isnan(pwm).all():
        return
    top, bottom = pwm.max(), pwm.min()
    if top > 65535.5 or bottom < 0:
        row = int(pwm.argmax() if top > 65535.5 else pwm.argmin())
        text = f"column cmd_thrust_pwm holds {pwm[row]:.6g} at t = {log.t[row]:.2f} s, but PWM is 0 to 65535"
        yield refuse("cmd_thrust_pwm", text)
    elif top <= 100.0:
        unit = "fraction" if top <= 1.5 else "%"
        yield refuse(
            "cmd_thrust_pwm",
            f"column cmd_thrust_pwm never exceeds {top:.3g}, but PWM is 0 to 65535: a {unit}? "
            f"State its unit. If it is a force: {OF_A_FORCE}",
        )
    elif np.ptp(pwm) < 1.0:
        yield refuse(
            "cmd_thrust_pwm", f"column cmd_thrust_pwm is always {top:.6g}: this is not a flown command"
        )
    elif top < MOTORS_OFF:
        yield refuse(
            "cmd_thrust_pwm",
            f"column cmd_thrust_pwm never exceeds {top:.0f} PWM: this is not a flight, or the unit is "
            "wrong; " + OF_A_FORCE,
        )
    else:
        yield from _check_frozen_thrust(log)
        share = (pwm >= 65534.0).mean()
        if share > 0.01:
            yield limit(
                "cmd_thrust_pwm",
                f"thrust command is saturated (65535 PWM) in {100 * share:.0f} % of the rows",
            )


def _check_frozen_thrust(log: FlightLog) -> Iterator[Finding]:
    """Yield a finding if a thrust command that otherwise changes stays constant for long in flight."""
    pwm = log.command[:, 0]
    start, stop = _constant(pwm)
    lasts = np.where((pwm[start] > MOTORS_OFF) & (pwm[start] < 65534.0), log.t[stop - 1] - log.t[start], 0.0)
    long = lasts >= SHORTEST
    if long.any() and lasts[~long].max(initial=0.0) < SETTLES:
        first = start[long][0]
        yield limit(
            "cmd_thrust_pwm",
            f"column cmd_thrust_pwm stays at {pwm[first]:.0f} PWM for {lasts[long].max():.2g} s from "
            f"t = {log.t[first]:.2f} s on, but otherwise changes all the time: was it still logged?",
        )


def _constant(column: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the first row and the row after the last (n,) of every stretch in which a column is constant."""
    start = np.flatnonzero(np.r_[True, np.diff(column) != 0.0])
    return start, np.append(start[1:], len(column))


def _check_attitude_commands(log: FlightLog) -> Iterator[Finding]:
    for (name, most, unit), column, angle in zip(_ATTITUDE_COMMANDS, log.command[:, 1:].T, log.attitude.T):
        if np.isnan(column).all():
            continue
        if np.ptp(column) < 1e-6 and name != "cmd_yaw_rate":
            yield limit(name, f"column {name} is always {column[0]:.3g}: its control loop cannot be checked")
        elif np.abs(column).max() > most:
            row = int(np.abs(column).argmax())
            top = f"{abs(column[row]):.3g} {unit} at t = {log.t[row]:.2f} s"
            taken = unit.replace("rad", "degrees")
            yield refuse(name, f"column {name} reaches {top}: {taken}? State its unit")
        elif unit == "rad":
            yield from _check_frozen_command(log, name, column, angle)


def _check_frozen_command(
    log: FlightLog, name: str, column: np.ndarray, angle: np.ndarray
) -> Iterator[Finding]:
    """Yield a finding if an angle (m,) keeps moving long after its command (m,) became constant."""
    usual = np.ptp(np.percentile(angle, (5, 95)))
    start, stop = _constant(column)
    long = log.t[stop - 1] - log.t[start] >= SHORTEST + SETTLES
    for a, b in zip(start[long], stop[long]):
        rows = slice(int(np.searchsorted(log.t, log.t[a] + SETTLES)), b)
        if log.command[rows, 0].min() < MOTORS_OFF:
            continue
        moved = np.ptp(np.percentile(angle[rows], (5, 95)))
        if moved > max(FOLLOWS, 0.5 * usual):
            yield limit(
                name,
                f"column {name} stays at {column[a]:.3g} rad for {log.t[b - 1] - log.t[a]:.2g} s from "
                f"t = {log.t[a]:.2f} s on, while the angle moves by {moved:.2g} rad: was it still logged?",
            )
            return


def _check_voltage(log: FlightLog) -> Iterator[Finding]:
    if log.voltage is None:
        return
    low, high = log.voltage.min(), log.voltage.max()
    if high > 100.0:
        at = log.t[log.voltage.argmax()]
        yield refuse("vbat", f"column vbat reaches {high:.4g} V at t = {at:.2f} s: millivolt? State its unit")
    elif high - low < 1e-3:
        text = f"column vbat is always {high:.4g} V: not a measurement of a battery in use; left out"
        yield limit("vbat", text, without="voltage")
    elif low < 2.5 or high > 4.5:
        yield limit("vbat", f"battery voltage runs from {low:.3g} to {high:.3g} V: not a single-cell battery")


def failed_speed_sensors(log: FlightLog) -> dict[int, str]:
    """Return a sentence for every rotor (1 to 4) whose measured speed contradicts those of the others."""
    if log.rotor_speed is None or not log.rotor_speed.any():
        return {}
    failed = {}
    middle = np.median(log.rotor_speed, axis=1)
    speed = log.rotor_speed[middle > 0.5 * middle.max()]  # in flight
    for k in range(speed.shape[1]):
        ratio = speed[:, k] / np.median(np.delete(speed, k, axis=1), axis=1)
        share = ((ratio < 1 / SPEED_RATIO) | (ratio > SPEED_RATIO)).mean()
        if share > FAILED_SHARE:
            failed[k + 1] = (
                f"rotor speed of M{k + 1} is {np.median(ratio):.2f} times that of the other rotors (median), "
                f"and contradicts them in {100 * share:.0f} % of the rows in flight; its sensor may have "
                "failed"
            )
    return failed
