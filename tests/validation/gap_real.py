"""`gap-real`: what four public data sets show without the workflow, for docs/evidence/public_flights.md.

A tilted motion capture shows in flown accelerations and at rest on the floor; an onboard estimate that knows
no drag, against the measured attitude; known hardware changes in what the motors are asked for in hover; the
motors' lag in the accelerometer. The workflow itself is run by `landing-eval gap` and `identify`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numba
import numpy as np
import pandas as pd
import tyro
from matplotlib.figure import Figure
from scipy import stats
from scipy.optimize import least_squares
from scipy.signal import savgol_filter

from inclined_landing.envs.shared import runs
from inclined_landing.eval.base.options import Folder
from inclined_landing.eval.base.style import GREEN, INK, MUTED, save_figure, styled
from inclined_landing.eval.gap.flights.usable import read_flights
from inclined_landing.eval.gap.flights.windows import prepare
from inclined_landing.eval.logs import FlightLog, csv_file
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.vehicle import Vehicle
from tests.validation.shared import cell, table_of

SETS = ("utias_fmpc", "nanobench", "crazypad", "arp_sysid")
SMOOTHING = 0.1  # s to either side
RESTING = 0.0015  # m, height above the first row
FEWEST_ROWS = 100  # of a flight
NORMAL = "normal_flight"
NAME = re.compile(r"pad_(E\d)_(.+)_log(\d+)")
# Hover and slow cruise at the height flown.
HEIGHT, CLIMB, ACCELERATION = (0.35, 0.75), 0.05, 1.0
QUANTITIES = {"total": "%", "M3": "%", "offset_x": "mm", "offset_y": "mm", "diagonal": "%"}


def command(
    data: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DATA")], /, out: Folder
) -> None:
    """Measured flights of others: tilt, lean, hardware changes and motor lag read directly (a minute).

    Args:
        data: folder of the tidy data sets utias_fmpc, nanobench, crazypad and arp_sysid.
        out: new folder for tables.md and crazypad.png.
    """
    for name in SETS:
        if not (data / name).is_dir():
            raise UserError(f"{data / name} is missing; {data} should hold the four data sets")
    runs.check_new_run(out)
    vehicle = load_vehicle()
    tilts = [tilt(log, vehicle) for log in flights(data / "utias_fmpc", "utias_*.csv.gz")]
    files = sorted((data / "nanobench").glob("nb_*.csv.gz"))
    leans = lean(files, flights(data / "nanobench", "nb_*.csv.gz"), vehicle)
    changes, slopes = compare(data / "crazypad", vehicle)
    rows = [
        {"vehicle": r["vehicle"], "change": r["condition"]}
        | {key: (r[key], r[f"{key}_half"]) for key in QUANTITIES}
        | {"told": r["says"]}
        for r in changes.to_dict("records")
    ]
    per_volt = f"Request per volt: {slopes['total']:.1f} ± {slopes['total_half']:.1f} %/V.\n"
    lags = [motor_lag(path) for path in sorted((data / "arp_sysid").glob("arp_*.csv.gz"))]
    parts = {
        "utias_fmpc: measured attitude where the true one is known otherwise": table_of(tilts),
        "nanobench: onboard estimate less motion capture [rad s/m]": ", ".join(
            f"{name} {cell(value)}" for name, value in leans.items()
        ),
        "crazypad: motor requests in hover": table_of(rows) + "\n" + per_volt,
        f"arp_sysid: motor lag (vehicle file: {vehicle.thrust_lag_rate:.1f} 1/s)": table_of(lags),
    }
    text = "\n".join(f"## {title}\n\n{part.rstrip()}\n" for title, part in parts.items())
    with runs.staged_run(out) as folder:
        storage.write_text(folder / "tables.md", text)
        save_figure(draw(changes), folder / "crazypad.png")
    print(text)


def flights(folder: Path, pattern: str) -> list[FlightLog]:
    """Return the logs of a data set. Raises UserError when there are none."""
    files = [str(path) for path in sorted(folder.glob(pattern))]
    if not files:
        raise UserError(f"{folder} holds no {pattern}")
    return read_flights(files).logs


def read_columns(path: Path, names: Sequence[str]) -> pd.DataFrame:
    """Return the columns `names` of a CSV file; raise UserError for one missing, cut or not finite."""
    record = csv_file.read(path)
    for name in names:
        if name in record.unreadable:
            raise UserError(f"{path}: {record.unreadable[name]}")
        if name not in record.columns:
            raise UserError(f"{path} lacks the column {name}")
    table = pd.DataFrame({name: record.columns[name] for name in names})
    if len(table) < FEWEST_ROWS or not np.isfinite(table).all(axis=None):
        raise UserError(f"{path} has {len(table)} rows, or columns that are no numbers throughout")
    return table


# --- attitude ----------------------------------------------------------------------------------------


def tilt(log: FlightLog, vehicle: Vehicle) -> dict:
    """Return the offset of the measured attitude [rad], at rest and by the flown accelerations.

    The latter by regression of horizontal accelerations on speed, with the drag [1/s] beside it.
    """
    flight = prepare(log, vehicle)
    u = flight.usable
    window = 2 * round(SMOOTHING / flight.dt) + 1
    acceleration = savgol_filter(flight.position, window, 3, deriv=2, delta=flight.dt, axis=0)
    axis = np.concatenate([flight.middle_rotation[:, :, 2], flight.middle_rotation[-1:, :, 2]])
    g = vehicle.environment_gravity
    thrust = (acceleration[:, 2] + g) / axis[:, 2]
    fits = []
    for k in (0, 1):
        left = acceleration[:, k] - thrust * axis[:, k]
        a = np.stack([flight.velocity[:, k], np.ones(len(left))], axis=1)[u]
        fits.append(np.linalg.lstsq(a, left[u], rcond=None)[0])
    still = log.position[:, 2] < log.position[0, 2] + RESTING
    lead = int(np.argmin(still)) if not still.all() else 0
    roll, pitch = map(float, log.attitude[:lead, :2].mean(axis=0)) if lead >= 5 else (None, None)
    # Thrust that seems to act towards +y is a roll measured too large; towards +x a pitch too small.
    return {
        "flight": log.name,
        "roll on the floor": roll,
        "pitch on the floor": pitch,
        "roll by the flight": float(fits[1][1] / g),
        "pitch by the flight": float(-fits[0][1] / g),
        "drag x 1/s": float(-fits[0][0]),
        "drag y 1/s": float(-fits[1][0]),
    }


def lean(
    paths: Sequence[Path], logs: Sequence[FlightLog], vehicle: Vehicle
) -> dict[str, tuple[float, float]]:
    """Return what the estimate of the NanoBench flights misses in proportion to the speed [rad s/m].

    Roll by the speed to the left, pitch by the forward speed, each with the half-width of its 95 % interval;
    beside a constant in every flight, and a scale and a lateness of the estimate.
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
    every = own.sum(axis=0)

    def slope(gram: np.ndarray) -> np.ndarray:
        return np.linalg.solve(gram[..., :3, :3], gram[..., :3, 3:])[..., 0, 0]

    value, without, n = slope(every), slope(every - own), len(logs)
    # Delete-one-flight jackknife: var = (n - 1) / n sum_k (x_(k) - mean)^2
    error = np.sqrt((n - 1) / n * ((without - without.mean(axis=0)) ** 2).sum(axis=0))
    half = stats.t.ppf(0.975, n - 1) * error
    return {name: (float(value[k]), float(half[k])) for k, name in enumerate(("roll", "pitch"))}


# --- known changes of the hardware -------------------------------------------------------------------


def hover(path: Path, vehicle: Vehicle) -> dict:
    """Return means over the hover of one log; offsets by the balance of moments with `vehicle.rotor_arm`.

    The requests (before battery compensation, proportional to force in that firmware) say without any
    attitude: their sum the weight over the thrust per request, their balance where the centre of mass sits or
    which rotor is weak. Their diagonal balance (the turning moment) should tell a weak rotor from a weight.
    """
    name = NAME.match(path.name)
    if name is None:
        raise UserError(f"{path} is not called pad_VEHICLE_CONDITION_logNUMBER")
    requests = [f"m{i}_cmd" for i in (1, 2, 3, 4)]
    table = read_columns(path, ("t", "z", "vz", "az", "vbat", *requests))
    still = table.z.between(*HEIGHT) & (table.vz.abs() < CLIMB) & (table.az.abs() < ACCELERATION)
    m = table.loc[still, requests].mean().to_numpy()
    share = m / m.sum()
    arm = 1000.0 * vehicle.rotor_arm
    return {
        "vehicle": name[1],
        "condition": name[2],
        "voltage": float(table.vbat[still].mean()),
        # Logarithms times 100: differences are percent.
        "total": 100.0 * np.log(m.sum()),
        "M3": 100.0 * np.log(m[2]),
        "offset_x": arm * float(share @ [1, -1, -1, 1]),
        "offset_y": arm * float(share @ [-1, -1, 1, 1]),
        "diagonal": 100.0 * float(share @ [1, -1, 1, -1]),
    }


def compare(folder: Path, vehicle: Vehicle) -> tuple[pd.DataFrame, dict[str, float]]:
    """Return every condition against the normal flights of the same vehicle, the voltage taken out.

    A table (vehicle, condition, and value and half-width of the interval of every quantity, 95 % for all
    conditions of one quantity together: Bonferroni) and the slope of each quantity per volt. Two logs of a
    condition differ in voltage: that gives the slope, and what it leaves gives the intervals.
    """
    logs = pd.DataFrame([hover(p, vehicle) for p in sorted(folder.glob("pad_*.csv.gz"))])
    if logs.empty:
        raise UserError(f"{folder} holds no pad_*.csv.gz")
    case = logs.vehicle + " " + logs.condition
    cases = list(dict.fromkeys(case))
    x = np.hstack([(case.to_numpy()[:, None] == np.array(cases)).astype(float), logs[["voltage"]] - 3.5])
    freedom = len(logs) - x.shape[1]
    lacking = [v for v in logs.vehicle.unique() if f"{v} {NORMAL}" not in cases]
    if freedom < 1 or lacking or not np.isfinite(logs[["voltage", *QUANTITIES]].to_numpy(float)).all():
        raise UserError(f"{folder} needs hover of each vehicle's {NORMAL}, and conditions flown twice")
    inverse = np.linalg.inv(x.T @ x)
    quantile = stats.t.ppf(1.0 - 0.025 / (len(cases) - logs.vehicle.nunique()), freedom)
    rows = {c: dict(zip(("vehicle", "condition"), c.split(" "))) for c in cases}
    slopes = {}
    for quantity in QUANTITIES:
        y = logs[quantity].to_numpy()
        fit = inverse @ x.T @ y
        variance = ((y - x @ fit) ** 2).sum() / freedom
        slopes[quantity] = float(fit[-1])
        slopes[f"{quantity}_half"] = float(quantile * np.sqrt(variance * inverse[-1, -1]))
        for c in cases:
            contrast = np.zeros(x.shape[1])
            contrast[cases.index(c)] += 1.0
            contrast[cases.index(f"{c.split(' ')[0]} {NORMAL}")] -= 1.0
            rows[c][quantity] = float(contrast @ fit)
            rows[c][f"{quantity}_half"] = float(quantile * np.sqrt(variance * contrast @ inverse @ contrast))
    table = pd.DataFrame([r for r in rows.values() if r["condition"] != NORMAL])
    seen = {"more force": "total", "M3 works harder": "M3"}
    table["says"] = [
        ", ".join(what for what, key in seen.items() if row[key] > row[f"{key}_half"]) or "nothing"
        for _, row in table.iterrows()
    ]
    return table, slopes


def draw(table: pd.DataFrame) -> Figure:
    """Return the change of the motor commands after known hardware changes."""
    y = np.arange(len(table))
    with styled():
        figure = Figure(figsize=(7.4, 4.6), layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True)
        for axes, quantity, title in (
            (left, "total", "change of PWM, all motors [%]"),
            (right, "M3", "change of PWM, motor M3 [%]"),
        ):
            seen = table[quantity].abs() > table[f"{quantity}_half"]
            for which, colour, mark, words in (
                (seen, GREEN, "o", "95 % interval excludes 0"),
                (~seen, MUTED, "s", "95 % interval includes 0"),
            ):
                error = table[f"{quantity}_half"][which]
                look = {"ls": "", "marker": mark, "color": colour, "capsize": 2, "ms": 4, "lw": 1.6}
                axes.errorbar(table[quantity][which], y[which], xerr=error, label=words, **look)
            axes.axvline(0.0, color=INK, lw=0.8)
            axes.grid(axis="x")
            axes.set_xlabel(title)
        names = [f"{v}: {c.replace('_', ' ')}" for v, c in zip(table.vehicle, table.condition)]
        left.set_yticks(y, names)
        left.set_ylim(len(table) - 0.5, -0.5)
        figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=2)
        figure.suptitle(
            "CrazyPAD: motor commands in hover after a known change, relative to the "
            f"{NORMAL.replace('_', ' ')}\n"
            "(E8, E9: vehicles; M1 to M4: motors; W1: a weight, W3: a heavier one)",
            size=10, x=0.01, ha="left",
        )  # fmt: skip
    return figure


# --- motor lag ---------------------------------------------------------------------------------------


def motor_lag(path: Path) -> dict:
    """Return the rates [1/s] of a first-order motor lag before a quadratic thrust curve, fitted to `imu_az`.

    One rate, and one each for spinning up and down; fits in percent of the accelerometer's own variation.
    """
    motors = [f"m{i}_pwm" for i in (1, 2, 3, 4)]
    table = read_columns(path, ("t", "imu_az", *motors))
    dt = float(np.median(np.diff(table.t)))
    pwm = table[motors].to_numpy() / 65535.0
    measured = table.imu_az.to_numpy()
    settled = slice(int(0.3 / dt), None)

    def left(log_rates):
        up, down = 1.0 - np.exp(-dt * np.exp(log_rates[0])), 1.0 - np.exp(-dt * np.exp(log_rates[-1]))
        u = np.stack([_lagged(np.ascontiguousarray(m), up, down) for m in pwm.T], axis=1)
        a = np.stack([np.ones(len(u)), u.mean(axis=1), (u**2).mean(axis=1)], axis=1)[settled]
        q = np.linalg.lstsq(a, measured[settled], rcond=None)[0]
        return a @ q - measured[settled]

    one = least_squares(left, [np.log(15.0)], diff_step=1e-3)
    two = least_squares(left, [one.x[0], one.x[0]], diff_step=1e-3)
    variation = measured[settled].std()
    fits = [100.0 * (1.0 - left(s.x).std() / variation) for s in (one, two)]
    rate, up, down = map(float, np.exp([*one.x, *two.x]))
    return {
        "log": path.name.split(".")[0],
        "rate": rate,
        "up": up,
        "down": down,
        "fit %": float(fits[0]),
        "gain of two rates %": float(fits[1] - fits[0]),
    }


@numba.njit(cache=True)
def _lagged(x, up, down):
    """First-order lag of x (m,) that closes the share `up` of the distance a row, `down` where it falls."""
    out = np.empty_like(x)
    s = x[0]
    for k in range(len(x)):
        s += (up if x[k] > s else down) * (x[k] - s)
        out[k] = s
    return out
