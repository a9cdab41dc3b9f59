"""What one action costs: counted, and estimated for the processor of a Crazyflie.

The estimate counts the instructions of the loops as arm-none-eabi-gcc 12 -Os compiles them for a Cortex-M4F,
each with the cycles of Arm's reference manual (DDI 0439D, tables 3-1 and 7-1). It is no measurement on a
vehicle, where interrupts and other tasks take their share.

One product of `dense`, of four at once: half a cycle for x (vldmia, 2), 2 for the weight (vldr), 3 for the
product and sum (vfma), 1 to 1.5 for counting and branching (4 to 6): 6.5 to 7. Where the weight is waited
for, 1 more; and at 168 MHz a line of four weights comes from flash after five wait states, 1.25 cycles each,
where nothing is prefetched: 9.25 at most.

One tanh of `activate`: 3 divisions of 14, 6 fused sums of 3, 29 other cycles, 89 with a branch of three; with
nothing waited for, 80.
"""

from __future__ import annotations

from inclined_landing.eval.export.network import Network

CLOCK = 168e6  # Hz, of the STM32F405 in a Crazyflie 2.1
_PRODUCT = (6.5, 9.25)  # cycles, at least and at most
_TANH = (80.0, 90.0)
_RELU = (8.0, 12.0)
_INPUT = (20.0, 30.0)  # division by the scale, clip, check: 14 and some
_TANH_OPERATIONS = 19  # additions, multiplications and divisions of one tanh


def estimate(network: Network) -> dict:
    """Return operation counts and time estimates of one action, for the contract."""
    low, high = (1e6 * cycles / CLOCK for cycles in cycle_bounds(network))
    return {
        "constants": network.numbers,
        "multiply_adds": network.multiply_adds,
        "activations": network.activations,
        "floating_point_operations": operations(network),
        "stm32f405_estimate_us": [round(low), round(high)],
    }


def operations(network: Network) -> int:
    """Return the floating-point operations of one action: two per product, and those of scaling and
    activation.
    """
    each = _TANH_OPERATIONS if network.activation == "Tanh" else 1
    hidden = sum(network.sizes[:-1])
    last = _TANH_OPERATIONS * network.sizes[-1] * network.squashed
    return 2 * network.multiply_adds + 2 * network.inputs + each * hidden + last


def cycle_bounds(network: Network) -> tuple[float, float]:
    """Return lower and upper bounds of the Cortex-M4F cycles for one action; see the module's docstring."""
    hidden, last = sum(network.sizes[:-1]), network.sizes[-1] * network.squashed
    activation = _TANH if network.activation == "Tanh" else _RELU
    low, high = (
        product * network.multiply_adds + each * hidden + tanh * last + scaled * network.inputs
        for product, each, tanh, scaled in zip(_PRODUCT, activation, _TANH, _INPUT)
    )
    return low, high
