"""Forward stepwise search for the effects that explain the flights, judged on flights left out.

Each step linearises the simulator with the effects found so far, ranks all others by what they explain
on flights left out, refits the best few through the simulator, and accepts the first that is supported
by windows of all flights, larger than negligible, the same in every flight and not at a bound.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from inclined_landing.eval.gap.evidence import Column, Problem, Values, Weighted, invert, solve
from inclined_landing.eval.gap.result import Candidate, SearchStep
from inclined_landing.models.parameters import Vehicle


@dataclasses.dataclass(frozen=True)
class Thresholds:
    """What it takes to be named. Fixed on development seeds of the hidden-effect benchmark."""

    evidence: float = 4.5  # standard errors of the gain over windows left out
    gain: float = 30.0  # decrease of the white squared error, over all windows
    share: float = 0.06  # of what the whole library could close at the first step
    share_more: float = 0.0007  # the same for effects beside others
    share_entailed: float = 0.30  # below which an effect follows from one that entails it
    share_left: float = 0.10  # of what it could close at this step
    agreement: float = 0.7  # share of groups of windows with a positive gain
    spread: float = 0.45  # between flights, as a share of the parameter's distance from neutral
    alike: float = 0.98  # R2 above which two effects are one class
    overlap: float = 0.3  # R2 above which an effect explains the same as one that was refused
    simpler: float = 0.04  # share of the gain that a further parameter must add
    most: int = 5  # effects
    shortlist: int = 6


# Share of the evidence that a few windows can give at most, where it is less than the limit.
ENOUGH = 0.8
# What an effect entails physically: found beside it, explaining less than it, that is no cause of its own.
# Motors that slow down late give more thrust on average, because the attitude controller drives them up and
# down all the time, most in fast flight. A battery that sags also runs down, and its voltage follows the
# load at once, which looks like faster motors. An attitude estimate that is corrected by late measurements
# is wrong in proportion to the rates, and so is the loop closed over it.
ENTAILED = {
    "spin_down": (
        *("thrust_bias", "thrust_scale", "mass", "battery_sag", "battery_voltage"),
        *("motor_lag", "thrust_delay", "translational_lift", "axial_inflow"),
    ),
    "battery_sag": ("thrust_fade", "motor_lag", "thrust_delay"),
    "battery_voltage": ("thrust_fade", "motor_lag", "thrust_delay"),
    "mocap_delay": ("attitude_gain", "attitude_time_constant", "second_order_attitude"),
}


@dataclasses.dataclass
class Fit:
    """Effects fitted together, with the linearisation at the fit."""

    values: dict[str, dict[str, float]]
    weighted: Weighted  # columns of the effects in `values`
    index: np.ndarray  # all of them
    inflation: np.ndarray  # (6,) that the weights were divided by

    @property
    def squares(self) -> float:
        """White squared error over all windows."""
        return float(self.weighted.c.sum())


@dataclasses.dataclass
class Search:
    """The outcome of `search`."""

    fit: Fit
    steps: list[SearchStep]
    inflation: np.ndarray
    closable: float  # squared error the whole library could close at first
    gains: dict[str, float]  # accepted effect -> share of it
    evidence: dict[str, float]
    classes: dict[str, tuple[str, ...]]
    follows: dict[str, str]  # accepted effect -> earlier one that entails it
    unexplained: bool = dataclasses.field(default=False, kw_only=True)  # landings: errors remain
    unstable: list[str]  # effects turned away because flights disagree or a bound was met


def refit(
    problem: Problem, values: Values, inflation: np.ndarray, iterations: int = 8, tolerance: float = 0.05
) -> Fit:
    """Levenberg-Marquardt fit, within bounds, of all parameters of the effects in `values`."""
    names = list(values)
    values = {name: dict(problem.library[name].neutral) | dict(v) for name, v in values.items()}
    damping = 1e-3
    columns = _own_columns(problem, names)
    fit = _fit_at(problem, values, columns, inflation)
    for _ in range(iterations if names else 0):
        improved = False
        while damping < 1e4:
            trial = _moved(problem, fit, damping)
            new = _fit_at(problem, trial, columns, inflation)
            if new.squares < fit.squares:
                gain, fit, improved = fit.squares - new.squares, new, True
                damping = max(1e-9, damping / 10.0)
                break
            if fit.squares - _predicted(fit, trial) < tolerance:
                break
            damping *= 10.0
        if not improved or gain < tolerance:
            break
    return fit


def _own_columns(problem: Problem, names: Sequence[str]) -> list[Column]:
    return [Column(name, p.name) for name in names for p in problem.library[name].parameters]


def _fit_at(problem: Problem, values, columns, inflation) -> Fit:
    weighted = problem.linearise(values, columns).weighted(inflation)
    return Fit(values, weighted, np.arange(len(columns)), inflation)


def _moved(problem: Problem, fit: Fit, damping: float) -> dict[str, dict[str, float]]:
    """Values after a damped step; parameters that would leave their bounds stay there, the others refit."""
    columns = fit.weighted.columns
    a, b = fit.weighted.group_a.sum(axis=0), fit.weighted.group_b.sum(axis=0)
    at = np.array([fit.values[c.effect][c.parameter] for c in columns])
    bounds = np.array([_parameter(problem, c).bounds for c in columns]).T
    free, step = np.ones(len(at), bool), np.zeros(len(at))
    for _ in range(len(at) + 1):
        k = np.flatnonzero(free)
        damped = a[np.ix_(k, k)] + damping * np.diag(np.diag(a)[k])
        step[k] = solve(damped, b[k] - a[np.ix_(k, ~free)] @ step[~free])
        outside = free & ((at + step < bounds[0]) | (at + step > bounds[1]))
        if not outside.any():
            break
        step[outside] = np.clip(at + step, *bounds)[outside] - at[outside]
        free &= ~outside
    new = {name: dict(v) for name, v in fit.values.items()}
    for column, value in zip(columns, at + step):
        new[column.effect][column.parameter] = float(value)
    return new


def _predicted(fit: Fit, trial: Values) -> float:
    step = np.array(
        [trial[c.effect][c.parameter] - fit.values[c.effect][c.parameter] for c in fit.weighted.columns]
    )
    return float(fit.weighted.left(fit.index, step).sum())


def _parameter(problem: Problem, column: Column):
    return next(p for p in problem.library[column.effect].parameters if p.name == column.parameter)


def search(problem: Problem, limits: Thresholds | None = None) -> Search:
    """Name the effects that explain the flights of `problem`."""
    limits = limits or Thresholds()
    names = list(problem.library)
    fit = _fit_at(problem, {}, [], np.ones(6))
    steps, evidence, classes, follows, unstable = [], {}, {}, {}, []
    closable_at_first = None
    inflation = np.ones(6)
    for _ in range(limits.most + 1):
        linear = problem.linearise(fit.values, problem.columns(fit.values, names))
        inflation = linear.inflation()
        weighted = linear.weighted(inflation)
        base = weighted.index(list(fit.values))
        before = weighted.left_out(base)
        whole = weighted.left(
            np.arange(len(weighted.columns)), weighted.fit(np.arange(len(weighted.columns)))
        )
        closable = max(1e-9, float(before.sum() - whole.sum()))
        others = [n for n in names if n not in fit.values]
        linear_gain = {
            n: float((before - weighted.left_out(np.concatenate([base, weighted.index([n])]))).sum())
            for n in others
        }
        order = sorted(others, key=lambda n: -linear_gain[n])
        tried = [n for n in order[: limits.shortlist] if linear_gain[n] > limits.gain / 3]
        trials = {n: _trial(problem, weighted, fit, n, inflation, before) for n in tried}
        closable_at_first = closable_at_first or closable
        ranked = sorted(tried, key=lambda n: -_score(problem, n, trials, limits))
        accepted, reasons = None, {}
        refused: list[str] = []
        for name in ranked:
            if any(_overlap(weighted, base, name, other) > limits.overlap for other in refused):
                reasons[name] = f"explains the same as {refused[0]}, worse"
                continue
            reasons[name] = objection(
                problem, name, trials[name], closable, closable_at_first, limits, fit.values
            )
            large = trials[name].gain > limits.share * closable_at_first
            if large and reasons[name].startswith(("differs", "at its bound")):
                unstable.append(name)
            if not reasons[name]:
                accepted = name
                break
            # A worse explanation of the same error must not slip in where the best one was refused.
            if trials[name].gain > limits.gain and reasons[name].startswith("differs"):
                refused.append(name)
        dropped: tuple[str, ...] = ()
        members: tuple[str, ...] = ()
        if accepted:
            trial = trials[accepted]
            for cause in fit.values:
                if (
                    accepted in ENTAILED.get(cause, ())
                    and trial.gain < limits.share_entailed * closable_at_first
                ):
                    follows[accepted] = cause
            fit = trial.fit
            evidence[accepted] = trial.evidence
            members = tie_class(problem, weighted, base, accepted, trial, trials, limits)
            classes[accepted] = members
            fit, dropped = _drop_useless(problem, fit, accepted, inflation, limits, closable_at_first)
        steps.append(
            SearchStep(
                accepted,
                dropped,
                tuple(
                    _row(n, trials.get(n), linear_gain[n], closable, members, reasons.get(n))
                    for n in ranked + [n for n in order if n not in ranked]
                ),
            )
        )
        if not accepted:
            break
    if fit.values:
        fit = refit(problem, fit.values, inflation)
    weight = problem.weight / inflation
    nothing = problem.linearise({}, []).weighted(inflation).c.sum()
    closable = max(1e-9, float(nothing - (weight * problem.rows[:, None]).sum()))
    gains = {name: _share(problem, fit, name, inflation, closable) for name in fit.values}
    return Search(fit, steps, inflation, closable_at_first, gains, evidence, classes, follows, unstable)


@dataclasses.dataclass
class Trial:
    """One candidate added to the effects found so far and refitted with them."""

    fit: Fit
    gain: float
    evidence: float
    agreement: float
    values: dict[str, float]


def _trial(problem: Problem, weighted: Weighted, fit: Fit, name: str, inflation, before: np.ndarray) -> Trial:
    effect = problem.library[name]
    start = dict(effect.neutral)
    columns = weighted.index([name])
    if any(weighted.columns[k].fixed for k in columns):
        start = _profiled_start(problem, weighted, fit, name, inflation)
    trial = refit(problem, {**fit.values, name: start}, inflation)
    return trial_of(problem, trial, name, before - trial.weighted.left_out(trial.index))


def trial_of(problem: Problem, fit: Fit, name: str, difference: np.ndarray) -> Trial:
    """A trial from the decrease (w,) of the squared error of every window."""
    by_group = np.bincount(problem.group_of, difference, minlength=problem.groups)
    return Trial(
        fit,
        float(difference.sum()),
        standard_errors(difference),
        float((by_group > 0).mean()),
        fit.values[name],
    )


def standard_errors(difference: np.ndarray) -> float:
    """Sum of the signed roots of the gains (w,) of all windows in standard errors of zero.

    Roots, because an effect that shows in a few windows only has very unequal gains.
    """
    root = np.sign(difference) * np.sqrt(np.abs(difference))
    return float(root.sum() / max(math.sqrt(float((root**2).sum())), 1e-9))


def _profiled_start(problem: Problem, weighted: Weighted, fit: Fit, name: str, inflation) -> dict[str, float]:
    """Start of a fit whose second parameter shows only once the first is not neutral: the best of a grid."""
    effect = problem.library[name]
    first, other = effect.parameters[0], next(p for p in effect.parameters if p.name == "reference")
    grid = np.linspace(*other.bounds, 8)[1:-1]
    columns = [Column(c.effect, c.parameter) for c in weighted.columns if c.effect in fit.values]
    columns += [Column(name, first.name, ((other.name, float(x)),)) for x in grid]
    linear = problem.linearise(fit.values, columns).weighted(inflation)
    best, start = np.inf, dict(effect.neutral)
    known = len(columns) - len(grid)
    for k, x in enumerate(grid):
        index = np.array([*range(known), known + k])
        change = linear.fit(index)
        left = float(linear.left(index, change).sum())
        if left < best:
            best = left
            value = float(np.clip(first.neutral + change[-1], *first.bounds))
            start = {**effect.neutral, first.name: value, other.name: float(x)}
    return start


def _score(problem: Problem, name: str, trials: dict[str, Trial], limits: Thresholds) -> float:
    """Gain less what a further parameter must bring."""
    best = max(t.gain for t in trials.values())
    extra = len(problem.library[name].parameters) - 1
    return trials[name].gain - extra * limits.simpler * max(best, 0.0)


def objection(problem, name, trial: Trial, closable, at_first, limits: Thresholds, found: Values) -> str:
    """Why a candidate is not accepted; empty if it is."""
    effect = problem.library[name]
    # All windows alike give the square root of their number: no more can be asked of a few.
    evidence = min(limits.evidence, ENOUGH * math.sqrt(len(problem.flight_of)))
    if trial.gain < limits.gain or trial.evidence < evidence:
        return f"not significant ({trial.evidence:.1f} standard errors)"
    if trial.agreement < limits.agreement:
        return f"helps in {100 * trial.agreement:.0f} % of the flights only"
    large = [abs(trial.values[p.name] - p.neutral) > p.negligible for p in effect.parameters if _sized(p)]
    if not any(large):
        return "negligible"
    least = limits.share_more if found else limits.share
    if trial.gain < limits.share_left * closable or trial.gain < least * at_first:
        return f"explains {100 * trial.gain / closable:.0f} % only"
    for p in effect.parameters:
        lo, hi = p.bounds
        if (
            _sized(p)
            and lo != p.neutral
            and min(trial.values[p.name] - lo, hi - trial.values[p.name]) < 1e-3 * (hi - lo)
        ):
            return f"at its bound ({p.name} = {trial.values[p.name]:g} {p.unit})"
    if disagreement(problem, trial.fit, name) > limits.spread:
        return "differs between flights"
    return ""


def _sized(parameter) -> bool:
    """Whether a parameter has a size of its own (a reference has none)."""
    return parameter.name != "reference"


def disagreement(problem: Problem, fit: Fit, name: str) -> float:
    """Spread of an effect's first-order size between flights beyond their errors, as a share of its size."""
    index = np.array([k for k, c in enumerate(fit.weighted.columns) if c.effect == name], int)
    if len(problem.flights) < 3:
        return 0.0
    change, error = fit.weighted.per_flight(fit.index)
    worst, size = [], []
    for k in index:
        column = fit.weighted.columns[k]
        parameter = _parameter(problem, column)
        if not _sized(parameter):
            continue
        worst.append(spread_between(change[:, k], error[:, k]))
        size.append(abs(fit.values[name][column.parameter] - parameter.neutral) / 1.0)
    size = np.array(size)
    main = int(np.argmax(size))
    return float(worst[main] / max(size[main], 1e-12))


def spread_between(value: np.ndarray, error: np.ndarray) -> float:
    """Standard deviation between flights beyond their standard errors (DerSimonian and Laird 1986)."""
    good = np.isfinite(value) & np.isfinite(error) & (error > 0)
    if good.sum() < 3:
        return 0.0
    w = 1.0 / error[good] ** 2
    mean = (w * value[good]).sum() / w.sum()
    q = (w * (value[good] - mean) ** 2).sum()
    excess = (q - (good.sum() - 1)) / (w.sum() - (w**2).sum() / w.sum())
    return math.sqrt(max(0.0, float(excess)))


def left_out_vehicles(problem: Problem, fit: Fit) -> list[Vehicle]:
    """For every flight, the vehicle with the effects fitted to the other flights.

    One Newton step from the fit to all, shortened where it does not fit the other flights as foreseen:
    parameters that only some flights tell apart may ask for steps beyond what is linear.
    """
    if not len(fit.index) or len(problem.flights) < 2:
        return [problem.corrected(fit.values)] * len(problem.flights)
    w = fit.weighted
    a, b = w.a.sum(axis=0), w.b.sum(axis=0)
    weight = problem.weight / fit.inflation
    vehicles = []
    for k in range(len(problem.flights)):
        own = problem.flight_of == k
        step = solve(a - w.a[own].sum(axis=0), b - w.b[own].sum(axis=0))
        others = float(w.c[~own].sum())
        for _ in range(6):
            vehicle = problem.corrected(_stepped(problem, fit, step))
            white = [problem.white_of(i, vehicle) for i in range(len(problem.flights)) if i != k]
            squares = (np.concatenate([(x**2).sum(axis=2) for x in white]) * weight[~own]).sum()
            if squares <= others * 1.001:
                break
            step = 0.3 * step
        vehicles.append(vehicle)
    return vehicles


def _stepped(problem: Problem, fit: Fit, step: np.ndarray) -> dict[str, dict[str, float]]:
    """Values of a fit after a step of its columns, within bounds."""
    values = {name: dict(v) for name, v in fit.values.items()}
    for column, change in zip(fit.weighted.columns, step):
        at = values[column.effect][column.parameter] + change
        values[column.effect][column.parameter] = float(np.clip(at, *_parameter(problem, column).bounds))
    return values


def tie_class(
    problem: Problem,
    weighted: Weighted,
    base: np.ndarray,
    name: str,
    trial: Trial,
    trials,
    limits: Thresholds,
) -> tuple[str, ...]:
    """Effects that change the prediction as `name` does: each is explained by the other, R2 above a limit."""
    own = weighted.index([name])
    members = [name]
    a = weighted.group_a.sum(axis=0)
    if len(base):  # what the other effects could explain does not tell these apart
        a = a - a[:, base] @ invert(a[np.ix_(base, base)]) @ a[base, :]
    size = _size_in(weighted, base, own)
    for other in problem.library:
        columns = weighted.index([other])
        if other == name or set(columns) & set(base) or not len(columns):
            continue
        if _explained(a, own, size, columns) > limits.alike:
            back = _size_in(weighted, base, columns)
            if _explained(a, columns, back, own) > limits.alike:
                members.append(other)
    return tuple(members)


def _overlap(weighted: Weighted, base: np.ndarray, name: str, other: str) -> float:
    """Share of the change by effect `name` that effect `other` can make too, beside the columns `base`."""
    own, columns = weighted.index([name]), weighted.index([other])
    return _explained(weighted.group_a.sum(axis=0), own, _size_in(weighted, base, own), columns)


def _size_in(weighted: Weighted, base: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Fitted linear change of the columns `own` beside those of `base`."""
    return weighted.fit(np.concatenate([base, own]))[len(base) :]


def _explained(a: np.ndarray, own: np.ndarray, size: np.ndarray, columns: np.ndarray) -> float:
    """R2 of the change `size` along `own`, explained by `columns`, in the metric `a`."""
    total = float(size @ a[np.ix_(own, own)] @ size)
    if total <= 0.0:
        return 0.0
    cross = a[np.ix_(columns, own)] @ size
    return float(cross @ solve(a[np.ix_(columns, columns)], cross)) / total


def _drop_useless(problem: Problem, fit: Fit, newest: str, inflation, limits: Thresholds, at_first: float):
    """Leave out earlier effects that the newest one made useless."""
    dropped = []
    for name in [n for n in fit.values if n != newest]:
        rest = {n: v for n, v in fit.values.items() if n != name}
        smaller = refit(problem, rest, inflation)
        with_it = fit.weighted.left_out(fit.index)
        without = smaller.weighted.left_out(smaller.index)
        difference = without - with_it
        small = all(
            abs(fit.values[name][p.name] - p.neutral) < p.negligible
            for p in problem.library[name].parameters
            if _sized(p)
        )
        if (
            small
            or difference.sum() < limits.gain
            or standard_errors(difference) < limits.evidence
            or difference.sum() < limits.share_more * at_first
        ):
            fit, _ = smaller, dropped.append(name)
    return fit, tuple(dropped)


def _share(problem: Problem, fit: Fit, name: str, inflation, closable: float) -> float:
    """Share of the closable error that the fit loses without an effect, the others refitted."""
    rest = {n: v for n, v in fit.values.items() if n != name}
    smaller = refit(problem, rest, inflation, iterations=3)
    loss = smaller.weighted.left_out(smaller.index).sum() - fit.weighted.left_out(fit.index).sum()
    return float(np.clip(loss / closable, 0.0, 1.0))


def _row(name, trial: Trial | None, linear_gain, closable, members, reason) -> Candidate:
    if trial is None:
        return Candidate(
            name, linear_gain, linear_gain / closable, 0.0, False, name in members, "explains less", {}
        )
    return Candidate(
        name,
        trial.gain,
        trial.gain / closable,
        trial.evidence,
        True,
        name in members,
        "explains less" if reason is None else reason,
        trial.values,
    )
