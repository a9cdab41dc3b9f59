"""The float32 network of a policy that every export contains, and the cost of one action.

The estimated times count the instructions of the loops of the C export as arm-none-eabi-gcc 12 -Os compiles
them for a Cortex-M4F, each with the cycles of Arm's reference manual (DDI 0439D, tables 3-1 and 7-1). They
were not measured on a vehicle, where interrupts and other tasks also take time.

One product of `dense`, of four at once: half a cycle for x (vldmia, 2), 2 for the weight (vldr), 3 for the
product and sum (vfma), 1 to 1.5 for counting and branching (4 to 6): 6.5 to 7. Waiting for the weight adds up
to 1; and at 168 MHz a line of four weights comes from flash after five wait states, 1.25 cycles each, if
nothing is prefetched: 9.25 at most.

One tanh of `activate`: 3 divisions of 14, 6 fused sums of 3, 29 other cycles, 89 with a branch of three;
without waiting, 80.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from inclined_landing.envs.policy import Policy
from inclined_landing.models.base.errors import UserError

_SMALLEST = float(np.finfo(np.float32).tiny)
_CLOCK = 168e6  # Hz, of the STM32F405 in a Crazyflie 2.1
_PRODUCT = (6.5, 9.25)  # cycles, at least and at most
_TANH = (80.0, 90.0)
_RELU = (8.0, 12.0)
_INPUT = (20.0, 30.0)  # division by the scale, clip, check: 14 and some
_TANH_OPERATIONS = 19  # additions, multiplications and divisions of one tanh


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

    def cost(self) -> dict:
        """Return the cost of one action for the contract: operation counts and estimated times."""
        products = sum(w.size for w in self.weights)
        hidden, last = sum(self.sizes[:-1]), self.sizes[-1] * self.squashed
        tanh = self.activation == "Tanh"
        low, high = (
            product * products + each * hidden + end * last + scaled * self.inputs
            for product, each, end, scaled in zip(_PRODUCT, _TANH if tanh else _RELU, _TANH, _INPUT)
        )
        operations = 2 * (products + self.inputs) + _TANH_OPERATIONS * last
        return {
            "constants": self.numbers,
            "multiply_adds": products,
            "activations": hidden + last,
            "floating_point_operations": operations + (_TANH_OPERATIONS if tanh else 1) * hidden,
            "stm32f405_estimate_us": [round(1e6 * cycles / _CLOCK) for cycles in (low, high)],
        }
