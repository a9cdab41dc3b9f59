"""Measured flights cut into short windows: resampling, smoothing, noise estimate, regimes.

Windows of 0.6 s are long enough to resolve an acceleration of a few cm/s2 in a millimetre of position noise,
and short enough for errors of a wrong model to stay small.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from scipy.signal import savgol_filter

from inclined_landing.eval.gap.flights.whitening import ErrorResponses, Whitening
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.attitude import rotations, tilted
from inclined_landing.models.equations import AMBIENT_SIZE
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import Vehicle

WINDOW = 0.6  # s
RATE = 100.0  # rows per second, at most, that the windows are made of
SMOOTHING = 0.1  # s to either side of a sample, for velocities
SKIP_AT_START = 0.25  # s of a log, for the unknown thrust lag to decay
NEAR = 0.15  # m above a surface that counts as near
LOW_BATTERY = 3.4  # V under load
REGIMES = ("hover", "climb", "lateral", "attitude_step", "near_surface", "low_battery")
# Commanded thrust below this share of the hover thrust is no flight.
IDLE = 0.3
# Without contacts in the log, rows no higher than this above its lowest one, at its ends, may touch [m].
GROUND_HEIGHT = 0.02
# Lower bounds of the noise estimate, for smoothed logs: m, rad.
LEAST_POSITION_NOISE, LEAST_ANGLE_NOISE = 1e-4, 3e-4


@dataclasses.dataclass(eq=False)
class MeasuredFlight:
    """One flight on an even time grid; the arrays that `prediction.predict` needs, and its windows."""

    name: str
    dt: float
    t: np.ndarray  # (m,) s from the log's start
    position: np.ndarray  # (m, 3)
    attitude: np.ndarray  # (m, 3)
    velocity: np.ndarray  # (m, 3) smoothed derivative
    command: np.ndarray  # (m, 4)
    has_yaw: bool
    voltage: np.ndarray | None
    middle_position: np.ndarray  # (m - 1, 3) in the middle of every step
    middle_velocity: np.ndarray
    middle_attitude: np.ndarray
    middle_rotation: np.ndarray  # (m - 1, 3, 3)
    ambient: np.ndarray  # (m - 1, 5)
    noise: np.ndarray  # (6,) standard deviation of the measured pose
    starts: np.ndarray  # (w,) first row of every window
    rows: int  # per window
    regimes: np.ndarray  # (w, len(REGIMES)) bool
    acceleration_noise: (
        np.ndarray
    )  # (3,) noise of the predicted acceleration by that of the attitude, per row
    error_responses: ErrorResponses
    whitening: Whitening
    usable: np.ndarray  # (m,) bool: measured, flying, not touching
    _without_tilt: dict = dataclasses.field(default_factory=dict, repr=False)

    @property
    def samples(self) -> int:
        """Return the number of rows m."""
        return len(self.t)

    @property
    def yaw_rate_command(self) -> np.ndarray | None:
        """Return the commanded yaw rate (m,) [rad/s], None where it or the heading was not logged."""
        return self.command[:, 3] if self.has_yaw else None

    @property
    def measured(self) -> np.ndarray:
        """Return the measured pose (m, 6)."""
        return np.hstack([self.position, self.attitude])

    def rewhiten(self, error_responses: ErrorResponses, noise_model) -> None:
        """Whiten with a `NoiseModel`: measurement noise and disturbance."""
        self.error_responses = error_responses
        noise = self.noise * noise_model.noise
        self.whitening = Whitening.of(
            error_responses, noise, self.acceleration_noise, noise_model.size, noise_model.time
        )

    def without_tilt(self, tilt: tuple[float, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return mid-step attitudes, their rotations, and the first attitude, with a tilt [rad] removed."""
        cached = self._without_tilt.get(tilt)
        if cached is None:
            attitude = remove_tilt(self.middle_attitude, tilt)
            cached = attitude, rotations(attitude), remove_tilt(self.attitude[:1], tilt)[0]
            if len(self._without_tilt) > 8:
                self._without_tilt.clear()
            self._without_tilt[tilt] = cached
        return cached

    def cut(self, values: np.ndarray) -> np.ndarray:
        """Return the windows (w, rows, ...) of `values` (m, ...)."""
        return values[self.starts[:, None] + np.arange(self.rows)]


def remove_tilt(attitude: np.ndarray, tilt: tuple[float, float]) -> np.ndarray:
    """Return the attitudes (m, 3) of a vehicle measured with a tilt (roll, pitch) [rad] of motion capture."""
    # Ry(-pitch) Rx(-roll) undoes Rx(roll) Ry(pitch).
    out = np.empty_like(attitude)
    tilted(attitude, 0.0, -tilt[1], out)
    tilted(out.copy(), -tilt[0], 0.0, out)
    return out


def prepare(log: FlightLog, vehicle: Vehicle, *, platform: bool = False) -> MeasuredFlight:
    """Return a `MeasuredFlight` flight from a log: the whitening's attitude modes are those of `vehicle`.

    platform: the slab of the vehicle file stands there (for the ground effect); else the floor only.
    Raises UserError, naming the flight, when there is too little to use.
    """
    missing = [n for n in log.missing if n not in ("cmd_yaw_rate", "yaw")]
    if missing:
        lacking = ", ".join(missing)
        raise UserError(f"{log.name}: {lacking} not logged; the gap workflow needs pose and commands")
    gaps = np.stack([log.t[log.gap_starts], log.t[log.gap_starts + 1]], axis=1)
    log = _resampled(log)
    dt = float(np.median(np.diff(log.t)))
    m = len(log.t)
    t = log.t - log.t[0]
    half = max(2, round(SMOOTHING / dt))
    rows = max(8, round(WINDOW / dt))
    if m < max(2 * half + 3, 2 * rows):
        raise UserError(f"{log.name}: {log.duration:.2f} s of flight; at least {2 * WINDOW:g} s are needed")
    yaw_known = "yaw" not in log.missing
    attitude = log.attitude.copy()
    if not yaw_known:
        attitude[:, 2] = 0.0
    attitude[:, 2] = np.unwrap(attitude[:, 2])
    velocity = savgol_filter(log.position, 2 * half + 1, 2, deriv=1, delta=dt, axis=0)
    has_yaw = yaw_known and not np.isnan(log.command[:, 3]).any()
    command = np.where(np.isnan(log.command), 0.0, log.command)
    noise = np.maximum(
        measurement_noise(np.hstack([log.position, attitude])),
        [LEAST_POSITION_NOISE] * 3 + [LEAST_ANGLE_NOISE] * 3,
    )
    middle = [0.5 * (a[1:] + a[:-1]) for a in (log.position, velocity, attitude)]
    ambient = np.zeros((m - 1, AMBIENT_SIZE))
    ambient[:, 0] = 0.5 * (t[1:] + t[:-1])
    ambient[:, 1] = np.nan if log.voltage is None else 0.5 * (log.voltage[1:] + log.voltage[:-1])
    ambient[:, 2:4] = vehicle.platform_inclination, float(platform)
    usable = in_free_flight(log, vehicle)
    usable[t < SKIP_AT_START] = False
    for start, stop in gaps:
        usable[(log.t > start - 1e-9) & (log.t < stop + 1e-9)] = False
    starts = _window_starts(usable, rows)
    if not len(starts):
        raise UserError(
            f"{log.name}: no window of {WINDOW:g} s in free flight; nothing of it can be used "
            f"({100 * usable.mean():.0f} % of its rows are in flight)"
        )
    acceleration_noise = _acceleration_noise(noise, attitude[usable], vehicle)
    error_responses = ErrorResponses.of(rows, dt, vehicle)
    flight = MeasuredFlight(
        name=log.name,
        dt=dt,
        t=t,
        position=log.position,
        attitude=attitude,
        velocity=velocity,
        command=command,
        has_yaw=has_yaw,
        voltage=log.voltage,
        middle_position=middle[0],
        middle_velocity=middle[1],
        middle_attitude=middle[2],
        middle_rotation=rotations(middle[2]),
        ambient=ambient,
        noise=noise,
        starts=starts,
        rows=rows,
        regimes=np.zeros((len(starts), len(REGIMES)), bool),
        acceleration_noise=acceleration_noise,
        error_responses=error_responses,
        whitening=Whitening.of(error_responses, noise, acceleration_noise),
        usable=usable,
    )
    flight.regimes = _regimes(flight, vehicle, platform)
    return flight


def _resampled(log: FlightLog) -> FlightLog:
    """Return the log on an even time grid of at most RATE."""
    step = np.diff(log.t)
    dt = float(np.median(step))
    if np.abs(step - dt).max() > 0.02 * dt or 1.0 / dt > 1.05 * RATE:
        return log.resampled(min(RATE, round(1.0 / dt, 3)))
    return log


def prepare_all(
    logs: Sequence[FlightLog], vehicle: Vehicle, platform: bool, notes: list[str]
) -> list[MeasuredFlight]:
    """Return the usable `logs`; the reasons for the others, and notes of the logs, are added to `notes`.

    Raises UserError when none can be used.
    """
    if not logs:
        raise UserError("no flight given")
    flights, refused = [], []
    for log in logs:
        try:
            flights.append(prepare(log, vehicle, platform=platform))
        except UserError as error:
            refused.append(str(error))
            continue
        notes += [f"{log.name}: {note}" for note in log.notes]
    if not flights:
        raise UserError("; ".join(refused))
    notes += [f"left out: {reason}" for reason in refused]
    return flights


def measurement_noise(values: np.ndarray) -> np.ndarray:
    """Return the standard deviation (k,) of the white noise in `values` (m, k), by a robust estimate."""
    # Residual r of a local cubic over seven rows (Savitzky-Golay), whose own weight in the fit is c:
    #   sigma = 1.4826 median |r| / sqrt(1 - c)
    residual = (values - savgol_filter(values, 7, 3, axis=0))[3:-3]
    centre = savgol_filter(np.eye(7)[3], 7, 3)[3]
    return 1.4826 * np.median(np.abs(residual), axis=0) / math.sqrt(1.0 - centre)


def in_free_flight(log: FlightLog, vehicle: Vehicle) -> np.ndarray:
    """Return which rows (m,) are in free flight: thrust commanded, no contact, not on the ground."""
    dt = float(np.median(np.diff(log.t)))
    bad = np.isnan(log.position).any(axis=1) | np.isnan(log.attitude[:, :2]).any(axis=1)
    bad |= np.isnan(log.command[:, :3]).any(axis=1)
    bad |= log.command[:, 0] < IDLE * vehicle.hover_pwm
    if log.contact is not None:
        bad |= log.contact
    else:
        bad |= _on_ground(log.position[:, 2])
    # At rest at the lowest height while the record begins or ends: standing on the ground.
    height = log.position[:, 2]
    resting = np.abs(height - height[0]) < 0.01
    lead = len(resting) if resting.all() else int(np.argmin(resting))
    if lead * dt > 1.0 and height[0] < np.nanquantile(height, 0.02) + 0.01 < np.nanmedian(height) - 0.1:
        bad[:lead] = True
    # Margins around contact and idling: 0.05 s before, 0.1 s after.
    wide = bad.copy()
    for k in np.flatnonzero(bad[1:] != bad[:-1]):
        wide[max(0, k - round(0.05 / dt)) : k + 2 + round(0.1 / dt)] = True
    return ~wide


def _on_ground(height: np.ndarray) -> np.ndarray:
    """Return the rows (m,) on the ground at a log's ends, in a log that climbs well above that."""
    low = ~(height > np.nanmin(height) + GROUND_HEIGHT)
    result = np.zeros(len(low), bool)
    if np.nanmedian(height) > np.nanmin(height) + 0.1 and not low.all():
        result[: int(np.argmin(low))] = True
        result[len(low) - int(np.argmin(low[::-1])) :] = True
    return result


def _window_starts(usable: np.ndarray, rows: int) -> np.ndarray:
    """Return the first rows (w,) of consecutive windows that are usable throughout."""
    starts, k = [], 0
    blocked = np.concatenate([[0], np.cumsum(~usable)])
    while k + rows <= len(usable):
        if blocked[k + rows] == blocked[k]:
            starts.append(k)
            k += rows
        else:
            k += int(np.flatnonzero(~usable[k : k + rows])[-1]) + 1
    return np.array(starts, int)


def _acceleration_noise(noise: np.ndarray, attitude: np.ndarray, vehicle: Vehicle) -> np.ndarray:
    """Return the noise (3,) of the predicted acceleration [m/s2] by the attitude noise."""
    # Thrust g tilted by the attitude error:  horizontal g sigma,  vertical g sigma sin(tilt)
    g = vehicle.environment_gravity
    tilt = math.sqrt(np.mean(attitude[:, :2] ** 2)) if len(attitude) else 0.0
    horizontal = g * math.sqrt(0.5 * (noise[3] ** 2 + noise[4] ** 2))
    return np.array([horizontal, horizontal, horizontal * min(1.0, 1.5 * tilt)])


def _regimes(flight: MeasuredFlight, vehicle: Vehicle, platform: bool) -> np.ndarray:
    """Return the regimes (w, len(REGIMES)) of the windows."""
    speed = flight.cut(flight.velocity)
    horizontal = np.hypot(speed[..., 0], speed[..., 1]).mean(axis=1)
    vertical = np.abs(speed[..., 2]).mean(axis=1)
    angles = flight.cut(flight.command[:, 1:3])
    lag = max(1, round(0.1 / flight.dt))
    stepped = np.abs(angles[:, lag:] - angles[:, :-lag]).max(axis=(1, 2)) > 0.12
    height = flight.position[:, 2].copy()
    if platform:
        x, y, z = flight.position.T
        slope = math.tan(vehicle.platform_inclination)
        above = (z - vehicle.platform_surface_height + slope * x) * math.cos(vehicle.platform_inclination)
        over = (np.abs(x) < 0.5 * vehicle.platform_width) & (np.abs(y) < 0.5 * vehicle.platform_depth)
        height = np.where(over & (above > -0.02), np.minimum(height, above), height)
    near = flight.cut(height).min(axis=1) < NEAR
    low = np.zeros(len(near), bool)
    if flight.voltage is not None:
        low = flight.cut(flight.voltage).mean(axis=1) < LOW_BATTERY
    climb, lateral = vertical > 0.2, horizontal > 0.5
    hover = ~(climb | lateral | stepped | near)
    return np.stack([hover, climb, lateral, stepped, near, low], axis=1)
