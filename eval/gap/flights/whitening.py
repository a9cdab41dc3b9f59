"""Whitening of window errors: the start state is projected out, and the Cholesky factor of the covariance
applied.

The error of a perfect model over a window is a line in time (unknown start position and velocity), plus
position noise, plus the double integral of an acceleration: white noise fed in through the measured attitude,
and the disturbance, an Ornstein-Uhlenbeck process. Errors in roll, pitch and yaw are white noise, the free
response of their loop, and its response to a disturbance in angular acceleration. Errors in the requests of
the motors are white noise and a disturbance of their own, with no start state.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.linalg import cholesky, null_space, solve_triangular

from inclined_landing.models.vehicle import Vehicle


@dataclasses.dataclass(frozen=True)
class ErrorResponses:
    """Linear responses of a window's error to noise and disturbance, for one length and vehicle."""

    # C channels: the pose (6), and where the motors' requests are logged their differences (3).
    projection: tuple[np.ndarray, ...]  # of C (rows, q): onto what no start state explains, q = rows - 2
    impulse: tuple[np.ndarray, ...]  # of C (rows, rows): of the error to a unit acceleration in every step
    dt: float

    @staticmethod
    def of(rows: int, dt: float, vehicle: Vehicle, requests: bool = False) -> ErrorResponses:
        """Return the responses for windows of `rows` samples dt apart, attitude loops as of `vehicle`.

        requests: whether there are channels of motor requests.
        """
        # Responses to an acceleration held over a step dt, h(t) - h(t - dt), with the step responses h:
        #   position t^2/2;  tilt (1 - m_0(t)) / (a b);  yaw [t - (1 - exp(-B t)) / B] / B
        t = np.arange(rows) * dt
        since = t[:, None] - t[None, :]
        modes, stiffness = _of_loop(vehicle)
        turn_bandwidth = vehicle.attitude_yaw_bandwidth

        def of_step(step_response) -> np.ndarray:
            begun, over = np.maximum(since, 0.0), np.maximum(since - dt, 0.0)
            return step_response(begun) - step_response(over)

        moved = of_step(lambda s: 0.5 * s * s)
        tilted = of_step(lambda s: (1.0 - modes(s)[0]) / stiffness)
        turned = of_step(
            lambda s: (s - (1.0 - np.exp(-turn_bandwidth * s)) / turn_bandwidth) / turn_bandwidth
        )
        line = np.stack([np.ones(rows), t], axis=1)
        tilt = np.stack(modes(t), axis=1)
        turn = np.stack([np.ones(rows), np.exp(-turn_bandwidth * t)], axis=1)
        line, tilt, turn = (null_space(x.T) for x in (line, tilt, turn))
        free, fed = [line] * 3 + [tilt] * 2 + [turn], [moved] * 3 + [tilted] * 2 + [turned]
        if requests:  # no start state; two rows fewer, as many numbers as the other channels have
            free += [np.eye(rows, rows - 2)] * 3
            fed += [np.eye(rows)] * 3
        return ErrorResponses(tuple(free), tuple(fed), dt)

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


def _of_loop(vehicle: Vehicle):
    """Return the attitude loop's free responses to an initial angle and rate; its stiffness [1/s2]."""
    # x'' + zeta (a + b) x' + a b x = 0,  a = 1 / tau:  poles -m +- h,  m = zeta (a + b) / 2,  h^2 = m^2 - a b
    a, b = 1.0 / vehicle.attitude_time_constant, vehicle.attitude_bandwidth
    mean = 0.5 * vehicle.attitude_damping * (a + b)
    half = np.sqrt(complex(mean * mean - a * b))
    half = half if abs(half) > 1e-3 * mean else 1e-3 * mean

    def modes(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        near, far = np.exp((half - mean) * t), np.exp(-(half + mean) * t)
        drive = ((near - far) / (2.0 * half)).real
        return (0.5 * (near + far)).real + mean * drive, drive

    return modes, a * b


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
        size: np.ndarray | None = None,
        time: np.ndarray | None = None,
    ) -> Whitening:
        """Return the whitening for noise (C,) of every channel and (3,) of the acceleration [m/s2].

        size, time (C,): of the disturbance in every channel [m/s2, rad/s2], [s]; None: no disturbance.
        """
        # C = L L';  W = L^-1 N',  so that W e is white with unit variance
        factors = []
        for channel, free in enumerate(error_responses.projection):
            covariance = error_responses.noise(channel, noise, acceleration)
            if size is not None and time is not None and size[channel] > 0.0:
                covariance = covariance + size[channel] ** 2 * error_responses.disturbance(
                    channel, time[channel]
                )
            factor = cholesky(covariance, lower=True)
            factors.append(solve_triangular(factor, free.T, lower=True))
        rows = factors[0].shape[1]
        t = np.arange(rows) * error_responses.dt
        level = np.ones(rows)
        unit = [0.5 * t * t] * 3 + [level] * 2 + [t / t[-1]] + [level] * (len(factors) - 6)
        matrices = np.array(factors)
        return Whitening(matrices, np.einsum("cqk,ck->cq", matrices, np.array(unit)))

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
