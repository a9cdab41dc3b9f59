"""What a flight is expected to tell: how far the probabilities of sets of effects move.

Every set predicts the flight with its own values; how well these are known, and what nobody needs to correct
of all other effects, are Gaussian. The prediction is linear in both, so that a flight is known by one matrix
of scalar products of predictions, made white by noise and unrest. Such matrices add up over pieces of flight.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from inclined_landing.eval.gap.flights.windows import Measured, prepare
from inclined_landing.eval.gap.plan.setpoints import Setpoints
from inclined_landing.eval.gap.search.evidence import Column, Suspects, Values
from inclined_landing.eval.gap.search.prediction import predict
from inclined_landing.models.effects import LIBRARY, Effect
from inclined_landing.models.parameters import Vehicle

# A real flight tells less than a linear, perfectly flown one: gains are averaged over these shares.
TRUST = (1.0, 0.1, 0.01)
DRAWS = 32  # of values and noise, for every set
SPIKE = 0.5  # standard deviation of what nobody needs to correct, in negligible sizes


@dataclasses.dataclass(frozen=True)
class Hypothesis:
    """A set of effects that a diagnosis holds for possible; the empty set: nothing is missing."""

    effects: tuple[str, ...]
    probability: float
    values: Values
    deviations: Values = dataclasses.field(default_factory=dict)  # of the values, where they are known

    @property
    def text(self) -> str:
        """Its names, as part of a sentence."""
        return " with ".join(self.effects) if self.effects else "nothing"


@dataclasses.dataclass(frozen=True)
class Quiet:
    """What a measured flight holds besides the vehicle's motion, of x, y, z, roll, pitch, yaw."""

    noise: np.ndarray  # (6,) standard deviation of the measured pose [m, rad]

    @staticmethod
    def usual() -> Quiet:
        """A millimetre and 0.3 deg of noise."""
        return Quiet(np.array([0.001] * 3 + [0.00524] * 3))


class Question(Suspects):
    """Sets of effects on a vehicle, and the directions in which predictions may differ.

    Directions are first the K sets, each at its values, then what is free: small sizes of all effects of the
    library, and the parameters of each set. free (K, P): their standard deviations under every set.
    """

    def __init__(
        self,
        hypotheses: Sequence[Hypothesis],
        vehicle: Vehicle,
        quiet: Quiet,
        library: Mapping[str, Effect] = LIBRARY,
    ):
        total = sum(h.probability for h in hypotheses)
        self.hypotheses = [dataclasses.replace(h, probability=h.probability / total) for h in hypotheses]
        self.vehicle, self.quiet = vehicle, quiet
        self.library = {n: e for n, e in library.items() if not e.contact}
        self.vehicles = [self.corrected(h.values) for h in self.hypotheses]
        best = max(self.hypotheses, key=lambda h: h.probability)
        self.base = self.corrected(best.values)
        self._pairs: list[tuple[Vehicle, Vehicle, float]] = []
        deviations: list[np.ndarray] = []
        for name, effect in self.library.items():
            for p in effect.parameters:
                if not p.is_reference:
                    self._add(best.values, Column(name, p.name))
                    deviations.append(np.full(len(self), SPIKE * p.negligible))
        for k, h in enumerate(self.hypotheses):
            for name in h.effects:
                for p in self.library[name].parameters:
                    self._add(h.values, Column(name, p.name))
                    own = np.zeros(len(self))
                    own[k] = self._deviation(h, name, p)
                    deviations.append(own)
        self.free = np.hstack([np.zeros((len(self),) * 2), np.array(deviations).reshape(-1, len(self)).T])

    def __len__(self) -> int:
        return len(self.hypotheses)

    @property
    def probabilities(self) -> np.ndarray:
        """(K,) of the sets, before the flight."""
        return np.array([h.probability for h in self.hypotheses])

    def _add(self, values: Values, column: Column) -> None:
        (low, high), step = self.to_either_side(values, column, 1.0)
        self._pairs.append((low, high, step))

    @staticmethod
    def _deviation(h: Hypothesis, name: str, p) -> float:
        """How well a set's value is known; a quarter of its size where the diagnosis does not say."""
        known = h.deviations.get(name, {}).get(p.name)
        if known is None:
            known = 0.25 * abs(p.size(h.values[name].get(p.name, p.neutral)))
        low, high = p.bounds
        return float(min(max(known, SPIKE * p.negligible), 0.25 * (high - low)))

    def gram(self, points: Setpoints, *, platform: bool = False) -> np.ndarray:
        """Scalar products (P, P) of the directions on a flight; zero where it is too short to tell."""
        flight = self._measured(points, platform)
        base = predict(flight, self.base)
        slopes = [predict(flight, v) - base for v in self.vehicles]
        slopes += [(predict(flight, high) - predict(flight, low)) / step for low, high, step in self._pairs]
        white = np.stack([flight.whitening(flight.cut(s)).ravel() for s in slopes])
        return white @ white.T

    def _measured(self, points: Setpoints, platform: bool) -> Measured:
        return prepare(points.log("planned", self.quiet.noise), self.vehicle, platform=platform)

    def expected(self, gram: np.ndarray, seed: int = 0) -> np.ndarray:
        """(K, K) expected probability of every set j after the flight where the set i is true."""
        return np.stack([p.mean(axis=0) for p in self._posteriors(gram, seed)])

    def gain(self, gram: np.ndarray, seed: int = 0) -> float:
        """Expected decrease of the entropy of the sets [nat], averaged over TRUST."""
        before = _entropy(self.probabilities[None])[0]
        after = [
            self.probabilities @ [_entropy(p).mean() for p in self._posteriors(share * gram, seed)]
            for share in TRUST
        ]
        return float(before - np.mean(after))

    def _posteriors(self, gram: np.ndarray, seed: int) -> list[np.ndarray]:
        """For every true set, probabilities (DRAWS, K) of the sets after flights drawn with it."""
        rng = np.random.default_rng(seed)
        size, vectors = np.linalg.eigh(gram)
        root = vectors * np.sqrt(np.maximum(size, 0.0))
        sets = [self._marginal(gram, k) for k in range(len(self))]
        result = []
        for k in range(len(self)):
            x = rng.standard_normal((DRAWS, len(gram))) * self.free[k]
            x[:, k] += 1.0
            seen = x @ gram + rng.standard_normal(x.shape) @ root.T
            score = np.log(np.maximum(self.probabilities, 1e-12)) + np.stack(
                [
                    seen[:, j] + 0.5 * (((seen[:, live] - gram[j, live]) @ w.T) ** 2).sum(axis=1) + constant
                    for j, (live, w, constant) in enumerate(sets)
                ],
                axis=1,
            )
            score -= score.max(axis=1, keepdims=True)
            p = np.exp(score)
            result.append(p / p.sum(axis=1, keepdims=True))
        return result

    def _marginal(self, gram: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray, float]:
        """Of the log-likelihood of a set, what is free integrated out: its directions, factor, constant."""
        live = np.flatnonzero(self.free[k])
        d = self.free[k, live]
        lower = np.linalg.cholesky(np.eye(len(live)) + d[:, None] * gram[np.ix_(live, live)] * d)
        w = np.linalg.solve(lower, np.diag(d))
        return live, w, -0.5 * gram[k, k] - float(np.log(np.diag(lower)).sum())


def _entropy(p: np.ndarray) -> np.ndarray:
    """Entropy (...,) [nat] of probabilities (..., K)."""
    return -(p * np.log(np.maximum(p, 1e-300))).sum(axis=-1)
