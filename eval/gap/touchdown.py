"""Naming what is wrong about contact, from landings: friction, stiffness, damping, platform height and tilt.

Contact has no equations of its own here: every landing is simulated in the MuJoCo plant from the measured
state shortly before the touch, under the commands that were sent, and the motion that follows is compared
in the axes of the surface. Start states are known up to their noise, and touches magnify it: each landing
is flown from a few of them, and their mean is what is compared. The search is that of free flight.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.signal import savgol_coeffs

from inclined_landing.eval.gap.evidence import Column, Linear, Values
from inclined_landing.eval.gap.naming import Search, Thresholds, objection, refit, trial_of
from inclined_landing.eval.gap.result import Candidate, SearchStep
from inclined_landing.eval.gap.rollout import drive
from inclined_landing.eval.gap.windows import measurement_noise
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.attitude import LAG, PITCH, ROLL, STATE_SIZE, VX, WX, X, Y, Z, body_rates
from inclined_landing.models.effects import Effect
from inclined_landing.models.parameters import Vehicle
from inclined_landing.models.plant import MujocoPlant

BEFORE = 0.1  # s before the touch at which the simulation starts
LOOK_BACK = 0.14  # s of flight before that from which the start state is fitted
STEP = 0.0025  # s at most, of the engine; it runs often here
AFTER = 0.6  # s after the touch that are compared
EVERY = 0.02  # s between the compared samples
STARTS = 2  # start states for every landing
FEWEST = 6  # landings
# What the comparison cannot be better than, one idealised contact against another: along the slope, where
# feet slide, across it, along its normal [m]; roll, pitch, yaw [rad].
CONTACT_FLOOR = (0.003, 0.001, 0.001, 0.01, 0.01, 0.02)
# Mean square of the errors, in standard deviations, below which nothing is looked for.
QUIET = 0.7
MATCHED = 0.48  # the same for landings that nothing is wrong with
UNEXPLAINED = 1.2  # mean square above which landings are not explained
EXPLAINED = 0.6  # share of what is above that which an effect must explain to be named
REFITTED = 2  # effects of every step
HUBER = 3.0  # standard deviations beyond which errors count linearly
SCAN = (-2.0, -1.0, -0.4, 0.4, 1.0, 2.0)  # times the plausible deviation
STEPS = 2.0  # difference quotients over this many times a parameter's negligible size
# Landings are few, and each tells more than a window of free flight.
LIMITS = Thresholds(
    evidence=2.0,
    gain=600.0,
    share=0.15,
    share_more=0.05,
    share_left=0.2,
    agreement=0.6,
    spread=1.0,
    alike=0.95,
    most=2,
    shortlist=5,
)


@dataclasses.dataclass
class Landing:
    """One touchdown: what is needed to simulate and compare it."""

    name: str
    dt: float
    start: np.ndarray  # (STARTS, 13) states without lag
    first: int  # row of the log at the start
    touch: int  # row of the log at the touch
    rows: int  # steps to simulate
    measured: np.ndarray  # (k, 6) pose at the compared rows
    compared: np.ndarray  # (k,) steps after the start
    deviation: np.ndarray  # (k, 6) standard deviation of measured minus simulated
    command: np.ndarray  # (m, 4) of the whole log
    on_platform: bool


def landings_of(logs: Sequence[FlightLog], vehicle: Vehicle, seed: int = 0) -> list[Landing]:
    """The touchdowns of flights with a contact channel: the first touch after at least 0.3 s of flight."""
    rng = np.random.default_rng(seed)
    found = []
    for log in logs:
        if log.contact is None or not log.contact.any():
            continue
        dt = float(np.median(np.diff(log.t)))
        back, rest = round((BEFORE + LOOK_BACK) / dt), round(AFTER / dt)
        touching = log.contact.astype(int)
        for touch in np.flatnonzero(np.diff(touching) == 1) + 1:
            if touch < back + 2 or log.contact[max(0, touch - max(back, round(0.3 / dt))) : touch].any():
                continue
            if touch + rest >= len(log.t):
                continue
            found.append(_landing(log, int(touch), dt, vehicle, rng))
    return found


def _landing(log: FlightLog, touch: int, dt: float, vehicle: Vehicle, rng) -> Landing:
    first = touch - round(BEFORE / dt)
    back = round(LOOK_BACK / dt)
    pose = np.hstack([log.position, np.unwrap(log.attitude, axis=0)])
    noise = measurement_noise(pose)
    # A parabola through the samples up to the start, and half as many after it, all before the touch.
    ahead = min(back // 2, touch - first - 2)
    length = back + ahead + 1
    length -= 1 - length % 2
    window = pose[first + ahead - length + 1 : first + ahead + 1]
    place = length - 1 - ahead
    weights = [savgol_coeffs(length, 2, deriv=d, delta=dt, pos=place, use="dot") for d in (0, 1)]
    value, rate = (w @ window for w in weights)
    gain = [np.linalg.norm(w) for w in weights]
    start = np.zeros((STARTS, STATE_SIZE))
    draws = rng.standard_normal((STARTS // 2, 12))
    draws = np.concatenate([draws, -draws])  # antithetic: their mean is the fitted state
    for k, draw in enumerate(draws):
        v = value + gain[0] * noise * draw[:6]
        r = rate + gain[1] * noise * draw[6:]
        start[k, :3], start[k, VX : VX + 3] = v[:3], r[:3]
        start[k, ROLL : ROLL + 3] = v[3:]
        start[k, WX : WX + 3] = body_rates(v[3], v[4], *r[3:])
    step = max(1, round(EVERY / dt))
    rows = touch - first + round(AFTER / dt)
    compared = np.arange(touch - first - step, rows + 1, step)
    since = compared[:, None] * dt
    floor = np.array(CONTACT_FLOOR)
    # What differs grows while things move, and stays once they rest.
    moving = np.minimum(since, BEFORE + 0.25)
    deviation = np.sqrt(noise**2 * (1 + gain[0] ** 2) + (gain[1] * noise * moving) ** 2 + floor**2)
    half = vehicle.slab_half_length * math.cos(vehicle.platform_inclination) + 0.05
    over = abs(value[0]) < half and abs(value[1]) < 0.5 * vehicle.platform_depth + 0.05
    return Landing(
        log.name,
        dt,
        start,
        first,
        touch,
        rows,
        pose[first + compared],
        compared,
        deviation,
        np.where(np.isnan(log.command), 0.0, log.command),
        bool(over and value[2] > 0.5 * vehicle.platform_surface_height),
    )


class TouchdownProblem:
    """Landings with the face of `evidence.Problem`, for `naming.search`.

    Channels: along and across the slope, along its normal, roll, pitch, yaw.
    """

    def __init__(self, landings: Sequence[Landing], vehicle: Vehicle, library: Mapping[str, Effect]):
        self.flights = list(landings)
        self.vehicle = vehicle
        self.library = {n: e for n, e in library.items() if set(e.channels) == {"touchdown"}}
        n = len(self.flights)
        self.flight_of = self.group_of = np.arange(n)
        self.groups = n
        self.samples = min(len(x.compared) for x in self.flights)
        self.rows = np.full(n, self.samples)
        self.logged = self.weight = np.ones((n, 6))

    def corrected(self, values: Values) -> Vehicle:
        """The vehicle with effects at `values`."""
        vehicle = self.vehicle
        for name, effect in self.library.items():
            if name in values:
                vehicle = effect.apply(vehicle, values[name])
        return vehicle

    def columns(self, values: Values, names: Sequence[str]) -> list[Column]:
        """All parameters of the effects `names`."""
        return [Column(name, p.name) for name in names for p in self.library[name].parameters]

    def scan(self, name: str, values: Values) -> tuple[float, dict[str, float]]:
        """Least squared error over a few values of an effect with one parameter, and the value."""
        parameter = self.library[name].parameters[0]
        span = parameter.plausible - parameter.neutral
        left = {}
        for x in np.clip(parameter.neutral + span * np.array(SCAN), *parameter.bounds):
            vehicle = self.corrected({**values, name: {parameter.name: float(x)}})
            left[float(x)] = float((self.errors(vehicle) ** 2).sum())
        best = min(left, key=left.get)
        return left[best], {parameter.name: best}

    def errors(self, vehicle: Vehicle) -> np.ndarray:
        """Errors (n, 6, samples) in standard deviations, large ones drawn in."""
        simulated = simulate(self.flights, vehicle)
        result = np.empty((len(self.flights), 6, self.samples))
        si, ci = math.sin(self.vehicle.platform_inclination), math.cos(self.vehicle.platform_inclination)
        for k, landing in enumerate(self.flights):
            error = landing.measured - simulated[k][landing.compared]
            if landing.on_platform:
                x, z = error[:, 0].copy(), error[:, 2].copy()
                error[:, 0], error[:, 2] = ci * x - si * z, si * x + ci * z
            white = (error / landing.deviation)[: self.samples].T
            size = np.abs(white)
            drawn = np.sqrt(np.maximum(2 * HUBER * size - HUBER**2, 0.0))
            result[k] = np.where(size <= HUBER, white, np.sign(white) * drawn)
        return result

    def linearise(self, values: Values, columns: Sequence[Column]) -> Linear:
        """As `evidence.Problem.linearise`."""
        error = self.errors(self.corrected(values))
        slopes = []
        for column in columns:
            effect = self.library[column.effect]
            parameter = next(p for p in effect.parameters if p.name == column.parameter)
            at = dict(effect.neutral) | dict(values.get(column.effect, {}))
            lo, hi = parameter.bounds
            step = STEPS * parameter.negligible
            ends = [max(lo, at[parameter.name] - step), min(hi, at[parameter.name] + step)]
            low, high = (
                self.errors(self.corrected({**values, column.effect: {**at, parameter.name: x}}))
                for x in ends
            )
            slopes.append(-(high - low) / (ends[1] - ends[0]))
        c = np.einsum("wcq,wcq->wc", error, error)
        if not slopes:
            return Linear((), np.zeros((*c.shape, 0, 0)), np.zeros((*c.shape, 0)), c, self)
        j = np.stack(slopes, axis=2)
        return Linear(tuple(columns), j @ j.swapaxes(2, 3), np.einsum("wcpq,wcq->wcp", j, error), c, self)


def simulate(landings: Sequence[Landing], vehicle: Vehicle) -> np.ndarray:
    """Mean simulated pose (n, rows + 1, 6) of every landing over its start states, in the MuJoCo plant."""
    dt = landings[0].dt
    rows = max(x.rows for x in landings)
    n = len(landings) * STARTS
    plain = dataclasses.replace(
        vehicle,
        command_control_period=dt,
        effects_thrust_delay=0.0,
        effects_attitude_delay=0.0,
        effects_mocap_delay=0.0,
    )
    state = np.concatenate([x.start for x in landings])
    commands = np.zeros((n, rows, 4))
    for k, x in enumerate(landings):
        driven, lag = drive(_Driven(x.command, dt), vehicle)
        own = slice(k * STARTS, (k + 1) * STARTS)
        part = driven[x.first : x.first + rows]
        commands[own, : len(part)] = part
        commands[own, len(part) :] = part[-1]
        state[own, LAG] = lag[x.first]
    plant = MujocoPlant(n, plain, timestep=dt / math.ceil(dt / STEP - 1e-9), integrator="implicitfast")
    plant.torque_needs_motors = True
    plant.set_platform(np.arange(n), vehicle.platform_inclination)
    plant.reset(np.arange(n), state)
    pose = np.empty((n, rows + 1, 6))
    columns = [X, Y, Z, ROLL, PITCH, PITCH + 1]
    pose[:, 0] = state[:, columns]
    for k in range(rows):
        plant.step(commands[:, k])
        pose[:, k + 1] = plant.state[:, columns]
    pose[..., 3:] = np.unwrap(pose[..., 3:], axis=1)
    return pose.reshape(len(landings), STARTS, rows + 1, 6).mean(axis=1)


def position_errors(landings: Sequence[Landing], vehicle: Vehicle) -> np.ndarray:
    """Distance (n, samples) [m] between simulated and measured position of every landing."""
    simulated = simulate(landings, vehicle)
    samples = min(len(x.compared) for x in landings)
    return np.stack(
        [
            np.linalg.norm((x.measured - s[x.compared])[:samples, :3], axis=1)
            for x, s in zip(landings, simulated)
        ]
    )


@dataclasses.dataclass
class _Driven:
    """What `rollout.drive` reads of a flight."""

    command: np.ndarray
    dt: float


def name_contact(
    landings: Sequence[Landing],
    vehicle: Vehicle,
    library: Mapping[str, Effect],
    limits: Thresholds = LIMITS,
) -> tuple[TouchdownProblem, Search]:
    """Name the contact effects that `vehicle`, corrected for free flight, lacks to explain `landings`.

    Feet that stick say nothing about how they would slide, so that every effect is scanned through the
    simulator, and the best few are refitted.
    """
    problem = TouchdownProblem(landings, vehicle, library)
    noise = np.ones(6)
    fit = refit(problem, {}, noise)
    found = Search(fit, [], noise, 1.0, {}, {}, {}, {}, [])
    total = fit.squares
    for _ in range(limits.most):
        if fit.squares < QUIET * 6 * problem.rows.sum():
            break
        scans = {n: problem.scan(n, fit.values) for n in problem.library if n not in fit.values}
        order = sorted(scans, key=lambda n: scans[n][0])
        before, trials, reasons = fit.weighted.c, {}, {}
        for name in order[:REFITTED]:
            new = refit(problem, {**fit.values, name: scans[name][1]}, noise, iterations=3)
            trials[name] = trial_of(problem, new, name, before - new.weighted.c)
        ranked = sorted(trials, key=lambda n: -trials[n].gain)
        best = ranked[0]
        closable = max(1.0, trials[best].gain)
        found.closable = max(found.closable, closable)
        reasons[best] = objection(problem, best, trials[best], closable, found.closable, limits, fit.values)
        excess = fit.squares - MATCHED * 6 * problem.rows.sum()
        if not reasons[best] and trials[best].gain < EXPLAINED * excess:
            reasons[best] = f"explains {100 * trials[best].gain / excess:.0f} % only"
        accepted = None if reasons[best] else best
        alike = [n for n in ranked if trials[n].gain > limits.alike * closable] if accepted else []
        rows = [
            Candidate(
                n,
                t.gain,
                t.gain / closable,
                t.evidence,
                True,
                n in alike,
                reasons.get(n, "explains less"),
                t.values,
            )
            for n, t in ((n, trials[n]) for n in ranked)
        ]
        for n in order[REFITTED:]:
            gain = fit.squares - scans[n][0]
            rows.append(Candidate(n, gain, gain / closable, 0.0, False, False, "explains less", scans[n][1]))
        found.steps.append(SearchStep(accepted, (), tuple(rows)))
        if accepted is None:
            break
        fit = trials[best].fit
        found.evidence[best], found.classes[best] = trials[best].evidence, tuple(alike)
        found.gains[best] = float(np.clip(trials[best].gain / total, 0.0, 1.0))
    found.fit = fit
    found.unexplained = fit.squares > UNEXPLAINED * 6 * problem.rows.sum()
    return problem, found
