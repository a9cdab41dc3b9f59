"""What a corrected vehicle still does not explain: how much, in physical units, and what it depends on."""

from __future__ import annotations

import numpy as np

from inclined_landing.eval.gap.result import Dependence, Remainder
from inclined_landing.eval.gap.search.evidence import Problem, Values
from inclined_landing.eval.gap.search.prediction import CHANNELS

# Root mean square beyond the noise that counts as nothing: m/s2 for x, y, z, rad for roll, pitch, yaw.
# Fixed on development seeds of the hidden-effect benchmark.
FLOORS = {"x": 0.03, "y": 0.03, "z": 0.03, "roll": 0.005, "pitch": 0.005, "yaw": 0.02}
UNITS = {"x": "m/s2", "y": "m/s2", "z": "m/s2", "roll": "rad", "pitch": "rad", "yaw": "rad"}
WORTH_TELLING = 0.1  # share of the remainder
BINS = 8
# Share of the squared error taken away by an effect of an idealised form that its form may leave.
FORM = 0.03


def sizes(problem: Problem, white: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Error (w, 6) of every window as an acceleration or angle, and its noise variance (w, 6)."""
    value = np.concatenate([f.whitening.sizes(x) for f, x in zip(problem.flights, white)])
    variance = np.concatenate(
        [np.tile(1.0 / f.whitening.power, (len(x), 1)) for f, x in zip(problem.flights, white)]
    )
    return value, variance


def floors_with(problem: Problem, values: Values) -> dict[str, float]:
    """`FLOORS`, raised by what the idealised form of the effects at `values` is known to leave.

    Effects that entail others are idealised; a turning vehicle couples its loops of roll and pitch, which
    are predicted apart.
    """
    squares = {c: f**2 for c, f in FLOORS.items()}
    for cause in (n for n in values if problem.library[n].entails):
        without = problem.corrected({n: v for n, v in values.items() if n != cause})
        value, variance = sizes(problem, problem.white([without] * len(problem.flights)))
        for k, channel in enumerate(CHANNELS):
            squares[channel] += FORM * max(0.0, float((value[:, k] ** 2 - variance[:, k]).mean()))
    corrected = problem.corrected(values)
    drift = corrected.effects_yaw_drift - problem.vehicle.effects_yaw_drift
    if drift:
        angle = np.concatenate([f.attitude[f.usable, :2] for f in problem.flights])
        coupled = drift * corrected.attitude_time_constant * np.sqrt((angle**2).mean(axis=0))
        squares["roll"] += float(coupled[1] ** 2)
        squares["pitch"] += float(coupled[0] ** 2)
    return {c: float(np.sqrt(s)) for c, s in squares.items()}


def assess(problem: Problem, white: list[np.ndarray], floors: dict[str, float]) -> Remainder:
    """Judge the errors `white`, one (w, 6, q) for each flight, of a corrected vehicle."""
    value, variance = sizes(problem, white)
    logged = problem.logged > 0.0
    size = {}
    for k, channel in enumerate(CHANNELS):
        w = logged[:, k]
        if w.any():
            size[channel] = float(np.sqrt(max(0.0, (value[w, k] ** 2 - variance[w, k]).mean())))
    large = [c for c, x in size.items() if x > floors[c]]
    depends = sorted(_dependences(problem, value, variance, large), key=lambda d: -d.share)
    return Remainder(
        bool(large), size, {c: floors[c] for c in size}, tuple(depends), _words(size, large, depends)
    )


def _words(size, large, depends) -> str:
    if not large:
        return "What remains is within the noise and what does not matter."
    parts = [f"{c} {size[c]:.2g} {UNITS[c]}" for c in large]
    text = "Unexplained beyond the noise: " + ", ".join(parts) + "."
    if depends:
        d = depends[0]
        text += f" In {d.channel}, {100 * d.share:.0f} % of it goes with the {d.on}."
    return text


def quantities(problem: Problem) -> dict[str, np.ndarray]:
    """Means (w,) over every window of what a remainder may depend on."""
    mean = {}

    def put(name, of):
        mean[name] = np.concatenate([f.cut(of(f)).mean(axis=1) for f in problem.flights])

    for k, axis in enumerate("xyz"):
        put(f"position {axis}", lambda f, k=k: f.position[:, k])
        put(f"velocity {axis}", lambda f, k=k: f.velocity[:, k])
    put("horizontal speed", lambda f: np.hypot(f.velocity[:, 0], f.velocity[:, 1]))
    put("heading", lambda f: f.attitude[:, 2])
    put("thrust command", lambda f: f.command[:, 0])
    put("roll command", lambda f: f.command[:, 1])
    put("pitch command", lambda f: f.command[:, 2])
    put("yaw rate command", lambda f: f.command[:, 3])
    put("flight time", lambda f: f.t)
    if all(f.voltage is not None for f in problem.flights):
        put("battery voltage", lambda f: f.voltage)
    return mean


def _dependences(problem: Problem, value, variance, large) -> list[Dependence]:
    found, features = [], quantities(problem) if large else {}
    for channel in large:
        k = CHANNELS.index(channel)
        w = problem.logged[:, k] > 0.0
        beyond = float((value[w, k] ** 2 - variance[w, k]).mean())
        for name, x in features.items():
            explained, centres, means = _binned(x[w], value[w, k], problem.group_of[w])
            share = float(np.clip(explained / beyond, 0.0, 1.0))
            if share > WORTH_TELLING:
                found.append(Dependence(channel, name, share, centres, means, UNITS[channel]))
    return found


def _binned(x: np.ndarray, y: np.ndarray, group: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Mean square of y that the mean of its bin of x explains on groups left out; bin centres and means."""
    edges = np.unique(np.quantile(x, np.linspace(0, 1, BINS + 1)))
    if len(edges) < 3:
        return 0.0, np.array([]), np.array([])
    bins = len(edges) - 1
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, bins - 1)
    total = np.bincount(place, y, bins)
    count = np.bincount(place, minlength=bins)
    left = 0.0
    for g in np.unique(group):
        own = group == g
        rest = count - np.bincount(place[own], minlength=bins)
        mean = (total - np.bincount(place[own], y[own], bins)) / np.maximum(1, rest)
        left += ((y[own] - mean[place[own]]) ** 2).sum()
    centre = np.bincount(place, x, bins) / np.maximum(1, count)
    return float((y**2).sum() - left) / len(y), centre, total / np.maximum(1, count)
