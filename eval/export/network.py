"""The float32 network of a policy that every export contains."""

from __future__ import annotations

import dataclasses

import numpy as np

from inclined_landing.envs.policy import Policy
from inclined_landing.models.base.errors import UserError

_SMALLEST = float(np.finfo(np.float32).tiny)


@dataclasses.dataclass(frozen=True)
class ExportNetwork:
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
    def from_policy(cls, policy: Policy) -> ExportNetwork:
        """Return the network of a policy. Raises UserError if float32 cannot represent its numbers."""
        scale = policy.scale.astype(np.float32)
        if not (scale >= _SMALLEST).all() or not np.isfinite(scale).all():
            raise UserError(f"policy {policy.path} has an observation scale beyond the range of float32")
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
