"""The errors of a perfect model: what noise and disturbance make of a window, and how large these are.

The error of a perfect model over a window is a line in time (unknown start position and velocity), plus
position noise, plus the double integral of an acceleration: white noise fed in through the measured attitude,
and the disturbance (process noise), an Ornstein-Uhlenbeck process. Errors in roll, pitch and yaw are white
noise, the free response of their loop, and its response to a disturbance in angular acceleration. Errors in
the requests of the motors are white noise and a disturbance of their own, with no start state.

Whitening projects the start state out and applies the Cholesky factor of the covariance. The disturbance's
standard deviation and correlation time and the variance of the measurement noise maximise the likelihood of
all windows of all flights, in every channel; intervals are from a bootstrap over flights.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, null_space, solve_triangular

from inclined_landing.models.threads import two_at_a_time
from inclined_landing.models.vehicle import Vehicle

# The likelihood is evaluated on a grid. Correlation times [s] reach from a few rows, where a disturbance is
# hardly distinguished from noise, to a few windows of 0.6 s, where it resembles a constant.
TIMES = np.geomspace(0.05, 1.6, 6)
MEDIUM_TIME = 0.3  # s, in the middle of these (in logarithms): where there is nothing to estimate it from
# Sizes, as shares of the size at which the disturbance alone would explain the errors; the least is none.
SIZE_FACTORS = np.geomspace(0.02, 3.0, 36)
NOISE_VARIANCES = np.geomspace(0.5, 8.0, 13)  # over those estimated from the log, which a filter may lower
BOOTSTRAP_SAMPLES = 200
# Medians of the mean squares of a flight's windows, as which larger ones count. Good errors of ten degrees of
# freedom, fewer than any window has at 50 Hz or more, are as large in one window of 20 000.
OUTLYING = 4.0


@dataclasses.dataclass(frozen=True)
class ErrorResponses:
    """Linear responses of a window's error to noise and disturbance, for one length and vehicle."""

    # C channels: the pose (6), and where the motors' requests are logged their differences (3).
    projection: tuple[np.ndarray, ...]  # of C (rows, q): onto what no start state explains, q = rows - 2
    impulse: tuple[np.ndarray, ...]  # of C (rows, rows): of the error to a unit acceleration in every step
    dt: float

    @staticmethod
    @functools.lru_cache(maxsize=16)  # flights of one rate have the same
    def of(rows: int, dt: float, vehicle: Vehicle, requests: bool = False) -> ErrorResponses:
        """Return the responses for windows of `rows` samples dt apart, attitude loops as of `vehicle`.

        requests: whether there are channels of motor requests.
        """
        # Step responses h(t), to an acceleration that begins at 0:
        #   position t^2/2;  tilt (1 - m_0(t)) / (a b);  yaw [t - (1 - exp(-B t)) / B] / B
        # and responses to one that is held over a step dt:  h(t) - h(t - dt)
        t = np.arange(rows) * dt
        since = t[:, None] - t[None, :]
        begun, over = np.maximum(since, 0.0), np.maximum(since - dt, 0.0)
        loop, bandwidth = _AttitudeLoop.of(vehicle), vehicle.attitude_yaw_bandwidth
        moved = 0.5 * begun * begun - 0.5 * over * over
        tilted = loop.step_response(begun) - loop.step_response(over)
        turned = _yaw_step_response(begun, bandwidth) - _yaw_step_response(over, bandwidth)
        # An unknown start state adds these functions of time to a position, a tilt and the yaw, ...
        line = np.stack([np.ones(rows), t], axis=1)
        tilt = np.stack(loop.free_responses(t), axis=1)
        turn = np.stack([np.ones(rows), np.exp(-bandwidth * t)], axis=1)
        # ... and the projections that leave nothing of it.
        no_line, no_tilt, no_turn = (null_space(x.T) for x in (line, tilt, turn))
        projection = [no_line] * 3 + [no_tilt] * 2 + [no_turn]
        impulse = [moved] * 3 + [tilted] * 2 + [turned]
        if requests:  # no start state; two rows fewer, as many numbers as the other channels have
            projection += [np.eye(rows, rows - 2)] * 3
            impulse += [np.eye(rows)] * 3
        return ErrorResponses(tuple(projection), tuple(impulse), dt)

    def noise(self, channel: int, noise: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
        """Return the covariance (q, q) of a channel's error by measurement noise (see `Whitening.of`)."""
        # N' (sigma^2 1 + s^2 H H') N,  N the projection, H the impulse responses
        free = self.projection[channel]
        covariance = noise[channel] ** 2 * np.eye(free.shape[1])
        if channel < 3:
            fed = acceleration[channel] * free.T @ self.impulse[channel]
            covariance += fed @ fed.T
        return covariance

    def disturbance(self, channel: int, time: float) -> np.ndarray:
        """Return the error covariance (q, q) of a channel by a unit disturbance of a correlation time [s]."""
        # N' H R H' N,  R_ij = exp(-|t_i - t_j| / T)
        fed = self.projection[channel].T @ self.impulse[channel]
        steps = np.arange(fed.shape[1]) * self.dt
        return fed @ np.exp(-np.abs(steps[:, None] - steps) / time) @ fed.T


class _AttitudeLoop(NamedTuple):
    """The attitude loop, x'' + zeta (a + b) x' + a b x = 0, by its poles -m +- h."""

    mean: float  # m = zeta (a + b) / 2 [1/s]
    half: complex  # h, h^2 = m^2 - a b [1/s]
    stiffness: float  # a b [1/s2]

    @staticmethod
    def of(vehicle: Vehicle) -> _AttitudeLoop:
        """Return the loop of a vehicle, a = 1 / tau its time constant and b its bandwidth."""
        a, b = 1.0 / vehicle.attitude_time_constant, vehicle.attitude_bandwidth
        mean = 0.5 * vehicle.attitude_damping * (a + b)
        half = np.sqrt(complex(mean * mean - a * b))
        # Equal poles are taken as nearly equal ones, for which the formulas below hold.
        return _AttitudeLoop(mean, half if abs(half) > 1e-3 * mean else 1e-3 * mean, a * b)

    def free_responses(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the angles after times t [s] by an initial angle of 1 rad, and by a rate of 1 rad/s."""
        # m_1 = (exp((h - m) t) - exp(-(h + m) t)) / 2h,  m_0 = (exp((h - m) t) + exp(-(h + m) t)) / 2 + m m_1
        near, far = np.exp((self.half - self.mean) * t), np.exp(-(self.half + self.mean) * t)
        by_rate = ((near - far) / (2.0 * self.half)).real
        return (0.5 * (near + far)).real + self.mean * by_rate, by_rate

    def step_response(self, t: np.ndarray) -> np.ndarray:
        """Return the angle after times t [s] by an angular acceleration of 1 rad/s2 that begins at 0."""
        by_angle, _ = self.free_responses(t)
        return (1.0 - by_angle) / self.stiffness


def _yaw_step_response(t: np.ndarray, bandwidth: float) -> np.ndarray:
    """Return the yaw after times t [s] by an angular acceleration of 1 rad/s2 that begins at 0."""
    return (t - (1.0 - np.exp(-bandwidth * t)) / bandwidth) / bandwidth


@dataclasses.dataclass(frozen=True)
class Whitening:
    """Whitening matrices (inverse Cholesky factors) for windows of one length and one noise model."""

    matrices: np.ndarray  # (C, q, rows): q = rows - 2 white numbers of unit variance for each channel
    unit_response: np.ndarray  # (C, q) the whitened error of a unit amplitude of each channel

    @staticmethod
    def of(
        error_responses: ErrorResponses,
        noise: np.ndarray,
        acceleration: np.ndarray,
        disturbances: NoiseModel = (),
    ) -> Whitening:
        """Return the whitening for noise (C,) of every channel and (3,) of the acceleration [m/s2].

        disturbances: those in every channel; empty: none.
        """
        # C = L L';  W = L^-1 N',  so that W e is white with unit variance
        whitening = []
        for channel, free in enumerate(error_responses.projection):
            covariance = error_responses.noise(channel, noise, acceleration)
            if disturbances and (one := disturbances[channel]).size > 0.0:
                covariance = covariance + one.size**2 * error_responses.disturbance(channel, one.time)
            factor = cholesky(covariance, lower=True)
            whitening.append(solve_triangular(factor, free.T, lower=True))
        matrices = np.array(whitening)
        # The errors along a window that `amplitudes` measures: a position by a constant acceleration t^2/2, a
        # constant roll or pitch, a yaw that drifts to 1 at the end, a constant difference of requests.
        t = np.arange(matrices.shape[2]) * error_responses.dt
        accelerated, constant, drifting = 0.5 * t * t, np.ones(len(t)), t / t[-1]
        requests = len(matrices) - 6
        of_unit = [accelerated] * 3 + [constant] * 2 + [drifting] + [constant] * requests
        return Whitening(matrices, np.einsum("cqk,ck->cq", matrices, np.array(of_unit)))

    def __call__(self, windows: np.ndarray) -> np.ndarray:
        """Return the white errors (w, C, q) of windows (w, rows, C)."""
        return np.matmul(self.matrices, windows.transpose(2, 1, 0)).transpose(2, 0, 1)

    def amplitudes(self, white: np.ndarray) -> np.ndarray:
        """Return the constant acceleration [m/s2] or angle [rad] (w, C) that fits each window's error."""
        # Generalised least squares with the white unit response r:  x = r'e / r'r,  var x = 1 / r'r
        return np.einsum("wcq,cq->wc", white, self.unit_response) / self.power

    @property
    def power(self) -> np.ndarray:
        """Return the inverse variance (C,) of `amplitudes` under noise and disturbance alone."""
        return np.einsum("cq,cq->c", self.unit_response, self.unit_response)


class ChannelNoise(NamedTuple):
    """Noise and Ornstein-Uhlenbeck disturbance of one channel; by default what the log shows, and none."""

    size: float = 0.0  # m/s2, rad/s2, requests 1: standard deviation
    size_ci95: tuple[float, float] = (0.0, 0.0)
    time: float = MEDIUM_TIME  # s, correlation time
    time_ci95: tuple[float, float] = (MEDIUM_TIME, MEDIUM_TIME)
    noise_ratio: float = 1.0  # measurement noise over that estimated from each log, at least 0.7


NoiseModel = tuple[ChannelNoise, ...]  # of every channel


def estimate(
    flights: Sequence,
    errors: Sequence[np.ndarray],
    weights: Sequence[np.ndarray] | None = None,
) -> NoiseModel:
    """Return the maximum-likelihood noise model of errors (m, C), measured minus predicted, of `flights`.

    These are `MeasuredFlight`s. weights (w, C) of the windows of each: inverse variance ratio by other
    errors; None: 1.
    """
    windows = [f.cut(e) for f, e in zip(flights, errors)]
    if weights is not None:
        windows = [w * np.sqrt(counts)[:, None] for w, counts in zip(windows, weights)]
    channels = range(flights[0].channels)
    return tuple(two_at_a_time(lambda c: _fit_channel(flights, windows, c), channels))


class _Modes(NamedTuple):
    """A flight's errors in one channel along the modes of a disturbance of one correlation time."""

    variances: np.ndarray  # (q,) by a disturbance of unit size, those by noise being 1
    squares: np.ndarray  # (q,) mean squares over the windows
    windows: int


def _fit_channel(flights, windows, channel: int) -> ChannelNoise:
    """Return the noise and disturbance of a channel, with intervals by a bootstrap over flights."""
    parts = [_simultaneous_modes(f, w, channel) for f, w in zip(flights, windows) if f.logged[channel]]
    if not parts:
        return ChannelNoise()
    # The size at which the disturbance alone, of a medium correlation time, would explain the errors.
    medium = [part[len(TIMES) // 2] for part in parts]
    typical = np.median([modes.squares.mean() / modes.variances.mean() for modes in medium])
    sizes = SIZE_FACTORS * np.sqrt(max(typical, 1e-12))
    by_flight = np.stack([_log_likelihood(part, sizes) for part in parts])  # (f, times, noise, sizes)
    total = by_flight.sum(axis=0)
    at_time, at_noise, at_size = np.unravel_index(int(np.argmax(total)), total.shape)
    size = _parabola_vertex(np.log(sizes), total[at_time, at_noise], at_size)
    time = _parabola_vertex(np.log(TIMES), total[:, at_noise, at_size], at_time)
    noise_ratio = float(np.sqrt(NOISE_VARIANCES[at_noise]))
    # Maximise the likelihood in every bootstrap sample of the flights, the noise variance fixed.
    rng = np.random.default_rng((0, channel))
    counts = rng.multinomial(len(parts), np.full(len(parts), 1.0 / len(parts)), BOOTSTRAP_SAMPLES)
    drawn = np.tensordot(counts, by_flight[:, :, at_noise, :], axes=1)  # (BOOTSTRAP_SAMPLES, times, sizes)
    places = [np.unravel_index(int(np.argmax(x)), x.shape) for x in drawn]
    time_low, time_high = np.quantile([TIMES[k] for k, _ in places], [0.025, 0.975]).tolist()
    size_low, size_high = np.quantile([sizes[k] for _, k in places], [0.025, 0.975]).tolist()
    if at_size == 0:  # the smallest size of the grid: no disturbance
        return ChannelNoise(0.0, (0.0, size_high), time, (time_low, time_high), noise_ratio)
    size_ci95 = (min(size, size_low), max(size, size_high))
    time_ci95 = (min(time, time_low), max(time, time_high))
    return ChannelNoise(size, size_ci95, time, time_ci95, noise_ratio)


def _simultaneous_modes(flight, windows: np.ndarray, channel: int) -> list[_Modes]:
    """Return a flight's errors along the modes of noise and disturbance, for every correlation time.

    The modes are the generalised eigenvectors, which diagonalise the covariances of both together.
    """
    # D v = lambda N v,  v'N v = 1:  a mode has the variance  noise + size^2 lambda.  With N = L L' these are
    # the eigenvectors u of L^-1 D L'^-1,  v = L'^-1 u.
    error_responses = flight.error_responses
    noise = error_responses.noise(channel, flight.noise, flight.acceleration_noise)
    inverse = np.linalg.inv(np.linalg.cholesky(noise))
    free = windows[..., channel] @ error_responses.projection[channel] @ inverse.T
    result = []
    for time in TIMES:
        disturbance = inverse @ error_responses.disturbance(channel, float(time)) @ inverse.T
        variance, modes = np.linalg.eigh(disturbance)  # unlike scipy's, in two threads at once
        result.append(_Modes(np.maximum(variance, 0.0), _mean_squares(free @ modes), len(windows)))
    return result


def _mean_squares(values: np.ndarray) -> np.ndarray:
    """Return mean squares (q,) of values (w, q), outlying windows winsorised."""
    squares = values**2
    return (squares * winsorised(squares.mean(axis=1))[:, None]).mean(axis=0)


def winsorised(squares: np.ndarray) -> np.ndarray:
    """Return the weights (w,) at which outlying mean squares (w,) count as OUTLYING times their median."""
    most = OUTLYING * np.median(squares) + 1e-300
    return np.minimum(1.0, most / np.maximum(squares, 1e-300))


def _log_likelihood(part: Sequence[_Modes], sizes: np.ndarray) -> np.ndarray:
    """Return the log-likelihood (times, noise, sizes) of one flight."""
    # log p = -1/2 w sum_q [log(n + s^2 lambda_q) + m_q / (n + s^2 lambda_q)],  m_q the mean square of mode q
    likelihoods = []
    for variance, squares, count in part:
        total = NOISE_VARIANCES[:, None, None] + sizes[None, :, None] ** 2 * variance
        likelihoods.append(-0.5 * count * (np.log(total) + squares / total).sum(axis=2))
    return np.stack(likelihoods)


def _parabola_vertex(x: np.ndarray, y: np.ndarray, k: int) -> float:
    """Return exp of the vertex of the parabola through the maximum and its neighbours; x: logarithms."""
    if k in (0, len(x) - 1):
        return float(np.exp(x[k]))
    bend = y[k - 1] - 2.0 * y[k] + y[k + 1]
    shift = 0.5 * (y[k - 1] - y[k + 1]) / bend if bend < 0.0 else 0.0
    return float(np.exp(x[k] + np.clip(shift, -0.5, 0.5) * (x[1] - x[0])))
