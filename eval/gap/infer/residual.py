"""Residual analysis: can what a corrected vehicle leaves unexplained be predicted?

A residual force that is a function of logged quantities - position, velocity, heading, commands and their
past, time, voltage - is missing physics; one that is not is a disturbance (process noise). The functions are
ridge regressions on radial basis functions of every input and random Fourier features of all, an acceleration
along an axis or an angular acceleration of a loop, cross-validated over flights. Significance comes from a
sign-flip permutation test over blocks of a few seconds, with the largest gain of all functions as statistic
(family-wise error rate). Functions fitted to the residual of the reference flights are subtracted first.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.infer.gaussian import EffectSet, LinearGaussian
from inclined_landing.eval.gap.infer.sets import SetPosterior
from inclined_landing.eval.gap.measured.noise import ErrorResponses
from inclined_landing.eval.gap.measured.windows import MeasuredFlight
from inclined_landing.eval.gap.model.prediction import POSE_CHANNELS, UNITS_OF
from inclined_landing.eval.gap.model.problem import Problem
from inclined_landing.eval.gap.model.reference import LINEAR, TARGETS, TIME, Basis, ReferenceResidual
from inclined_landing.eval.gap.result import HORIZON, Dependence, Quantity, ResidualAnalysis
from inclined_landing.models.threads import two_at_a_time
from inclined_landing.models.vehicle import Vehicle

FLIPS = 400  # random sign flips: eight are beyond the level of 2 %
BLOCK = 5.0  # s of flight that share a sign in the permutation test: longer than a disturbance lasts
# How long ago commands and velocities may act still, chosen by hand.
COMMAND_LAGS = (0.1, 0.25)  # s
VELOCITY_LAGS = (0.15, 0.3, 0.5)  # s
SAMPLES = 200  # of the bootstrap over groups of windows
EXPECTED_SIZE = {"m/s2": 0.01, "rad/s2": 0.3}  # least prior standard deviation of a function, chosen by hand


def white_residuals(problem: Problem, local: LinearGaussian, names: EffectSet) -> list[np.ndarray]:
    """Return the white residuals (w, C, q) of every flight at the posterior mean of all columns.

    Random effects of the flights included.
    """
    change, _ = local.posterior(names)
    errors, jacobian_of = [], problem.jacobian(local.values, local.columns)
    for k, flight in enumerate(problem.flights):
        step = (change + local.random_effect(k, change)) * local.unit  # z + u of this flight
        jacobian = jacobian_of(flight, problem.form_jacobians[k])
        error = flight.measured - jacobian[0] - np.tensordot(step, jacobian[1:], axes=1)
        errors.append(flight.whitening(flight.cut(error)))
    return errors


def reference_residual(problem: Problem, residual: Sequence[np.ndarray]) -> ReferenceResidual:
    """Return the functions of all flights of `problem`, each shrunk by its cross-validated gain."""
    inputs = regressors(problem.flights)
    bases = _bases(problem, inputs)
    functions = _functions(problem, residual, inputs, bases, None)
    result: dict[str, dict[str, np.ndarray]] = {}
    for f in functions:
        if np.any(weights := f.shrinkage() * f.weights()):
            result.setdefault(f.on, {})[f.target] = weights
    return ReferenceResidual(bases, result)


def regressors(flights: Sequence[MeasuredFlight]) -> dict[str, list[np.ndarray]]:
    """Return what functions of the residual may depend on: name -> inputs (m, k) of every flight."""
    columns: dict[str, Callable[[MeasuredFlight], Sequence[np.ndarray]]] = {
        "place": lambda f: [f.position],
        "velocity": lambda f: [f.velocity],
        "velocity along its heading": lambda f: [_along_heading(f)],
        "tilt": lambda f: [f.attitude[:, :2]],
        "heading": lambda f: [np.cos(f.attitude[:, 2]), np.sin(f.attitude[:, 2])],
        "commands": lambda f: [f.command],
        "roll command": lambda f: [f.command[:, 1]],
        "pitch command": lambda f: [f.command[:, 2]],
        "thrust command and its past": lambda f: _lagged(f, f.command[:, :1], COMMAND_LAGS),
        "tilt commands and their past": lambda f: _lagged(f, f.command[:, 1:3], COMMAND_LAGS),
        "velocity and its past": lambda f: _lagged(f, _along_heading(f), VELOCITY_LAGS),
        TIME: lambda f: [f.t],
    }
    voltages = [f.voltage for f in flights]
    inputs = {name: [np.column_stack(of(f)) for f in flights] for name, of in columns.items()}
    if all(v is not None for v in voltages):
        inputs["battery voltage"] = [np.column_stack([v]) for v in voltages]
    return inputs


def _along_heading(f: MeasuredFlight) -> np.ndarray:
    """Return the velocity (m, 3) of a flight forward, to the left and up."""
    c, s = np.cos(f.attitude[:, 2]), np.sin(f.attitude[:, 2])
    x, y, z = f.velocity.T
    return np.column_stack([c * x + s * y, -s * x + c * y, z])


def _lagged(f: MeasuredFlight, values: np.ndarray, times: Sequence[float]) -> list[np.ndarray]:
    """Return values (m, k) of a flight now, and some times [s] ago."""
    rows = np.arange(f.samples)
    return [values[np.maximum(0, rows - round(t / f.dt))] for t in (0.0, *times)]


@dataclasses.dataclass(frozen=True)
class _RidgeRegression:
    """Ridge regression of the residual along one target on the features of one group of inputs."""

    target: str
    on: str  # name of the inputs
    a: np.ndarray  # (g, D, D) Gram matrices of the groups of windows
    b: np.ndarray  # (k, D) features times residual, of every block
    fold_of: np.ndarray  # (k,) group of every block: its fold in cross-validation
    ridge: float
    gain_matrix: np.ndarray  # (k, k) see `gain_matrix`

    @property
    def gain(self) -> float:
        """Return the cross-validated decrease of the squared error."""
        return float(self.gain_matrix.sum())

    def scores(self, signs: np.ndarray) -> np.ndarray:
        """Return the gains (s,) under sign flips (s, k), standardised over all flips."""
        # s'Qs with independent signs:  mean tr Q,  variance 1/2 sum_(i != j) (Q_ij + Q_ji)^2
        q = self.gain_matrix
        gains = np.einsum("sg,gh,sh->s", signs, q, signs, optimize=True) - np.trace(q)
        apart = q + q.T
        np.fill_diagonal(apart, 0.0)
        return gains / max(np.sqrt(0.5 * (apart**2).sum()), 1e-12)

    def weights(self, without: int | None = None) -> np.ndarray:
        """Return the ridge weights (D,) of all groups, or of all but one:  (a + ridge)^-1 b."""
        use = np.arange(len(self.a)) != (-1 if without is None else without)
        a = self.a[use].sum(axis=0) + self.ridge * np.eye(self.a.shape[1])
        return np.linalg.solve(a, self.b[use[self.fold_of]].sum(axis=0))

    def shrinkage(self) -> float:
        """Return the optimal shrinkage: the cross-validated gain over the predicted one."""
        gain, predicted = self.cross_validated_gain()
        return float(np.clip(gain.sum() / max(predicted.sum(), 1e-12), 0.0, 1.0))

    def cross_validated_gain(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the decrease of the squared error (g,) of every group left out, and the predicted one."""
        # With the weights w_-g of the other groups:  gain 2 b_g'w - w'a_g w,  predicted w'a_g w
        gain, predicted = np.zeros((2, len(self.a)))
        for g in range(len(self.a)):
            w = self.weights(g)
            predicted[g] = w @ self.a[g] @ w
            gain[g] = 2.0 * self.b[self.fold_of == g].sum(axis=0) @ w - predicted[g]
        return gain, predicted


def analyse_residual(found: SetPosterior, vehicle: Vehicle) -> ResidualAnalysis:
    """Return the residual's significant functions, given the most probable set.

    vehicle: the corrected one.
    """
    problem = found.problem
    residual = white_residuals(problem, found.local, found.names)
    repeating = problem.reference.repeating if problem.reference else None
    inputs = regressors(problem.flights)
    bases = _bases(problem, inputs)
    if repeating:
        bases = {name: repeating.bases.get(name, basis) for name, basis in bases.items()}
    functions = _functions(problem, residual, inputs, bases, repeating)
    signs = _sign_flips(len(functions[0].b))
    scores = np.stack([f.scores(signs) for f in functions])
    largest = scores.max(axis=0)  # over all functions, of the data and of every flip (max-T test)
    p_value = float((largest >= largest[0] - 1e-9).mean())
    threshold = np.quantile(largest[1:], 1.0 - thresholds.RESIDUAL)
    depends: dict[str, Dependence] = {}
    for k in np.argsort(-scores[:, 0], kind="stable"):
        f = functions[k]
        if scores[k, 0] >= threshold and f.target not in depends and f.gain > 0.0:
            moved = _displacement(problem, f, bases[f.on], inputs[f.on], vehicle)
            depends[f.target] = Dependence(f.target, f.on, moved.value, moved.ci95)
    return ResidualAnalysis(p_value, depends_on=tuple(depends.values()))


def _functions(
    problem: Problem,
    residual: Sequence[np.ndarray],
    inputs: Mapping[str, Sequence[np.ndarray]],
    bases: Mapping[str, Basis],
    repeating: ReferenceResidual | None,
) -> list[_RidgeRegression]:
    """Return one ridge regression for every group of inputs along every target."""
    block_of = _blocks(problem)

    def fits(name: str) -> list[_RidgeRegression]:
        features = [f.cut(bases[name](x)) for f, x in zip(problem.flights, inputs[name])]
        on = (LINEAR[name],) if name in LINEAR else TARGETS
        known = repeating.weights.get(name, {}) if repeating else {}
        return [
            _fit(problem, residual, target, name, features, block_of, known.get(target))
            for target in on
            if problem.logged[:, _channels(target)].any()
        ]

    return list(itertools.chain.from_iterable(two_at_a_time(fits, inputs)))


def _displacement(
    problem: Problem,
    function: _RidgeRegression,
    basis: Basis,
    inputs: Sequence[np.ndarray],
    vehicle: Vehicle,
) -> Quantity:
    """Return the displacement [m] over HORIZON that a function explains in flights left out.

    Root mean square by the function fitted to the other flights, times the root of its optimal shrinkage; the
    95 % interval is a bootstrap over groups of windows.
    """
    if function.target == "yaw":
        return Quantity(0.0, (0.0, 0.0))
    squares = np.zeros(len(function.a))  # of the displacements in every group, and their number
    counts = np.zeros(len(function.a))
    for k, (flight, x) in enumerate(zip(problem.flights, inputs)):
        through = _displacement_response(flight, function.target, vehicle)
        # Four displacements a second, each counted with the group of the window that it begins in
        first = np.arange(0, max(0, flight.samples - len(through)), max(1, len(through) // 4))
        first = flight.usable_from(first, len(through))
        window = np.clip(np.searchsorted(flight.starts, first, side="right") - 1, 0, None)
        group = problem.group_of[problem.flight_of == k][window]
        features = basis(x)
        for g in np.unique(group):
            value = features @ function.weights(g)
            displacement = value[first[group == g][:, None] + np.arange(len(through))] @ through
            squares[g] += (displacement**2).sum()
            counts[g] += len(displacement)
    # d^2 = shrinkage mean square,  shrinkage = cross-validated over predicted gain; first of all groups, then
    # of every sample of them
    gain, predicted = function.cross_validated_gain()
    drawn = np.random.default_rng(0).integers(0, len(gain), (SAMPLES, len(gain)))
    drawn = np.vstack([np.arange(len(gain)), drawn])
    shrinkage = np.clip(gain[drawn].sum(axis=1) / np.maximum(predicted[drawn].sum(axis=1), 1e-12), 0.0, 1.0)
    mean_square = shrinkage * squares[drawn].sum(axis=1) / np.maximum(counts[drawn].sum(axis=1), 1.0)
    value, *samples = np.sqrt(mean_square)
    low, high = np.quantile(samples, [0.025, 0.975])
    return Quantity(value, (low, high))


def _displacement_response(flight: MeasuredFlight, target: str, vehicle: Vehicle) -> np.ndarray:
    """Return the impulse response (r,): displacement [m] after HORIZON per unit of a target in each row."""
    # Position by an acceleration in each row, h; by an angular acceleration, through g times the angle: g h H
    impulse = ErrorResponses.of(round(HORIZON / flight.dt), flight.dt, vehicle).impulse
    of_position, of_angle = impulse[POSE_CHANNELS.index("x")][-1], impulse[POSE_CHANNELS.index("roll")]
    if target not in ("roll", "pitch"):
        return of_position
    return vehicle.environment_gravity * of_position @ of_angle


# Targets along the heading psi: their shares along the channels x and y.
_ALONG_HEADING: dict[str, tuple[Callable[[np.ndarray], np.ndarray], ...]] = {
    "forward": (np.cos, np.sin),  # (cos psi, sin psi)
    "left": (lambda psi: -np.sin(psi), np.cos),  # (-sin psi, cos psi)
}


def _channels(target: str) -> tuple[int, ...]:
    """Return the channels that a target acts on."""
    return (0, 1) if target in _ALONG_HEADING else (POSE_CHANNELS.index(target),)


def _bases(problem: Problem, inputs: Mapping[str, Sequence[np.ndarray]]) -> dict[str, Basis]:
    """Return the bases of the inputs of all flights."""
    usable = {n: [x[f.usable] for f, x in zip(problem.flights, of)] for n, of in inputs.items()}
    return {name: Basis.of(np.concatenate(of), name) for name, of in usable.items()}


def _fit(
    problem: Problem, residual: Sequence[np.ndarray], target: str, name: str, features, block_of, known
) -> _RidgeRegression:
    """Return a ridge regression of the residual on features: Gram matrices and cross-validated gains.

    known (D,): what the function is in the flights of the reference; None: nothing.
    """
    channels = _channels(target)
    groups, width = problem.groups, features[0].shape[2]
    a, b = np.zeros((groups, width, width)), np.zeros((int(block_of.max()) + 1, width))
    by_flight = map(problem.split, (problem.group_of, block_of, problem.weight))
    for flight, errors, basis, g, k, weight in zip(problem.flights, residual, features, *by_flight):
        for channel in channels:
            drive = basis
            if target in _ALONG_HEADING:
                heading = flight.cut(flight.attitude[:, 2])[..., None]
                drive = basis * _ALONG_HEADING[target][channel](heading)
            # White slopes of the weighted errors in the function's weights:  S = share W H features
            scale = 1.0 / np.sqrt(problem.inflation[channel])
            through = scale * flight.whitening.matrices[channel] @ flight.error_responses.impulse[channel]
            share = np.sqrt(weight[:, channel])[:, None]
            slopes = share[..., None] * np.matmul(through, drive)  # (w, q, D)
            for one in np.unique(g):
                own = slopes[g == one].reshape(-1, width)
                a[one] += own.T @ own
            error = scale * share * errors[:, channel]
            if known is not None:
                error = error - slopes @ known
            np.add.at(b, k, np.einsum("wqd,wq->wd", slopes, error, optimize=True))
    # Prior of the weights N(0, size^2), size that of the disturbance:  ridge = 1 / size^2
    least = EXPECTED_SIZE[UNITS_OF[POSE_CHANNELS[channels[0]]]]
    ridge = 1.0 / max(*(problem.noise_model[k].size for k in channels), least) ** 2
    fold_of = np.array([problem.group_of[np.argmax(block_of == k)] for k in range(len(b))])
    return _RidgeRegression(target, name, a, b, fold_of, ridge, gain_matrix(a, b, fold_of, ridge))


def gain_matrix(a: np.ndarray, b: np.ndarray, fold_of: np.ndarray, ridge: float) -> np.ndarray:
    """Return the matrix Q (k, k) of the cross-validated gain s'Qs under sign flips s (k,) of the blocks.

    a (g, D, D) of every group of windows, b (k, D) of every block.
    """
    # Fits of fold g from the blocks outside it:  F_g = (sum_(h != g) a_h + ridge)^-1 b_i  (0 inside), and
    #   Q = sum_g [2 b_g F_g' - F_g a_g F_g']
    total, q = a.sum(axis=0), np.zeros((len(b), len(b)))
    for g in range(len(a)):
        own = fold_of == g
        fits = np.where(own[:, None], 0.0, np.linalg.solve(total - a[g] + ridge * np.eye(a.shape[1]), b.T).T)
        q[own] += 2.0 * b[own] @ fits.T
        q -= fits @ a[g] @ fits.T
    return q


def _blocks(problem: Problem) -> np.ndarray:
    """Return the permutation block (w,) of every window: pieces of flights of about BLOCK seconds."""
    result, count = np.zeros(len(problem.group_of), int), 0
    for g in range(problem.groups):
        w = np.flatnonzero(problem.group_of == g)
        flight = problem.flights[problem.flight_of[w[0]]]
        parts = max(1, round(len(w) * flight.rows * flight.dt / BLOCK))
        result[w] = count + np.arange(len(w)) * parts // len(w)
        count = result[w[-1]] + 1
    return result


def _sign_flips(blocks: int) -> np.ndarray:
    """Return random signs (FLIPS, blocks), the first row all positive (the data)."""
    signs = np.random.default_rng(0).choice((-1.0, 1.0), (FLIPS, blocks))
    signs[0] = 1.0
    return signs
