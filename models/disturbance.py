"""Random disturbance of the air for n vehicles.

Each world axis has an acceleration and each body axis an angular acceleration that is an
Ornstein-Uhlenbeck process: Gaussian, of a standard deviation and a correlation time, both entries of the
vehicle file's table `[disturbance]` (`landing-eval gap` estimates them from flights). The steps are exact for
any control period; a value is held for one period, and the axes of an angular one are those of the body at
the period's beginning. Both plants get the same numbers with the same seed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

from inclined_landing.models.attitude import PITCH, ROLL, YAW, rotation
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.models.compiled import kernel
from inclined_landing.models.vehicle import Vehicle

# A seed, or a generator that gives one.
Seed: TypeAlias = int | np.random.Generator


class Disturbance:
    """Random accelerations of n vehicles (n, 6): linear along the world axes, angular about the body axes.

    choice (n,): which of `vehicles` each one is; later changes of this array count.
    period: the control period [s]. seed: for all random numbers.
    Raises UserError for a negative seed.
    """

    def __init__(self, choice: np.ndarray, vehicles: Sequence[Vehicle], period: float, seed: Seed):
        n, self._choice = len(choice), choice
        self._bits: Any = None
        self._random: Any = None
        self.seed(seed)
        self._stream = np.zeros(4, np.uint64)
        size = np.array([(*v.disturbance_acceleration, *v.disturbance_angular) for v in vehicles])
        times = np.array([(*v.disturbance_acceleration_time, *v.disturbance_angular_time) for v in vehicles])
        keep = np.exp(-period / np.where(times > 0.0, times, np.inf))
        self._size, self._keep, self._fresh = size, keep, size * np.sqrt(1.0 - keep**2)
        self._inertia = np.array([v.body_inertia for v in vehicles])
        self.now = np.zeros((n, 6))  # m/s2 along the world's axes, rad/s2 about the body's
        self.held = np.zeros((n, 6))  # the value that `push` returns

    def seed(self, seed: Seed) -> None:
        """Restart everything drawn from now on."""
        if isinstance(seed, np.random.Generator):
            seed = int(seed.integers(2**63))
        if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
            raise UserError(
                "disturbance must be a seed, a whole number from 0, or a generator, "
                f"not {shown(repr(seed), 40)}"
            )
        self._bits = np.random.SFC64(int(seed))
        self._random = np.random.Generator(self._bits)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return everything that a replay needs; call `resume` after overwriting it."""
        self._stream[:] = self._bits.state["state"]["state"]
        return {"disturbance": self.now, "disturbance_stream": self._stream}

    def resume(self) -> None:
        """Continue with the random stream of `arrays`."""
        state = self._bits.state
        state["state"]["state"] = self._stream.copy()
        self._bits.state = state

    def reset(self, ids) -> None:
        """Restart from the stationary distribution for the vehicles `ids`."""
        size = self._size[self._choice[ids]]
        self.now[ids] = size * self._random.standard_normal(size.shape)

    def push(self, state: np.ndarray, torque: bool) -> np.ndarray:
        """Return the push applied from now on: acceleration [m/s2] and torque [N m] (n, 6) in the world's
        axes.

        state (n, 13); torque: whether it has an effect, else it is 0.
        """
        _push(self.now, state, self._inertia, self._choice, torque, self.held)
        return self.held

    def step(self, ids=slice(None)) -> None:
        """Advance the vehicles `ids` by one control period."""
        now, choice = self.now[ids], self._choice[ids]
        fresh = self._fresh[choice] * self._random.standard_normal(now.shape)
        self.now[ids] = self._keep[choice] * now + fresh


@kernel
def _push(now, state, inertia, choice, torque, out):
    for i in range(len(now)):
        for k in range(3):
            out[i, k], out[i, 3 + k] = now[i, k], 0.0
        if torque:
            r, diagonal = rotation(state[i, ROLL], state[i, PITCH], state[i, YAW]), inertia[choice[i]]
            for k in range(3):
                for j in range(3):
                    out[i, 3 + k] += r[k, j] * diagonal[j] * now[i, 3 + j]
