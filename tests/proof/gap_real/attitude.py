"""Attitude loops and tilted motion capture of single flights, outside the search: to compare with it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy import stats
from scipy.optimize import least_squares

from inclined_landing.eval.gap.flights.windows import prepare
from inclined_landing.eval.logs import FlightLog
from inclined_landing.eval.logs.csv_file import read_columns
from inclined_landing.models.delays import averages
from inclined_landing.models.vehicle import Vehicle
from tests.proof.gap_real.thrust import SMOOTHING, derivative, lagged

STARTED = 2.5  # s, after the take-off
RESTING = 0.0015  # m, height above the first row
LONGEST = 0.15  # s of delay


@dataclasses.dataclass(frozen=True)
class Loop:
    """angle = gain command(t - delay) behind a first-order lag, plus a constant; open loop."""

    flight: str
    axis: str
    gain: float
    time_constant: float  # s
    delay: float  # s
    offset: float  # rad
    fit: float  # percent of the angle's own variation
    nominal_fit: float  # with the vehicle's time constant, no delay; gain and offset fitted


def loops(log: FlightLog, vehicle: Vehicle) -> list[Loop]:
    """Both loops of one flight."""
    flight = prepare(log, vehicle)
    rows = flight.usable & (flight.t > STARTED)
    found = []
    for k, axis in enumerate(("roll", "pitch")):
        y, command = flight.attitude[:, k], flight.command[:, 1 + k]

        def fit(tau, delay, y=y, command=command):
            x = lagged(np.append(averages(command, flight.dt, delay), 0.0), flight.dt, 1.0 / tau)
            x = np.concatenate([[x[0]], x[:-1]])
            a = np.stack([x, np.ones(len(x))], axis=1)[rows]
            q = np.linalg.lstsq(a, y[rows], rcond=None)[0]
            return a @ q - y[rows], q

        starts = [(tau, delay) for tau in (0.03, 0.1, 0.2) for delay in (0.005, 0.04, 0.08)]
        best = min(
            (
                least_squares(
                    lambda p, fit=fit: fit(*p)[0],
                    s,
                    bounds=([0.005, 0.0], [1.0, LONGEST]),
                    x_scale=0.02,
                    diff_step=1e-3,
                )
                for s in starts
            ),
            key=lambda s: s.cost,
        )
        left, (gain, offset) = fit(*best.x)
        before, _ = fit(vehicle.attitude_time_constant, 0.0)
        variation = y[rows].std()
        shares = [100.0 * (1.0 - r.std() / variation) for r in (left, before)]
        found.append(
            Loop(log.name, axis, float(gain), *map(float, best.x), float(offset), *map(float, shares))
        )
    return found


@dataclasses.dataclass(frozen=True)
class Tilt:
    """Measured attitude where the true one is known otherwise."""

    flight: str
    rest: tuple[float, float] | None  # rad, roll and pitch measured on the floor before the take-off
    flown: tuple[float, float]  # rad, offset that the flown accelerations need
    drag: tuple[float, float]  # 1/s along x and y, beside it


def tilt(log: FlightLog, vehicle: Vehicle) -> Tilt:
    """Offset of the measured attitude by regression of horizontal accelerations on speed, and at rest."""
    flight = prepare(log, vehicle)
    u = flight.usable
    acceleration = derivative(flight.position, flight.dt, SMOOTHING)
    axis = np.concatenate([flight.middle_rotation[:, :, 2], flight.middle_rotation[-1:, :, 2]])
    thrust = (acceleration[:, 2] + vehicle.environment_gravity) / axis[:, 2]
    fits = []
    for k in (0, 1):
        left = acceleration[:, k] - thrust * axis[:, k]
        a = np.stack([flight.velocity[:, k], np.ones(len(left))], axis=1)[u]
        fits.append(np.linalg.lstsq(a, left[u], rcond=None)[0])
    g = vehicle.environment_gravity
    still = log.position[:, 2] < log.position[0, 2] + RESTING
    lead = int(np.argmin(still)) if not still.all() else 0
    rest = tuple(map(float, log.attitude[:lead, :2].mean(axis=0))) if lead >= 5 else None
    # Thrust that seems to act towards +y is a roll measured too large; towards +x a pitch too small.
    return Tilt(
        log.name,
        rest,
        (float(fits[1][1] / g), float(-fits[0][1] / g)),
        (float(-fits[0][0]), float(-fits[1][0])),
    )


@dataclasses.dataclass(frozen=True)
class Lean:
    """Onboard estimate less motion capture, per speed [rad s/m]: (mean, half-width of the 95 % interval)."""

    roll: tuple[float, float]  # by the speed to the left
    pitch: tuple[float, float]  # by the forward speed
    flights: int


def lean(paths: Sequence[Path], logs: Sequence[FlightLog], vehicle: Vehicle) -> Lean:
    """What the estimate of the NanoBench flights misses in proportion to the speed.

    Beside a constant in every flight, and a scale and a lateness of the estimate.
    """
    grams = []
    for path, log in zip(paths, logs):
        flight = prepare(log, vehicle)
        table = read_columns(path, ("t", "ekf_roll", "ekf_pitch"))
        own = (table["t"] - table["t"].iloc[0]).to_numpy()
        u, heading = flight.usable, flight.attitude[:, 2]
        x, y = flight.velocity[:, 0], flight.velocity[:, 1]
        speeds = np.cos(heading) * y - np.sin(heading) * x, np.cos(heading) * x + np.sin(heading) * y
        rates = np.gradient(flight.attitude, flight.dt, axis=0)
        for k, name in enumerate(("ekf_roll", "ekf_pitch")):
            apart = np.interp(flight.t, own, table[name]) - flight.attitude[:, k]
            a = np.stack([speeds[k], rates[:, k], flight.attitude[:, k], apart], axis=1)[u]
            a -= a.mean(axis=0)
            grams.append(a.T @ a)
    own = np.reshape(grams, (len(logs), 2, 4, 4))
    all_of_them = own.sum(axis=0)

    def slope(gram: np.ndarray) -> np.ndarray:
        return np.linalg.solve(gram[..., :3, :3], gram[..., :3, 3:])[..., 0, 0]

    value, without, n = slope(all_of_them), slope(all_of_them - own), len(logs)
    error = np.sqrt((n - 1) / n * ((without - without.mean(axis=0)) ** 2).sum(axis=0))  # jackknife
    half = stats.t.ppf(0.975, n - 1) * error
    return Lean((float(value[0]), float(half[0])), (float(value[1]), float(half[1])), n)
