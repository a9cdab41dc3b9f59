"""How broadly a flight excites what an unexplained remainder depends on.

The quantities are those of the search for remainders. A smooth unknown function of one is a sum of random
features; a flight tells the more of it the more its features vary: half the log determinant of their scalar
products.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from sklearn.kernel_approximation import RBFSampler
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from inclined_landing.eval.gap.flights.windows import MeasuredFlight, prepare
from inclined_landing.eval.gap.plan import pieces
from inclined_landing.eval.gap.plan.pieces import Space
from inclined_landing.eval.gap.plan.setpoints import setpoints
from inclined_landing.eval.gap.search.residual import regressors
from inclined_landing.models.errors import UserError, shown

FEATURES = 16  # of a function
APART = 0.3  # s after which a disturbance is another one


class RegressorCoverage:
    """Unknown functions of some quantities (names of groups or inputs of `regressors`); none of no names.

    Raises UserError for a name that is not known.
    """

    def __init__(self, names: Sequence[str], space: Space, noise: np.ndarray):
        path = pieces.joined_path([pieces.midpoint(k) for k in pieces.kinds(space)], space)
        usual = prepare(setpoints(path, space.vehicle).log("usual", noise), space.vehicle)
        known = self._inputs(usual)
        unknown = [name for name in names if name not in known]
        if unknown:
            raise UserError(f"no quantity is called {shown(repr(unknown[0]))}; known are {', '.join(known)}")
        self.names = tuple(dict.fromkeys(names))
        self._features = {}
        for name in self.names:
            random = RBFSampler(gamma=0.5 / known[name].shape[1], n_components=FEATURES, random_state=0)
            self._features[name] = make_pipeline(StandardScaler(), random).fit(known[name])

    @staticmethod
    def _inputs(flight: MeasuredFlight) -> dict[str, np.ndarray]:
        """Values (m, k) of every group of quantities, and of every single one."""
        groups = regressors([flight])
        whole = {name: arrays[0] for name, (_, arrays) in groups.items()}
        single = {
            one: arrays[0][:, inputs.index(one), None] for inputs, arrays in groups.values() for one in inputs
        }
        return single | whole

    def gram(self, flight: MeasuredFlight) -> np.ndarray:
        """Scalar products (g, FEATURES, FEATURES) of the features of every function on a flight."""
        result = np.zeros((len(self.names), FEATURES, FEATURES))
        if self.names:
            inputs = self._inputs(flight)
            for k, name in enumerate(self.names):
                x = self._features[name].transform(inputs[name][flight.usable])
                result[k] = x.T @ x * flight.dt / APART
        return result

    def gain(self, gram: np.ndarray) -> float:
        """What is told of the functions [nat], the mean over all of them; 0 where there is none."""
        if not self.names:
            return 0.0
        return float(0.5 * np.linalg.slogdet(np.eye(FEATURES) + gram)[1].mean() / FEATURES)
