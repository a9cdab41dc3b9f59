"""Set-points of a path and the feed-forward commands of a vehicle (differential flatness)."""

from __future__ import annotations

import dataclasses

import numpy as np

from inclined_landing.eval.flying.tracking import Trajectory, thrust_and_angles
from inclined_landing.eval.gap.plan.pieces import RATE, Path
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.vehicle import Vehicle


@dataclasses.dataclass(frozen=True)
class Setpoints(Trajectory):
    """The trajectory of a path, with the feed-forward commands that track it with the nominal vehicle."""

    path: Path

    def log(self, name: str, noise: np.ndarray) -> FlightLog:
        """Return the flight as tracked perfectly and measured with noise (6,) [m, rad], seed 0."""
        rng = np.random.default_rng(0)
        measured = np.hstack([self.position, self.attitude])
        measured = measured + noise * rng.standard_normal(measured.shape)
        untouched = np.zeros(len(measured), bool)
        return FlightLog(name, self.t, measured[:, :3], measured[:, 3:], self.command, contact=untouched)


def setpoints(path: Path, vehicle: Vehicle) -> Setpoints:
    """Return the path with the feed-forward commands of `vehicle`: lags and delays inverted, drag ignored."""
    # Thrust lag (first order):  u = PWM + dPWM/dt / rate.  Attitude loop (second order, gain k):
    #   u = [angle + 2 zeta (tau + 1/B) / 2 d(angle)/dt + tau/B d2(angle)/dt2] / k
    v, dt = vehicle, 1.0 / RATE
    velocity = np.gradient(path.position, dt, axis=0)
    acceleration = np.gradient(velocity, dt, axis=0)
    size, angles = thrust_and_angles(acceleration, path.yaw, v.environment_gravity)
    rates = np.gradient(angles, dt, axis=0)
    second_rates = np.gradient(rates, dt, axis=0)
    tau, bandwidth = v.attitude_time_constant, v.attitude_bandwidth
    lag = v.attitude_damping * (tau + 1.0 / bandwidth)
    lead = (lag * rates + tau / bandwidth * second_rates) / v.attitude_gain
    pwm = v.hover_pwm * size / v.environment_gravity
    lag_compensation = np.gradient(pwm, dt) / v.thrust_lag_rate
    angle_commands = _ahead(angles / v.attitude_gain + lead, v.effects_attitude_delay)
    turn = np.gradient(path.yaw, dt)
    turn = turn + np.gradient(turn, dt) / v.attitude_yaw_bandwidth
    limit, rate_limit = v.command_angle_limit, v.command_yaw_rate_limit
    command = np.column_stack(
        [
            np.clip(_ahead(pwm + lag_compensation, v.effects_thrust_delay), *v.command_pwm_range),
            np.clip(angle_commands, -limit, limit),
            np.clip(_ahead(turn, v.effects_attitude_delay), -rate_limit, rate_limit),
        ]
    )
    attitude = np.column_stack([angles, path.yaw])
    return Setpoints(path.t, path.position, attitude, command, velocity, acceleration, path)


def _ahead(values: np.ndarray, delay: float) -> np.ndarray:
    """Return rows (m, ...) advanced by `delay` s, the last ones held."""
    rows = round(delay * RATE)
    return values[np.minimum(np.arange(len(values)) + rows, len(values) - 1)]
