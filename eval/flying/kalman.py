"""Position and velocity from motion capture: a Kalman filter over what a vehicle of this kind can do.

State of each axis: position, velocity, acceleration. The acceleration is a first-order Gauss-Markov process
(R. A. Singer, "Estimating Optimal Tracking Filter Performance for Manned Maneuvering Targets", IEEE
Transactions on Aerospace and Electronic Systems 6(4), 1970): it forgets with the time constant of the
attitude loop, and its size is that of the accelerations which the commands allow. Time between measurements
is whatever it was; between them, and through dropouts, the state is predicted and its variance grows.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from inclined_landing.models.vehicle import Vehicle

# A touch changes the velocity by at most this, m/s (a flight's largest speed), between two poses at most this
# far apart, s: a jump of the pose by more than 12 cm is none.
IMPACT, IMPACT_TIME = 4.0, 0.03
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


@dataclasses.dataclass(frozen=True)
class NoiseModel:
    """Measurement noise of the motion capture and process noise of the vehicle's acceleration.

    Motion capture of this kind is good to a millimetre or better once calibrated; 1 mm is on the safe side.
    """

    position: float = 1e-3  # standard deviation of a measured position, per axis, m
    acceleration: float = 3.3  # of the vehicle's acceleration, per axis, m/s2
    correlation: float = 0.18  # time after which the acceleration is forgotten, s
    speed: float = 1.0  # of the velocity before the first measurement, per axis, m/s
    gate: float = 30.7  # largest normalised innovation squared: one of a million, chi-square with 3 degrees

    @classmethod
    def of(cls, vehicle: Vehicle, position: float = 1e-3) -> NoiseModel:
        """Return the noise model of a vehicle: accelerations uniform up to what its tilt limit allows."""
        largest = vehicle.environment_gravity * math.tan(vehicle.command_angle_limit)
        return cls(position, largest / math.sqrt(3.0), vehicle.attitude_time_constant)


class KalmanFilter:
    """Kalman filter of one flight; initialised by the first measurement."""

    def __init__(self, noise: NoiseModel):
        self.noise = noise
        self.time: float | None = None  # of the last measurement that was believed, s
        self.mean = np.zeros((3, 3))  # position, velocity, acceleration of x, y, z
        self.variance = np.zeros((3, 3))  # of position, velocity, acceleration, the same for all axes
        self.contact_updates = 0  # measurements that only a touch explains
        self.normalised_innovation_squared = (
            0.0  # normalised, squared, of the last measurement; chi-square with 3 degrees
        )

    def update(self, time: float, position: np.ndarray, impact: bool = False) -> bool:
        """Update the state with a position (3,) [m] measured at `time` [s]; return False if it is rejected.

        impact: something to touch is near, and the velocity may have changed at once.

        Not believed are positions that are not finite, not newer than the last one, or farther off than
        `NoiseModel.gate` allows.
        """
        position = np.asarray(position, float)
        if not (math.isfinite(time) and np.isfinite(position).all()):
            return False
        n = self.noise
        if self.time is None:
            self.mean[0] = position
            self.variance = np.diag([n.position**2, n.speed**2, n.acceleration**2])
            self.time = time
            return True
        if time <= self.time:
            return False
        # Innovation y = z - H x, S = H P H' + R, NIS = y'y / S, K = P H' / S, H = (1, 0, 0) for each axis.
        mean, variance = self._ahead(time - self.time)
        innovation = position - mean[0]
        expected = variance[0, 0] + n.position**2
        self.normalised_innovation_squared = float(innovation @ innovation / expected)
        if not self.normalised_innovation_squared <= n.gate:
            reach = IMPACT * min(time - self.time, IMPACT_TIME) + 5.0 * n.position
            if not (impact and math.sqrt(innovation @ innovation) <= reach):
                return False
            # Contact adds an unknown change w of velocity within dt: P + w^2 (dt, 1, 0)' (dt, 1, 0).
            hit = np.array([time - self.time, 1.0, 0.0]) * IMPACT
            variance = variance + np.outer(hit, hit)
            self.contact_updates += 1
            expected = variance[0, 0] + n.position**2
        gain = variance[:, 0] / expected
        reduction = np.eye(3)
        reduction[:, 0] -= gain
        self.mean = mean + np.outer(gain, innovation)
        # Joseph's form, which stays symmetric and positive: P = (I - K H) P (I - K H)' + K R K'.
        self.variance = reduction @ variance @ reduction.T + n.position**2 * np.outer(gain, gain)
        self.time = time
        return True

    def predict(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Return position (3,) [m] and velocity (3,) [m/s] predicted for `time` [s]; NaN before any
        measurement.
        """
        if self.time is None:
            return np.full(3, np.nan), np.full(3, np.nan)
        mean = transition(max(0.0, time - self.time), self.noise.correlation) @ self.mean
        return mean[0], mean[1]

    def standard_deviations(self, time: float) -> tuple[float, float]:
        """Return the standard deviations, per axis, of predicted position [m] and velocity [m/s]."""
        if self.time is None:
            return math.inf, math.inf
        _, variance = self._ahead(max(0.0, time - self.time))
        return math.sqrt(variance[0, 0]), math.sqrt(variance[1, 1])

    def _ahead(self, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and covariance (3, 3) propagated by dt [s]."""
        f = transition(dt, self.noise.correlation)
        grown = process_noise(dt, self.noise.acceleration, self.noise.correlation)
        return f @ self.mean, f @ self.variance @ f.T + grown


def transition(dt: float, correlation: float) -> np.ndarray:
    """Return the transition matrix (3, 3) of position, velocity, acceleration over dt [s]."""
    # exp(A dt) of dx/dt = v, dv/dt = a, da/dt = -a / T, with s = dt / T (Singer 1970):
    #   [1  dt  T^2 (s - 1 + exp(-s))],  [0  1  T (1 - exp(-s))],  [0  0  exp(-s)]
    s = dt / correlation
    decay, rise = math.exp(-s), -math.expm1(-s)
    return np.array(
        [[1.0, dt, correlation**2 * (s - rise)], [0.0, 1.0, correlation * rise], [0.0, 0.0, decay]]
    )


def process_noise(dt: float, acceleration: float, correlation: float) -> np.ndarray:
    """Return the process noise covariance (3, 3) of the random acceleration over dt [s].

    The integral of the response to white jerk, by Gauss-Legendre quadrature: positive semidefinite for any
    dt, and exact to rounding for those between two measurements.
    """
    # Q = 2 sigma^2 / T  int_0^dt  r(s) r(s)' ds,  r the last column of the transition matrix.
    ages = 0.5 * dt * (_NODES + 1.0)
    s = ages / correlation
    rise = -np.expm1(-s)
    response = np.stack([correlation**2 * (s - rise), correlation * rise, np.exp(-s)])
    density = 2.0 * acceleration**2 / correlation
    return 0.5 * dt * density * (response * _WEIGHTS) @ response.T
