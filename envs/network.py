"""A dense network evaluated in float64 by a compiled loop: actions of many observations.

Rows are computed one after the other, so that an action does not depend on the other rows.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from inclined_landing.models.compiled import formula, inlined, kernel

_TAYLOR = tuple(1.0 / math.factorial(k) for k in range(13))  # of exp, for |r| <= log(2)/2: 2e-16
_LOG_TWO = 6.93145751953125e-1, 1.42860682030941723212e-6  # as a sum, whose first part has 21 bits
_PER_LOG_TWO = 1.0 / math.log(2.0)
_LARGEST = 20.0  # where tanh is 1 in float64


class Network(NamedTuple):
    """The network of a policy, with the fields of `Policy`; any number of layers has the same type."""

    centre: np.ndarray
    scale: np.ndarray
    limit: float
    sizes: np.ndarray  # (layers + 1,) inputs, and outputs of every layer
    weights: np.ndarray  # of all layers, one after the other
    biases: np.ndarray
    activation: int  # index into ACTIVATIONS
    squashed: bool
    bound: float


@formula
def tanh(x):
    """Return the hyperbolic tangent to 3e-16 without branches or calls, so that loops over it vectorise."""
    # tanh|x| = 1 - 2/(e^t + 1), t = 2|x|; e^t = 2^n e^r with n the nearest integer to t/log 2
    t = 2.0 * abs(x)
    t = 2.0 * _LARGEST if t > 2.0 * _LARGEST else t  # NaN passes
    n = np.int32(t * _PER_LOG_TWO + 0.5)
    r = (t - n * _LOG_TWO[0]) - n * _LOG_TWO[1]
    c = _TAYLOR
    p = ((((c[12] * r + c[11]) * r + c[10]) * r + c[9]) * r + c[8]) * r + c[7]
    p = ((((p * r + c[6]) * r + c[5]) * r + c[4]) * r + c[3]) * r + c[2]
    p = (p * r + c[1]) * r + c[0]
    return math.copysign(1.0 - 2.0 / (p * np.int64((np.int64(n) + 1023) << 52).view(np.float64) + 1.0), x)


@inlined
def _row(network, x, y):
    """Return the array with the outputs of all layers for the scaled inputs x (widest,); y is a buffer."""
    sizes, activation, first, end = network.sizes, network.activation, 0, 0
    for k in range(len(sizes) - 1):
        inputs, outputs = sizes[k], sizes[k + 1]
        w = network.weights[first : first + inputs * outputs].reshape(inputs, outputs)
        for j in range(outputs):
            y[j] = network.biases[end + j]
        first, end = first + inputs * outputs, end + outputs
        for i in range(inputs):
            for j in range(outputs):
                y[j] += x[i] * w[i, j]
        if k < len(sizes) - 2:
            for j in range(outputs):
                y[j] = tanh(y[j]) if activation == 0 else max(y[j], 0.0)
        x, y = y, x
    return x


@kernel
def forward(rows, network):
    """Return the actions (n, a) float32 of observations (n, o)."""
    # x_0 = clip((o - centre)/scale), x_k+1 = activation(W_k x_k + b_k), the last layer without
    centre, scale, limit, sizes, _, _, _, squashed, bound = network
    result = np.empty((len(rows), sizes[-1]), np.float32)
    x, y = np.empty(sizes.max()), np.empty(sizes.max())
    for row in range(len(rows)):
        for i in range(len(centre)):
            x[i] = min(limit, max(-limit, (rows[row, i] - centre[i]) / scale[i]))
        outputs = _row(network, x, y)
        for j in range(sizes[-1]):
            a = outputs[j]
            if squashed:
                a = math.tanh(min(bound, max(-bound, a)))
            result[row, j] = min(1.0, max(-1.0, a))
    return result
