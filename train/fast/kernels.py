"""Dense tanh networks compiled: forward, backward, PPO's loss and Adam, in blocks of samples.

A network is one vector of float32 weights, layer by layer (outputs, inputs) and then the bias, as torch has
them, and the widths of its layers; an actor's ends with the logarithm of its standard deviations. Activations
stand in blocks (width, BLOCK), samples last, so that every inner loop runs over a fixed number of neighbours.
Indices are unsigned, or the compiler would ask for negative ones before each access.

The loss is that of Stable-Baselines3: Schulman et al., Proximal Policy Optimization Algorithms, 2017, with
advantages normalised in each minibatch, a global limit of the gradient's norm, and Kingma and Ba's Adam.
"""

from __future__ import annotations

import math

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


@_inlined
def _multiply(w, first, by_row, by_column, rows, columns, a, from_row, z, to_row):
    """z[j] += sum_i w[first + j by_row + i by_column] a[i]: rows of blocks a and z from the given rows on."""
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
    """The product of two rows of blocks, summed over the samples."""
    total = np.float32(0)
    for s in range(_B):
        total += d[d0 + s] * a[a0 + s]
    return total


@_inlined
def _outer(d, a, row, rows, from_row, columns, g, first):
    """g[first + j columns + i] += sum over samples of d[row + j] a[from_row + i]."""
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
    """Hyperbolic tangent in place of `count` numbers."""
    for k in range(first, first + count):
        x = z[k]
        x = -_LIMIT if x < -_LIMIT else x  # NaN passes both
        x = _LIMIT if x > _LIMIT else x
        y = x * x
        p = (((_P[4] * y + _P[3]) * y + _P[2]) * y + _P[1]) * y + _P[0]
        q = (((_Q[4] * y + _Q[3]) * y + _Q[2]) * y + _Q[1]) * y + _Q[0]
        z[k] = x * p / q


@_inlined
def _load(inputs, rows, first, count, centre, scale, limit, a):
    """The scaled inputs (N, o) of `count` samples rows[first:], as a block; the rest of it 0."""
    for i in range(np.uint64(len(centre))):
        for s in range(_B):
            a[i * _B + s] = np.float32(0)
        for s in range(count):
            x = (inputs[rows[first + s], i] - centre[i]) / scale[i]
            x = -limit if x < -limit else x
            a[i * _B + s] = limit if x > limit else x


@_inlined
def _forward(w, widths, a):
    """Activations of every layer after the block of inputs; returns the row at which the outputs begin."""
    row, first = _0, _0
    last = np.uint64(len(widths)) - _2
    for layer in range(last + _1):
        columns, rows = widths[layer], widths[layer + _1]
        to_row, bias = row + columns, first + rows * columns
        for j in range(rows):
            for s in range(_B):
                a[(to_row + j) * _B + s] = w[bias + j]
        _multiply(w, first, columns, _1, rows, columns, a, row, a, to_row)
        if layer < last:
            _tanh(a, to_row * _B, rows * _B)
        row, first = to_row, bias + rows
    return row


@_inlined
def _backward(w, widths, a, d, row, g):
    """Add to g what the loss's derivative by the outputs, d from `row` on, says of every weight."""
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
            _multiply(w, first, _1, columns, columns, rows, d, row, d, from_row)
            for k in range(begin, end):
                d[k] *= np.float32(1) - a[k] * a[k]
        row = from_row


@_inlined
def _log_density(deviation, log_std):
    """Of a normal distribution at a deviation in standard deviations."""
    return np.float32(-0.5) * deviation * deviation - log_std - np.float32(_HALF_LOG_TWO_PI)


@_compiled
def act(w, widths, centre, scale, limit, observations, noise, low, high, a, actions, clipped, log_prob):
    """Actions (n, a) drawn with standard normal `noise` (n, a), clipped ones, and log_prob (n,)."""
    n, size = np.uint64(len(observations)), widths[-1]
    log_std = np.uint64(len(w)) - size
    std = np.exp(w[log_std:])
    rows = np.arange(len(observations)).astype(np.uint64)
    for first in range(_0, n, _B):
        count = min(_B, n - first)
        _load(observations, rows, first, count, centre, scale, limit, a)
        out = _forward(w, widths, a)
        for s in range(count):
            total = np.float32(0)
            for k in range(size):
                mean = a[(out + k) * _B + s]
                action = mean + std[k] * noise[first + s, k]
                total += _log_density((action - mean) / std[k], w[log_std + k])
                actions[first + s, k] = action
                action = low[k] if action < low[k] else action
                clipped[first + s, k] = high[k] if action > high[k] else action
            log_prob[first + s] = total


@_compiled
def evaluate(w, widths, centre, scale, limit, observations, a, values):
    """The critic's values (n,) of observations (n, o)."""
    n = np.uint64(len(observations))
    rows = np.arange(len(observations)).astype(np.uint64)
    for first in range(_0, n, _B):
        count = min(_B, n - first)
        _load(observations, rows, first, count, centre, scale, limit, a)
        out = _forward(w, widths, a)
        for s in range(count):
            values[first + s] = a[out * _B + s]


@numba.njit(cache=True, nogil=True)
def advantages(rewards, values, starts, last_values, last_dones, gamma, gae_lambda, result):
    """Generalised advantage estimates (t, n); in float32 and in the order of SB3's `RolloutBuffer`."""
    steps, n = rewards.shape
    gamma32, both = np.float32(gamma), np.float32(gamma * gae_lambda)
    for i in range(n):
        going = np.float32(1) - np.float32(last_dones[i])
        value, total = last_values[i], np.float32(0)
        for t in range(steps - 1, -1, -1):
            delta = rewards[t, i] + gamma32 * value * going - values[t, i]
            total = delta + both * going * total
            result[t, i] = total
            going, value = np.float32(1) - starts[t, i], values[t, i]


@_inlined
def _actor_gradient(
    w, widths, data, rows, first, last, clip, entropy, learns, a, d, g, centre, scale, limit, said
):
    """g of the clipped loss and the entropy over rows[first:last]; `said` gets STATISTICS of them."""
    observations, actions, before, gains, _ = data
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
        _load(observations, rows, begin, count, centre, scale, limit, a)
        out = _forward(w, widths, a)
        for k in range(out * _B, (out + size) * _B):
            d[k] = np.float32(0)
        for s in range(count):
            row = rows[begin + s]
            density = np.float32(0)
            for k in range(size):
                deviations[k] = (actions[row, k] - a[(out + k) * _B + s]) * per_std[k]
                density += _log_density(deviations[k], w[log_std + k])
            gain = np.float32((gains[row] - np.float32(mean)) / (np.float32(std) + np.float32(1e-8)))
            log_ratio = density - before[row]
            ratio = np.exp(log_ratio)
            limited = low if ratio < low else ratio
            limited = high if limited > high else limited
            flat = gain * limited < gain * ratio  # the limit takes the gradient away
            loss -= gain * limited if flat else gain * ratio
            kl += (ratio - np.float32(1)) - log_ratio
            clipped += abs(ratio - np.float32(1)) > clip
            slope = np.float32(0) if flat else -gain * ratio / np.float32(samples)
            for k in range(size):
                d[(out + k) * _B + s] = slope * deviations[k] * per_std[k]
                g[log_std + k] += slope * (deviations[k] * deviations[k] - np.float32(1))
        if learns:
            _backward(w, widths, a, d, out, g)
    total = 0.0
    for k in range(size):
        g[log_std + k] -= entropy
        total += 0.5 + _HALF_LOG_TWO_PI + w[log_std + k]
    said[0], said[2], said[3], said[4] = loss / samples, -total, kl / samples, clipped / samples


@_inlined
def _critic_gradient(w, widths, data, rows, first, last, weight, a, d, g, centre, scale, limit, said):
    """g of `weight` times the mean square error of the values over rows[first:last]; `said` gets that."""
    observations, _, _, _, returns = data
    samples = last - first
    g[:] = 0
    loss = 0.0
    for begin in range(first, last, _B):
        count = min(_B, last - begin)
        _load(observations, rows, begin, count, centre, scale, limit, a)
        out = _forward(w, widths, a)
        for s in range(_B):
            d[out * _B + s] = np.float32(0)
        for s in range(count):
            error = a[out * _B + s] - returns[rows[begin + s]]
            loss += error * error
            d[out * _B + s] = weight * np.float32(2) * error / np.float32(samples)
        _backward(w, widths, a, d, out, g)
    said[1] = loss / samples


@_inlined
def _square(g):
    total = 0.0
    for k in range(np.uint64(len(g))):
        total += g[k] * g[k]
    return total


@_inlined
def _adam(w, g, mean, square, step, share, rate, beta1, beta2, epsilon):
    """One step, the `step`-th, with `share` of the gradient."""
    size = np.float32(rate / (1.0 - beta1**step))
    root = np.float32(math.sqrt(1.0 - beta2**step))
    b1, b2, small = np.float32(1.0 - beta1), np.float32(beta2), np.float32(epsilon)
    rest = np.float32(1.0 - beta2)
    for k in range(np.uint64(len(w))):
        slope = g[k] * share
        mean[k] += b1 * (slope - mean[k])
        square[k] = b2 * square[k] + rest * slope * slope
        w[k] -= size * mean[k] / (np.sqrt(square[k]) / root + small)


@intrinsic
def _arrive(typing, counter):
    """Add one to counter[0], seen by all cores at once."""

    def generate(context, builder, signature, arguments):
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        builder.atomic_rmw("add", array.data, ir.Constant(ir.IntType(64), 1), "seq_cst")
        return context.get_dummy_value()

    return types.void(counter), generate


@intrinsic
def _arrived(typing, counter):
    """counter[0] as all cores see it."""

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
    actor_part, critic_part, counter, norms, actor, critic, data, order, batch, scaling, actor_learns, loss,
    adam, said,
):  # fmt: skip
    """Every minibatch of every epoch, for the actor, the critic or both.

    Two threads may share it, one for each network: they meet once per minibatch, to add the squares of their
    gradients. Whichever way, the same numbers are computed in the same order.

    counter (1,) int64, 0 at first, NOBODY if the other thread has failed.
    norms (2, 2) float64, of even and odd minibatches.
    actor, critic: (weights, widths, moments (2, w), steps (1,), activations, their derivatives, gradient).
    data: observations (N, o), actions (N, a), log-probabilities, advantages and returns (N,), all float32.
    order: (epochs, N) uint64, which samples; batch: how many in a minibatch.
    scaling: (centre, scale, limit) of the observations.
    loss: (clip, entropy's weight, values' weight, greatest norm); adam: (rate, beta 1, beta 2, epsilon).
    said: (minibatches, 5) float64, STATISTICS.
    """
    centre, scale, limit = scaling
    clip, entropy, weight, most = loss
    rate, beta1, beta2, epsilon = adam
    w, widths, moments, steps, a, d, g = actor
    cw, cwidths, cmoments, csteps, ca, cd, cg = critic
    samples = np.uint64(order.shape[1])
    k = 0
    for epoch in range(len(order)):
        rows = order[epoch]
        for first in range(_0, samples, batch):
            last = min(first + batch, samples)
            now = norms[k % 2]
            if actor_part:
                _actor_gradient(
                    w, widths, data, rows, first, last, np.float32(clip), np.float32(entropy), actor_learns,
                    a, d, g, centre, scale, limit, said[k],
                )  # fmt: skip
                now[0] = _square(g) if actor_learns else 0.0
            if critic_part:
                _critic_gradient(
                    cw, cwidths, data, rows, first, last, np.float32(weight), ca, cd, cg,
                    centre, scale, limit, said[k],
                )  # fmt: skip
                now[1] = _square(cg)
            k += 1
            if not (actor_part and critic_part):
                _meet(counter, 2 * k)
            share = most / (math.sqrt(now[0] + now[1]) + 1e-6)
            share = np.float32(1.0 if share > 1.0 else share)
            if actor_part and actor_learns:
                steps[0] += 1
                _adam(w, g, moments[0], moments[1], steps[0], share, rate, beta1, beta2, epsilon)
            if critic_part:
                csteps[0] += 1
                _adam(cw, cg, cmoments[0], cmoments[1], csteps[0], share, rate, beta1, beta2, epsilon)
