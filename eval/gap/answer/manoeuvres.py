"""Flights that would tell effects apart which look alike in the flights at hand.

Each manoeuvre is a smooth path flown perfectly; how far it separates two effects is computed with the
windows, noise and unrest of the diagnosis, in standard errors, after everything else that could be adjusted
(the first effect's own size, the accepted effects) has been.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy.ndimage import gaussian_filter1d

from inclined_landing.eval.gap.flights.unrest import Unrest
from inclined_landing.eval.gap.flights.windows import prepare
from inclined_landing.eval.gap.search.evidence import Problem, Values, solve
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.parameters import Vehicle

SECONDS = 20.0
RATE = 100.0
# Standard errors below which a flight tells nothing apart.
SEPARATED = 3.0


def _yaw_turn(t):
    return np.zeros((len(t), 3)) + [0, 0, 1.2], 2.0 * math.pi * t / t[-1]


def _vertical(t):
    z = 1.2 + 0.35 * np.sin(2 * np.pi * 0.5 * t) + 0.03 * np.sign(np.sin(2 * np.pi * 1.0 * t))
    return np.stack([0 * t, 0 * t, _smooth(z)], axis=1), 0 * t


def _fast(t):
    speed = 0.3 + 0.7 * (t > 0.5 * t[-1])
    phase = np.cumsum(speed) * (t[1] - t[0]) * 2 * np.pi * 0.35
    return np.stack([1.4 * np.sin(phase), 0.4 * np.sin(0.5 * phase), 1.2 + 0 * t], axis=1), 0 * t


def _doublets(t):
    x = 0.25 * np.sign(np.sin(2 * np.pi * 0.45 * t))
    return np.stack([_smooth(x, 0.25), _smooth(-x, 0.25), 1.2 + 0 * t], axis=1), 0 * t


def _low_and_high(t):
    z = 0.55 + 0.5 * np.sign(np.sin(2 * np.pi * t / 8.0))
    return np.stack([0 * t, 0 * t, _smooth(z, 0.5)], axis=1), 0 * t


def _heights(t):
    z = 1.2 + 0.5 * np.sin(2 * np.pi * 0.8 * t)
    return np.stack([0 * t, 0 * t, z], axis=1), 0 * t


MANOEUVRES: dict[str, tuple[str, Callable]] = {
    "turn": ("hover while turning once around the vertical axis", _yaw_turn),
    "thrust_steps": ("steps of thrust up and down in place, half a second apart", _vertical),
    "fast": ("fly to and fro over two metres, first slowly, then fast", _fast),
    "attitude_steps": ("quick steps of roll and pitch to both sides", _doublets),
    "low_and_high": ("hover a few centimetres above the floor and one metre higher in turn", _low_and_high),
    "heave": ("climb and sink over one metre as hard as the thrust allows", _heights),
}


def _smooth(x: np.ndarray, seconds: float = 0.15) -> np.ndarray:
    return gaussian_filter1d(x, seconds * RATE, mode="nearest")


def fly(name: str, vehicle: Vehicle, noise: np.ndarray) -> FlightLog:
    """A manoeuvre flown perfectly by `vehicle` without effects: pose and the commands it takes."""
    t = np.arange(0, SECONDS, 1 / RATE)
    position, yaw = MANOEUVRES[name][1](t)
    acceleration = np.gradient(np.gradient(position, t, axis=0), t, axis=0)
    thrust = acceleration + [0, 0, vehicle.environment_gravity]
    size = np.linalg.norm(thrust, axis=1)
    d = thrust / size[:, None]
    across = np.cos(yaw) * d[:, 1] - np.sin(yaw) * d[:, 0]
    along = np.cos(yaw) * d[:, 0] + np.sin(yaw) * d[:, 1]
    # Thrust along the third column of Rx Ry: (sin pitch, -sin roll cos pitch, cos roll cos pitch).
    pitch = np.arcsin(np.clip(along, -0.7, 0.7))
    roll = np.arctan2(-across, d[:, 2])
    angles = np.stack([roll, pitch], axis=1)
    wanted = (
        angles + vehicle.attitude_time_constant * np.gradient(angles, t, axis=0)
    ) / vehicle.attitude_gain
    pwm = vehicle.hover_pwm * size / vehicle.environment_gravity
    pwm = pwm + np.gradient(pwm, t) / vehicle.thrust_lag_rate
    # Measured poses carry noise, for `prepare` to find.
    rng = np.random.default_rng(0)
    command = np.stack([np.clip(pwm, 10000, 60000), wanted[:, 0], wanted[:, 1], np.gradient(yaw, t)], axis=1)
    shape = position.shape
    return FlightLog(
        name,
        t,
        position + noise[:3] * rng.standard_normal(shape),
        np.column_stack([roll, pitch, yaw]) + noise[3:] * rng.standard_normal(shape),
        command,
    )


def separating(problem: Problem, stir: Unrest, ties: Sequence[tuple[str, ...]], values: Values) -> list[dict]:
    """For every class of more than one effect, the manoeuvre that separates its members best.

    stir: the unrest that they are flown in.
    Returns [{name, text, separation, members}], separation in standard errors of the closest pair,
    largest first.
    """
    answers = [_separating(problem, stir, members, values) for members in ties if len(members) > 1]
    return sorted(answers, key=lambda r: -r["separation"])


def _separating(problem: Problem, stir: Unrest, members: tuple[str, ...], values: Values) -> dict:
    told = " ".join(problem.library[m].told_by for m in members if problem.library[m].told_by)
    members = tuple(m for m in members if not problem.library[m].told_by)
    flown = MANOEUVRES if len(members) > 1 else ()
    tried = {name: _separation(problem, stir, name, members, values) for name in flown}
    scored = {name: errors for name, errors in tried.items() if errors is not None}
    best = max(scored, key=lambda name: (scored[name], name), default="none")
    errors, text = scored.get(best, 0.0), ""
    if scored and errors >= SEPARATED:
        text = f"To tell {_list(members)} apart: {MANOEUVRES[best][0]} "
        text += f"({SECONDS:.0f} s separate them by {errors:.0f} standard errors)."
    elif scored:
        best, text = "none", f"None of the flights tried tells {_list(members)} apart"
        text += ": correct any one of them." if told else "."
    text = f"{told} {text}".strip()
    return {"name": best, "text": text, "separation": errors, "members": list(members)}


def _separation(
    problem: Problem, stir: Unrest, name: str, members: Sequence[str], values: Values
) -> float | None:
    """Standard errors between the accepted effect, the first, and the closest to it; None if not seen."""
    noise = np.median([f.noise for f in problem.flights], axis=0)
    flown = Problem(
        [prepare(fly(name, problem.vehicle, noise), problem.vehicle)], problem.vehicle, problem.library
    )
    flown.rewhiten(stir, problem.vehicle)
    live = [m for m in members if m in flown.library]
    if len(live) < 2:
        return None
    others = {k: v for k, v in values.items() if k not in members}
    linear = flown.linearise(others, flown.columns(others, live + list(others))).weighted(np.ones(6))
    a = linear.a.sum(axis=0)
    own, nuisance = linear.index(live[:1]), linear.index(list(others))
    parameters = [problem.parameter(linear.columns[k]) for k in own]
    size = np.array([p.size(values.get(live[0], {}).get(p.name, p.plausible)) for p in parameters])
    distance = []
    for other in live[1:]:
        columns = np.concatenate([linear.index([other]), nuisance])
        cross = a[np.ix_(columns, own)] @ size
        left = size @ a[np.ix_(own, own)] @ size - cross @ solve(a[np.ix_(columns, columns)], cross)
        distance.append(math.sqrt(max(0.0, float(left))))
    return min(distance)


def _list(names: Sequence[str]) -> str:
    return ", ".join(names[:-1]) + f" and {names[-1]}"
