"""Information of a flight about unknown functions of regressors, for a residual that no effect explains.

The regressors are those of the residual analysis. A smooth unknown function of one is a Gaussian process with
a squared exponential kernel, approximated by random Fourier features (Rahimi and Recht 2007).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from inclined_landing.eval.gap.flights.windows import MeasuredFlight, prepare
from inclined_landing.eval.gap.infer.residual import regressors
from inclined_landing.eval.gap.plan import pieces
from inclined_landing.eval.gap.plan.pieces import Space
from inclined_landing.eval.gap.plan.setpoints import setpoints
from inclined_landing.models.base.errors import UserError, shown

FEATURES = 16  # of a function
CORRELATION_TIME = 0.3  # s, of the disturbance: samples closer than this count as one


class _RandomFeatures:
    """Random Fourier features of a regressor, standardised by the samples (m, k) it is made from."""

    def __init__(self, samples: np.ndarray):
        k = samples.shape[1]
        self.mean, scale = samples.mean(axis=0), samples.std(axis=0)
        self.scale = np.where(scale > 0.0, scale, 1.0)
        rng = np.random.RandomState(0)  # legacy generator: keeps plans reproducible
        self.weights = np.sqrt(1.0 / k) * rng.normal(size=(k, FEATURES))
        self.phases = rng.uniform(0.0, 2.0 * np.pi, FEATURES)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Return the features (m, FEATURES) of samples (m, k)."""
        # phi(x) = sqrt(2 / D) cos(W' x + b),  E phi(x)' phi(y) = exp(-|x - y|^2 / (2 k))
        z = (x - self.mean) / self.scale
        return np.sqrt(2.0 / FEATURES) * np.cos(z @ self.weights + self.phases)


class RegressorCoverage:
    """Unknown functions of some regressors, named by group or by single input; none for no names.

    Raises UserError for an unknown name.
    """

    def __init__(self, names: Sequence[str], space: Space, noise: np.ndarray):
        path = pieces.joined_path([pieces.midpoint(k) for k in pieces.kinds(space)], space)
        typical = self._inputs(prepare(setpoints(path, space.vehicle).log("usual", noise), space.vehicle))
        for name in names:
            if name not in typical:
                known = ", ".join(typical)
                raise UserError(f"unknown quantity {shown(repr(name))}; choose from {known}")
        self._features = {name: _RandomFeatures(typical[name]) for name in names}

    @staticmethod
    def _inputs(flight: MeasuredFlight) -> dict[str, np.ndarray]:
        """Return the values (m, k) of every group of regressors, and (m, 1) of every single one."""
        groups = regressors([flight])
        single = {
            one: arrays[0][:, inputs.index(one), None] for inputs, arrays in groups.values() for one in inputs
        }
        return single | {name: arrays[0] for name, (_, arrays) in groups.items()}

    def gram(self, flight: MeasuredFlight) -> np.ndarray:
        """Return the Gram matrices (g, FEATURES, FEATURES) of the features of every function on a flight."""
        result = np.zeros((len(self._features), FEATURES, FEATURES))
        if self._features:
            inputs = self._inputs(flight)
            for k, (name, features) in enumerate(self._features.items()):
                x = features(inputs[name][flight.usable])
                result[k] = x.T @ x * flight.dt / CORRELATION_TIME
        return result

    def gain(self, gram: np.ndarray) -> float:
        """Return the information gain about the functions [nat per feature], their mean; 0 for none."""
        if not self._features:
            return 0.0
        # Bayesian linear regression with weights ~ N(0, 1):  I = 1/2 log det(1 + Phi' Phi)
        return float(0.5 * np.linalg.slogdet(np.eye(FEATURES) + gram)[1].mean() / FEATURES)
