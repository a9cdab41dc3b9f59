"""What others would do with the same flights: a regression by hand of a told size, or parameter tuning.

`tune` fits all parameters that the model already has together, as system identification tools do; it is given
the workflow's own windows and whitening, which they lack. It cannot answer that something unknown remains.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats
from scipy.optimize import least_squares

from inclined_landing.eval.gap.flights.windows import prepare_all
from inclined_landing.eval.gap.infer.fit import fit_least_squares
from inclined_landing.eval.gap.model.problem import Problem
from inclined_landing.eval.logs import FlightLog, motion
from inclined_landing.eval.logs.log import MOTORS_OFF
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.vehicle import Vehicle

# Effects that rescale a constant of the paper's equations.
TUNED = tuple(
    name
    for name, effect in LIBRARY.items()
    if any(p.constant and not p.constant.field.startswith("effects_") for p in effect.parameters)
)


def tune(flights: Sequence[FlightLog], vehicle: Vehicle) -> set[str]:
    """Return which of TUNED are off: the 95 % interval leaves out nominal, by more than is negligible."""
    problem = Problem.of(prepare_all(flights, vehicle, False)[0], vehicle, LIBRARY)
    names = [name for name in TUNED if name in problem.library]
    fit = fit_least_squares(problem, {name: {} for name in names}, iterations=15)
    error = _standard_errors(fit.linear.a, fit.linear.b)
    quantile = stats.t.ppf(0.975, max(1, problem.groups - 1))
    found = set()
    for column, e in zip(fit.linear.columns, error):
        p = problem.parameter(column)
        name, parameter = column.key
        value = fit.values[name][parameter]
        if abs(value - p.neutral) > max(quantile * e, p.negligible):
            found.add(column.effect)
    return found


def _standard_errors(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the cluster-robust standard errors (P,) of a fit (sandwich estimator), a (g, P, P), b (g, P)."""
    # A^-1 [n/(n-1) sum_g s_g s_g'] A^-1,  s_g = b_g - a_g x the score of group g at the solution x (Liang and
    # Zeger 1986), in units of the diagonal of A; at least by the windows' noise, A^-1.
    total, n = a.sum(axis=0), len(a)
    unit = np.sqrt(np.maximum(np.diag(total), 1e-300))
    inverse = np.linalg.inv(total / np.outer(unit, unit) + 1e-9 * np.eye(len(unit)))
    scores = b / unit - a / np.outer(unit, unit) @ (inverse @ (b.sum(axis=0) / unit))
    clustered = inverse @ (scores.T @ scores * n / max(1, n - 1)) @ inverse
    error = np.sqrt(np.maximum(np.diag(clustered), np.diag(inverse))) / unit
    return np.where(np.diag(total) > 0.0, error, np.inf)


def thrust(reference: Sequence[FlightLog], flights: Sequence[FlightLog]) -> float | None:
    """Return the specific thrust per command of flights over that of the reference; None without either."""
    levels = [
        [x for log in logs if (x := _specific_thrust(log)) is not None] for logs in (reference, flights)
    ]
    return float(np.median(levels[1]) / np.median(levels[0])) if all(levels) else None


def _specific_thrust(log: FlightLog) -> float | None:
    parts = motion.motion(log)
    if not parts:
        return None
    pwm, force = (np.concatenate([getattr(p, k) for p in parts]) for k in ("pwm", "force"))
    good = motion.in_air(log, parts) & np.isfinite(pwm) & np.isfinite(force)
    # f = slope PWM, least squares
    return float(pwm[good] @ force[good] / (pwm[good] @ pwm[good])) if good.sum() >= motion.RATE else None


def wind(reference: Sequence[FlightLog], flights: Sequence[FlightLog]) -> float | None:
    """Return the wind along -x (m/s) of flights, the reference in still air; None without motion.

    One drag, linear and quadratic in the speed through the air, explains both groups.
    """
    groups = [_unexplained(logs) for logs in (reference, flights)]
    if any(len(a) < motion.RATE for a, _ in groups):
        return None
    a, v = (np.concatenate([group[k] for group in groups]) for k in (0, 1))
    windy = np.arange(len(a)) >= len(groups[0][0])

    # a = c - (k1 + k2 |v - w|) (v - w), w = 0 in the reference; c is what levels and trims are off
    def error(x: np.ndarray) -> np.ndarray:
        through = v - windy * complex(x[4], x[5])
        e = complex(x[0], x[1]) - (x[2] + x[3] * abs(through)) * through - a
        return np.concatenate([e.real, e.imag])

    low, high = [-9.0, -9.0, 0.0, 0.0, -40.0, -40.0], [9.0, 9.0, 5.0, 5.0, 40.0, 40.0]
    fit = least_squares(
        error, [0.0, 0.0, 0.2, 0.01, 0.1, 0.0], bounds=(low, high), x_scale=np.array(high) / 9
    )
    return -float(fit.x[4])


def _unexplained(logs: Sequence[FlightLog]) -> tuple[np.ndarray, np.ndarray]:
    """Return horizontal acceleration that the tilt does not explain, and velocity, as x + iy in the world."""
    found = []
    for p in (p for log in logs for p in motion.motion(log)):
        upward = np.maximum(p.vertical_acceleration + motion.GRAVITY, 2.0)
        # horizontal acceleration = thrust_tilt upward exp(i yaw): the turn is had back from the two
        turn = p.horizontal_acceleration / np.where(p.thrust_tilt == 0, 1.0, p.thrust_tilt * upward)
        tilt = np.tan(p.tilt.real) + 1j * np.tan(p.tilt.imag)
        a = p.horizontal_acceleration - tilt * upward * turn
        good = np.isfinite(a) & (abs(turn) > 0.5)
        found.append(np.stack([a[good], p.horizontal_velocity[good]]))
    return tuple(np.concatenate(found, axis=1)) if found else (np.empty(0), np.empty(0))


def request(reference: Sequence[FlightLog], flights: Sequence[FlightLog], rotor: int) -> float | None:
    """Return by which share more is requested of a rotor (0 to 3) than of the others, less the reference's.

    None where requests are not logged.
    """
    levels = [
        [_request(log, rotor) for log in logs if log.requests is not None] for logs in (reference, flights)
    ]
    return float(np.median(levels[1]) / np.median(levels[0]) - 1.0) if all(levels) else None


def _request(log: FlightLog, rotor: int) -> float:
    """Return the request of a rotor over the mean of the others, in flight."""
    assert log.requests is not None
    on = log.requests[(log.requests > MOTORS_OFF).all(axis=1)]
    return float(np.median(on[:, rotor] / np.delete(on, rotor, axis=1).mean(axis=1)))
