"""What a corrected vehicle still does not explain, and whether that can be predicted.

A disturbance that is a function of something known - place, speed, heading, commands and their past, time,
voltage - would be missing physics; one that is not is unrest. Functions are ridge regressions on splines and
random Fourier features, driven through the same window errors as any effect: an acceleration along an axis of
the world or of the heading, an angular acceleration of a loop. Each is fitted to all flights but one and
judged on that one. If nothing repeated, the errors of any few seconds might as well have the other sign: over
flips of signs, the largest gain of all functions gives the rate of false alarms by construction.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from sklearn.kernel_approximation import RBFSampler
from sklearn.pipeline import make_pipeline, make_union
from sklearn.preprocessing import FunctionTransformer, SplineTransformer, StandardScaler

from inclined_landing.eval.gap.flights.windows import REGIMES, Measured
from inclined_landing.eval.gap.result import Dependence, Remainder
from inclined_landing.eval.gap.search.evidence import Problem
from inclined_landing.eval.gap.search.prediction import CHANNELS, predict
from inclined_landing.eval.gap.search.sets import Search

UNITS = {"x": "m/s2", "y": "m/s2", "z": "m/s2", "roll": "rad", "pitch": "rad", "yaw": "rad"}
TARGETS = (*CHANNELS, "forward", "left")
FALSE_ALARM = 0.05
FLIPS = 400
FEATURES = 24  # random ones of a function
KNOTS = 7  # of the spline of every input
EVERY = 0.5  # s between those of the flight time
BLOCK = 5.0  # s of a flight that may have the other sign
PAST = (0.1, 0.25)  # s ago, of commands
MOVED = (0.15, 0.3, 0.5)  # s ago, of velocities
TIME = "flight time"
BINS = 8
WORTH = 2.0  # squared error that is worth telling, in that of errors of negligible size
FORM = 0.02  # share of the motion by which no formula is wrong enough to tell
UNITS_OF = ("m/s2",) * 3 + ("rad/s2",) * 3
LEAST = {"m/s2": 0.01, "rad/s2": 0.3}  # a function's expected size where the air is still


def sizes(problem: Problem, white: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Error (w, 6) of every window as an acceleration or angle, its variance (w, 6) by noise and unrest."""
    value = np.concatenate([f.whitening.sizes(x) for f, x in zip(problem.flights, white)])
    variance = np.concatenate(
        [np.tile(1.0 / f.whitening.power, (len(x), 1)) for f, x in zip(problem.flights, white)]
    )
    return value, variance


def quantities(flights: Sequence[Measured]) -> dict[str, tuple[tuple[str, ...], list[np.ndarray]]]:
    """What a remainder may depend on: name -> (names of its inputs, inputs (m, k) of every flight)."""
    result: dict[str, tuple[tuple[str, ...], list[np.ndarray]]] = {}

    def put(name: str, inputs: Sequence[str], of) -> None:
        result[name] = (tuple(inputs), [np.column_stack(of(f)) for f in flights])

    def turned(f: Measured, values: np.ndarray) -> np.ndarray:
        c, s = np.cos(f.attitude[:, 2]), np.sin(f.attitude[:, 2])
        x, y = values[:, 0], values[:, 1]
        return np.column_stack([c * x + s * y, -s * x + c * y, values[:, 2]])

    def ago(f: Measured, values: np.ndarray, times: Sequence[float]) -> list[np.ndarray]:
        rows = np.arange(f.samples)
        return [values[np.maximum(0, rows - round(t / f.dt))] for t in (0.0, *times)]

    put("place", ("position x", "position y", "position z"), lambda f: [f.position])
    put("velocity", ("velocity x", "velocity y", "velocity z"), lambda f: [f.velocity])
    body = ("forward speed", "sideways speed", "climb rate")
    put("velocity along its heading", body, lambda f: [turned(f, f.velocity)])
    put("tilt", ("roll", "pitch"), lambda f: [f.attitude[:, :2]])
    put("heading", ("heading",) * 2, lambda f: [np.cos(f.attitude[:, 2]), np.sin(f.attitude[:, 2])])
    commands = ("thrust command", "roll command", "pitch command", "yaw rate command")
    put("commands", commands, lambda f: [f.command])
    past = [f"thrust command{when}" for when in _when(PAST)]
    put("thrust command and its past", ("thrust command", *past), lambda f: ago(f, f.command[:, :1], PAST))
    names = [f"{axis} command{when}" for when in ("", *_when(PAST)) for axis in ("roll", "pitch")]
    put("tilt commands and their past", names, lambda f: ago(f, f.command[:, 1:3], PAST))
    names = [f"{axis}{when}" for when in ("", *_when(MOVED)) for axis in body]
    put("velocity and its past", names, lambda f: ago(f, turned(f, f.velocity), MOVED))
    put("flight time", (TIME,), lambda f: [f.t])
    if all(f.voltage is not None for f in flights):
        put("battery voltage", ("battery voltage",), lambda f: [f.voltage])
    return result


def _when(times: Sequence[float]) -> list[str]:
    return [f" {t:g} s ago" for t in times]


@dataclasses.dataclass
class _Function:
    """A disturbance along one target as a function of one group of inputs, fitted to the flights."""

    target: str
    on: str
    a: np.ndarray  # (g, D, D)
    b: np.ndarray  # (k, D) of every block
    ridge: float
    form: np.ndarray  # (k, k) see `form_of`

    @property
    def gain(self) -> float:
        """Decrease of the squared error on flights left out."""
        return float(self.form.sum())

    def scores(self, signs: np.ndarray) -> np.ndarray:
        """(s,) gains under flips of signs (s, k), in standard deviations over all flips."""
        gains = np.einsum("sg,gh,sh->s", signs, self.form, signs, optimize=True) - np.trace(self.form)
        apart = self.form + self.form.T
        np.fill_diagonal(apart, 0.0)
        return gains / max(np.sqrt(0.5 * (apart**2).sum()), 1e-12)

    def weights(self) -> np.ndarray:
        """(D,) fitted to all flights."""
        a = self.a.sum(axis=0) + self.ridge * np.eye(self.a.shape[1])
        return np.linalg.solve(a, self.b.sum(axis=0))


def assess(problem: Problem, found: Search, seed: int = 0) -> Remainder:
    """Judge what the most probable set leaves of the flights of `problem`.

    Errors that come from parameters off by what nobody needs to correct are taken off first, in every flight
    by its own estimate.
    """
    white = left_by(problem, found)
    value, variance = sizes(problem, white)
    size = {}
    for k, channel in enumerate(CHANNELS):
        w = problem.logged[:, k] > 0.0
        if w.any():
            size[channel] = float(np.sqrt(max(0.0, (value[w, k] ** 2 - variance[w, k]).mean())))
    inputs = quantities(problem.flights)
    basis = {name: _basis(problem, names, arrays, seed) for name, (names, arrays) in inputs.items()}
    block_of = _blocks(problem)
    signs = _signs(int(block_of.max()) + 1, seed)
    functions = []
    for target in TARGETS:
        if target == "yaw" and not problem.logged[:, 5].any():
            continue
        for name, features in basis.items():
            functions.append(_fit(problem, found, white, target, name, features, block_of))
    scores = np.stack([f.scores(signs) for f in functions])
    most = scores.max(axis=0)
    p_value = float((most >= most[0] - 1e-9).mean())
    tolerance, total = _tolerances(problem, found)
    sure = np.quantile(most[1:], 1.0 - FALSE_ALARM)
    depends: dict[str, Dependence] = {}
    for k in np.argsort(-scores[:, 0], kind="stable"):
        f = functions[k]
        if scores[k, 0] < sure or f.target in depends:
            continue
        if f.gain < WORTH * tolerance[f.target]:
            continue
        arrays, names = inputs[f.on][1], inputs[f.on][0]
        share = float(np.clip(f.gain / total[f.target], 0.0, 1.0))
        depends[f.target] = _described(problem, f, basis[f.on], arrays, names, share, float(scores[k, 0]))
    told = tuple(depends.values())
    # The heading is compared on its own and moves nothing else.
    return Remainder(any(d.channel != "yaw" for d in told), p_value, size, told, _words(told))


def _tolerances(problem: Problem, found: Search) -> tuple[dict[str, float], dict[str, float]]:
    """Squared error of every target that errors of negligible size and form make, and all that is left."""
    vehicle = problem.corrected(found.at)
    moved = [f.whitening(f.cut(predict(f, vehicle))) for f in problem.flights]
    linear = problem.linearise(found.at, found.local.columns)
    weight = problem.weight / found.inflation
    spread = np.einsum("wckk,k,wc->c", linear.a, found.local.unit**2, weight, optimize=True)
    spread += FORM**2 * (np.concatenate([(x**2).sum(axis=2) for x in moved]) * weight).sum(axis=0)
    left = (linear.c * weight).sum(axis=0)
    result = []
    for by_channel in (spread, left):
        table = dict(zip(CHANNELS, map(float, by_channel)))
        result.append(table | dict.fromkeys(("forward", "left"), table["x"] + table["y"]))
    return result[0], result[1]


def _described(problem, function: _Function, features, arrays, names, share, score) -> Dependence:
    """A function in numbers: its size by regime, and its course over the input it goes with most."""
    weights = function.weights()
    value = np.concatenate([np.matmul(x, weights).mean(axis=1) for x in features])
    regimes = np.concatenate([f.regimes for f in problem.flights])
    rms = {n: float(np.sqrt((value[w] ** 2).mean())) for n, w in zip(REGIMES, regimes.T) if w.any()}
    against, best, curve = names[0], -1.0, (np.zeros(0), np.zeros(0))
    for k, name in enumerate(names):
        x = np.concatenate([f.cut(v[:, k]).mean(axis=1) for f, v in zip(problem.flights, arrays)])
        told, *bins = _binned(x, value)
        if told > best:
            against, best, curve = name, told, bins
    unit = UNITS_OF[CHANNELS.index(function.target)] if function.target in CHANNELS else UNITS_OF[0]
    size = float(np.sqrt((value**2).mean()))
    return Dependence(function.target, function.on, size, unit, share, score, rms, against, *curve)


def _binned(x: np.ndarray, y: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Variance of y between bins of x, bin centres and means."""
    edges = np.unique(np.quantile(x, np.linspace(0, 1, BINS + 1)))
    if len(edges) < 3:
        return 0.0, np.zeros(0), np.zeros(0)
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    count = np.maximum(1, np.bincount(place, minlength=len(edges) - 1))
    centre, mean = np.bincount(place, x) / count, np.bincount(place, y) / count
    return float((count * (mean - y.mean()) ** 2).sum() / len(y)), centre, mean


def _words(told: Sequence[Dependence]) -> str:
    if not told:
        return "What remains cannot be predicted from anything that was logged: it is noise and unrest."
    d = told[0]
    regime = max(d.regimes, key=d.regimes.get).replace("_", " ") if d.regimes else ""
    where = f", most in {regime}" if regime else ""
    axis = {"forward": "along the heading", "left": "across the heading"}.get(d.channel, f"in {d.channel}")
    more = f"; so does something in {', '.join(x.channel for x in told[1:])}" if told[1:] else ""
    return (
        f"Something of {d.size:.2g} {d.unit} {axis} repeats on flights left out and goes with the "
        f"{d.on}{where}{more}."
    )


def left_by(problem: Problem, found: Search) -> list[np.ndarray]:
    """White errors (w, 6, q) of every flight beside the best set and negligible errors of all effects."""
    local = found.local
    change, _ = local.fit(found.names)
    vehicle = problem.corrected(found.at)
    result = []
    for k, flight in enumerate(problem.flights):
        own = (change + local.deviation(k, change)) * local.unit
        error = flight.measured - predict(flight, vehicle)
        here = predict(flight, vehicle)
        for column, step in zip(local.columns, own):
            beside, width = problem.to_one_side(found.at, column)
            error -= (predict(flight, beside) - here) * (step / width)
        result.append(flight.whitening(flight.cut(error)))
    return result


def _basis(problem: Problem, names, arrays: Sequence[np.ndarray], seed: int) -> list[np.ndarray]:
    """Features (w, rows, D) of the inputs of every flight: splines of each input, and random ones of all."""
    seen = np.concatenate([x[f.usable] for f, x in zip(problem.flights, arrays)])
    k = seen.shape[1]
    knots = KNOTS
    if names == (TIME,):  # what beats, or swings
        knots = max(KNOTS, round(float(np.ptp(seen)) / EVERY))
    splines = SplineTransformer(knots, degree=2, knots="quantile", extrapolation="constant")
    parts: list = [make_pipeline(StandardScaler(), splines)]
    if k > 1:
        random = RBFSampler(gamma=0.5 / k, n_components=FEATURES, random_state=seed)
        drawn_in = FunctionTransformer(np.clip, kw_args={"a_min": -4.0, "a_max": 4.0})
        parts.append(make_pipeline(StandardScaler(), drawn_in, random))
    spread = seen + 1e-9 * np.random.default_rng(seed).standard_normal(seen.shape)  # knots that differ
    features = make_union(*parts).fit(spread[:: max(1, len(spread) // 5000)])
    return [f.cut(features.transform(x)) for f, x in zip(problem.flights, arrays)]


def _fit(problem, found, white, target: str, name: str, features, block_of: np.ndarray) -> _Function:
    """The Gram matrices of a function's slopes with the errors that are left, and its gains."""
    size = found.unrest.size
    channels = {"forward": (0, 1), "left": (0, 1)}.get(target) or (CHANNELS.index(target),)
    groups, width = problem.groups, features[0].shape[2]
    a, b = np.zeros((groups, width, width)), np.zeros((int(block_of.max()) + 1, width))
    ends = np.cumsum([len(f.starts) for f in problem.flights])[:-1]
    of_flights = [np.split(x, ends) for x in (problem.group_of, block_of, problem.weight)]
    for flight, errors, basis, g, k, weight in zip(problem.flights, white, features, *of_flights):
        for channel in channels:
            drive = basis
            if len(channels) == 2:
                heading = flight.cut(flight.attitude[:, 2])[..., None]
                across = channel == (target == "forward")
                sign = -1.0 if target == "left" and channel == 0 else 1.0
                drive = basis * (sign * np.sin(heading) if across else np.cos(heading))
            scale = 1.0 / np.sqrt(found.inflation[channel])
            through = scale * flight.whitening.matrices[channel] @ flight.shapes.responses[channel]
            share = np.sqrt(weight[:, channel])[:, None]
            slopes = share[..., None] * np.matmul(through, drive)  # (w, q, D)
            for one in np.unique(g):
                own = slopes[g == one].reshape(-1, width)
                a[one] += own.T @ own
            left = scale * share * errors[:, channel]
            np.add.at(b, k, np.einsum("wqd,wq->wd", slopes, left, optimize=True))
    # Expected as large as what is taken for unrest.
    expected = max(float(size[list(channels)].max()), LEAST[UNITS_OF[channels[0]]])
    ridge = 1.0 / expected**2
    fold_of = np.array([problem.group_of[np.argmax(block_of == k)] for k in range(len(b))])
    return _Function(target, name, a, b, ridge, form_of(a, b, fold_of, ridge))


def form_of(a: np.ndarray, b: np.ndarray, fold_of: np.ndarray, ridge: float) -> np.ndarray:
    """Q (k, k): s Q s is the decrease of the squared error of all flights, each fitted to the others.

    a (g, D, D) of every flight, b (k, D) of every block, s (k,) the signs of the blocks.
    """
    total, form = a.sum(axis=0), np.zeros((len(b), len(b)))
    for g in range(len(a)):
        own = fold_of == g
        fits = np.where(own[:, None], 0.0, np.linalg.solve(total - a[g] + ridge * np.eye(a.shape[1]), b.T).T)
        form[own] += 2.0 * b[own] @ fits.T
        form -= fits @ a[g] @ fits.T
    return form


def _blocks(problem: Problem) -> np.ndarray:
    """Block (w,) of every window: pieces of flights of about BLOCK, none over two groups."""
    result, count = np.zeros(len(problem.group_of), int), 0
    for g in range(problem.groups):
        w = np.flatnonzero(problem.group_of == g)
        flight = problem.flights[problem.flight_of[w[0]]]
        parts = max(1, round(len(w) * flight.rows * flight.dt / BLOCK))
        result[w] = count + np.arange(len(w)) * parts // len(w)
        count = result[w[-1]] + 1
    return result


def _signs(blocks: int, seed: int) -> np.ndarray:
    """Signs (FLIPS, blocks), those of the first row all positive."""
    signs = np.random.default_rng(seed).choice((-1.0, 1.0), (FLIPS, blocks))
    signs[0] = 1.0
    return signs
