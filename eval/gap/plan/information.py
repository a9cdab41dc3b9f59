"""Expected information gain of a flight about which set of effects is missing.

Every set predicts the flight at its own values; their uncertainties, and negligible sizes of all other
effects, are normal. The prediction is linear in both, so that the Gram matrix of white predictions is a
sufficient statistic of a flight. Gram matrices are additive over pieces of flight.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from msgspec import structs

from inclined_landing.eval.gap.infer.gaussian import BETWEEN, SPIKE
from inclined_landing.eval.gap.measured.noise import ChannelNoise, Whitening
from inclined_landing.eval.gap.measured.windows import MeasuredFlight, prepare
from inclined_landing.eval.gap.model.columns import Candidates, ParameterColumn
from inclined_landing.eval.gap.model.prediction import predict
from inclined_landing.eval.gap.model.reference import VehiclePosterior
from inclined_landing.eval.gap.plan.pieces import Setpoints
from inclined_landing.eval.gap.result import ScoredSet
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.vehicle import Vehicle

# Shares of the linear model's information over which gains are averaged: a real flight has less.
INFORMATION_SHARES = (1.0, 0.1, 0.01)
DRAWS = 20  # Monte Carlo samples of every set


@dataclasses.dataclass(frozen=True)
class NoiseLevels:
    """Measurement noise and disturbance of x, y, z, roll, pitch, yaw."""

    noise: np.ndarray  # (6,) standard deviation of the measured pose [m, rad]
    disturbance: np.ndarray  # (6,) standard deviation of the disturbance [m/s2, rad/s2]
    time: np.ndarray  # (6,) its correlation time [s]

    def disturbed(self, vehicle: Vehicle) -> Vehicle:
        """Return the vehicle with this disturbance."""
        size, time = (tuple(map(float, x)) for x in (self.disturbance, self.time))
        fields: dict[str, Any] = {
            "disturbance_acceleration": size[:3],
            "disturbance_acceleration_time": time[:3],
            "disturbance_angular": size[3:],
            "disturbance_angular_time": time[3:],
        }
        return dataclasses.replace(vehicle, **fields)

    @staticmethod
    def typical() -> NoiseLevels:
        """Return typical levels: noise of a millimetre and 0.3 deg, and a small disturbance."""
        noise, disturbance = [0.001] * 3 + [0.00524] * 3, [0.05] * 3 + [1.0] * 3
        return NoiseLevels(np.array(noise), np.array(disturbance), np.full(6, 0.3))


class ModelDiscrimination:
    """Bayesian discrimination between sets of effects (Box and Hill 1967), in a linear-Gaussian model.

    The P directions of a prediction are the K sets, each at its values, then free parameters: negligible
    sizes of all effects of the library with the uncertainty of the vehicle's identification, and the
    parameters of each set. free (K, P): their standard deviations under every set. reference: of the vehicle;
    None: its constants are exact.
    """

    def __init__(
        self,
        hypotheses: Sequence[ScoredSet],
        vehicle: Vehicle,
        noise_levels: NoiseLevels,
        reference: VehiclePosterior | None = None,
    ):
        total = sum(h.probability for h in hypotheses)
        self.hypotheses = [structs.replace(h, probability=h.probability / total) for h in hypotheses]
        self.vehicle, self.noise_levels = vehicle, noise_levels
        proposed = {name for h in hypotheses for name in h.effects}
        # What only the requests of the motors show: flights that are planned have none.
        shown = {
            n: e
            for n, e in LIBRARY.items()
            if not e.contact and (n in proposed or "requests" not in e.channels or not e.requires)
        }
        self._candidates = Candidates.for_vehicle(vehicle, shown)
        self.library = self._candidates.library
        self.vehicles = [self._candidates.corrected(h.values) for h in self.hypotheses]
        best = max(self.hypotheses, key=lambda h: h.probability)
        self.base = self._candidates.corrected(best.values)
        shared = [
            ParameterColumn(name, p.name)
            for name, effect in self.library.items()
            for p in effect.parameters
            if not p.is_reference
        ]
        own = [
            (k, h, ParameterColumn(name, p.name))
            for k, h in enumerate(self.hypotheses)
            for name in h.effects
            for p in self.library[name].parameters
        ]
        difference = self._candidates.central_difference
        self._differences = [difference(best.values, column) for column in shared]
        self._differences += [difference(h.values, column) for _, h, column in own]
        # What the vehicle's identification left uncertain comes on top, in all sets alike. The directions are
        # turned to the covariance's principal axes, in which they are independent.
        negligible = [self._candidates.parameter(column).negligible for column in shared]
        covariance = np.diag(np.square(math.hypot(SPIKE, BETWEEN) * np.array(negligible)))
        if reference is not None:
            covariance += reference.along(shared)[1]
        unit = np.sqrt(covariance.diagonal())
        size, axes = np.linalg.eigh(covariance / np.outer(unit, unit))
        self._axes = unit[:, None] * axes  # (L, L), of unit size along `size`
        of_shared = np.tile(np.sqrt(np.maximum(size, 0.0)), (len(self), 1))
        of_own = np.zeros((len(self), len(own)))
        for j, (k, h, column) in enumerate(own):
            of_own[k, j] = self._deviation(h, column)
        self.free = np.hstack([np.zeros((len(self), len(self))), of_shared, of_own])

    def __len__(self) -> int:
        return len(self.hypotheses)

    @property
    def probabilities(self) -> np.ndarray:
        """Return the prior probabilities (K,) of the sets, before the flight."""
        return np.array([h.probability for h in self.hypotheses])

    def _deviation(self, h: ScoredSet, column: ParameterColumn) -> float:
        """Return the standard error of a set's value; a quarter of its size where the diagnosis has none."""
        p, values = self._candidates.parameter(column), h.values[column.effect]
        known = h.standard_errors.get(column.effect, {}).get(p.name)
        if known is None:
            known = 0.25 * abs(p.size(values.get(p.name, p.neutral)))
        low, high = p.bounds
        return float(min(max(known, SPIKE * p.negligible), 0.25 * (high - low)))

    def flight(self, points: Setpoints, *, platform: bool = False) -> MeasuredFlight:
        """Return the measured flight of a vehicle that tracks the set-points perfectly."""
        return prepare(points.log("planned", self.noise_levels.noise), self.vehicle, platform=platform)

    def flown_grams(self, logs: Sequence[FlightLog], *, platform: bool = False) -> np.ndarray:
        """Return the Gram matrices (K, P, P) of one plan as flown under the sets.

        logs: one for each of the first sets; the others are assumed to fly like the first.
        """
        grams = [self.gram(prepare(log, self.vehicle, platform=platform)) for log in logs]
        return np.stack([grams[k if k < len(grams) else 0] for k in range(len(self))])

    def gram(self, flight: MeasuredFlight) -> np.ndarray:
        """Return the Gram matrix (P, P) of the white directions on a flight."""
        levels = self.noise_levels
        noise_model = tuple(ChannelNoise(s, time=t) for s, t in zip(levels.disturbance, levels.time))
        responses, acceleration_noise = flight.error_responses, flight.acceleration_noise
        white_by = Whitening.of(responses, levels.noise, acceleration_noise, noise_model)
        base = predict(flight, self.base)
        slopes = [predict(flight, v) - base for v in self.vehicles]
        slopes += [
            (predict(flight, high) - predict(flight, low)) / step for (low, high), step in self._differences
        ]
        white = np.stack([white_by(flight.cut(s)).ravel() for s in slopes])
        shared = slice(len(self), len(self) + len(self._axes))
        white[shared] = self._axes.T @ white[shared]
        return white @ white.T

    def expected(self, gram: np.ndarray) -> np.ndarray:
        """Return (K, K): the expected posterior probability of every set j where the set i is true.

        gram (P, P), or (K, P, P) where the flight is another one under every set.
        """
        return self._after(gram, (1.0,))[0].mean(axis=1)

    def forecast(self, gram: np.ndarray) -> np.ndarray:
        """Return `expected` (K, K) averaged over INFORMATION_SHARES, as a real flight has less than all."""
        return self._after(gram, INFORMATION_SHARES).mean(axis=(0, 2))

    def gain(self, gram: np.ndarray) -> float:
        """Return the expected information gain [nat], averaged over INFORMATION_SHARES; gram as above."""
        # I = H(p) - E H(p | data),  H(p) = -sum_j p_j log p_j  (Lindley 1956)
        p = self.probabilities
        after = [p @ _entropy(one).mean(axis=1) for one in self._after(gram, INFORMATION_SHARES)]
        return float(_entropy(p) - np.mean(after))

    def _after(self, gram: np.ndarray, shares: Sequence[float]) -> np.ndarray:
        """Return posterior probabilities (S, K, DRAWS, K) after each share of the information of a flight."""
        if gram.ndim == 2:
            root = _matrix_root(gram)
            return np.stack([self._simulated_posteriors(x * gram, math.sqrt(x) * root) for x in shares])
        return np.stack([self._after(one, shares)[:, k] for k, one in enumerate(gram)], axis=1)

    def _simulated_posteriors(self, gram: np.ndarray, root: np.ndarray) -> np.ndarray:
        """Return posterior probabilities (K, DRAWS, K) after flights simulated with each set."""
        # Data enter as their scalar products with the directions: y = G x + N(0, G), x the direction of the
        # true set i with its parameters drawn. Posterior p_j ~ p_j p(y | j), parameters of j marginalised.
        rng = np.random.default_rng(0)
        x = rng.standard_normal((len(self), DRAWS, len(gram))) * self.free[:, None]
        x[np.arange(len(self)), :, np.arange(len(self))] += 1.0
        seen = x @ gram + rng.standard_normal(x.shape) @ root.T
        scores = np.empty((len(self), DRAWS, len(self)))
        for j in range(len(self)):
            live, w, constant = self._marginal_likelihood(gram, j)
            square = (((seen[..., live] - gram[j, live]) @ w.T) ** 2).sum(axis=-1)
            scores[..., j] = seen[..., j] + 0.5 * square + constant
        scores += np.log(np.maximum(self.probabilities, 1e-12))
        p = np.exp(scores - scores.max(axis=-1, keepdims=True))
        return p / p.sum(axis=-1, keepdims=True)

    def _marginal_likelihood(self, gram: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray, float]:
        """Return free directions, factor W and constant c of the marginal log-likelihood of a set."""
        # log p(y | k) = y_k + 1/2 |W (y - G_k)|^2 + c,  L L' = 1 + D G D,  W = L^-1 D,
        # c = -1/2 G_kk - log det L,  over the free directions with standard deviations D
        live = np.flatnonzero(self.free[k])
        d = self.free[k, live]
        lower = np.linalg.cholesky(np.eye(len(live)) + d[:, None] * gram[np.ix_(live, live)] * d)
        w = np.linalg.solve(lower, np.diag(d))
        return live, w, -0.5 * gram[k, k] - float(np.log(np.diag(lower)).sum())


def _matrix_root(gram: np.ndarray) -> np.ndarray:
    """Return a square root R of a positive semidefinite matrix: R R' = gram."""
    size, vectors = np.linalg.eigh(gram)
    return vectors * np.sqrt(np.maximum(size, 0.0))


def _entropy(p: np.ndarray) -> np.ndarray:
    """Return the entropy (...,) [nat] of probabilities (..., K)."""
    return -(p * np.log(np.maximum(p, 1e-300))).sum(axis=-1)
