"""What others would do with the same flights: tune the model's own parameters, or regress its residuals.

- `tuning`: all parameters that the model already has are fitted together, and those count as named whose 95 %
  interval leaves out the nominal value by more than is negligible. This is what system identification tools
  do; it is given the workflow's own windows and whitening, which they lack.
- `sparse`: accelerations and angular rates by Savitzky-Golay differentiation, less those of the nominal
  model, regressed by pysindy's sequentially thresholded least squares on the terms that the library's effects
  add to them. Scale, bias and mass are one term: free flight shows thrust over mass alone, and several terms
  that cancel would be kept. Lags, delays and contact have no term.

Neither can answer that something unknown remains.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence

import numpy as np
from scipy import stats
from scipy.signal import lfilter, savgol_filter

from inclined_landing.eval.gap import measure_gap
from inclined_landing.eval.gap.flights.windows import in_free_flight, prepare_all
from inclined_landing.eval.gap.infer.fit import fit_least_squares
from inclined_landing.eval.gap.model.problem import Problem
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.attitude import rotation
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.errors import UserError
from inclined_landing.models.forces import lags, pack, rotor_speed_sum, total_thrust
from inclined_landing.models.perturbation import NEUTRAL
from inclined_landing.models.vehicle import Vehicle

# Effects that rescale a constant of the paper's equations.
TUNED = tuple(
    name
    for name, effect in LIBRARY.items()
    if any(p.constant and not p.constant.field.startswith("effects_") for p in effect.parameters)
)
# Only thrust over mass is visible in free flight.
_LEVEL = tuple(name for name, effect in LIBRARY.items() if effect.scales_thrust)
_SMOOTH = 0.1  # s to either side, as the workflow's own velocities
# Least contribution of a term, root mean square over all rows: m/s2 and rad/s. Chosen on development sets.
THRESHOLDS = {"translation": 0.03, "attitude": 0.015, "yaw": 0.01}


def report(method: str, flights: Sequence[FlightLog], heldout: Sequence[FlightLog], vehicle: Vehicle) -> dict:
    """What the scorer reads of a report, by baseline `method` (tuning or sparse)."""
    values = {"tuning": tune, "sparse": regress}[method](flights, vehicle)
    corrected = vehicle
    for name, effect in LIBRARY.items():
        if name in values:
            corrected = effect.apply(corrected, values[name])
    gap = {}
    for plant in ("analytic", "mujoco"):
        try:
            before = measure_gap(vehicle, heldout, plant=plant)
            after = measure_gap(corrected, heldout, plant=plant)
        except UserError:
            continue  # landings: no second of free flight
        gap[plant] = {"before": before["error"], "after": after["error"], "floor": before["floor"]}
    return {
        "verdict": "effects" if values else "nothing",
        "effects": [
            {
                "name": name,
                "members": list(_LEVEL if name in _LEVEL else (name,)),
                "parameters": {key: {"value": value} for key, value in numbers.items()},
            }
            for name, numbers in values.items()
        ],
        "gap": gap,
    }


def tune(flights: Sequence[FlightLog], vehicle: Vehicle) -> dict[str, dict[str, float]]:
    """Effect -> parameter -> value for TUNED, those that differ from nominal."""
    problem = Problem(prepare_all(flights, vehicle, False, []), vehicle, LIBRARY)
    names = [name for name in TUNED if name in problem.library]
    fit = fit_least_squares(problem, {name: {} for name in names}, np.ones(problem.channels), iterations=15)
    error = np.sqrt(np.diag(fit.linear.covariance()))
    quantile = stats.t.ppf(0.975, max(1, problem.groups - 1))
    found: dict[str, dict[str, float]] = {}
    for column, e in zip(fit.linear.columns, error):
        p = problem.parameter(column)
        value = fit.values[column.effect][column.parameter]
        if abs(value - p.neutral) > max(quantile * e, p.negligible):
            found[column.effect] = dict(fit.values[column.effect])
    return found


def regress(flights: Sequence[FlightLog], vehicle: Vehicle) -> dict[str, dict[str, float]]:
    """Effect -> parameter -> value by sparse regression."""
    tables = [_terms(log, vehicle) for log in flights]
    coefficients: dict[tuple[str, str], float] = {}
    for channel, threshold in THRESHOLDS.items():
        if any(channel not in table for table in tables):
            continue  # its command was not logged
        residual = np.concatenate([table[channel][0] for table in tables])
        terms = [key for key in tables[0][channel][1] if all(key in table[channel][1] for table in tables)]
        columns = {key: np.concatenate([table[channel][1][key] for table in tables]) for key in terms}
        coefficients |= _stlsq(columns, residual, threshold)
    values: dict[str, dict[str, float]] = {}
    for (name, parameter), coefficient in coefficients.items():
        p = LIBRARY[name].parameter(parameter)
        numbers = values.setdefault(name, dict(LIBRARY[name].neutral))
        numbers[parameter] = float(np.clip(p.neutral + coefficient, *p.bounds))
    # The terms of a battery are about these; what is off there belongs to the thrust scale.
    about = {"PWM": vehicle.hover_pwm, "V": vehicle.effects_voltage_reference}
    for name in values:
        if (reference := LIBRARY[name].reference) and reference.unit in about:
            values[name][reference.name] = about[reference.unit]
    return values


def _stlsq(columns: dict, residual: np.ndarray, threshold: float) -> dict:
    """Coefficients of the terms that stay, each contributing at least `threshold` root mean square."""
    import pysindy

    size = {key: float(np.sqrt(np.mean(column**2))) for key, column in columns.items()}
    keys = [key for key in columns if size[key] > 0]
    x = np.column_stack([columns[key] / size[key] for key in keys])
    optimiser = pysindy.STLSQ(threshold=threshold, alpha=1e-6)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # it warns when no term stays, which is an answer
        optimiser.fit(x, residual[:, None])
    found = np.ravel(optimiser.coef_)
    return {key: c / size[key] for key, c in zip(keys, found) if c != 0.0}


def _terms(log: FlightLog, vehicle: Vehicle) -> dict[str, tuple[np.ndarray, dict]]:
    """Channel -> (residual (n,), {(effect, parameter): term (n,)}) of the free flight of one log."""
    v, packed, dt = vehicle, pack(vehicle), 1.0 / log.rate
    window = 2 * round(_SMOOTH / dt) + 1
    rows = in_free_flight(log, vehicle)
    rows[: max(window, round(0.3 / dt))] = rows[-window:] = False

    def smooth(x, derivative=0):
        return savgol_filter(x, window, 3, deriv=derivative, delta=dt, axis=0)

    velocity, acceleration = smooth(log.position, 1), smooth(log.position, 2)
    measured = np.nan_to_num(log.attitude)  # a heading that was not logged: the workflow's own choice too
    attitude, rates = smooth(measured), smooth(measured, 1)
    pwm = log.command[:, 0]
    # Measured speeds lag behind nothing.
    lag = pwm / v.thrust_lag_rate if log.thrust_is_measured else lags(pwm, dt, packed)[:-1]
    load = v.thrust_lag_rate * lag
    n = int(rows.sum())
    up, drag, across, still, wind_x, wind_y = (np.empty((n, 3)) for _ in range(6))
    force, plane, axial, near = (np.empty(n) for _ in range(4))
    for k, i in enumerate(np.flatnonzero(rows)):
        r = rotation(*attitude[i])
        force[k] = total_thrust(lag[i], pwm[i], packed[0], np.array(NEUTRAL))
        k_drag = r @ np.diag(v.drag_coefficients) @ r.T * rotor_speed_sum(force[k], packed[0]) / v.body_mass
        body = r.T @ velocity[i]
        up[k], drag[k] = r[:, 2], k_drag @ velocity[i]
        across[k] = k_drag @ (velocity[i] - body[2] * r[:, 2])
        wind_x[k], wind_y[k] = -k_drag[:, 0], -k_drag[:, 1]
        still[k] = -np.linalg.norm(body) * velocity[i] / v.body_mass
        plane[k], axial[k] = body[0] ** 2 + body[1] ** 2, body[2]
        near[k] = min(0.5, v.rotor_radius / (4.0 * max(log.position[i, 2], 0.01))) ** 2
    thrust = up * force[:, None] / v.body_mass
    t, load, hover = log.t[rows] - log.t[0], load[rows], v.hover_pwm
    translation = {
        ("thrust_scale", "scale"): thrust,
        ("thrust_fade", "rate"): -thrust * t[:, None],
        ("battery_sag", "sag"): -thrust * (load / hover - 1.0)[:, None],
        ("rotor_drag", "lateral"): across,
        ("rotor_drag", "axial"): drag - across,
        ("body_drag", "coefficient"): still,
        ("wind", "x"): wind_x,
        ("wind", "y"): wind_y,
        ("translational_lift", "coefficient"): thrust * plane[:, None],
        ("axial_inflow", "coefficient"): -thrust * axial[:, None],
        ("ground_effect", "strength"): thrust * near[:, None],
    }
    if log.voltage is not None:
        volts = log.voltage[rows] - v.effects_voltage_reference
        translation["battery_voltage", "sensitivity"] = thrust * volts[:, None]
    nominal = thrust + drag - np.array([0.0, 0.0, v.environment_gravity])
    result = {"translation": _flat(acceleration[rows] - nominal, translation)}
    if not np.isnan(log.command[:, 3]).any():
        result["yaw"] = _flat(rates[rows, 2] - log.command[rows, 3], {("yaw_drift", "rate"): np.ones(n)})
    if np.isnan(log.command[:, 1:3]).any():
        return result
    # The rate loop delays the command; its time constant is known.
    keep = math.exp(-v.attitude_bandwidth * dt)
    wanted = log.command[:, 1:3]
    wanted = lfilter([0.0, 1.0 - keep], [1.0, -keep], wanted - wanted[0], axis=0) + wanted[0]
    gain, tau = v.attitude_gain, v.attitude_time_constant
    wanted, angle = wanted[rows], attitude[rows, :2]
    loop = (gain * wanted - angle) / tau
    one, none = np.full(n, gain / tau), np.zeros(n)
    attitude_terms = {
        ("attitude_gain", "scale"): gain * wanted / tau,
        ("attitude_time_constant", "scale"): -loop,
        ("attitude_trim", "roll"): np.column_stack([one, none]),
        ("attitude_trim", "pitch"): np.column_stack([none, one]),
    }
    return {**result, "attitude": _flat(rates[rows, :2] - loop, attitude_terms)}


def _flat(residual: np.ndarray, terms: dict) -> tuple[np.ndarray, dict]:
    return residual.ravel(), {key: term.ravel() for key, term in terms.items()}
