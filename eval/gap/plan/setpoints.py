"""A path as set-points and as the commands that a vehicle needs to fly it perfectly."""

from __future__ import annotations

import dataclasses

import numpy as np

from inclined_landing.eval.gap.plan.pieces import RATE, Path
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.parameters import Vehicle

COLUMNS = (
    *("t", "x", "y", "z", "roll", "pitch", "yaw"),
    *("cmd_thrust_pwm", "cmd_roll", "cmd_pitch", "cmd_yaw_rate"),
    *("vx", "vy", "vz", "ax", "ay", "az"),
)


@dataclasses.dataclass(frozen=True)
class Setpoints:
    """Where a vehicle is to be, and the commands that bring a vehicle there that flies as modelled."""

    path: Path
    velocity: np.ndarray  # (m, 3) m/s
    acceleration: np.ndarray  # (m, 3) m/s2
    attitude: np.ndarray  # (m, 3) rad: roll, pitch, yaw
    command: np.ndarray  # (m, 4) PWM, roll, pitch [rad], yaw rate [rad/s]
    lead: np.ndarray  # (m, 3) the part of PWM, roll and pitch that makes up for lags

    def table(self) -> np.ndarray:
        """The numbers of COLUMNS (m, 17): the documented log with velocity and acceleration."""
        p = self.path
        return np.column_stack(
            [p.t, p.position, self.attitude, self.command, self.velocity, self.acceleration]
        )

    def log(self, name: str, noise: np.ndarray) -> FlightLog:
        """The flight as if flown perfectly and measured with noise (6,) [m, rad], seed 0."""
        rng = np.random.default_rng(0)
        measured = np.hstack([self.path.position, self.attitude])
        measured = measured + noise * rng.standard_normal(measured.shape)
        untouched = np.zeros(len(measured), bool)
        return FlightLog(name, self.path.t, measured[:, :3], measured[:, 3:], self.command, contact=untouched)


def thrust_and_angles(acceleration: np.ndarray, yaw: np.ndarray, gravity: float) -> tuple:
    """Thrust per mass (...,) [m/s2], roll and pitch (..., 2) [rad] that give an acceleration (..., 3)."""
    thrust = acceleration + np.array([0.0, 0.0, gravity])
    size = np.linalg.norm(thrust, axis=-1)
    d = thrust / size[..., None]
    along = np.cos(yaw) * d[..., 0] + np.sin(yaw) * d[..., 1]
    across = np.cos(yaw) * d[..., 1] - np.sin(yaw) * d[..., 0]
    # Thrust along the third column of Rx Ry: (sin pitch, -sin roll cos pitch, cos roll cos pitch).
    pitch = np.arcsin(np.clip(along, -1.0, 1.0))
    roll = np.arctan2(-across, d[..., 2])
    return size, np.stack([roll, pitch], axis=-1)


def setpoints(path: Path, vehicle: Vehicle) -> Setpoints:
    """The path with the commands that `vehicle` needs, lags and delays made up for, drag left to feedback."""
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
    hover_equivalent = np.column_stack([pwm, angles / v.attitude_gain])
    attitude = np.column_stack([angles, path.yaw])
    return Setpoints(path, velocity, acceleration, attitude, command, command[:, :3] - hover_equivalent)


def _ahead(values: np.ndarray, delay: float) -> np.ndarray:
    """Rows (m, ...) as they come `delay` s later, the last ones held."""
    rows = round(delay * RATE)
    return values[np.minimum(np.arange(len(values)) + rows, len(values) - 1)]
