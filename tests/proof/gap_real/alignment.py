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
FEWEST_BLOCKS = 6  # blocks
LARGEST_SHIFT = 0.06  # s that attitude is looked for beside position
GRAVITY = 9.81  # m/s2; its error is one of the scale, which is fitted


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A number with the half-width of its 95 % interval."""

    value: float
    half_width: float


@dataclasses.dataclass(frozen=True)
class PoseAlignment:
    """Time offset and lever arm between the measured attitude and position of one flight."""

    delay: Estimate  # s by which attitude is dated later than position
    height: Estimate  # m by which the tracked point lies above the centre of mass


def align_pose(log: FlightLog) -> PoseAlignment:
    """Return the delay of attitude against position, and the height of the tracked point.

    Raises UserError when there is too little flight with yaw, roll and pitch.
    """
    motion = log.resampled(RATE)
    smooth = _make_smoother(motion)
    if np.isnan(motion.attitude).any():
        raise UserError(f"{log.name}: roll, pitch or yaw was not logged")
    acceleration, speed = smooth(motion.position, 2), smooth(motion.position, 1)
    measured = rotations(motion.attitude)[:, :, 2]
    b = np.concatenate([acceleration[:, 0], acceleration[:, 1]])

    # With f = (a_z + g) / b_z the specific force and b(t) the body's z axis in the world:
    #   a_x(t) = k (f b_x + h d2b_x/dt2)(t + delay) + c v_x + a_0,   the same for y,
    # where h is the height of the tracked point above the centre of mass and -c the drag rate.
    def system(delay: float) -> np.ndarray:
        """Return the regressors (2 m, 6): tilt and height; drag and attitude offset in x and in y."""
        axis = np.stack([np.interp(motion.t + delay, motion.t, x) for x in measured.T], axis=1)
        tilt, bending = smooth(axis), smooth(axis, 2)
        force = (acceleration[:, 2] + GRAVITY) / tilt[:, 2]
        rows = [np.stack([force * tilt[:, k], bending[:, k]], axis=1) for k in (0, 1)]
        drag = [np.column_stack([speed[:, k], np.ones(len(speed))]) for k in (0, 1)]
        none = np.zeros_like(drag[0])
        return np.vstack([np.hstack([rows[0], drag[0], none]), np.hstack([rows[1], none, drag[1]])])

    in_flight = np.tile(_in_free_flight(motion), 2)
    blocks = np.tile(np.floor(motion.t / BLOCK).astype(int), 2)

    shifts = np.arange(-LARGEST_SHIFT, LARGEST_SHIFT + 1e-9, 0.5 / RATE)
    systems = [np.column_stack([system(shift), b]) for shift in shifts]
    chosen = np.unique(blocks[in_flight])
    # Gram matrices by shift and block: leaving a block out is a subtraction.
    grams = np.array(
        [[a[rows].T @ a[rows] for rows in ((blocks == k) & in_flight for k in chosen)] for a in systems]
    )

    def solve(rows: np.ndarray) -> np.ndarray:
        total = grams[:, np.isin(chosen, np.unique(blocks[rows]))].sum(axis=1)
        x = np.linalg.solve(total[:, :-1, :-1], total[:, :-1, -1:])[..., 0]
        residual = total[:, -1, -1] - (x * total[:, :-1, -1]).sum(axis=1)
        k = int(np.clip(np.argmin(residual), 1, len(shifts) - 2))
        # Minimum of the parabola through the best shift and its neighbours:
        # x = (r[-1] - r[1]) / (2 (r[-1] - 2 r[0] + r[1])) in steps.
        before, at, after = residual[k - 1 : k + 2]
        part = float(np.clip(0.5 * (before - after) / (before - 2.0 * at + after), -1.0, 1.0))
        height = x[:, 1] / x[:, 0]
        return np.array([shifts[k] + 0.5 / RATE * part, np.interp(k + part, range(len(shifts)), height)])

    return PoseAlignment(*_jackknife(solve, blocks, in_flight, log.name))


def align_commands(logs: Sequence[FlightLog]) -> list[Estimate]:
    """Return the delay [s] of each flight's roll and pitch commands against the mean of all flights.

    Positive: dated later than in the other flights.
    Raises UserError with fewer than two flights, and where too little of one is flown.
    """
    if len(logs) < 2:
        raise UserError("offsets of commands are those against other flights: at least two are needed")
    flights = [_Response.of(log) for log in logs]
    delay = np.zeros(len(flights))
    for _ in range(4):  # converges by a factor of ten each time where offsets are below the response's width
        kernel = _fit_impulse_response(flights, delay)
        delay = delay + np.array([f.solve(kernel, delay[k], f.in_flight) for k, f in enumerate(flights)])
        delay -= delay.mean()
    kernel = _fit_impulse_response(flights, delay)
    result = []
    for k, f in enumerate(flights):

        def solve(rows: np.ndarray, f=f, k=k) -> np.ndarray:
            return np.array([delay[k] + f.solve(kernel, delay[k], rows)])

        result += _jackknife(solve, f.blocks, f.in_flight, f.name)
    return result


@dataclasses.dataclass(frozen=True)
class _Response:
    """Commanded and measured roll and pitch of one flight on an even grid of m rows."""

    name: str
    command: np.ndarray  # (2, m) rad
    motion: np.ndarray  # (2, m) rad
    in_flight: np.ndarray  # (2 m,) bool
    blocks: np.ndarray  # (2 m,)

    @staticmethod
    def of(log: FlightLog) -> _Response:
        even = log.resampled(RATE)
        smooth = _make_smoother(even)
        command, motion = even.command[:, 1:3], smooth(even.attitude[:, :2])
        if np.isnan(command).any() or np.isnan(motion).any():
            raise UserError(f"{log.name}: roll, pitch or their commands were not logged")
        in_flight = _in_free_flight(even)
        reach = round((RESPONSE + SMOOTHING) * RATE)
        in_flight[:reach] = in_flight[-reach:] = False
        blocks = np.floor(even.t / BLOCK).astype(int)
        return _Response(log.name, smooth(command).T, motion.T, np.tile(in_flight, 2), np.tile(blocks, 2))

    def delayed(self, delay: float) -> np.ndarray:
        """Return the commands at the lags of the impulse response (2 m, lags), corrected for `delay`."""
        lags = np.arange(round(RESPONSE * RATE)) / RATE
        t = np.arange(self.command.shape[1]) / RATE
        return np.concatenate(
            [np.stack([np.interp(t - lag + delay, t, u) for lag in lags], axis=1) for u in self.command]
        )

    def solve(self, kernel: np.ndarray, delay: float, rows: np.ndarray) -> float:
        """Return the remaining delay [s], a Gauss-Newton step on the rate of the predicted motion."""
        # y(t) = g p(t + d) ~ g p(t) + g d dp/dt with p = h * u: d is the ratio of the two coefficients.
        predicted = self.delayed(delay) @ kernel
        rate = np.gradient(predicted.reshape(self.motion.shape), 1.0 / RATE, axis=1).ravel()
        first = np.repeat(np.eye(len(self.motion)), self.motion.shape[1], axis=0)
        a = np.column_stack([predicted, rate, first])[rows]
        x = np.linalg.lstsq(a, self.motion.ravel()[rows], rcond=None)[0]
        return float(x[1] / x[0]) if x[0] else 0.0


def _fit_impulse_response(flights: Sequence[_Response], delay: np.ndarray) -> np.ndarray:
    """Return the impulse response (lags,) common to all flights, by ridge regression on its curvature."""
    # Ridge regression: (U'U + t (1e-2 D'D + 1e-6 I)) h = U'y with D the second difference, t = tr(U'U) / n.
    n = round(RESPONSE * RATE)
    bend = np.diff(np.eye(n), n=2, axis=0)
    gram, right = np.zeros((n, n)), np.zeros(n)
    for f, shift in zip(flights, delay):
        u = f.delayed(shift)[f.in_flight]
        y = f.motion.ravel()[f.in_flight]
        u, y = u - u.mean(axis=0), y - y.mean()
        gram += u.T @ u
        right += u.T @ y
    return np.linalg.solve(gram + np.trace(gram) / n * (1e-2 * bend.T @ bend + 1e-6 * np.eye(n)), right)


def _make_smoother(log: FlightLog):
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


def _in_free_flight(log: FlightLog) -> np.ndarray:
    """Return a mask (m,) of the rows under thrust, without contact and away from edges of such stretches."""
    high = log.command[:, 0] > 0.5 * np.nanmedian(log.command[:, 0])
    if log.contact is not None:
        high &= ~log.contact
    edge = round(0.5 * RATE)
    low = np.convolve(~high, np.ones(2 * edge + 1), "same") > 0.5
    low[:edge] = low[-edge:] = True
    return ~low


def _jackknife(solve, blocks: np.ndarray, rows: np.ndarray, name: str) -> list[Estimate]:
    """Return the estimates that `solve` makes from `rows`, with intervals from leaving out one block at a
    time.
    """
    chosen = np.unique(blocks[rows])
    n = len(chosen)
    if n < FEWEST_BLOCKS:
        raise UserError(f"{name}: {n * BLOCK:.0f} s of flight; {FEWEST_BLOCKS * BLOCK:.0f} s are needed")
    estimate = solve(rows)
    without = np.array([solve(rows & (blocks != k)) for k in chosen])
    # Delete-one-block jackknife: var = (n - 1) / n sum_k (x_(k) - mean)^2, Student's t with n - 1 degrees.
    error = np.sqrt((n - 1) / n * ((without - without.mean(axis=0)) ** 2).sum(axis=0))
    return [Estimate(float(v), float(h)) for v, h in zip(estimate, stats.t.ppf(0.975, n - 1) * error)]
