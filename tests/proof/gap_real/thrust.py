"""Thrust per mass seen in the flown path, against motor PWM, battery voltage and height; motor lag."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numba
import numpy as np
import pandas as pd
from scipy import stats
from scipy.optimize import least_squares
from scipy.signal import savgol_filter

from inclined_landing.eval.logs import FlightLog
from inclined_landing.eval.logs.csv_file import read_columns
from inclined_landing.models.vehicle import Vehicle

SMOOTHING = 0.1  # s to either side
FREE = 0.3  # m above the floor, where it is not felt
CALM = 1.5  # m/s2, vertical acceleration at most
SATURATED = 64000.0  # PWM, mean of the four motors
REFERENCE_PWM, REFERENCE_VOLTAGE = 55000.0, 3.5
BINS = (0.01, 0.02, 0.03, 0.05, 0.08, 0.12, 0.2, 0.3)  # m above the height at rest


@dataclasses.dataclass(frozen=True)
class Law:
    """F/m = level (PWM / 55000)^pwm (V / 3.5)^voltage; (value, half-width of the 95 % interval)."""

    level: tuple[float, float]  # m/s2
    pwm: tuple[float, float]
    voltage: tuple[float, float]
    sag: tuple[float, float]  # V per 10 000 PWM, at a given time of a flight
    samples: pd.DataFrame  # flight, thrust (m/s2), pwm, voltage, ratio to the law
    near: pd.DataFrame  # height above rest (bin), ratio, half-width, flights, rows


def samples(log: FlightLog, vehicle: Vehicle) -> pd.DataFrame:
    """Thrust per mass [m/s2] along the body axis from the second derivative of the path, row by row."""
    dt = float(np.median(np.diff(log.t)))
    up = derivative(log.position[:, 2], dt, SMOOTHING)
    tilt = np.cos(log.attitude[:, 0]) * np.cos(log.attitude[:, 1])
    return pd.DataFrame(
        {
            "flight": log.name,
            "t": log.t - log.t[0],
            "thrust": (up + vehicle.environment_gravity) / tilt,
            "pwm": lagged(log.command[:, 0], dt, vehicle.thrust_lag_rate),
            "sent": log.command[:, 0],
            "voltage": log.voltage,
            "height": log.position[:, 2],
            "above_rest": log.position[:, 2] - np.quantile(log.position[:, 2], 0.001),
            "acceleration": up,
        }
    )


def derivative(x: np.ndarray, dt: float, half: float) -> np.ndarray:
    """Smoothed second derivative of x (m, ...), a cubic over `half` seconds to either side."""
    return savgol_filter(x, 2 * round(half / dt) + 1, 3, deriv=2, delta=dt, axis=0)


def law(logs: Sequence[FlightLog], vehicle: Vehicle) -> Law:
    """Powers of PWM and battery voltage that thrust follows; intervals by leaving flights out."""
    table = pd.concat([samples(log, vehicle) for log in logs], ignore_index=True)
    calm = table.acceleration.abs() < CALM
    free = table[calm & (table.height > FREE) & (table.sent < SATURATED) & (table.sent > 20000.0)].copy()
    x = np.stack(
        [
            np.ones(len(free)),
            np.log(free.pwm / REFERENCE_PWM),
            np.log(free.voltage / REFERENCE_VOLTAGE),
        ],
        axis=1,
    )
    y = np.log(free.thrust.to_numpy())
    flights = free.flight.to_numpy()
    fit = np.linalg.lstsq(x, y, rcond=None)[0]
    names = np.unique(flights)
    n = len(names)
    without = np.array([np.linalg.lstsq(x[flights != f], y[flights != f], rcond=None)[0] for f in names])
    error = np.sqrt((n - 1) / n * ((without - without.mean(axis=0)) ** 2).sum(axis=0))  # jackknife
    half = stats.t.ppf(0.975, n - 1) * error

    def predicted(t):
        pwm, voltage = t.pwm.clip(1000.0) / REFERENCE_PWM, t.voltage / REFERENCE_VOLTAGE
        return np.exp(fit[0]) * pwm ** fit[1] * voltage ** fit[2]

    free["ratio"] = free.thrust / predicted(free)
    low = table[(table.acceleration.abs() < 2.5) & (table.sent > 30000.0)].copy()
    low["ratio"] = low.thrust / predicted(low)
    low["bin"] = pd.cut(low.above_rest, BINS)
    rows = []
    for interval, group in low.groupby("bin", observed=True):
        means = group.groupby("flight").ratio.median()
        k = len(means)
        wide = stats.t.ppf(0.975, k - 1) * means.std(ddof=1) / np.sqrt(k) if k > 2 else np.nan
        rows.append((interval.left, interval.right, means.mean(), wide, k, len(group)))
    near = pd.DataFrame(rows, columns=["above", "below", "ratio", "half", "flights", "rows"])
    level = np.exp(fit[0])
    slopes = -np.array([_voltage_slope(own) for _, own in free.groupby("flight")])
    sag = slopes.mean(), stats.t.ppf(0.975, n - 1) * slopes.std(ddof=1) / np.sqrt(n)
    return Law(
        (float(level), float(level * half[0])),
        (float(fit[1]), float(half[1])),
        (float(fit[2]), float(half[2])),
        (float(sag[0]), float(sag[1])),
        free[["flight", "thrust", "pwm", "voltage", "ratio"]],
        near,
    )


def _voltage_slope(table: pd.DataFrame) -> float:
    """Change of voltage per 10 000 PWM, beside a parabola in time."""
    x = np.stack([table.pwm / 1e4, np.ones(len(table)), table.t, table.t**2], axis=1)
    return float(np.linalg.lstsq(x, table.voltage.to_numpy(), rcond=None)[0][0])


@dataclasses.dataclass(frozen=True)
class Lag:
    """Motor lag of one log from accelerometer and motor PWM."""

    log: str
    rate: float  # 1/s, one rate
    up: float  # 1/s, spinning up
    down: float  # 1/s, spinning down
    fit: float  # percent of the accelerometer's own variation, one rate
    gain: float  # of that fit, in percent, by two rates


def motor_lag(path: Path) -> Lag:
    """Rates of a first-order lag between PWM and a quadratic thrust curve, fitted to `imu_az`."""
    motors = [f"m{i}_pwm" for i in (1, 2, 3, 4)]
    table = read_columns(path, ("t", "imu_az", *motors))
    dt = float(np.median(np.diff(table.t)))
    pwm = table[motors].to_numpy() / 65535.0
    measured = table.imu_az.to_numpy()
    settled = slice(int(0.3 / dt), None)

    def left(log_rates):
        up, down = np.exp(log_rates[0]), np.exp(log_rates[-1])
        u = np.stack([lagged(m, dt, up, down) for m in pwm.T], axis=1)
        a = np.stack([np.ones(len(u)), u.mean(axis=1), (u**2).mean(axis=1)], axis=1)[settled]
        q = np.linalg.lstsq(a, measured[settled], rcond=None)[0]
        return a @ q - measured[settled]

    one = least_squares(left, [np.log(15.0)], diff_step=1e-3)
    two = least_squares(left, [one.x[0], one.x[0]], diff_step=1e-3)
    variation = measured[settled].std()
    fits = [100.0 * (1.0 - left(s.x).std() / variation) for s in (one, two)]
    rates = np.exp([*one.x, *two.x])
    return Lag(path.name.split(".")[0], *map(float, rates), float(fits[0]), float(fits[1] - fits[0]))


@numba.njit(cache=True)
def _lagged(x, up, down):
    out = np.empty_like(x)
    s = x[0]
    for k in range(len(x)):
        s += (up if x[k] > s else down) * (x[k] - s)
        out[k] = s
    return out


def lagged(x: np.ndarray, dt: float, up: float, down: float | None = None) -> np.ndarray:
    """First-order lag of x (m,) with a rate [1/s], another one downwards if given."""
    down = up if down is None else down
    return _lagged(np.ascontiguousarray(x, float), 1.0 - np.exp(-dt * up), 1.0 - np.exp(-dt * down))
