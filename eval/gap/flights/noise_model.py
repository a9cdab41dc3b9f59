"""Noise model: measurement noise and disturbance (process noise), by maximum likelihood from window errors.

The disturbance is an Ornstein-Uhlenbeck acceleration in every channel. Its standard deviation and correlation
time and the variance of the measurement noise maximise the likelihood of all windows of all flights;
intervals are from a bootstrap over flights.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.linalg import eigh

from inclined_landing.eval.gap.flights.windows import MeasuredFlight

TIMES = np.geomspace(0.05, 1.6, 6)  # s
# Grid of sizes, as shares of the size at which the disturbance alone would explain the errors.
SIZE_FACTORS = np.geomspace(0.02, 3.0, 36)
NOISE_VARIANCES = np.geomspace(0.5, 8.0, 13)  # grid of noise variances over those estimated from the log
BOOTSTRAP_SAMPLES = 200


@dataclasses.dataclass(frozen=True)
class NoiseModel:
    """Ornstein-Uhlenbeck disturbance in x, y, z [m/s2], roll, pitch, yaw [rad/s2] and requests [1]."""

    size: np.ndarray  # (C,) standard deviation
    size_ci95: np.ndarray  # (2, C)
    time: np.ndarray  # (C,) s, correlation time
    time_ci95: np.ndarray  # (2, C)
    noise: np.ndarray  # (C,) measurement noise over that estimated from each log, at least 0.7

    @staticmethod
    def none(channels: int) -> NoiseModel:
        """Return zero disturbance and the noise estimated from the logs."""
        zero, time = np.zeros((2, channels)), np.full((2, channels), 0.3)
        return NoiseModel(zero[0], zero, time[0], time, np.ones(channels))


def estimate(
    flights: Sequence[MeasuredFlight],
    errors: Sequence[np.ndarray],
    weights: Sequence[np.ndarray] | None = None,
    seed: int = 0,
) -> NoiseModel:
    """Return the maximum-likelihood noise model of errors (m, C), measured minus predicted, of flights.

    weights (w, C) of the windows of every flight: inverse variance ratio by other errors; None: 1.
    """
    windows = [f.cut(e) for f, e in zip(flights, errors)]
    if weights is not None:
        windows = [w * np.sqrt(counts)[:, None] for w, counts in zip(windows, weights)]
    columns = [_fit_channel(flights, windows, c, seed) for c in range(flights[0].channels)]
    size, size_ends, time, time_ends, noise = (np.array(x) for x in zip(*columns))
    return NoiseModel(size, size_ends.T, time, time_ends.T, noise)


def _fit_channel(flights, windows, channel: int, seed: int):
    """Return (size, its interval, correlation time, its interval, noise factor) of a channel."""
    parts = [_simultaneous_modes(f, w, channel) for f, w in zip(flights, windows) if f.logged[channel]]
    if not parts:
        return 0.0, (0.0, 0.0), 0.3, (0.3, 0.3), 1.0
    # The size at which the disturbance alone, of a medium correlation time, would explain the errors.
    middle = len(TIMES) // 2
    typical = np.median([z.mean() / v.mean() for v, z, _ in (p[middle] for p in parts)])
    sizes = SIZE_FACTORS * np.sqrt(max(typical, 1e-12))
    table = np.stack([_log_likelihood(part, sizes) for part in parts])  # (f, times, noise, sizes)
    best = np.unravel_index(int(np.argmax(table.sum(axis=0))), table.shape[1:])
    rng = np.random.default_rng((seed, channel))
    counts = rng.multinomial(len(parts), np.full(len(parts), 1.0 / len(parts)), BOOTSTRAP_SAMPLES)
    drawn = np.tensordot(counts, table[:, :, best[1], :], axes=1)
    places = [np.unravel_index(int(np.argmax(x)), x.shape) for x in drawn]
    size_ends = np.quantile([sizes[k] for _, k in places], [0.025, 0.975])
    time_ends = np.quantile([TIMES[k] for k, _ in places], [0.025, 0.975])
    total = table.sum(axis=0)
    size = _parabola_vertex(np.log(sizes), total[best[0], best[1]], best[2])
    time = _parabola_vertex(np.log(TIMES), total[:, best[1], best[2]], best[0])
    if best[2] == 0:  # the smallest size of the grid: no disturbance
        return (
            0.0,
            (0.0, float(size_ends[1])),
            time,
            tuple(time_ends),
            float(np.sqrt(NOISE_VARIANCES[best[1]])),
        )
    ends = (min(size, size_ends[0]), max(size, size_ends[1]))
    times = (min(time, time_ends[0]), max(time, time_ends[1]))
    return size, ends, time, times, float(np.sqrt(NOISE_VARIANCES[best[1]]))


def _simultaneous_modes(flight: MeasuredFlight, windows: np.ndarray, channel: int):
    """Return, for every correlation time, (variances (q,) by unit disturbance, mean squares (q,), windows w).

    In the generalised eigenvectors that diagonalise the covariances of noise and disturbance together.
    """
    # D v = lambda N v,  v'N v = 1:  a mode has the variance  noise + size^2 lambda
    error_responses = flight.error_responses
    noise = error_responses.noise(channel, flight.noise, flight.acceleration_noise)
    free = windows[..., channel] @ error_responses.projection[channel]
    result = []
    for time in TIMES:
        variance, modes = eigh(error_responses.disturbance(channel, float(time)), noise)
        result.append((np.maximum(variance, 0.0), _mean_squares(free @ modes), len(windows)))
    return result


def _mean_squares(values: np.ndarray) -> np.ndarray:
    """Return mean squares (q,) of values (w, q), outlying windows winsorised."""
    squares = values**2
    total = squares.mean(axis=1)
    most = 4.0 * np.median(total) + 1e-300
    return (squares * np.minimum(1.0, most / np.maximum(total, 1e-300))[:, None]).mean(axis=0)


def _log_likelihood(part, sizes: np.ndarray) -> np.ndarray:
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
