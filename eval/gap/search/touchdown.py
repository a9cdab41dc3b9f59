"""Naming what is wrong about contact, from landings: friction, stiffness, damping, platform height and tilt.

Contact has no equations of its own here: every landing is simulated in the MuJoCo plant from the measured
state shortly before the touch, under the commands that were sent, and the motion that follows is compared
in the axes of the surface. Errors are weighed by what they can come from at each moment: noise of the
measurement and of the start state, and what two idealised contacts differ in. The resting pose counts
little therefore, and the tenth of a second after the touch, in which stiff and soft, springy and damped
differ, counts most.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.signal import savgol_coeffs

from inclined_landing.eval.gap.flights.windows import measurement_noise
from inclined_landing.eval.gap.result import Candidate, SearchStep
from inclined_landing.eval.gap.search.evidence import Column, Linear, Suspects, Values, gram
from inclined_landing.eval.gap.search.fit import Fitted, refit, standard_errors
from inclined_landing.eval.gap.search.naming import Search
from inclined_landing.eval.gap.search.rollout import drive
from inclined_landing.eval.gap.search.trial import (
    Objection,
    Reason,
    Thresholds,
    Trial,
    objection,
    trial_of,
)
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.attitude import LAG, PITCH, ROLL, STATE_SIZE, VX, WX, X, Y, Z, body_rates
from inclined_landing.models.effects import Effect
from inclined_landing.models.effects.contact import spring_of
from inclined_landing.models.geometry import reach_below, shapes_of
from inclined_landing.models.parameters import Vehicle
from inclined_landing.models.plants import MujocoPlant
from inclined_landing.models.plants.recorder import fly
from inclined_landing.models.scene import compile_scene

BEFORE = 0.1  # s before the touch at which the simulation starts
LOOK_BACK = 0.14  # s of flight before that from which the start state is fitted
STEP = 0.00125  # s at most, of the engine: damping times 3 is unstable at twice as much
AFTER = 0.45  # s after the touch that are compared: nothing moves any more
EVERY = 0.01  # s between the compared samples
FEWEST = 6  # landings
# What the comparison cannot be better than, one idealised contact against another, in the motion that follows
# the touch at once and in where it ends: along the slope, where feet slide, across it, along its normal [m];
# roll, pitch, yaw [rad]. Each is correlated over time: the first over FLEETING, the second stays.
FLEETING = 0.05  # s
MISMATCH = (0.0010, 0.0005, 0.0003, 0.010, 0.016, 0.006)
OFFSET = (0.0030, 0.0008, 0.0004, 0.008, 0.005, 0.012)
# Mean error, drawn in, above which landings are not explained; it is 0.7 to 0.76 where nothing is hidden.
UNEXPLAINED = 0.95
MATCHED = 0.77  # the same, below which no second effect is looked for
REFITTED = 2  # effects of every step
TIED = 0.7  # standard errors by which the best must beat an effect that is told from it
SCAN = (-2.0, -1.0, -0.4, 0.4, 1.0, 2.0)  # times the plausible deviation
SCAN_FACTOR = (0.27, 0.4, 0.6, 0.8, 1.25, 1.7, 2.5, 3.6)  # factors instead
STEPS = 2.0  # difference quotients over this many times a parameter's negligible size
# Landings are few, and each tells more than a window of free flight.
LIMITS = Thresholds(
    evidence=2.3,
    gain=35.0,
    share=0.15,
    share_more=0.3,
    share_left=0.2,
    agreement=0.5,
    spread=1.0,
    most=2,
    shortlist=5,
)


@dataclasses.dataclass
class Landing:
    """One touchdown: what is needed to simulate and compare it."""

    name: str
    dt: float
    start: np.ndarray  # (13,) state without lag
    first: int  # row of the log at the start
    touch: int  # row of the log at the touch
    rows: int  # steps to simulate
    measured: np.ndarray  # (k, 6) pose at the compared rows
    compared: np.ndarray  # (k,) steps after the start
    deviation: np.ndarray  # (k, 6) standard deviation of measured minus simulated
    whiten: np.ndarray  # (6, k, k) what makes their errors independent, each of unit variance
    command: np.ndarray  # (m, 4) of the whole log
    on_platform: bool


def landings_of(logs: Sequence[FlightLog], vehicle: Vehicle) -> list[Landing]:
    """The touchdowns of flights with a contact channel: the first touch after at least 0.3 s of flight."""
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
            found.append(_landing(log, int(touch), dt, vehicle))
    return found


def _landing(log: FlightLog, touch: int, dt: float, vehicle: Vehicle) -> Landing:
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
    start = np.zeros(STATE_SIZE)
    start[:3], start[VX : VX + 3] = value[:3], rate[:3]
    start[ROLL : ROLL + 3] = value[3:]
    start[WX : WX + 3] = body_rates(value[3], value[4], *rate[3:])
    step = max(1, round(EVERY / dt))
    rows = touch - first + round(AFTER / dt)
    compared = np.arange(touch - first - step, rows + 1, step)
    covariance = _covariance(compared * dt - BEFORE, noise, gain)
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
        np.sqrt(np.einsum("cii->ic", covariance)),
        np.linalg.inv(np.linalg.cholesky(covariance)),
        np.where(np.isnan(log.command), 0.0, log.command),
        bool(over and value[2] > 0.5 * vehicle.platform_surface_height),
    )


def _covariance(t: np.ndarray, noise: np.ndarray, gain: Sequence[float]) -> np.ndarray:
    """Covariance (6, k, k) of measured minus simulated pose at t (k,) [s] after the touch.

    noise (6,) of the measurement; gain: what start pose and rates make of it. Errors of the start grow while
    things move; the surface ends them along its normal, in roll and in pitch.
    """
    moving = np.clip(t, -BEFORE, 0.15) + BEFORE
    held = np.exp(-np.maximum(t, 0.0) / FLEETING)
    touched = np.clip(t / FLEETING, 0.0, 1.0)
    settled = 1.0 - np.exp(-np.maximum(t, 0.0) / FLEETING)
    fleeting = touched * np.exp(-np.maximum(t - 0.1, 0.0) / FLEETING)
    near = np.exp(-np.abs(t[:, None] - t) / FLEETING)
    result = np.empty((6, len(t), len(t)))
    for c in range(6):
        start = gain[0] ** 2 + gain[1] ** 2 * np.outer(moving, moving)
        if c in (2, 3, 4):
            start = start * np.outer(held, held)
        result[c] = noise[c] ** 2 * (np.eye(len(t)) + start)
        result[c] += MISMATCH[c] ** 2 * near * np.outer(fleeting, fleeting)
        result[c] += OFFSET[c] ** 2 * np.outer(settled, settled)
    return result


class TouchdownProblem(Suspects):
    """Landings with the face of `evidence.Problem`, for fits and trials.

    Channels: along and across the slope, along its normal, roll, pitch, yaw.
    """

    def __init__(self, landings: Sequence[Landing], vehicle: Vehicle, library: Mapping[str, Effect]):
        self.flights = list(landings)
        self.vehicle = vehicle
        self.library = {name: effect for name, effect in library.items() if effect.contact}
        self.reach = float(reach_below(shapes_of(compile_scene(vehicle)), part="feet"))
        n = len(self.flights)
        self.flight_of = self.group_of = np.arange(n)
        self.groups = n
        self.samples = min(len(x.compared) for x in self.flights)
        self.rows = np.full(n, self.samples)
        self.logged = self.weight = np.ones((n, 6))

    def scan(self, name: str, values: Values) -> dict[float, np.ndarray]:
        """`cells` for a few values of an effect with one parameter."""
        parameter = self.library[name].parameters[0]
        grid = parameter.neutral + (parameter.plausible - parameter.neutral) * np.array(SCAN)
        grid = SCAN_FACTOR if parameter.is_factor else grid
        lo, hi = parameter.bounds
        return {float(x): self._cells(name, float(x), values) for x in grid if lo <= x <= hi}

    def refined(self, name: str, values: Values, left: dict[float, np.ndarray]) -> dict[str, float]:
        """The value of least squared error: the neighbourhood halved twice, then the vertex of a parabola."""
        left = {x: float(c.sum()) for x, c in left.items()}
        for _ in range(2):
            for middle in _between(left):
                left[middle] = float(self._cells(name, middle, values).sum())
        x = np.array(sorted(left))
        k = int(np.clip(np.argmin([left[v] for v in x]), 1, len(x) - 2))
        a, b, _ = np.polyfit(x[k - 1 : k + 2] - x[k], [left[v] for v in x[k - 1 : k + 2]], 2)
        vertex = float(x[k] - 0.5 * b / a) if a > 0 else float(x[k])
        if x[k - 1] < vertex < x[k + 1] and vertex not in left:
            left[vertex] = float(self._cells(name, vertex, values).sum())
        return {self.library[name].parameters[0].name: min(left, key=left.get)}

    def _cells(self, name: str, x: float, values: Values) -> np.ndarray:
        own = {self.library[name].parameters[0].name: x}
        return self.cells(self.corrected({**values, name: own}))

    def errors(self, vehicle: Vehicle) -> np.ndarray:
        """Errors (n, 6, samples) in standard deviations, large ones drawn in."""
        simulated = simulate(self.flights, vehicle)
        result = np.empty((len(self.flights), 6, self.samples))
        si, ci = math.sin(self.vehicle.platform_inclination), math.cos(self.vehicle.platform_inclination)
        lower, leaning = np.subtract(sag(vehicle, self.reach), sag(self.vehicle, self.reach))
        for k, landing in enumerate(self.flights):
            error = (landing.measured - simulated[k][landing.compared])[: self.samples]
            if landing.on_platform:
                x, z = error[:, 0].copy(), error[:, 2].copy()
                error[:, 0], error[:, 2] = ci * x - si * z, si * x + ci * z
            t = landing.compared[: self.samples] * landing.dt - BEFORE
            settled = 1.0 - np.exp(-np.maximum(t, 0.0) / FLEETING)
            error[:, 2] += lower * settled
            if landing.on_platform:
                error[:, 4] -= leaning * settled
            white = np.einsum("cij,jc->ci", landing.whiten, error)
            # Once an axis of a landing goes wrong it stays wrong: what it adds grows with the logarithm.
            mean = np.maximum((white**2).mean(axis=1, keepdims=True), 1e-12)
            result[k] = white * np.sqrt(np.log1p(mean) / mean)
        return result

    def cells(self, vehicle: Vehicle) -> np.ndarray:
        """Squared error (n, 6) of every landing and axis."""
        return (self.errors(vehicle) ** 2).sum(axis=2)

    def linearise(self, values: Values, columns: Sequence[Column]) -> Linear:
        """As `evidence.Problem.linearise`."""
        error = self.errors(self.corrected(values))
        slopes = []
        for column in columns:
            ends, step = self.to_either_side(values, column, STEPS)
            low, high = map(self.errors, ends)
            slopes.append(-(high - low) / step)
        return Linear(tuple(columns), *gram(error, slopes), self)


def sag(vehicle: Vehicle, reach: float) -> tuple[float, float]:
    """How feet of the vehicle's contact stiffness give way at rest: distance [m], pitch on the slope [rad].

    reach: of the feet below the centre of mass [m].

    MuJoCo's contact acts on accelerations and carries the weight without giving way; feet do give way, and
    more on the side where friction below the centre of mass tips the vehicle.
    """
    stiffness, g = spring_of(vehicle)[0], vehicle.environment_gravity
    along = g * math.sin(vehicle.platform_inclination)
    return g / stiffness, along * reach / (stiffness * vehicle.rotor_arm**2)


def simulate(landings: Sequence[Landing], vehicle: Vehicle) -> np.ndarray:
    """Simulated pose (n, rows + 1, 6) of every landing, in the MuJoCo plant."""
    dt = landings[0].dt
    rows = max(x.rows for x in landings)
    n = len(landings)
    plain = dataclasses.replace(
        vehicle,
        effects_thrust_delay=0.0,
        effects_attitude_delay=0.0,
        effects_mocap_delay=0.0,
    )
    state = np.stack([x.start for x in landings])
    commands = np.zeros((n, rows, 4))
    for k, x in enumerate(landings):
        driven, lag = drive(_Driven(x.command, dt), vehicle)
        part = driven[x.first : x.first + rows]
        commands[k, : len(part)] = part
        commands[k, len(part) :] = part[-1]
        state[k, LAG] = lag[x.first]
    step = dt / math.ceil(dt / STEP - 1e-9)
    plant = MujocoPlant(
        n, plain, control_period=dt, timestep=step, integrator="implicitfast", torque_needs_motors=True
    )
    plant.set_platform(np.arange(n), vehicle.platform_inclination)
    plant.reset(np.arange(n), state)
    pose = fly(plant, commands.swapaxes(0, 1))[..., [X, Y, Z, ROLL, PITCH, PITCH + 1]].swapaxes(0, 1)
    pose[..., 3:] = np.unwrap(pose[..., 3:], axis=1)
    return pose


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
    simulator, and the best few are refined. Effects are ranked by evidence over landings and axes, not by
    the error they take away: a few landings that go another way would decide that.
    """
    problem = TouchdownProblem(landings, vehicle, library)
    noise = np.ones(6)
    found = Search(refit(problem, {}, noise), noise)
    total = found.fit.squares
    size = 6 * problem.rows.sum()
    for _ in range(limits.most):
        if found.fit.values and found.fit.squares < MATCHED * size:
            break
        scans = _Scans(problem, found.fit)
        best, trial = max(scans.trials.items(), key=lambda item: item[1].evidence)
        closable = max(1.0, trial.gain)
        against = _coupled(problem, best, found.fit.values) or objection(
            problem, best, trial, closable, max(found.closable, closable), limits, found.fit.values
        )
        alike = [] if against else scans.alike(best, limits)
        rows = scans.rows(best, alike, closable, against)
        found.steps.append(SearchStep(None if against else best, (), rows))
        if against:
            break
        found.closable = max(found.closable, closable)
        found.fit = trial.fit
        found.evidence[best], found.classes[best] = trial.evidence, tuple(alike)
        found.gains[best] = float(np.clip(trial.gain / total, 0.0, 1.0))
    found.unexplained = found.fit.squares > UNEXPLAINED * size
    return problem, found


def _coupled(problem: TouchdownProblem, name: str, found: Values) -> Objection | None:
    """What speaks against naming an effect beside one that the engine couples it with."""
    for other in found:
        if name in problem.library[other].couples_with:
            return Objection(Reason.COUPLED, {"other": other})
    return None


class _Scans:
    """Every effect scanned beside those found, and trials of the best few."""

    def __init__(self, problem: TouchdownProblem, fit: Fitted):
        self.problem = problem
        self.before = problem.cells(problem.corrected(fit.values))
        self.scans = {n: problem.scan(n, fit.values) for n in problem.library if n not in fit.values}
        best = {n: min(cells.values(), key=np.sum) for n, cells in self.scans.items()}
        self.order = sorted(self.scans, key=lambda n: -standard_errors(self.before - best[n]))
        self.trials: dict[str, Trial] = {}
        self.left: dict[str, np.ndarray] = {}
        for name in self.order[:REFITTED]:
            start = {problem.library[name].parameters[0].neutral: self.before, **self.scans[name]}
            values = {**fit.values, name: problem.refined(name, fit.values, start)}
            new = refit(problem, values, fit.inflation, iterations=0)
            self.left[name] = problem.cells(problem.corrected(new.values))
            gain = self.before - self.left[name]
            trial = trial_of(problem, new, name, gain.sum(axis=1))
            self.trials[name] = dataclasses.replace(trial, evidence=standard_errors(gain))

    def alike(self, best: str, limits: Thresholds) -> list[str]:
        """The refined effects that cannot be told from the best."""
        return [
            n
            for n in self._ranked()
            if self.trials[n].evidence > limits.evidence
            and standard_errors(self.left[n] - self.left[best]) < TIED
        ]

    def _ranked(self) -> list[str]:
        return sorted(self.trials, key=lambda n: -self.trials[n].evidence)

    def rows(
        self, best: str, alike: Sequence[str], closable: float, against: Objection | None
    ) -> tuple[Candidate, ...]:
        """The ranking of this step."""
        less, rows = str(Objection(Reason.LESS_EVIDENCE)), []
        for n in self._ranked():
            t = self.trials[n]
            reason = less if n != best else str(against or "")
            rows.append(
                Candidate(n, t.gain, t.gain / closable, t.evidence, True, n in alike, reason, t.values)
            )
        for n in self.order[REFITTED:]:
            value, cells = min(self.scans[n].items(), key=lambda item: item[1].sum())
            gain, evidence = float((self.before - cells).sum()), standard_errors(self.before - cells)
            values = {self.problem.library[n].parameters[0].name: value}
            rows.append(Candidate(n, gain, gain / closable, evidence, False, False, less, values))
        return tuple(rows)


def _between(left: Mapping[float, float]) -> list[float]:
    """Middles between the key of the least value and its neighbours."""
    x = sorted(left)
    k = min(range(len(x)), key=lambda i: left[x[i]])
    return [0.5 * (x[k] + x[i]) for i in (k - 1, k + 1) if 0 <= i < len(x)]
