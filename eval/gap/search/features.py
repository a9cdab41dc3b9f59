"""Functions of logged quantities: their features, and those of the residual of reference flights."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from inclined_landing.eval.gap.search.prediction import CHANNELS

TARGETS = (*CHANNELS, "forward", "left")
FEATURES = 24  # random Fourier features of a function
KNOTS = 7  # radial basis functions along every input
TIME_SPACING = 0.5  # s between those along the flight time
TIME = "flight time"


@dataclasses.dataclass(frozen=True)
class Basis:
    """Features of some inputs: radial basis functions of each, random Fourier features of all."""

    centre: np.ndarray  # (k,)
    scale: np.ndarray  # (k,)
    knots: tuple[np.ndarray, ...]  # of k, in scaled inputs

    @staticmethod
    def of(seen: np.ndarray, inputs: Sequence[str]) -> Basis:
        """Return a basis scaled to inputs `seen` (m, k)."""
        centre, scale = seen.mean(axis=0), np.maximum(seen.std(axis=0), 1e-9)
        z, count = (seen - centre) / scale, KNOTS
        if tuple(inputs) == (TIME,):  # oscillations in time need a finer basis
            count = max(KNOTS, round(float(np.ptp(seen)) / TIME_SPACING))
        return Basis(centre, scale, tuple(np.quantile(c, np.linspace(0, 1, count)) for c in z.T))

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Return the features (m, D) of inputs (m, k)."""
        # Radial: exp(-(z - knot)^2 / (2 width^2));  Fourier: sqrt(2 / D) cos(w'z + phase), w ~ N(0, 1 / k)
        z = np.clip((x - self.centre) / self.scale, -4.0, 4.0)
        parts = []
        for column, knots in zip(z.T, self.knots):
            width = max(float(np.ptp(knots)) / (len(knots) - 1), 1e-6)
            parts.append(np.exp(-0.5 * ((column[:, None] - knots) / width) ** 2))
        if len(self.knots) > 1:
            rng = np.random.default_rng(0)
            turns = rng.standard_normal((len(self.knots), FEATURES)) / np.sqrt(len(self.knots))
            phase = rng.uniform(0.0, 2.0 * np.pi, FEATURES)
            parts.append(np.sqrt(2.0 / FEATURES) * np.cos(z @ turns + phase))
        return np.hstack(parts)


@dataclasses.dataclass(frozen=True)
class ReferenceResidual:
    """Functions fitted to the residual of the reference flights."""

    bases: Mapping[str, Basis]  # of quantities
    weights: Mapping[tuple[str, str], np.ndarray]  # (target, quantity) -> (D,)
