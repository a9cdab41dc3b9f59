"""Touchdowns cut out of flights: start state before contact, and the motion after it with its covariance."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
import scipy  # whose submodules are imported when they are used

from inclined_landing.eval.gap.measured.windows import measurement_noise
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.attitude import ROLL, STATE_SIZE, VX, WX, body_rates
from inclined_landing.models.vehicle import Vehicle

BEFORE = 0.1  # s before the touch at which the simulation starts
FIT_BEFORE = 0.14  # s of flight before that from which the start state is fitted
AFTER = 0.45  # s after the touch that are compared: nothing moves any more
COMPARE_EVERY = 0.01  # s between the compared samples
# What the comparison cannot be better than, one idealised contact against another, in the motion that follows
# the touch at once and in where it ends: along the slope, where feet slide, across it, along its normal [m];
# roll, pitch, yaw [rad]. Each is correlated over time: the first over FLEETING, the second stays.
TRANSIENT = 0.05  # s
TRANSIENT_ERROR = (0.0010, 0.0005, 0.0003, 0.010, 0.016, 0.006)
REST_ERROR = (0.0030, 0.0008, 0.0004, 0.008, 0.005, 0.012)


@dataclasses.dataclass(frozen=True)
class LandingReference:
    """The residual of the reference vehicle's landings with its constants, by surface (floor, platform).

    Real contact does not follow MuJoCo's law. The common error of the landings is expected of others too,
    and their scatter is the uncertainty of a single landing.
    """

    count: tuple[int, int]  # landings
    time: np.ndarray  # (k,) s after the touch
    common: np.ndarray  # (2, 6, k) mean residual, in the surface frame [m, rad]
    transient: np.ndarray  # (6,) as TRANSIENT_ERROR
    rest: np.ndarray  # (6,) as REST_ERROR

    def expected(self, t: np.ndarray, on_platform: bool) -> np.ndarray:
        """Return the mean residual (m, 6) at t (m,) [s] after contact; none on a surface never landed on."""
        return np.stack([np.interp(t, self.time, c) for c in self.common[int(on_platform)]], axis=1)

    def __post_init__(self):
        errors = self.transient.shape == self.rest.shape == (6,)
        if self.common.shape != (2, 6, len(self.time)) or not errors:
            raise ValueError("landings of another shape")
        if min(self.count) < 0 or not sum(self.count) or min(*self.transient, *self.rest) <= 0.0:
            raise ValueError("landings without number or errors")


@dataclasses.dataclass
class Landing:
    """One touchdown: start state, commands, measured motion and its covariance."""

    name: str
    dt: float
    start: np.ndarray  # (13,) state without lag
    first: int  # row of the log at the start
    touch: int  # row of the log at the touch
    rows: int  # steps to simulate
    measured: np.ndarray  # (k, 6) pose at the compared rows
    compared: np.ndarray  # (k,) steps after the start
    deviation: np.ndarray  # (k, 6) standard deviation of measured minus simulated
    whiten: np.ndarray  # (6, k, k) inverse Cholesky factors of the covariance
    by_noise: np.ndarray  # (6, k, k) its part by measurement noise
    by_model: np.ndarray  # (6, k, k) and that between two contact models
    command: np.ndarray  # (m, 4) of the whole log
    on_platform: bool
    expected: np.ndarray  # (k, 6) mean residual of the reference's landings, in the surface frame


def landings_of(
    logs: Sequence[FlightLog], vehicle: Vehicle, reference: LandingReference | None = None
) -> list[Landing]:
    """Return the touchdowns of flights with a contact channel: first contacts after 0.3 s of flight."""
    found = []
    for log in logs:
        if log.contact is None or not log.contact.any():
            continue
        dt = float(np.median(np.diff(log.t)))
        back, rest = round((BEFORE + FIT_BEFORE) / dt), round(AFTER / dt)
        touching = log.contact.astype(int)
        for touch in np.flatnonzero(np.diff(touching) == 1) + 1:
            if touch < back + 2 or log.contact[max(0, touch - max(back, round(0.3 / dt))) : touch].any():
                continue
            if touch + rest >= len(log.t):
                continue
            found.append(_landing(log, int(touch), dt, vehicle, reference))
    return found


def _landing(
    log: FlightLog, touch: int, dt: float, vehicle: Vehicle, reference: LandingReference | None
) -> Landing:
    """Return the landing whose first contact is the row `touch`."""
    first = touch - round(BEFORE / dt)
    back = round(FIT_BEFORE / dt)
    pose = np.hstack([log.position, np.unwrap(log.attitude, axis=0)])
    noise = measurement_noise(pose)
    # Start state: a local parabola (Savitzky-Golay) up to the start and half as far beyond it, before
    # contact.
    ahead = min(back // 2, touch - first - 2)
    length = back + ahead + 1
    length -= 1 - length % 2
    window = pose[first + ahead - length + 1 : first + ahead + 1]
    place = length - 1 - ahead
    weights = [scipy.signal.savgol_coeffs(length, 2, d, dt, place, use="dot") for d in (0, 1)]
    value, rate = (w @ window for w in weights)
    gain = [np.linalg.norm(w) for w in weights]
    start = np.zeros(STATE_SIZE)
    start[:3], start[VX : VX + 3] = value[:3], rate[:3]
    start[ROLL : ROLL + 3] = value[3:]
    start[WX : WX + 3] = body_rates(value[3], value[4], *rate[3:])
    step = max(1, round(COMPARE_EVERY / dt))
    rows = touch - first + round(AFTER / dt)
    compared = np.arange(touch - first - step, rows + 1, step)
    t = compared * dt - BEFORE
    errors = (reference.transient, reference.rest) if reference else (TRANSIENT_ERROR, REST_ERROR)
    by_noise, by_model = _noise_covariance(t, noise, gain), contact_model_covariance(t, *errors)
    covariance = by_noise + by_model
    half = vehicle.slab_half_length * math.cos(vehicle.platform_inclination) + 0.05
    over = abs(value[0]) < half and abs(value[1]) < 0.5 * vehicle.platform_depth + 0.05
    on_platform = bool(over and value[2] > 0.5 * vehicle.platform_surface_height)
    return Landing(
        log.name,
        dt,
        start,
        first,
        touch,
        rows,
        pose[first + compared],
        compared,
        np.sqrt(np.einsum("cii->ic", covariance)),
        np.linalg.inv(np.linalg.cholesky(covariance)),
        by_noise,
        by_model,
        np.where(np.isnan(log.command), 0.0, log.command),
        on_platform,
        reference.expected(t, on_platform) if reference else np.zeros((len(t), 6)),
    )


def _noise_covariance(t: np.ndarray, noise: np.ndarray, gain: Sequence[float]) -> np.ndarray:
    """Return the covariance (6, k, k) of measured minus simulated pose by noise, t (k,) [s] after contact.

    noise (6,) of the measurement; gain: noise gains of the start pose and rates. Start errors grow during the
    motion; along the normal, in roll and in pitch they decay after contact.
    """
    # C = sigma^2 [1 + (g_0^2 + g_1^2 t t') d d'],  d = exp(-t / TRANSIENT) in z, roll, pitch
    moving = np.clip(t, -BEFORE, 0.15) + BEFORE
    held = np.exp(-np.maximum(t, 0.0) / TRANSIENT)
    result = np.empty((6, len(t), len(t)))
    for c in range(6):
        start = gain[0] ** 2 + gain[1] ** 2 * np.outer(moving, moving)
        if c in (2, 3, 4):
            start = start * np.outer(held, held)
        result[c] = noise[c] ** 2 * (np.eye(len(t)) + start)
    return result


def contact_model_covariance(
    t: np.ndarray,
    transient: Sequence[float] | np.ndarray = TRANSIENT_ERROR,
    rest: Sequence[float] | np.ndarray = REST_ERROR,
) -> np.ndarray:
    """Return the covariance (6, k, k) between two idealised contact models at t (k,) [s] after contact."""
    # a^2 exp(-|t - t'| / TRANSIENT) f f' + b^2 s s',  f the transient's envelope, s = 1 - exp(-t / TRANSIENT)
    touched = np.clip(t / TRANSIENT, 0.0, 1.0)
    settled = 1.0 - np.exp(-np.maximum(t, 0.0) / TRANSIENT)
    fleeting = touched * np.exp(-np.maximum(t - 0.1, 0.0) / TRANSIENT)
    near = np.exp(-np.abs(t[:, None] - t) / TRANSIENT)
    first, stays = near * np.outer(fleeting, fleeting), np.outer(settled, settled)
    return np.stack([a**2 * first + b**2 * stays for a, b in zip(transient, rest)])
