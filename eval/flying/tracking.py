"""A reference trajectory with its commands as a file, and the position controller that tracks it.

`landing-eval plan` simulates the controller under every candidate, and `landing-eval fly --plan` uses the
same controller, so that the predictions of a plan apply to its flights.
"""

from __future__ import annotations

import dataclasses
import io
import math
import warnings
from pathlib import Path

import numpy as np
import pandas

from inclined_landing.models.attitude import VX, YAW, X, Z
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.vehicle import Vehicle

COLUMNS = (
    *("t", "x", "y", "z", "roll", "pitch", "yaw"),
    *("cmd_thrust_pwm", "cmd_roll", "cmd_pitch", "cmd_yaw_rate"),
    *("vx", "vy", "vz", "ax", "ay", "az"),
)
# Gains of the controller: proportional, derivative, integral; of the heading proportional.
SIDEWAYS, UPWARD, HEADING = (4.0, 3.2, 1.0), (8.0, 5.0, 3.0), 1.5  # 1/s2, 1/s, 1/s3; 1/s
LEAST_THRUST = 2.0  # m/s2, thrust per mass along z below which the controller does not go
WINDUP = 0.5  # m, position error beyond which the integral grows no faster
LONGEST_STEP = 0.05  # s between two rows of a file
LONGEST = 300.0  # s: longer than any battery


@dataclasses.dataclass(frozen=True)
class Trajectory:
    """A trajectory of m rows and the commands that fly it on the vehicle it was planned for."""

    t: np.ndarray  # (m,) s, from 0
    position: np.ndarray  # (m, 3) m
    attitude: np.ndarray  # (m, 3) rad: roll, pitch, yaw, the yaw continuous
    command: np.ndarray  # (m, 4) PWM, roll, pitch [rad], yaw rate [rad/s], in the heading of the row
    velocity: np.ndarray  # (m, 3) m/s
    acceleration: np.ndarray  # (m, 3) m/s2

    @property
    def seconds(self) -> float:
        """Return the duration."""
        return float(self.t[-1])

    def row(self, time: float) -> int:
        """Return the row that applies at a time [s]; after the end, the last one."""
        return max(0, int(np.searchsorted(self.t, time + 1e-9, side="right")) - 1)

    def table(self) -> np.ndarray:
        """Return the numbers of COLUMNS (m, 17)."""
        return np.column_stack(
            [self.t, self.position, self.attitude, self.command, self.velocity, self.acceleration]
        )

    def csv(self) -> str:
        """Return the file's text, to the micrometre and microradian."""
        rows = (",".join(f"{x:.6f}" for x in row) for row in self.table())
        return "\n".join([",".join(COLUMNS), *rows]) + "\n"


def read_trajectory(path: Path) -> Trajectory:
    """Return the trajectory in a file written by `landing-eval plan`. Raises UserError for another file."""
    where = f"planned flight {path}"
    text = storage.read_text(path, "planned flight")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pandas.errors.ParserWarning)  # of rows that are too long
            cells = pandas.read_csv(io.StringIO(text), index_col=False, dtype=str, na_filter=False)
    except (pandas.errors.ParserError, pandas.errors.ParserWarning, pandas.errors.EmptyDataError) as error:
        raise UserError(f"{where} is not CSV: {str(error).strip()}") from None
    cells.columns = cells.columns.str.strip()
    missing = [name for name in COLUMNS if name not in cells]
    if missing:
        raise UserError(f"{where} has no column {missing[0]}; name the flight.csv of landing-eval plan")
    try:
        table = cells[list(COLUMNS)].to_numpy(object).astype(float)
    except ValueError:
        raise UserError(f"{where} has an empty or non-numeric cell") from None
    if len(table) < 2 or not np.isfinite(table).all():
        raise UserError(f"{where} has fewer than two rows, or a number that is not finite")
    t, step = table[:, 0], np.diff(table[:, 0])
    if abs(t[0]) > 1e-6 or not ((step > 0.0) & (step <= LONGEST_STEP)).all() or t[-1] > LONGEST:
        raise UserError(
            f"{where}: times must increase from 0 in steps of at most {LONGEST_STEP:g} s, "
            f"and end by {LONGEST:g} s"
        )
    attitude = table[:, 4:7].copy()
    attitude[:, 2] = np.unwrap(attitude[:, 2])
    return Trajectory(t, table[:, 1:4], attitude, table[:, 7:11], table[:, 11:14], table[:, 14:17])


def thrust_and_angles(acceleration: np.ndarray, yaw: np.ndarray, gravity: float) -> tuple:
    """Return thrust per mass (...,) [m/s2], roll and pitch (..., 2) [rad] for an acceleration (..., 3)."""
    thrust = acceleration + np.array([0.0, 0.0, gravity])
    size = np.linalg.norm(thrust, axis=-1)
    d = thrust / size[..., None]
    along = np.cos(yaw) * d[..., 0] + np.sin(yaw) * d[..., 1]
    across = np.cos(yaw) * d[..., 1] - np.sin(yaw) * d[..., 0]
    # Thrust along the third column of Rx Ry: (sin pitch, -sin roll cos pitch, cos roll cos pitch).
    pitch = np.arcsin(np.clip(along, -1.0, 1.0))
    roll = np.arctan2(-across, d[..., 2])
    return size, np.stack([roll, pitch], axis=-1)


class Tracker:
    """PID controller of n vehicles along one reference, with the reference's commands as feed-forward."""

    def __init__(self, reference: Trajectory, vehicle: Vehicle, n: int = 1):
        self.reference, self._vehicle = reference, vehicle
        self._integral = np.zeros((n, 3))

    def command(self, time: float, state: np.ndarray, dt: float) -> np.ndarray:
        """Return the commands (n, 4), in the vehicles' headings, at a time [s] for measured states (n, 13).

        dt [s]: since the last one.
        """
        # a = a_d + Kp (x_d - x) + Kd (v_d - v) + Ki int (x_d - x) dt, and with T, q: thrust and angles of an
        # acceleration, the commands  u_T = u_T,d T(a) / T(a_d),  u_q = u_q,d + q(a) - q(a_d)
        r, v, k = self.reference, self._vehicle, self.reference.row(time)
        error = r.position[k] - state[:, X : Z + 1]
        self._integral += dt * np.clip(error, -WINDUP, WINDUP)
        gains = np.array([SIDEWAYS, SIDEWAYS, UPWARD]).T
        wanted = r.acceleration[k] + gains[0] * error + gains[2] * self._integral
        wanted = wanted + gains[1] * (r.velocity[k] - state[:, VX : VX + 3])
        wanted[:, 2] = np.maximum(wanted[:, 2], LEAST_THRUST - v.environment_gravity)
        size, angles = thrust_and_angles(wanted, state[:, YAW], v.environment_gravity)
        planned, as_planned = thrust_and_angles(r.acceleration[k], r.attitude[k, 2], v.environment_gravity)
        limit, rate_limit = v.command_angle_limit, v.command_yaw_rate_limit
        turn = HEADING * self.heading_error(time, state[:, YAW])
        return np.column_stack(
            [
                np.clip(r.command[k, 0] * size / planned, *v.command_pwm_range),
                np.clip(r.command[k, 1:3] + angles - as_planned, -limit, limit),
                np.clip(r.command[k, 3] + turn, -rate_limit, rate_limit),
            ]
        )

    def heading_error(self, time: float, yaw: np.ndarray) -> np.ndarray:
        """Return the lag (n,) [rad] of a heading (n,) behind the reference, within half a turn."""
        turn = self.reference.attitude[self.reference.row(time), 2] - yaw
        return (turn + math.pi) % (2.0 * math.pi) - math.pi
