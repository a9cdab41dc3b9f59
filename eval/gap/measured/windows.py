"""Measured flights cut into short windows: resampling, smoothing, noise estimate, regimes.

Windows of 0.6 s are long enough to resolve an acceleration of a few cm/s2 in a millimetre of position noise,
and short enough for errors of a wrong model to stay small.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy  # whose submodules are imported when they are used

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.measured.noise import ErrorResponses, NoiseModel, Whitening
from inclined_landing.eval.logs import FlightLog
from inclined_landing.eval.logs.log import as_logs
from inclined_landing.eval.logs.motion import standing
from inclined_landing.models.attitude import body_accelerations, euler_rates, rotations, tilted
from inclined_landing.models.base.errors import UserError, first_of
from inclined_landing.models.compiled import unlocked
from inclined_landing.models.forces import AMBIENT_SIZE, INCLINATION, PRESENT, TIME, VOLTAGE
from inclined_landing.models.vehicle import Vehicle

WINDOW = 0.6  # s
RATE = 100.0  # rows per second, at most, that the windows are made of
SMOOTHING = 0.1  # s to either side of a sample, for velocities
SKIP_AT_START = 0.25  # s of a log, and after a gap, for the unknown thrust lag to decay
WINDOW_REGIMES = ("hover", "climb", "lateral", "attitude_step", "near_surface", "low_battery")
# Where a regime begins. Regimes group errors in the report and decide no name, so round numbers do.
NEAR = 0.15  # m above a surface: a few rotor radii, within which the ground effect shows
LOW_BATTERY = 3.4  # V under load
CLIMBING, LATERAL = 0.2, 0.5  # m/s, mean speeds of a window
STEPPED, STEP_TIME = 0.12, 0.1  # rad within s: a change of an angle that smooth flight does not ask for
# Commanded thrust below this share of the hover thrust is no flight.
IDLE = 0.3
# Without contacts in the log, rows no higher than this above its lowest one, at its ends, may touch [m].
GROUND_HEIGHT = 0.02
WELL_ABOVE = 0.1  # m, by which the median height must exceed that of rows that count as on the ground
RESTING_TIME, RESTING_HEIGHT = 1.0, 0.01  # s in which a vehicle at rest does not move by more m
LOWEST = 0.02  # quantile of the heights that counts as the lowest, because of outliers
BEFORE_STOP, AFTER_STOP = 0.05, 0.1  # s around contact and idling that are no free flight either
UNEVEN, ABOVE_RATE = 0.02, 1.05  # of a step, of RATE: what is within is not resampled, as clocks jitter
THROUGH_SLAB = 0.02  # m that a position over the slab may be measured below its surface
# Lower bounds of the noise estimate, for smoothed logs: m, rad.
LEAST_POSITION_NOISE, LEAST_ANGLE_NOISE = 1e-4, 3e-4
LEAST_REQUEST_NOISE = 1e-3  # of the sum of all requests
YAW = 5  # channel
TILT_OVER_ANGLES = 1.5  # of root mean squares: sqrt(2), a little more where the larger tilts say most
KEPT_ATTITUDES = 10  # results of `MeasuredFlight.attitude_of`; with more, all are forgotten
# Signs of the motors M1 (front right), M2 (back right), M3 (back left) and M4 (front left) in a positive
# torque about the body's x, y and z axes (M2 and M4 turn clockwise).
REQUEST_SIGNS = np.array([[-1.0, -1.0, 1.0, 1.0], [-1.0, 1.0, 1.0, -1.0], [-1.0, 1.0, -1.0, 1.0]])


@dataclasses.dataclass(frozen=True, eq=False)
class MeasuredFlight:
    """One flight on an even time grid; the arrays that `prediction.predict` needs, and its windows."""

    name: str
    dt: float
    t: np.ndarray  # (m,) s from the log's start
    position: np.ndarray  # (m, 3)
    attitude: np.ndarray  # (m, 3)
    velocity: np.ndarray  # (m, 3) smoothed derivative
    command: np.ndarray  # (m, 4)
    logged: np.ndarray  # (C,) bool: which channels can be compared
    voltage: np.ndarray | None
    middle_position: np.ndarray  # (m - 1, 3) in the middle of every step
    middle_velocity: np.ndarray
    middle_attitude: np.ndarray
    middle_rotation: np.ndarray  # (m - 1, 3, 3)
    ambient: np.ndarray  # (m - 1, AMBIENT_SIZE)
    noise: np.ndarray  # (C,) standard deviation of the measured pose, and of the requests
    starts: np.ndarray  # (w,) first row of every window
    rows: int  # per window
    clearance: np.ndarray  # (m,) m above the floor or the slab
    # (3,) m/s2, noise of the predicted acceleration caused by the attitude noise of one row
    acceleration_noise: np.ndarray
    error_responses: ErrorResponses
    whitening: Whitening
    usable: np.ndarray  # (m,) bool: measured, flying, not touching
    thrust_is_measured: bool  # whether the thrust command is that of measured rotor speeds: without a lag
    requests: MotorRequests | None  # None: not logged
    # Results of `attitude_of` by tilt and delay, since fits come back to the same few.
    _attitudes: dict = dataclasses.field(default_factory=dict, repr=False)

    @property
    def samples(self) -> int:
        """Return the number of rows m."""
        return len(self.t)

    @property
    def channels(self) -> int:
        """Return the number of channels C: 6 of the pose, and 3 of the motors' requests if logged."""
        return len(self.logged)

    @property
    def has_angle_commands(self) -> bool:
        """Return whether both attitude commands were logged."""
        return bool(self.logged[YAW - 2 : YAW].all())

    @property
    def shows_lags(self) -> bool:
        """Return whether its sampling rate is high enough to distinguish lags and delays."""
        return 1.0 / self.dt > thresholds.LAG_RATE

    @property
    def yaw_rate_command(self) -> np.ndarray | None:
        """Return the commanded yaw rate (m,) [rad/s], None where it or the heading was not logged."""
        return self.command[:, 3] if self.logged[YAW] else None

    @cached_property
    def regimes(self) -> np.ndarray:
        """Return the regimes (w, len(WINDOW_REGIMES)) of the windows, bool."""
        speed = self.cut(self.velocity)
        horizontal = np.hypot(speed[..., 0], speed[..., 1]).mean(axis=1)
        vertical = np.abs(speed[..., 2]).mean(axis=1)
        angles = self.cut(self.command[:, 1:3] if self.has_angle_commands else self.attitude[:, :2])
        lag = max(1, round(STEP_TIME / self.dt))
        stepped = np.abs(angles[:, lag:] - angles[:, :-lag]).max(axis=(1, 2)) > STEPPED
        near = self.cut(self.clearance).min(axis=1) < NEAR
        low = np.zeros(len(near), bool)
        if self.voltage is not None:
            low = self.cut(self.voltage).mean(axis=1) < LOW_BATTERY
        climb, lateral = vertical > CLIMBING, horizontal > LATERAL
        hover = ~(climb | lateral | stepped | near)
        return np.stack([hover, climb, lateral, stepped, near, low], axis=1)

    @property
    def pose(self) -> np.ndarray:
        """Return the measured pose (m, 6)."""
        return np.hstack([self.position, self.attitude])

    @property
    def measured(self) -> np.ndarray:
        """Return what is predicted, as measured (m, C): the pose and the motors' requests."""
        return np.hstack([self.pose, self.requests.differences]) if self.requests else self.pose

    @property
    def request_differences(self) -> np.ndarray | None:
        """Return the differences of the motors' requests (m, 3), None where they were not logged."""
        return self.requests and self.requests.differences

    def whitened(self, error_responses: ErrorResponses, noise_model: NoiseModel) -> MeasuredFlight:
        """Return the flight whitened with measurement noise and disturbance of a noise model."""
        noise = self.noise * [one.noise_ratio for one in noise_model]
        whitening = Whitening.of(error_responses, noise, self.acceleration_noise, noise_model)
        return dataclasses.replace(self, error_responses=error_responses, whitening=whitening)

    def with_request_slope(self, slope: float) -> MeasuredFlight:
        """Return the flight with another power of the thrust over the motors' requests in hover."""
        assert self.requests is not None
        return dataclasses.replace(self, requests=dataclasses.replace(self.requests, slope=slope))

    def attitude_of(self, vehicle: Vehicle) -> RotorAttitude:
        """Return the rotors' attitude along the flight.

        A tilt and a delay of the measured attitude beyond that of the position are taken off.
        """
        tilt, late = vehicle.effects_mocap_tilt, vehicle.effects_estimator_delay
        known = self._attitudes.get((tilt, late))
        if known is None:
            middle, rotation, first = self.middle_attitude, self.middle_rotation, self.attitude[0]
            if late or any(tilt):
                middle = remove_tilt(earlier(middle, -late / self.dt), tilt)
                rotation, first = rotations(middle), remove_tilt(self.attitude[:1], tilt)[0]
            known = RotorAttitude(rotation, rates_about_x(middle), first)
            if len(self._attitudes) >= KEPT_ATTITUDES:
                self._attitudes.clear()
            self._attitudes[tilt, late] = known
        return known

    def cut(self, values: np.ndarray) -> np.ndarray:
        """Return the windows (w, rows, ...) of `values` (m, ...)."""
        return values[self.starts[:, None] + np.arange(self.rows)]

    def usable_from(self, first: np.ndarray, rows: int) -> np.ndarray:
        """Return those of the rows `first` (k,) from which on `rows` rows are usable throughout."""
        blocked = np.concatenate([[0], np.cumsum(~self.usable)])
        return first[blocked[first + rows] == blocked[first]]


class RotorAttitude(NamedTuple):
    """The attitude that drives a flight's translation."""

    rotation: np.ndarray  # (m - 1, 3, 3) body to world, in the middle of every step
    rates_about_x: np.ndarray  # (m - 1, 3) Euler rates of a body rate of 1 rad/s about x, there too
    first: np.ndarray  # (3,) rad, roll, pitch, yaw of the first row


@dataclasses.dataclass(frozen=True)
class MotorRequests:
    """The commands of the motors M1 to M4 along a flight, and those that the vehicle's motion requires."""

    differences: np.ndarray  # (m, 3) in roll, pitch and yaw, over the sum of all four: see `REQUEST_SIGNS`
    torques: np.ndarray  # (m, 3) about body x and y over arm and weight, for the smoothed motion; z: 0
    # The exponent of a rotor's thrust over its request in hover; None: that of the vehicle that is predicted.
    slope: float | None = None

    @staticmethod
    def of(
        log: FlightLog, attitude: np.ndarray, dt: float, half: int, vehicle: Vehicle
    ) -> MotorRequests | None:
        """Return the requests of a log on an even grid; None where they were not logged, or all zero.

        attitude (m, 3), yaw continuous; half: rows to either side of a sample, for accelerations.
        """
        if log.requests is None or not np.any(log.requests):
            return None
        # d = sum_i s_i r_i / sum_i r_i
        total = np.maximum(log.requests.sum(axis=1, keepdims=True), 1.0)
        differences = log.requests @ REQUEST_SIGNS.T / total
        rates, second = (scipy.signal.savgol_filter(attitude, 2 * half + 1, 3, k, dt, axis=0) for k in (1, 2))
        turning = np.empty_like(attitude)
        for k, (angles, rate, acceleration) in enumerate(zip(attitude, rates, second)):
            turning[k] = body_accelerations(angles[0], angles[1], tuple(rate), tuple(acceleration))
        # t = J dw/dt / (arm m g)
        weight = vehicle.body_mass * vehicle.environment_gravity
        torques = turning * np.array(vehicle.body_inertia) / (vehicle.rotor_arm * weight)
        torques[:, 2] = 0.0
        return MotorRequests(differences, torques)


def earlier(values: np.ndarray, rows: float) -> np.ndarray:
    """Return values (..., m, k) as they were some rows, whole or not, before (negative: after)."""
    last = values.shape[-2] - 1
    at = np.clip(np.arange(last + 1) - rows, 0.0, last)
    low = np.minimum(at.astype(int), last - 1)
    part = (at - low)[:, None]
    return (1.0 - part) * values[..., low, :] + part * values[..., low + 1, :]


@unlocked
def rates_about_x(attitude):
    """Return the Euler rates (k, 3) of a body rate of 1 rad/s about x, at attitudes (k, 3)."""
    out = np.empty_like(attitude)
    for k in range(len(attitude)):
        out[k, 0], out[k, 1], out[k, 2] = euler_rates(attitude[k, 0], attitude[k, 1], 1.0, 0.0, 0.0)
    return out


def remove_tilt(attitude: np.ndarray, tilt: tuple[float, float]) -> np.ndarray:
    """Return the attitudes (m, 3) of a vehicle measured with a tilt (roll, pitch) [rad] of motion capture."""
    # Ry(-pitch) Rx(-roll) undoes Rx(roll) Ry(pitch).
    out = np.empty_like(attitude)
    tilted(attitude, 0.0, -tilt[1], out)
    tilted(out.copy(), -tilt[0], 0.0, out)
    return out


def prepare(log: FlightLog, vehicle: Vehicle, *, platform: bool = False) -> MeasuredFlight:
    """Return a log as a `MeasuredFlight`, whitened with the attitude modes of `vehicle`.

    platform: the slab of the vehicle file stands there (for the ground effect); else the floor only.
    Raises UserError, naming the flight, when there is too little to use.
    """
    (log,) = as_logs([log])
    optional = {"roll", "pitch", "yaw", "cmd_roll", "cmd_pitch", "cmd_yaw_rate"}
    missing = [n for n in log.missing if n not in optional]
    if missing:
        lacking = ", ".join(missing)
        raise UserError(f"{log.name}: {lacking} not logged; the gap workflow needs pose and thrust command")
    gaps = np.stack([log.t[log.gap_starts], log.t[log.gap_starts + 1]], axis=1)
    log = _resampled(log)
    dt = float(np.median(np.diff(log.t)))
    m = len(log.t)
    t = log.t - log.t[0]
    half = max(2, round(SMOOTHING / dt))
    rows = max(8, round(WINDOW / dt))
    if m < max(2 * half + 3, 2 * rows):
        raise UserError(f"{log.name}: {log.duration:.2f} s of flight; at least {2 * WINDOW:g} s are needed")
    angle_known = ~np.isnan(log.attitude).any(axis=0)
    attitude = np.where(angle_known, log.attitude, 0.0)
    attitude[:, 2] = np.unwrap(attitude[:, 2])
    velocity = scipy.signal.savgol_filter(log.position, 2 * half + 1, 2, 1, dt, axis=0)
    commanded = ~np.isnan(log.command).any(axis=0)
    command = np.where(np.isnan(log.command), 0.0, log.command)
    requests = MotorRequests.of(log, attitude, dt, half, vehicle)
    seen, least = [log.position, attitude], [LEAST_POSITION_NOISE] * 3 + [LEAST_ANGLE_NOISE] * 3
    # Without one tilt angle the thrust's horizontal part is unknown; its vertical part hardly differs.
    tilt_known = angle_known[:2].all()
    logged = [tilt_known, tilt_known, True, *(angle_known & commanded[1:])]  # position, attitude
    if requests is not None:
        seen, least = [*seen, requests.differences], least + [LEAST_REQUEST_NOISE] * 3
        logged += [True] * 3
    noise = np.maximum(measurement_noise(np.hstack(seen)), least)
    ambient = np.zeros((m - 1, AMBIENT_SIZE))
    ambient[:, TIME] = _middle(t)
    ambient[:, VOLTAGE] = np.nan if log.voltage is None else _middle(log.voltage)
    ambient[:, INCLINATION], ambient[:, PRESENT] = vehicle.platform_inclination, platform
    usable = _usable_rows(log, gaps, vehicle)
    starts = _window_starts(usable, rows)
    if not len(starts):
        raise UserError(
            f"{log.name}: no window of {WINDOW:g} s in free flight, so it cannot be used "
            f"({100 * usable.mean():.0f} % of its rows are in flight)"
        )
    acceleration_noise = _acceleration_noise(noise, attitude[usable], vehicle)
    error_responses = ErrorResponses.of(rows, dt, vehicle, requests is not None)
    return MeasuredFlight(
        name=log.name,
        dt=dt,
        t=t,
        position=np.ascontiguousarray(log.position),  # whatever array it is a part of
        attitude=attitude,
        velocity=velocity,
        command=command,
        logged=np.array(logged, bool),
        voltage=log.voltage,
        middle_position=_middle(log.position),
        middle_velocity=_middle(velocity),
        middle_attitude=_middle(attitude),
        middle_rotation=rotations(_middle(attitude)),
        ambient=ambient,
        noise=noise,
        starts=starts,
        rows=rows,
        clearance=_clearance(log.position, vehicle, platform),
        acceleration_noise=acceleration_noise,
        error_responses=error_responses,
        whitening=Whitening.of(error_responses, noise, acceleration_noise),
        usable=usable,
        thrust_is_measured=log.thrust_is_measured,
        requests=requests,
    )


def _middle(values: np.ndarray) -> np.ndarray:
    """Return values (m - 1, ...) in the middle of the steps between rows (m, ...)."""
    return 0.5 * (values[1:] + values[:-1])


def _usable_rows(log: FlightLog, gaps: np.ndarray, vehicle: Vehicle) -> np.ndarray:
    """Return (m,) bool: rows in free flight, later than the start and than every gap (g, 2) [s]."""
    usable = in_free_flight(log, vehicle)
    usable[log.t - log.t[0] < SKIP_AT_START] = False
    for start, stop in gaps:
        usable[(log.t > start - 1e-9) & (log.t < stop + SKIP_AT_START + 1e-9)] = False
    return usable


def _resampled(log: FlightLog) -> FlightLog:
    """Return the log on an even time grid of at most RATE."""
    step = np.diff(log.t)
    dt = float(np.median(step))
    uneven = np.abs(step - dt).max() > UNEVEN * dt or 1.0 / dt > ABOVE_RATE * RATE
    return log.resampled(min(RATE, round(1.0 / dt, 3))) if uneven else log


def prepare_all(
    logs: Sequence[FlightLog], vehicle: Vehicle, platform: bool
) -> tuple[list[MeasuredFlight], tuple[str, ...]]:
    """Return `logs` cut into windows, and notes: those of the logs, and why some are not used.

    Raises UserError when none can be used.
    """
    if not logs:
        raise UserError("no flight given")
    flights, refused, notes = [], [], []
    for log in logs:
        try:
            flights.append(prepare(log, vehicle, platform=platform))
            notes += [f"{log.name}: {note}" for note in log.notes]
        except UserError as error:
            refused.append(str(error))
    if not flights:
        raise UserError(first_of(refused))
    if len({f.thrust_is_measured for f in flights}) > 1:
        raise UserError(
            "some flights have thrust from measured rotor speeds, others from commands; use one kind only"
        )
    if len({f.requests is None for f in flights}) > 1:  # all flights of a regression have the same channels
        silent = [dataclasses.replace(log, requests=None) for log in logs]
        return prepare_all(silent, vehicle, platform)
    return flights, (*notes, *(f"not used: {reason}" for reason in refused))


def measurement_noise(values: np.ndarray) -> np.ndarray:
    """Return the standard deviation (k,) of the white noise in `values` (m, k), by a robust estimate."""
    # Residual r of a local cubic over seven rows (Savitzky-Golay), whose own weight in the fit is c:
    #   sigma = 1.4826 median |r| / sqrt(1 - c)
    residual = (values - scipy.signal.savgol_filter(values, 7, 3, axis=0))[3:-3]
    centre = scipy.signal.savgol_coeffs(7, 3)[3]
    return 1.4826 * np.median(np.abs(residual), axis=0) / math.sqrt(1.0 - centre)


def in_free_flight(log: FlightLog, vehicle: Vehicle) -> np.ndarray:
    """Return which rows (m,) are in free flight: thrust commanded, no contact, not standing."""
    dt = float(np.median(np.diff(log.t)))
    bad = np.isnan(log.position).any(axis=1) | np.isnan(log.attitude[:, :2]).all(axis=1)
    bad |= np.isnan(log.command[:, 0])
    bad |= log.command[:, 0] < IDLE * vehicle.hover_pwm
    bad |= standing(log)
    if log.contact is not None:
        bad |= log.contact
    else:
        bad |= _on_ground(log.position[:, 2])
    # A vehicle that rests while the record begins stands on the ground, if it is nowhere lower and flies well
    # above that later.
    height = log.position[:, 2]
    resting = np.abs(height - height[0]) < RESTING_HEIGHT
    lead = len(resting) if resting.all() else int(np.argmin(resting))
    if lead * dt > RESTING_TIME:
        lowest = np.nanquantile(height, LOWEST) + RESTING_HEIGHT
        if height[0] < lowest < np.nanmedian(height) - WELL_ABOVE:
            bad[:lead] = True
    wide = bad.copy()
    for k in np.flatnonzero(bad[1:] != bad[:-1]):
        wide[max(0, k - round(BEFORE_STOP / dt)) : k + 2 + round(AFTER_STOP / dt)] = True
    return ~wide


def _on_ground(height: np.ndarray) -> np.ndarray:
    """Return the rows (m,) on the ground at a log's ends, in a log that climbs well above that."""
    low = ~(height > np.nanmin(height) + GROUND_HEIGHT)
    result = np.zeros(len(low), bool)
    if np.nanmedian(height) > np.nanmin(height) + WELL_ABOVE and not low.all():
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
    # Thrust g tilted by the attitude error:  horizontal g sigma,  vertical g sigma sin(tilt),  where the tilt
    # is sqrt(2) times the root mean square of roll and pitch: see TILT_OVER_ANGLES.
    g = vehicle.environment_gravity
    tilt = TILT_OVER_ANGLES * math.sqrt(np.mean(attitude[:, :2] ** 2)) if len(attitude) else 0.0
    horizontal = g * math.sqrt(0.5 * (noise[3] ** 2 + noise[4] ** 2))
    return np.array([horizontal, horizontal, horizontal * min(1.0, tilt)])


def _clearance(position: np.ndarray, vehicle: Vehicle, platform: bool) -> np.ndarray:
    """Return the height (m,) above the floor, or above the slab where the vehicle is over it."""
    x, y, z = position.T
    if not platform:
        return z.copy()
    slope = math.tan(vehicle.platform_inclination)
    above = (z - vehicle.platform_surface_height + slope * x) * math.cos(vehicle.platform_inclination)
    over = (np.abs(x) < 0.5 * vehicle.platform_width) & (np.abs(y) < 0.5 * vehicle.platform_depth)
    return np.where(over & (above > -THROUGH_SLAB), np.minimum(z, above), z)
