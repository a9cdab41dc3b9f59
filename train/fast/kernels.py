"""Dense tanh networks compiled: forward, backward, PPO's loss and Adam, in blocks of samples.

A network is one vector of float32 weights, layer by layer (outputs, inputs) and then the bias, as torch has
them, and the widths of its layers; an actor's ends with the logarithm of its standard deviations. Activations
stand in blocks (width, BLOCK), samples last, so that every inner loop runs over a fixed number of neighbours.
Indices are unsigned, or the compiler would ask for negative ones before each access.

The loss is that of Stable-Baselines3: Schulman et al., Proximal Policy Optimization Algorithms, 2017, with
advantages normalised in each minibatch, a global limit of the gradient's norm, and Kingma and Ba's Adam.

Symbols of the comments: policy pi with parameters theta, observation o, action a, advantage A, return R,
value V, reward r, discount gamma.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

BLOCK = 128  # samples in a block; 128 rows of 128 float32 are the first-level cache twice
STATISTICS = ("policy_loss", "value_loss", "entropy", "kl", "clipped")  # of a minibatch
_B = np.uint64(BLOCK)
_0, _1, _2, _3, _4 = (np.uint64(k) for k in range(5))
_HALF_LOG_TWO_PI = 0.5 * math.log(2 * math.pi)
NOBODY = 2**62  # in the counter: no thread is to be waited for
_SPINS = 4000  # looks at the other core before it may work for somebody else

# tanh(x) = x P(x^2) / Q(x^2) for |x| <= 8: relative error 6.5e-9 before rounding, 3.1e-7 in float32; from
# reweighted least squares at Chebyshev nodes; coefficients of the powers from 0. At 8 tanh is 1 - 2.3e-7.
_LIMIT = np.float32(8.0)
_P = tuple(map(np.float32, (0.9999999936, 0.1344453831, 3.571645855e-3, 2.189544937e-5, 1.523151571e-8)))
_Q = tuple(map(np.float32, (1.0, 0.4677786566, 2.616462504e-2, 3.411370214e-4, 8.522894192e-7)))

# Sums may be reordered (no `nnan`: what is not finite stays so); division by zero is IEEE's.
_OPTIONS = {"cache": True, "fastmath": {"reassoc", "contract", "nsz"}, "error_model": "numpy", "nogil": True}
_compiled = numba.njit(**_OPTIONS)
# Everything that Python does not call is inlined. Else the process that compiles and one that loads from
# numba's cache link different copies of it, whose sums are in another order: other bits, another training.
_inlined = numba.njit(**_OPTIONS, forceinline=True)


class Network(NamedTuple):
    """A network to be evaluated."""

    weights: np.ndarray  # (w,) float32
    widths: np.ndarray  # (layers + 1,) uint64
    activations: np.ndarray  # memory for one block of all layers' activations


class Learner(NamedTuple):
    """A network that learns."""

    weights: np.ndarray  # (w,) float32
    widths: np.ndarray  # (layers + 1,) uint64
    moments: np.ndarray  # (2, w) float32, Adam's
    steps: np.ndarray  # (1,) float64, Adam's until now
    activations: np.ndarray  # memory for one block of all layers' activations
    derivatives: np.ndarray  # of the loss by them
    gradient: np.ndarray  # (w,)


class Scaling(NamedTuple):
    """How observations o are scaled: clip((o - centre)/scale, -limit, limit)."""

    centre: np.ndarray  # (o,) float32
    scale: np.ndarray  # (o,) float32
    limit: np.float32


class Bounds(NamedTuple):
    """Of the actions."""

    low: np.ndarray  # (a,) float32
    high: np.ndarray  # (a,) float32


class Drawn(NamedTuple):
    """Actions of n environments."""

    actions: np.ndarray  # (n, a) float32
    clipped: np.ndarray  # (n, a) within the bounds
    log_prob: np.ndarray  # (n,)


class Rollout(NamedTuple):
    """The samples of an update, float32."""

    observations: np.ndarray  # (N, o)
    actions: np.ndarray  # (N, a)
    log_probs: np.ndarray  # (N,) of the policy that drew them
    advantages: np.ndarray  # (N,)
    returns: np.ndarray  # (N,)


class Settings(NamedTuple):
    """Of an update."""

    batch: np.uint64  # samples in a minibatch
    actor_learns: bool
    clip: float  # epsilon of the clipped surrogate
    entropy: float  # weight of the entropy in the loss
    values: float  # weight of the values' error in the loss
    largest_norm: float  # of the gradient
    rate: float  # Adam's, and its other constants
    beta1: float
    beta2: float
    epsilon: float


class _Matrix(NamedTuple):
    """A matrix within a vector of weights: entry (j, i) is weights[first + j by_row + i by_column]."""

    weights: np.ndarray
    first: np.uint64
    by_row: np.uint64
    by_column: np.uint64
    rows: np.uint64
    columns: np.uint64


@_inlined
def _multiply(matrix, a, from_row, z, to_row):
    """Add to z, from a row on, the product of the matrix and the rows of a from a row on."""
    # z_j += sum_i w_ji a_i
    w, first, by_row, by_column, rows, columns = matrix
    j = _0
    while j + _4 <= rows:
        z0 = (to_row + j) * _B
        z1, z2, z3 = z0 + _B, z0 + _2 * _B, z0 + _3 * _B
        i = _0
        while i + _4 <= columns:
            p = first + j * by_row + i * by_column
            c0, c1, c2, c3 = _0, by_column, _2 * by_column, _3 * by_column
            w00, w01, w02, w03 = w[p + c0], w[p + c1], w[p + c2], w[p + c3]
            p += by_row
            w10, w11, w12, w13 = w[p + c0], w[p + c1], w[p + c2], w[p + c3]
            p += by_row
            w20, w21, w22, w23 = w[p + c0], w[p + c1], w[p + c2], w[p + c3]
            p += by_row
            w30, w31, w32, w33 = w[p + c0], w[p + c1], w[p + c2], w[p + c3]
            a0 = (from_row + i) * _B
            a1, a2, a3 = a0 + _B, a0 + _2 * _B, a0 + _3 * _B
            for s in range(_B):
                x0, x1, x2, x3 = a[a0 + s], a[a1 + s], a[a2 + s], a[a3 + s]
                z[z0 + s] += w00 * x0 + w01 * x1 + w02 * x2 + w03 * x3
                z[z1 + s] += w10 * x0 + w11 * x1 + w12 * x2 + w13 * x3
                z[z2 + s] += w20 * x0 + w21 * x1 + w22 * x2 + w23 * x3
                z[z3 + s] += w30 * x0 + w31 * x1 + w32 * x2 + w33 * x3
            i += _4
        while i < columns:
            p, a0 = first + j * by_row + i * by_column, (from_row + i) * _B
            w0, w1, w2, w3 = w[p], w[p + by_row], w[p + _2 * by_row], w[p + _3 * by_row]
            for s in range(_B):
                x = a[a0 + s]
                z[z0 + s] += w0 * x
                z[z1 + s] += w1 * x
                z[z2 + s] += w2 * x
                z[z3 + s] += w3 * x
            i += _1
        j += _4
    while j < rows:
        z0 = (to_row + j) * _B
        for i in range(columns):
            weight, a0 = w[first + j * by_row + i * by_column], (from_row + i) * _B
            for s in range(_B):
                z[z0 + s] += weight * a[a0 + s]
        j += _1


@_inlined
def _dot(d, d0, a, a0):
    """Return the product of two rows of blocks, summed over the samples."""
    total = np.float32(0)
    for s in range(_B):
        total += d[d0 + s] * a[a0 + s]
    return total


@_inlined
def _outer(d, a, row, rows, from_row, columns, g, first):
    """Add the outer product of rows of d and a, summed over samples, to the gradient g from `first` on."""
    # g_ji += sum_s d_j a_i
    zero = np.float32(0)
    j = _0
    while j + _4 <= rows:
        d0 = (row + j) * _B
        d1, d2, d3 = d0 + _B, d0 + _2 * _B, d0 + _3 * _B
        i = _0
        while i + _4 <= columns:
            a0 = (from_row + i) * _B
            a1, a2, a3 = a0 + _B, a0 + _2 * _B, a0 + _3 * _B
            g00 = g01 = g02 = g03 = g10 = g11 = g12 = g13 = zero
            g20 = g21 = g22 = g23 = g30 = g31 = g32 = g33 = zero
            for s in range(_B):
                x0, x1, x2, x3 = a[a0 + s], a[a1 + s], a[a2 + s], a[a3 + s]
                y0, y1, y2, y3 = d[d0 + s], d[d1 + s], d[d2 + s], d[d3 + s]
                g00, g01, g02, g03 = g00 + y0 * x0, g01 + y0 * x1, g02 + y0 * x2, g03 + y0 * x3
                g10, g11, g12, g13 = g10 + y1 * x0, g11 + y1 * x1, g12 + y1 * x2, g13 + y1 * x3
                g20, g21, g22, g23 = g20 + y2 * x0, g21 + y2 * x1, g22 + y2 * x2, g23 + y2 * x3
                g30, g31, g32, g33 = g30 + y3 * x0, g31 + y3 * x1, g32 + y3 * x2, g33 + y3 * x3
            p = first + j * columns + i
            g[p] += g00
            g[p + _1] += g01
            g[p + _2] += g02
            g[p + _3] += g03
            p += columns
            g[p] += g10
            g[p + _1] += g11
            g[p + _2] += g12
            g[p + _3] += g13
            p += columns
            g[p] += g20
            g[p + _1] += g21
            g[p + _2] += g22
            g[p + _3] += g23
            p += columns
            g[p] += g30
            g[p + _1] += g31
            g[p + _2] += g32
            g[p + _3] += g33
            i += _4
        while i < columns:
            p, a0 = first + j * columns + i, (from_row + i) * _B
            g[p] += _dot(d, d0, a, a0)
            g[p + columns] += _dot(d, d1, a, a0)
            g[p + _2 * columns] += _dot(d, d2, a, a0)
            g[p + _3 * columns] += _dot(d, d3, a, a0)
            i += _1
        j += _4
    while j < rows:
        for i in range(columns):
            g[first + j * columns + i] += _dot(d, (row + j) * _B, a, (from_row + i) * _B)
        j += _1


@_inlined
def _tanh(z, first, count):
    """Take the hyperbolic tangent of `count` numbers in place."""
    for k in range(first, first + count):
        x = z[k]
        # tanh(x) = x P(x^2)/Q(x^2)
        x = -_LIMIT if x < -_LIMIT else x  # NaN passes both
        x = _LIMIT if x > _LIMIT else x
        y = x * x
        p = (((_P[4] * y + _P[3]) * y + _P[2]) * y + _P[1]) * y + _P[0]
        q = (((_Q[4] * y + _Q[3]) * y + _Q[2]) * y + _Q[1]) * y + _Q[0]
        z[k] = x * p / q


@_inlined
def _load(inputs, rows, first, count, scaling, a):
    """Write the scaled inputs (N, o) of `count` samples rows[first:] as a block into a; the rest of it 0."""
    centre, scale, limit = scaling
    for i in range(np.uint64(len(centre))):
        for s in range(_B):
            a[i * _B + s] = np.float32(0)
        for s in range(count):
            x = (inputs[rows[first + s], i] - centre[i]) / scale[i]
            x = -limit if x < -limit else x
            a[i * _B + s] = limit if x > limit else x


@_inlined
def _forward(w, widths, a):
    """Write the activations of every layer behind the inputs in a; return the row where the outputs begin."""
    # a_l+1 = tanh(W_l a_l + b_l), the last layer without tanh
    row, first = _0, _0
    last = np.uint64(len(widths)) - _2
    for layer in range(last + _1):
        columns, rows = widths[layer], widths[layer + _1]
        to_row, bias = row + columns, first + rows * columns
        for j in range(rows):
            for s in range(_B):
                a[(to_row + j) * _B + s] = w[bias + j]
        _multiply(_Matrix(w, first, columns, _1, rows, columns), a, row, a, to_row)
        if layer < last:
            _tanh(a, to_row * _B, rows * _B)
        row, first = to_row, bias + rows
    return row


@_inlined
def _backward(w, widths, a, d, row, g):
    """Add the gradient by the weights to g, from the loss's derivative by the outputs in d from `row` on."""
    # dL/dW_l = d_l+1 a_l^T, dL/db_l = d_l+1, d_l = (W_l^T d_l+1) (1 - a_l^2)
    first = _0
    layers = np.uint64(len(widths)) - _1
    for layer in range(layers):
        first += (widths[layer] + _1) * widths[layer + _1]
    for back in range(layers):
        layer = layers - _1 - back
        columns, rows = widths[layer], widths[layer + _1]
        bias = first - rows
        first = bias - rows * columns
        from_row = row - columns
        _outer(d, a, row, rows, from_row, columns, g, first)
        for j in range(rows):
            total = np.float32(0)
            for s in range(_B):
                total += d[(row + j) * _B + s]
            g[bias + j] += total
        if layer > _0:
            begin, end = from_row * _B, row * _B
            for k in range(begin, end):
                d[k] = np.float32(0)
            transposed = _Matrix(w, first, _1, columns, columns, rows)
            _multiply(transposed, d, row, d, from_row)
            for k in range(begin, end):
                d[k] *= np.float32(1) - a[k] * a[k]
        row = from_row


@_inlined
def _log_density(deviation, log_std):
    """Return the log density of a normal distribution at a deviation in standard deviations."""
    # log N(a; mu, sigma) = -x^2/2 - log sigma - log(2 pi)/2, x = (a - mu)/sigma
    return np.float32(-0.5) * deviation * deviation - log_std - np.float32(_HALF_LOG_TWO_PI)


@_compiled
def act(network, scaling, observations, noise, bounds, drawn):
    """Draw actions for observations (n, o) with standard normal `noise` (n, a), into `drawn`."""
    w, widths, a = network
    n, size = np.uint64(len(observations)), widths[-1]
    log_std = np.uint64(len(w)) - size
    std = np.exp(w[log_std:])
    rows = np.arange(len(observations)).astype(np.uint64)
    for first in range(_0, n, _B):
        count = min(_B, n - first)
        _load(observations, rows, first, count, scaling, a)
        out = _forward(w, widths, a)
        for s in range(count):
            total = np.float32(0)
            for k in range(size):
                mean = a[(out + k) * _B + s]
                # a = mu(o) + sigma noise
                action = mean + std[k] * noise[first + s, k]
                total += _log_density((action - mean) / std[k], w[log_std + k])
                drawn.actions[first + s, k] = action
                action = bounds.low[k] if action < bounds.low[k] else action
                drawn.clipped[first + s, k] = bounds.high[k] if action > bounds.high[k] else action
            drawn.log_prob[first + s] = total


@_compiled
def evaluate(network, scaling, observations, values):
    """Write the critic's values (n,) of observations (n, o)."""
    w, widths, a = network
    n = np.uint64(len(observations))
    rows = np.arange(len(observations)).astype(np.uint64)
    for first in range(_0, n, _B):
        count = min(_B, n - first)
        _load(observations, rows, first, count, scaling, a)
        out = _forward(w, widths, a)
        for s in range(count):
            values[first + s] = a[out * _B + s]


@numba.njit(cache=True, nogil=True)
def advantages(rewards, values, starts, last_values, last_dones, gamma, gae_lambda, result):
    """Write the generalised advantage estimates (t, n), in float32 and in the order of SB3's buffer."""
    steps, n = rewards.shape
    gamma32, both = np.float32(gamma), np.float32(gamma * gae_lambda)
    for i in range(n):
        going = np.float32(1) - np.float32(last_dones[i])
        value, total = last_values[i], np.float32(0)
        for t in range(steps - 1, -1, -1):
            # delta_t = r_t + gamma V_t+1 - V_t, A_t = delta_t + gamma lambda A_t+1, within an episode
            delta = rewards[t, i] + gamma32 * value * going - values[t, i]
            total = delta + both * going * total
            result[t, i] = total
            going, value = np.float32(1) - starts[t, i], values[t, i]


@_inlined
def _actor_gradient(actor, rollout, rows, first, last, scaling, settings, statistics):
    """Write the gradient of the clipped surrogate and the entropy over rows[first:last], and STATISTICS."""
    w, widths, _, _, a, d, g = actor
    observations, actions, before, gains, _ = rollout
    clip, entropy, learns = np.float32(settings.clip), np.float32(settings.entropy), settings.actor_learns
    size, samples = widths[-1], last - first
    log_std = np.uint64(len(w)) - size
    g[:] = 0
    mean, squares = 0.0, 0.0
    for k in range(first, last):
        mean += gains[rows[k]]
    mean /= samples
    for k in range(first, last):
        squares += (gains[rows[k]] - mean) ** 2
    std = math.sqrt(squares / (samples - _1))
    loss, kl, clipped = 0.0, 0.0, 0.0
    low, high = np.float32(1) - clip, np.float32(1) + clip
    per_std, deviations = np.float32(1) / np.exp(w[log_std:]), np.empty(size, np.float32)
    for begin in range(first, last, _B):
        count = min(_B, last - begin)
        _load(observations, rows, begin, count, scaling, a)
        out = _forward(w, widths, a)
        for k in range(out * _B, (out + size) * _B):
            d[k] = np.float32(0)
        for s in range(count):
            row = rows[begin + s]
            density = np.float32(0)
            for k in range(size):
                deviations[k] = (actions[row, k] - a[(out + k) * _B + s]) * per_std[k]
                density += _log_density(deviations[k], w[log_std + k])
            # A <- (A - mean A)/(std A + 1e-8); ratio = pi(a|o)/pi_old(a|o)
            # L = -min(ratio A, clip(ratio, 1 - eps, 1 + eps) A); KL ~ (ratio - 1) - log ratio
            gain = np.float32((gains[row] - np.float32(mean)) / (np.float32(std) + np.float32(1e-8)))
            log_ratio = density - before[row]
            ratio = np.exp(log_ratio)
            limited = low if ratio < low else ratio
            limited = high if limited > high else limited
            flat = gain * limited < gain * ratio  # the limit takes the gradient away
            loss -= gain * limited if flat else gain * ratio
            kl += (ratio - np.float32(1)) - log_ratio
            clipped += abs(ratio - np.float32(1)) > clip
            # dL/dlog pi = -ratio A/N; dlog pi/dmu = x/sigma, dlog pi/dlog sigma = x^2 - 1
            slope = np.float32(0) if flat else -gain * ratio / np.float32(samples)
            for k in range(size):
                d[(out + k) * _B + s] = slope * deviations[k] * per_std[k]
                g[log_std + k] += slope * (deviations[k] * deviations[k] - np.float32(1))
        if learns:
            _backward(w, widths, a, d, out, g)
    # Entropy of the normal distribution: H = sum(1/2 + log(2 pi)/2 + log sigma)
    total = 0.0
    for k in range(size):
        g[log_std + k] -= entropy
        total += 0.5 + _HALF_LOG_TWO_PI + w[log_std + k]
    statistics[0], statistics[2] = loss / samples, -total
    statistics[3], statistics[4] = kl / samples, clipped / samples


@_inlined
def _critic_gradient(critic, rollout, rows, first, last, scaling, settings, statistics):
    """Write the gradient of the weighted mean square error of the values over rows[first:last], and that."""
    # L = weight mean((V - R)^2)
    w, widths, _, _, a, d, g = critic
    observations, _, _, _, returns = rollout
    weight = np.float32(settings.values)
    samples = last - first
    g[:] = 0
    loss = 0.0
    for begin in range(first, last, _B):
        count = min(_B, last - begin)
        _load(observations, rows, begin, count, scaling, a)
        out = _forward(w, widths, a)
        for s in range(_B):
            d[out * _B + s] = np.float32(0)
        for s in range(count):
            error = a[out * _B + s] - returns[rows[begin + s]]
            loss += error * error
            d[out * _B + s] = weight * np.float32(2) * error / np.float32(samples)
        _backward(w, widths, a, d, out, g)
    statistics[1] = loss / samples


@_inlined
def _square(g):
    """Return the square of the norm of g."""
    total = 0.0
    for k in range(np.uint64(len(g))):
        total += g[k] * g[k]
    return total


@_inlined
def _adam(learner, share, settings):
    """Take one step of Adam with `share` of the gradient."""
    # g <- share dL/dw, m <- b1 m + (1 - b1) g, v <- b2 v + (1 - b2) g^2
    # w <- w - rate/(1 - b1^t) m/(sqrt(v)/sqrt(1 - b2^t) + epsilon)
    w, g, mean, square = learner.weights, learner.gradient, learner.moments[0], learner.moments[1]
    learner.steps[0] += 1
    step, rate, beta1, beta2 = learner.steps[0], settings.rate, settings.beta1, settings.beta2
    size = np.float32(rate / (1.0 - beta1**step))
    root = np.float32(math.sqrt(1.0 - beta2**step))
    b1, b2, small = np.float32(1.0 - beta1), np.float32(beta2), np.float32(settings.epsilon)
    rest = np.float32(1.0 - beta2)
    for k in range(np.uint64(len(w))):
        slope = g[k] * share
        mean[k] += b1 * (slope - mean[k])
        square[k] = b2 * square[k] + rest * slope * slope
        w[k] -= size * mean[k] / (np.sqrt(square[k]) / root + small)


@intrinsic
def _arrive(typing, counter):
    """Add one to counter[0] atomically."""

    def generate(context, builder, signature, arguments):
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        builder.atomic_rmw("add", array.data, ir.Constant(ir.IntType(64), 1), "seq_cst")
        return context.get_dummy_value()

    return types.void(counter), generate


@intrinsic
def _arrived(typing, counter):
    """Return counter[0] as all cores see it."""

    def generate(context, builder, signature, arguments):
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        return builder.load_atomic(array.data, "seq_cst", 8)

    return types.int64(counter), generate


@intrinsic
def _yield(typing):
    """Let another thread have the core."""

    def generate(context, builder, signature, arguments):
        kind = ir.FunctionType(ir.IntType(32), [])
        builder.call(cgutils.get_or_insert_function(builder.module, kind, "sched_yield"), [])
        return context.get_dummy_value()

    return types.void(), generate


@_inlined
def _meet(counter, arrivals):
    """Wait until counter[0] is `arrivals`, which this thread adds one to."""
    _arrive(counter)
    spins = 0
    while _arrived(counter) < arrivals:
        spins += 1
        if spins > _SPINS:
            _yield()


@_compiled
def update(
    actor_part, critic_part, counter, norms, actor, critic, rollout, order, scaling, settings, statistics
):
    """Take the steps of every minibatch of every epoch, for the actor, the critic or both.

    Two threads may share it, one for each network: they meet once per minibatch, to add the squares of their
    gradients. Whichever way, the same numbers are computed in the same order.

    counter (1,) int64, 0 at first, NOBODY if the other thread has failed.
    norms (2, 2) float64, of even and odd minibatches.
    actor, critic: each a `Learner`.
    order: (epochs, N) uint64, which samples.
    statistics: (minibatches, 5) float64, STATISTICS.
    """
    samples = np.uint64(order.shape[1])
    k = 0
    for epoch in range(len(order)):
        rows = order[epoch]
        for first in range(_0, samples, settings.batch):
            last = min(first + settings.batch, samples)
            now = norms[k % 2]
            if actor_part:
                _actor_gradient(actor, rollout, rows, first, last, scaling, settings, statistics[k])
                now[0] = _square(actor.gradient) if settings.actor_learns else 0.0
            if critic_part:
                _critic_gradient(critic, rollout, rows, first, last, scaling, settings, statistics[k])
                now[1] = _square(critic.gradient)
            k += 1
            if not (actor_part and critic_part):
                _meet(counter, 2 * k)
            # share = min(1, largest norm/(|g| + 1e-6))
            share = settings.largest_norm / (math.sqrt(now[0] + now[1]) + 1e-6)
            share = np.float32(1.0 if share > 1.0 else share)
            if actor_part and settings.actor_learns:
                _adam(actor, share, settings)
            if critic_part:
                _adam(critic, share, settings)
