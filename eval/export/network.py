"""The network of a policy in float32, as every export holds it."""

from __future__ import annotations

import dataclasses

import numpy as np

from inclined_landing.envs.policy import Policy
from inclined_landing.models.errors import UserError

_SMALLEST = float(np.finfo(np.float32).tiny)


@dataclasses.dataclass(frozen=True)
class Network:
    """A chain of dense layers with clipped inputs and outputs; all arrays float32.

    x = clip((input - centre) / scale, -limit, limit), then through the layers with the activation between
    them; at the end, where `squashed`, tanh(clip(x, -bound, bound)); always clip(x, -1, 1).
    """

    centre: np.ndarray  # (i,)
    scale: np.ndarray  # (i,)
    limit: float  # inf: not clipped
    weights: tuple[np.ndarray, ...]  # (inputs, outputs) of each layer
    biases: tuple[np.ndarray, ...]  # (outputs,)
    activation: str  # "Tanh" or "ReLU"
    squashed: bool
    bound: float  # inf: not clipped

    @classmethod
    def from_policy(cls, policy: Policy) -> Network:
        """Return the network of a policy. Raises UserError where float32 cannot hold its numbers."""
        scale = policy.scale.astype(np.float32)
        if not (scale >= _SMALLEST).all() or not np.isfinite(scale).all():
            raise UserError(
                f"policy {policy.path} divides observations by a scale that float32 does not hold"
            )
        return cls(
            centre=policy.centre.astype(np.float32),
            scale=scale,
            limit=policy.limit,
            weights=tuple(w.astype(np.float32) for w in policy.weights),
            biases=tuple(b.astype(np.float32) for b in policy.biases),
            activation=policy.activation,
            squashed=policy.squashed,
            bound=policy.bound,
        )

    @property
    def inputs(self) -> int:
        """Number of inputs."""
        return len(self.centre)

    @property
    def sizes(self) -> list[int]:
        """Number of outputs of each layer."""
        return [len(b) for b in self.biases]

    @property
    def numbers(self) -> int:
        """Number of constants, four bytes each."""
        return 2 * self.inputs + sum(w.size + b.size for w, b in zip(self.weights, self.biases))

    @property
    def multiply_adds(self) -> int:
        """Number of multiply-adds for one action."""
        return sum(w.size for w in self.weights)

    @property
    def activations(self) -> int:
        """Number of activation functions evaluated for one action, a final tanh included."""
        return sum(self.sizes[:-1]) + self.squashed * self.sizes[-1]
