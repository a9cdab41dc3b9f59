"""Do the streams of a flight agree in time? Offsets between position, attitude and commands.

Attitude against position: horizontal acceleration is thrust per mass times the tilt of its axis, so that a
late attitude shows as a part of the acceleration proportional to the tilt's rate; a tracked point above the
centre of mass shows as one proportional to its second derivative. Commands against attitude: in one flight a
late command and a slow loop look alike, so offsets are those of a flight against the others, which share one
impulse response. The same is not done for thrust: the controller answers vertical disturbances so much that
the offsets found would be its own.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import stats
from scipy.signal import savgol_filter

from inclined_landing.eval.logs.log import FlightLog
from inclined_landing.models.attitude import rotations
from inclined_landing.models.errors import UserError

RATE = 100.0  # rows per second
SMOOTHING = 0.1  # s to either side, the same for all streams
RESPONSE = 0.4  # s of the impulse response from command to motion
BLOCK = 2.0  # s of a flight that are left out together for the intervals
FEWEST = 6  # blocks
FARTHEST = 0.06  # s that attitude is looked for beside position
GRAVITY = 9.81  # m/s2; its error is one of the scale, which is fitted


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A number with the half-width of its 95 % interval."""

    value: float
    half: float


@dataclasses.dataclass(frozen=True)
class Pose:
    """How the measured attitude fits the measured position of one flight."""

    late: Estimate  # s by which attitude is dated later than position
    above: Estimate  # m by which the tracked point lies above the centre of mass


def pose(log: FlightLog) -> Pose:
    """Lateness of attitude against position, and height of the tracked point.

    Raises UserError when there is too little flight with yaw, roll and pitch.
    """
    motion = log.resampled(RATE)
    smooth = _smoother(motion)
    if np.isnan(motion.attitude).any():
        raise UserError(f"{log.name}: roll, pitch or yaw was not logged")
    acceleration, speed = smooth(motion.position, 2), smooth(motion.position, 1)
    measured = rotations(motion.attitude)[:, :, 2]
    b = np.concatenate([acceleration[:, 0], acceleration[:, 1]])

    def system(late: float) -> np.ndarray:
        """Columns: tilt and height; drag and a tilt of the measured attitude, in x and in y."""
        axis = np.stack([np.interp(motion.t + late, motion.t, x) for x in measured.T], axis=1)
        tilt, bending = smooth(axis), smooth(axis, 2)
        force = (acceleration[:, 2] + GRAVITY) / tilt[:, 2]
        own = [np.stack([force * tilt[:, k], bending[:, k]], axis=1) for k in (0, 1)]
        drag = [np.column_stack([speed[:, k], np.ones(len(speed))]) for k in (0, 1)]
        none = np.zeros_like(drag[0])
        return np.vstack([np.hstack([own[0], drag[0], none]), np.hstack([own[1], none, drag[1]])])

    flown = np.tile(_flown(motion), 2)
    blocks = np.tile(np.floor(motion.t / BLOCK).astype(int), 2)

    shifts = np.arange(-FARTHEST, FARTHEST + 1e-9, 0.5 / RATE)
    systems = [np.column_stack([system(shift), b]) for shift in shifts]
    chosen = np.unique(blocks[flown])
    # Gram matrices by shift and block: leaving a block out is a subtraction.
    grams = np.array(
        [[a[own].T @ a[own] for own in ((blocks == k) & flown for k in chosen)] for a in systems]
    )

    def solve(keep: np.ndarray) -> np.ndarray:
        total = grams[:, np.isin(chosen, np.unique(blocks[keep]))].sum(axis=1)
        x = np.linalg.solve(total[:, :-1, :-1], total[:, :-1, -1:])[..., 0]
        left = total[:, -1, -1] - (x * total[:, :-1, -1]).sum(axis=1)
        k = int(np.clip(np.argmin(left), 1, len(shifts) - 2))
        before, at, after = left[k - 1 : k + 2]  # the parabola through the best shift and its neighbours
        part = float(np.clip(0.5 * (before - after) / (before - 2.0 * at + after), -1.0, 1.0))
        height = x[:, 1] / x[:, 0]
        return np.array([shifts[k] + 0.5 / RATE * part, np.interp(k + part, range(len(shifts)), height)])

    return Pose(*_jackknife(solve, blocks, flown, log.name))


def commands(logs: Sequence[FlightLog]) -> list[Estimate]:
    """Lateness [s] of the roll and pitch commands of every flight against the mean of all.

    Positive: dated later than in the other flights.
    Raises UserError with fewer than two flights, and where too little of one is flown.
    """
    if len(logs) < 2:
        raise UserError("offsets of commands are those against other flights: at least two are needed")
    flights = [_Response.of(log) for log in logs]
    late = np.zeros(len(flights))
    for _ in range(4):  # converges by a factor of ten each time where offsets are below the response's width
        kernel = _common(flights, late)
        late = late + np.array([f.solve(kernel, late[k], f.flown) for k, f in enumerate(flights)])
        late -= late.mean()
    kernel = _common(flights, late)
    result = []
    for k, f in enumerate(flights):

        def solve(keep: np.ndarray, f=f, k=k) -> np.ndarray:
            return np.array([late[k] + f.solve(kernel, late[k], keep)])

        result += _jackknife(solve, f.blocks, f.flown, f.name)
    return result


@dataclasses.dataclass(frozen=True)
class _Response:
    """Commanded and measured roll and pitch of one flight on an even grid of m rows."""

    name: str
    command: np.ndarray  # (2, m) rad
    motion: np.ndarray  # (2, m) rad
    flown: np.ndarray  # (2 m,) bool
    blocks: np.ndarray  # (2 m,)

    @staticmethod
    def of(log: FlightLog) -> _Response:
        even = log.resampled(RATE)
        smooth = _smoother(even)
        command, motion = even.command[:, 1:3], smooth(even.attitude[:, :2])
        if np.isnan(command).any() or np.isnan(motion).any():
            raise UserError(f"{log.name}: roll, pitch or their commands were not logged")
        flown = _flown(even)
        reach = round((RESPONSE + SMOOTHING) * RATE)
        flown[:reach] = flown[-reach:] = False
        blocks = np.floor(even.t / BLOCK).astype(int)
        return _Response(log.name, smooth(command).T, motion.T, np.tile(flown, 2), np.tile(blocks, 2))

    def delayed(self, late: float) -> np.ndarray:
        """Commands at the lags of the response (2 m, lags), as they would be without being `late`."""
        lags = np.arange(round(RESPONSE * RATE)) / RATE
        t = np.arange(self.command.shape[1]) / RATE
        return np.concatenate(
            [np.stack([np.interp(t - lag + late, t, u) for lag in lags], axis=1) for u in self.command]
        )

    def solve(self, kernel: np.ndarray, late: float, keep: np.ndarray) -> float:
        """How much later still [s]: the part of the motion that the predicted one's rate explains."""
        predicted = self.delayed(late) @ kernel
        rate = np.gradient(predicted.reshape(self.motion.shape), 1.0 / RATE, axis=1).ravel()
        first = np.repeat(np.eye(len(self.motion)), self.motion.shape[1], axis=0)
        a = np.column_stack([predicted, rate, first])[keep]
        x = np.linalg.lstsq(a, self.motion.ravel()[keep], rcond=None)[0]
        return float(x[1] / x[0]) if x[0] else 0.0


def _common(flights: Sequence[_Response], late: np.ndarray) -> np.ndarray:
    """The impulse response that all flights share, smooth and ending at zero."""
    n = round(RESPONSE * RATE)
    bend = np.diff(np.eye(n), n=2, axis=0)
    gram, right = np.zeros((n, n)), np.zeros(n)
    for f, shift in zip(flights, late):
        u = f.delayed(shift)[f.flown]
        y = f.motion.ravel()[f.flown]
        u, y = u - u.mean(axis=0), y - y.mean()
        gram += u.T @ u
        right += u.T @ y
    return np.linalg.solve(gram + np.trace(gram) / n * (1e-2 * bend.T @ bend + 1e-6 * np.eye(n)), right)


def _smoother(log: FlightLog):
    window = 2 * round(SMOOTHING * RATE) + 1
    if len(log) < 2 * window:
        raise UserError(f"{log.name}: {log.duration:.2f} s; too short to compare its streams")

    def smooth(values: np.ndarray, order: int = 0) -> np.ndarray:
        # One filter for every derivative: what it takes away must be missing on both sides.
        values = savgol_filter(values, window, 3, axis=0)
        if order == 1:
            return np.gradient(values, 1.0 / RATE, axis=0)
        if order == 2:
            return np.pad(np.diff(values, 2, axis=0), ((1, 1), (0, 0))) * RATE**2
        return values

    return smooth


def _flown(log: FlightLog) -> np.ndarray:
    """Rows under thrust and without contact, away from their ends and those of the record."""
    high = log.command[:, 0] > 0.5 * np.nanmedian(log.command[:, 0])
    if log.contact is not None:
        high &= ~log.contact
    edge = round(0.5 * RATE)
    low = np.convolve(~high, np.ones(2 * edge + 1), "same") > 0.5
    low[:edge] = low[-edge:] = True
    return ~low


def _jackknife(solve, blocks: np.ndarray, keep: np.ndarray, name: str) -> list[Estimate]:
    """What `solve` finds on the rows `keep`, intervals by leaving blocks out."""
    chosen = np.unique(blocks[keep])
    n = len(chosen)
    if n < FEWEST:
        raise UserError(f"{name}: {n * BLOCK:.0f} s of flight; {FEWEST * BLOCK:.0f} s are needed")
    whole = solve(keep)
    without = np.array([solve(keep & (blocks != k)) for k in chosen])
    error = np.sqrt((n - 1) / n * ((without - without.mean(axis=0)) ** 2).sum(axis=0))
    return [Estimate(float(v), float(h)) for v, h in zip(whole, stats.t.ppf(0.975, n - 1) * error)]
