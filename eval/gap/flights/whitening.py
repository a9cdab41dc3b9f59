"""Window errors made white: start state projected out, noise of known shape divided out.

The error of a perfect model over a window is a line in time (unknown start position and velocity) plus
position noise plus the double integral of a white acceleration, which noise in the measured attitude
feeds into the prediction. Roll and pitch errors carry white noise and the two decaying modes of their
loop, yaw errors an offset and the mode of its loop.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.linalg import cholesky, null_space, solve_triangular

from inclined_landing.models.parameters import Vehicle


@dataclasses.dataclass(frozen=True)
class Whitening:
    """Matrices for windows of one length and one noise."""

    matrices: np.ndarray  # (6, q, rows): q = rows - 2 white numbers of unit variance for each channel
    shapes: np.ndarray  # (6, q) the whitened unit remainder of each channel (see `sizes`)

    @staticmethod
    def of(rows: int, dt: float, noise: np.ndarray, acceleration: np.ndarray, vehicle: Vehicle) -> Whitening:
        """For windows of `rows` samples dt apart.

        noise (6,) of the measured pose [m, rad], acceleration (3,) noise per sample [m/s2].
        """
        t = np.arange(rows) * dt
        lag = np.arange(rows)[:, None] - np.arange(rows)[None, :] - 0.5
        double = np.where(lag > 0, lag, 0.0) * dt * dt
        tau, bandwidth = vehicle.attitude_time_constant, vehicle.attitude_bandwidth
        line = np.stack([np.ones(rows), t], axis=1)
        tilt = np.stack([np.exp(-t / tau), np.exp(-t * bandwidth)], axis=1)
        turn = np.stack([np.ones(rows), np.exp(-t * vehicle.attitude_yaw_bandwidth)], axis=1)
        matrices = []
        for channel in range(6):
            covariance = noise[channel] ** 2 * np.eye(rows)
            if channel < 3:
                covariance += acceleration[channel] ** 2 * double @ double.T
            free = null_space((line if channel < 3 else tilt if channel < 5 else turn).T)
            factor = cholesky(free.T @ covariance @ free, lower=True)
            matrices.append(solve_triangular(factor, free.T, lower=True))
        unit = [0.5 * t * t] * 3 + [np.ones(rows)] * 2 + [t / t[-1]]
        matrices = np.array(matrices)
        return Whitening(matrices, np.einsum("cqk,ck->cq", matrices, np.array(unit)))

    def __call__(self, windows: np.ndarray) -> np.ndarray:
        """White errors (w, 6, q) of windows (w, rows, 6)."""
        return np.matmul(self.matrices, windows.transpose(2, 1, 0)).transpose(2, 0, 1)

    def sizes(self, white: np.ndarray) -> np.ndarray:
        """Each window's error (w, 6) as a constant acceleration [m/s2] or angle [rad]; yaw: at its end."""
        return np.einsum("wcq,cq->wc", white, self.shapes) / self.power

    @property
    def power(self) -> np.ndarray:
        """(6,) inverse variance of `sizes` under the noise alone."""
        return np.einsum("cq,cq->c", self.shapes, self.shapes)
