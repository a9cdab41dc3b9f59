"""Consistency checks between columns: signs, axes, units and clocks, from the motion of the vehicle.

A tilt in the horizontal plane is a complex number, x + iy. Its thrust points along pitch - i roll (the
vehicle's heading being the real axis), its acceleration shows the actual direction of the thrust. A factor r
e^(i delta) between the two means a wrong unit (r) or a rotated frame (delta: 180 degrees are two wrong
signs); agreement with the *conjugate* is a mirrored frame: one wrong sign, or two swapped columns.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator

import numpy as np
import scipy  # whose submodules are imported when they are used
from scipy.spatial.transform import Rotation

from inclined_landing.eval.logs.limits import LEAST_RATE
from inclined_landing.eval.logs.log import MOTORS_OFF, Finding, FlightLog, info, limit, refuse, runs
from inclined_landing.eval.logs.values import SHORTEST

GRAVITY = 9.81
RATE = 100.0  # Hz, of the grid compared on
WINDOW = 0.25  # s, of the smoothing that differentiates
LEAST_EXCITATION = 0.015  # rad rms of tilt, or twice what 1 mm of noise looks like through WINDOW
LEAST_CORRELATION = 0.6  # correlation from which two columns are said to show the same motion
SURE_CORRELATION = 0.8  # from which their scales are compared
MOST_RATIO = 20.0  # of an acceleration to what the attitude gives, beyond which a unit is wrong
# Circling against drag turns the tilt against the acceleration too, by up to 13 deg in NanoBench flights.
SUSPICIOUS_TURN = np.radians(20.0)
WRONG_TURN = np.radians(60.0)
LONGEST_LAG = 0.4  # s
LONGEST_DELAY = 0.3  # s: the slowest attitude loop and radio known here stay below 0.2
LONGEST_LEAD = 0.015  # s by which a response may seem to lead its cause before the clocks are doubted
STILL, STANDS = 0.03, 0.5  # m/s below which, and s for which at least, a vehicle that stands does not move
PLACE = 0.005  # m that the measured position of a vehicle that stands may stray
# A vehicle that does not move has a command that differs from the one in flight by this share only where
# something holds it: near the ground, and with another battery voltage, the difference is smaller.
STANDING_DIFFERENCE = 0.2
LEAST_QW = 0.1  # few quaternions of level vehicles are below, only of those that face backwards
CLEARANCE = 0.1  # m above the lowest row, from which a vehicle that climbs is in the air


@dataclasses.dataclass(frozen=True)
class LoggedMotion:
    """Smoothed motion of one flight in the air, on a grid of RATE; complex: x + iy.

    Each field is a list of arrays, one for each stretch with the motors on and without gaps.
    """

    height: list[np.ndarray]  # z (m)
    attitude: list[np.ndarray]  # (m, 3) roll, pitch, yaw
    acceleration: list[np.ndarray]  # (m, 3) m/s2
    lean: list[np.ndarray]  # where the thrust pointed, in the frame of the world
    thrust_tilt: list[np.ndarray]  # where the thrust pointed, in the frame of the heading
    tilt: list[np.ndarray]  # pitch - i roll, NaN where one is not logged
    commanded_tilt: list[np.ndarray]
    pwm: list[np.ndarray]
    force: list[np.ndarray]  # specific force (m/s2)


def motion(log: FlightLog) -> LoggedMotion:
    """Return the stretches with the motors on, without gaps, that last at least SHORTEST."""
    found: dict[str, list[np.ndarray]] = {field.name: [] for field in dataclasses.fields(LoggedMotion)}
    for piece in log.pieces(SHORTEST):
        on = ~(piece.command[:, 0] <= MOTORS_OFF) & ~standing(piece)
        for a, b in runs(on):
            if b - a > 1 and piece.t[b - 1] - piece.t[a] >= SHORTEST:
                for name, values in _motion(piece.rows(slice(a, b)).resampled(RATE)).items():
                    found[name].append(values)
    return LoggedMotion(**found)


def standing(log: FlightLog) -> np.ndarray:
    """Return the rows (m,) in which the vehicle is supported, mostly by the ground.

    These are the rows, until it leaves the place, in which it does not move and its thrust command differs
    from that in flight. There are none in a log without a second of motion.
    """
    pieces = log.pieces()
    still = [_still(piece) for piece in pieces]
    pwm = np.concatenate([piece.command[~s, 0] for piece, s in zip(pieces, still)])
    flown = pwm[pwm > MOTORS_OFF]
    result = np.zeros(len(log), bool)
    if len(flown) < log.rate:
        return result
    level = float(np.median(flown))
    for piece, slow in zip(pieces, still):
        first = int(np.searchsorted(log.t, piece.t[0]))
        for a, b in runs(slow):
            if (
                piece.t[b - 1] - piece.t[a] < STANDS
                or abs(piece.command[a:b, 0].mean() - level) < STANDING_DIFFERENCE * level
            ):
                continue
            distance = np.linalg.norm(piece.position - np.median(piece.position[a:b], axis=0), axis=1)
            near = distance < PLACE + 4.0 * np.median(distance[a:b])
            near[a:b] = True
            begin, end = next(run for run in runs(near) if run[0] <= a < run[1])
            result[first + begin : first + end] = True
    return result


def _still(piece: FlightLog) -> np.ndarray:
    """Return the rows (m,) of a stretch without gaps in which the smoothed velocity is below STILL."""
    rows = 2 * max(2, round(WINDOW * piece.rate)) + 1
    if len(piece) < rows:
        return np.zeros(len(piece), bool)
    velocity = scipy.signal.savgol_filter(piece.position, rows, 1, 1, 1 / piece.rate, axis=0)
    return np.linalg.norm(velocity, axis=1) < STILL


def _motion(log: FlightLog) -> dict[str, np.ndarray]:
    """Return the fields of `LoggedMotion` for one stretch on a grid of RATE."""

    def smooth(value: np.ndarray, order: int = 0) -> np.ndarray:
        rows = int(WINDOW * RATE) | 1
        if not np.isfinite(value).all():
            return np.full(value.shape, np.nan)
        return scipy.signal.savgol_filter(value, rows, 2, order, 1 / RATE, axis=0)

    # The thrust points along (a_x, a_y, a_z + g): its tilt in the frame of the heading is
    # (a_x + i a_y) / (a_z + g) exp(-i yaw), for small angles pitch - i roll.
    acceleration = smooth(log.position, 2)
    roll, pitch, yaw = (smooth(column) for column in log.attitude.T)
    upward = np.maximum(acceleration[:, 2] + GRAVITY, 2.0)
    lean = (acceleration[:, 0] + 1j * acceleration[:, 1]) / upward
    return {
        "height": log.position[:, 2],
        "attitude": log.attitude,
        "acceleration": acceleration,
        "lean": lean,
        "thrust_tilt": lean * np.exp(-1j * np.where(np.isnan(yaw), 0.0, yaw)),
        "tilt": pitch - 1j * roll,
        "commanded_tilt": smooth(log.command[:, 2]) - 1j * smooth(log.command[:, 1]),
        "pwm": smooth(log.command[:, 0]),
        "force": np.linalg.norm(acceleration + [0.0, 0.0, GRAVITY], axis=1),
    }


def in_air(log: FlightLog, moves: LoggedMotion) -> np.ndarray:
    """Return which rows of all stretches (m,) of a log are in the air.

    These are all rows of a log that begins and ends in the air: its height stays within 2 CLEARANCE, and the
    horizontal acceleration follows the tilt, unlike on the ground. Otherwise they are the rows above
    CLEARANCE.
    """
    height, lowest = np.concatenate(moves.height), log.position[:, 2].min()
    if height.max() <= lowest + 2 * CLEARANCE:
        pair = _compare_signals(moves.tilt, moves.thrust_tilt, excited=0.0)
        if pair is not None and pair.agreement > LEAST_CORRELATION:
            return np.full(len(height), True)
    return height > lowest + CLEARANCE


def check(log: FlightLog, moves: LoggedMotion) -> Iterator[Finding]:
    """Yield findings on the consistency between the columns of one flight; moves: its `motion`."""
    if not moves.pwm:
        yield limit(
            "cmd_thrust_pwm", "no second with the motors on: signs, units and clocks were not checked"
        )
        return
    for wrong in (
        _check_clock(log, moves),
        _check_swapped_height(moves),
        _check_quaternion(moves) if log.from_quaternion else (),
    ):
        found = list(wrong)
        yield from found
        if any(finding.decision == "refuse" for finding in found):
            return
    yield from _check_standing(log)
    yield from _check_thrust(moves)
    tilt = list(_check_attitude(moves))
    yield from tilt
    if not any(finding.decision == "refuse" for finding in tilt):
        yield from _check_attitude_commands(moves)


def _check_clock(log: FlightLog, moves: LoggedMotion) -> Iterator[Finding]:
    """Yield a finding if attitude and acceleration agree, but not at the rate of the log's rows.

    This is checked for logs with few rows per second, or with accelerations far above those from the
    attitude.
    """
    pair = _compare_signals(moves.tilt, moves.thrust_tilt)
    if log.rate >= LEAST_RATE and (pair is None or pair.ratio < MOST_RATIO):
        return
    # At RATE rows per second, accelerations are s^2 times too large if rows follow after s/RATE.
    even = motion(dataclasses.replace(log, t=log.t * log.rate / RATE))
    pair = _compare_signals(even.tilt, even.thrust_tilt) if even.pwm else None
    if pair is not None and pair.agreement > SURE_CORRELATION:
        step = np.sqrt(pair.ratio) / RATE
        if not 1 / 4 < step * log.rate < 4:
            text = f"roll and pitch belong to the horizontal acceleration if rows are {step:.2g} s apart"
            yield refuse("t", f"{text}, not {1 / log.rate:.2g} s: state the unit of time")


def _check_swapped_height(moves: LoggedMotion) -> Iterator[Finding]:
    """Yield a finding if x or y follows the thrust command and z does not."""
    along = {name: [part[:, k] for part in moves.acceleration] for k, name in enumerate("xyz")}
    if _best_lag(moves.pwm, along.pop("z"))[1] > 0.3:
        return
    for axis, values in along.items():
        if np.concatenate(values).std() > 0.3 and _best_lag(moves.pwm, values)[1] > 0.7:
            yield refuse(
                "z", f"{axis} moves up and down with the thrust command and z does not: they are swapped"
            )


# Names of a quaternion's numbers, what they may be instead, and where w, x, y, z lie in what was read then.
_ORDERS = (("qw, qx, qy, qz", "x, y, z, w", (3, 0, 1, 2)), ("qx, qy, qz, qw", "w, x, y, z", (1, 2, 3, 0)))


def _check_quaternion(moves: LoggedMotion) -> Iterator[Finding]:
    """Yield a finding if the attitude is consistent with the quaternion's numbers in another order."""
    yaw_roll_pitch = np.concatenate(moves.attitude)[:, [2, 0, 1]]
    numbers = Rotation.from_euler("ZXY", yaw_roll_pitch).as_quat(scalar_first=True)
    lean = np.concatenate(moves.lean)
    missed = _unexplained(numbers, lean)
    for named, order, places in _ORDERS:
        other = _unexplained(numbers[:, places], lean)
        if other < 0.5 * min(1.0, missed):
            text = (
                f"{named} follow the horizontal acceleration only if their numbers lie in the order {order}"
            )
            yield refuse("qw, qx, qy, qz", f"{text}: exchange the columns, or use a mapping file")
        elif order == "x, y, z, w" and np.median(np.abs(numbers[:, 0])) < LEAST_QW and missed > 0.5 * other:
            text = (
                "qw stays near 0: the vehicle faces -x throughout, or the order of the numbers is x, y, z, w"
            )
            yield limit("qw, qx, qy, qz", text)


def _unexplained(quaternion: np.ndarray, lean: np.ndarray) -> float:
    """Return the share of the variance of `lean` (m,) that attitudes (m, 4), w first, do not explain."""
    x, y, z = Rotation.from_quat(quaternion, scalar_first=True).apply([0.0, 0.0, 1.0]).T
    error = lean - (x + 1j * y) / np.maximum(z, 0.2)
    return float(np.var(error) / max(np.var(lean), 1e-12))


def _check_standing(log: FlightLog) -> Iterator[Finding]:
    """Yield a finding if the vehicle is on the ground with its motors running."""
    rows = runs(standing(log) & (log.command[:, 0] > MOTORS_OFF))
    seconds = [log.t[b - 1] - log.t[a] for a, b in rows]
    if sum(seconds) > STANDS:
        begin = log.t[rows[int(np.argmax(seconds))][0]]
        text = (
            f"stands for {sum(seconds):.1f} s with its motors running, most of it from t = {begin:.2f} s on"
        )
        yield info("cmd_thrust_pwm", f"{text}; this does not count as flight")


def _check_thrust(moves: LoggedMotion) -> Iterator[Finding]:
    if np.concatenate(moves.force).std() < 0.3:
        return
    lag, correlation = _best_lag(moves.pwm, moves.force)
    pwm, lift = moves.pwm, [part[:, 2] for part in moves.acceleration]
    if correlation < 0.8 and _best_lag([-p for p in pwm], lift)[1] > 0.7 and _best_lag(pwm, lift)[1] < 0.3:
        yield refuse(
            "z", "height falls when thrust is commanded: z must point up (and cmd_thrust_pwm mean thrust)"
        )
    elif correlation < 0.3:
        yield limit(
            "cmd_thrust_pwm",
            f"vertical motion hardly follows the thrust command (correlation {correlation:.2f})",
        )
    else:
        yield from _check_delay("thrust", "cmd_thrust_pwm", lag, correlation)


def _check_attitude(moves: LoggedMotion) -> Iterator[Finding]:
    pair = _compare_signals(moves.tilt, moves.thrust_tilt)
    if pair is None:
        yield limit("roll, pitch", "too little tilt to check the signs and the unit of roll and pitch")
        return
    yield from _check_convention(pair, "roll and pitch", "the horizontal acceleration")


def _check_attitude_commands(moves: LoggedMotion) -> Iterator[Finding]:
    commanded_tilt, tilt = moves.commanded_tilt, moves.tilt
    if all(np.isnan(part.real).all() and np.isnan(part.imag).all() for part in commanded_tilt):
        return
    lag = _best_lag(commanded_tilt, tilt)[0]
    shift = round(abs(lag) * RATE)
    if shift:
        commanded_tilt = [a[:-shift] if lag > 0 else a[shift:] for a in commanded_tilt]
        tilt = [a[shift:] if lag > 0 else a[:-shift] for a in tilt]
    pair = _compare_signals(commanded_tilt, tilt)
    if pair is None:
        return
    wrong = list(_check_convention(pair, "cmd_roll and cmd_pitch", "the attitude"))
    yield from wrong
    if not wrong and pair.agreement > LEAST_CORRELATION:
        yield from _check_delay("attitude", "cmd_roll, cmd_pitch", lag, pair.agreement)


@dataclasses.dataclass(frozen=True)
class _Agreement:
    """Correlation of a complex signal with another and with its mirror image, and ratio of their sizes."""

    straight: complex
    mirrored: complex
    ratio: float  # of the second to the first
    axis: str | None  # "x" or "y" when only that one moves, so that mirror and turn cannot be told apart

    @property
    def agreement(self) -> float:
        return max(abs(self.straight), abs(self.mirrored))


def _compare_signals(
    first: list[np.ndarray], second: list[np.ndarray], excited: float = LEAST_EXCITATION
) -> _Agreement | None:
    """Return the agreement of two signals, without NaN axes; None if the second hardly moves."""
    a = np.concatenate([x - x.mean() for x in first])
    b = np.concatenate([x - x.mean() for x in second])
    if np.isnan(a.real).any() or np.isnan(b.real).any():
        a, b = 1j * np.nan_to_num(a.imag), 1j * np.nan_to_num(b.imag)
    if np.isnan(a.imag).any() or np.isnan(b.imag).any():
        a, b = np.nan_to_num(a.real) + 0j, np.nan_to_num(b.real) + 0j
    if b.size == 0:
        return None
    # Noise of the derived second signal may pass for motion where the first, less noisy, shows none.
    strength_a, strength_b = (np.sqrt(np.mean(np.abs(x) ** 2)) for x in (a, b))
    if strength_b < excited or (strength_a < excited and strength_b < 3 * excited):
        return None
    size = np.sqrt(np.sum(np.abs(a) ** 2) * np.sum(np.abs(b) ** 2))
    if size == 0:
        return None
    axis = None
    for name, part, other in (("x", b.real, b.imag), ("y", b.imag, b.real)):
        if np.mean(other**2) < 0.02 * np.mean(part**2):
            axis = name
    # Complex correlation <a, b> / (|a| |b|), with the mirror image conj(a) instead of a, and ratio |b| / |a|.
    ratio = np.sqrt(np.sum(np.abs(b) ** 2) / np.sum(np.abs(a) ** 2))
    return _Agreement(complex(np.vdot(a, b) / size), complex(np.dot(a, b) / size), float(ratio), axis)


def _check_convention(pair: _Agreement, what: str, against: str) -> Iterator[Finding]:
    """Yield findings on signs, axes and unit of the columns `what`, compared with `against`."""
    if pair.agreement < LEAST_CORRELATION:
        yield limit(what, f"{what} agree poorly with {against} (correlation {pair.agreement:.2f})")
        return
    mirrored = abs(pair.mirrored) > abs(pair.straight) + 0.2
    turn = float(np.angle(pair.mirrored if mirrored else pair.straight))
    ratio = f"{against} is {pair.ratio:.2g} times the value that {what} imply"
    if mirrored:
        yield refuse(what, f"{what} mirror {against}: {_describe_mirror(what, turn)}, or x and y are")
    elif abs(turn) > WRONG_TURN:
        yield refuse(
            what, f"{what} are turned by {np.degrees(turn):.0f} deg against {against}: {_describe_turn(turn)}"
        )
    elif not 1 / MOST_RATIO < pair.ratio < MOST_RATIO:
        unit = "degrees" if pair.ratio < 1 else f"{against} in degrees"
        yield refuse(what, f"{ratio}: {unit} taken for radians?")
    elif abs(turn) > SUSPICIOUS_TURN and pair.axis is None:
        yield limit(what, f"{what} are turned by {np.degrees(turn):.0f} deg about z against {against}")
    elif not 0.5 < pair.ratio < 2:
        yield limit(what, ratio)


def _describe_mirror(what: str, turn: float) -> str:
    prefix = "cmd_" if what.startswith("cmd") else ""
    if abs(turn) < np.pi / 4:
        return f"{prefix}roll has the wrong sign"
    if abs(turn) > 3 * np.pi / 4:
        return f"{prefix}pitch has the wrong sign"
    return f"{prefix}pitch and {prefix}roll are swapped"


def _describe_turn(turn: float) -> str:
    if abs(turn) > 3 * np.pi / 4:
        return "both signs are wrong, or the frames are turned about z"
    return "the columns are swapped and one sign is wrong, or the frames are turned about z"


def _check_delay(response: str, channel: str, lag: float, correlation: float) -> Iterator[Finding]:
    text = f"{response} follows its command after {1e3 * lag:.0f} ms (correlation {correlation:.2f})"
    if lag < -LONGEST_LEAD and correlation > LEAST_CORRELATION:
        yield limit(
            channel, f"{response} leads its command by {-1e3 * lag:.0f} ms: the commands are stamped too late"
        )
    elif lag > LONGEST_DELAY and correlation > LEAST_CORRELATION:
        yield limit(channel, f"{text}: the commands are stamped too early, or are not the flown ones")
    else:
        yield info(channel, text)


def _best_lag(cause: list[np.ndarray], effect: list[np.ndarray]) -> tuple[float, float]:
    """Return the delay [s] of `effect` against `cause` with the largest correlation, and that correlation."""
    best = (0.0, -1.0)
    for rows in range(-round(0.15 * RATE), round(LONGEST_LAG * RATE) + 1):
        first = [c[: len(c) - rows] if rows >= 0 else c[-rows:] for c in cause]
        second = [e[rows:] if rows >= 0 else e[:rows] for e in effect]
        if np.iscomplexobj(first[0]):
            pair = _compare_signals(first, second, excited=0.0)
            value = -1.0 if pair is None else pair.agreement
        else:
            value = _correlation(np.concatenate(first), np.concatenate(second))
        if value > best[1]:
            best = (rows / RATE, value)
    return best


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Return the correlation of two signals (m,), 0 where one is constant, or the first is not logged."""
    a, b = a - a.mean(), b - b.mean()
    squares = float(a @ a), float(b @ b)
    if 0.0 in squares or not np.isfinite(squares[0]):
        return 0.0
    return float(a @ b) / math.sqrt(squares[0] * squares[1])
