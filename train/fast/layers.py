"""Compiled dense tanh networks: products, forward and backward pass, in blocks of samples.

A network consists of one vector of float32 weights, for each layer (outputs, inputs) and then the bias, as in
torch, and the widths of its layers; that of an actor ends with the logarithm of its standard deviations.
Activations are stored in blocks (width, BLOCK), samples last, so that every inner loop runs over a fixed
number of neighbours. Products are computed in tiles of two rows and four columns, which fit into sixteen
vector registers. Indices are unsigned, which avoids a check for negative ones before each access.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

BLOCK = 128  # samples in a block; 128 rows of 128 float32 are the first-level cache twice
_B = np.uint64(BLOCK)
_0, _1, _2, _3, _4 = (np.uint64(k) for k in range(5))

# tanh(x) = x P(x^2) / Q(x^2) for |x| <= 8: relative error 6.5e-9 before rounding, 3.1e-7 in float32; from
# reweighted least squares at Chebyshev nodes; coefficients of the powers from 0. At 8 tanh is 1 - 2.3e-7.
_LIMIT = np.float32(8.0)
_P = tuple(map(np.float32, (0.9999999936, 0.1344453831, 3.571645855e-3, 2.189544937e-5, 1.523151571e-8)))
_Q = tuple(map(np.float32, (1.0, 0.4677786566, 2.616462504e-2, 3.411370214e-4, 8.522894192e-7)))

# Sums may be reordered (no `nnan`: what is not finite stays so); division by zero is IEEE's.
_OPTIONS = {"cache": True, "fastmath": {"reassoc", "contract", "nsz"}, "error_model": "numpy", "nogil": True}
compiled = numba.njit(**_OPTIONS, no_cfunc_wrapper=True)
# Everything that Python does not call is inlined. Else the process that compiles and one that loads from
# numba's cache link different copies of it, whose sums are in another order: other bits, another training.
# That cache does not notice a change of this file alone: save kernels.py too.
inlined = numba.njit(**_OPTIONS, forceinline=True, no_cfunc_wrapper=True)
# What is large and called at one place only is part of its caller already for numba, not compiled twice.
once = numba.njit(**_OPTIONS, inline="always")


class Scaling(NamedTuple):
    """The scaling of observations o: clip((o - centre)/scale, -limit, limit)."""

    centre: np.ndarray  # (o,) float32
    scale: np.ndarray  # (o,) float32
    limit: np.float32


class _Matrix(NamedTuple):
    """A matrix within a vector of weights: entry (j, i) is weights[first + j by_row + i by_column]."""

    weights: np.ndarray
    first: np.uint64
    by_row: np.uint64
    by_column: np.uint64
    rows: np.uint64
    columns: np.uint64


@inlined
def _multiply(matrix, a, from_row, z, to_row):
    """Add to z, from a row on, the product of the matrix and the rows of a from a row on."""
    # z_j += sum_i w_ji a_i
    w, first, by_row, by_column, rows, columns = matrix
    j = _0
    while j + _2 <= rows:
        z0 = (to_row + j) * _B
        z1 = z0 + _B
        i = _0
        while i + _4 <= columns:
            p = first + j * by_row + i * by_column
            q = p + by_row
            c1, c2, c3 = by_column, _2 * by_column, _3 * by_column
            w00, w01, w02, w03 = w[p], w[p + c1], w[p + c2], w[p + c3]
            w10, w11, w12, w13 = w[q], w[q + c1], w[q + c2], w[q + c3]
            a0 = (from_row + i) * _B
            a1, a2, a3 = a0 + _B, a0 + _2 * _B, a0 + _3 * _B
            for s in range(_B):
                x0, x1, x2, x3 = a[a0 + s], a[a1 + s], a[a2 + s], a[a3 + s]
                z[z0 + s] += w00 * x0 + w01 * x1 + w02 * x2 + w03 * x3
                z[z1 + s] += w10 * x0 + w11 * x1 + w12 * x2 + w13 * x3
            i += _4
        while i < columns:
            p, a0 = first + j * by_row + i * by_column, (from_row + i) * _B
            w0, w1 = w[p], w[p + by_row]
            for s in range(_B):
                x = a[a0 + s]
                z[z0 + s] += w0 * x
                z[z1 + s] += w1 * x
            i += _1
        j += _2
    while j < rows:
        z0 = (to_row + j) * _B
        for i in range(columns):
            weight, a0 = w[first + j * by_row + i * by_column], (from_row + i) * _B
            for s in range(_B):
                z[z0 + s] += weight * a[a0 + s]
        j += _1


@inlined
def _dot(d, d0, a, a0):
    """Return the scalar product of two rows of blocks over the samples."""
    total = np.float32(0)
    for s in range(_B):
        total += d[d0 + s] * a[a0 + s]
    return total


@inlined
def _add(g, p, x0, x1, x2, x3):
    """Add four numbers to those of g beginning at p."""
    g[p] += x0
    g[p + _1] += x1
    g[p + _2] += x2
    g[p + _3] += x3


@once
def _outer(d, a, row, rows, from_row, columns, g, first):
    """Add the outer product of rows of d and a, summed over samples, to the gradient g from `first` on."""
    # g_ji += sum_s d_j a_i
    zero = np.float32(0)
    j = _0
    while j + _2 <= rows:
        d0 = (row + j) * _B
        d1 = d0 + _B
        i = _0
        while i + _4 <= columns:
            a0 = (from_row + i) * _B
            a1, a2, a3 = a0 + _B, a0 + _2 * _B, a0 + _3 * _B
            g00 = g01 = g02 = g03 = g10 = g11 = g12 = g13 = zero
            for s in range(_B):
                x0, x1, x2, x3 = a[a0 + s], a[a1 + s], a[a2 + s], a[a3 + s]
                y0, y1 = d[d0 + s], d[d1 + s]
                g00, g01, g02, g03 = g00 + y0 * x0, g01 + y0 * x1, g02 + y0 * x2, g03 + y0 * x3
                g10, g11, g12, g13 = g10 + y1 * x0, g11 + y1 * x1, g12 + y1 * x2, g13 + y1 * x3
            p = first + j * columns + i
            _add(g, p, g00, g01, g02, g03)
            _add(g, p + columns, g10, g11, g12, g13)
            i += _4
        while i < columns:
            p, a0 = first + j * columns + i, (from_row + i) * _B
            g[p] += _dot(d, d0, a, a0)
            g[p + columns] += _dot(d, d1, a, a0)
            i += _1
        j += _2
    while j < rows:
        for i in range(columns):
            g[first + j * columns + i] += _dot(d, (row + j) * _B, a, (from_row + i) * _B)
        j += _1


@once
def tanh(z, first, count):
    """Replace `count` numbers by their hyperbolic tangents."""
    for k in range(first, first + count):
        x = z[k]
        # tanh(x) = x P(x^2)/Q(x^2)
        x = -_LIMIT if x < -_LIMIT else x  # NaN passes both
        x = _LIMIT if x > _LIMIT else x
        y = x * x
        p = (((_P[4] * y + _P[3]) * y + _P[2]) * y + _P[1]) * y + _P[0]
        q = (((_Q[4] * y + _Q[3]) * y + _Q[2]) * y + _Q[1]) * y + _Q[0]
        z[k] = x * p / q


@inlined
def load(inputs, rows, first, count, scaling, a):
    """Write the scaled inputs (N, o) of `count` samples rows[first:] to the block a, padded with 0."""
    centre, scale, limit = scaling
    for i in range(np.uint64(len(centre))):
        for s in range(_B):
            a[i * _B + s] = np.float32(0)
        for s in range(count):
            x = (inputs[rows[first + s], i] - centre[i]) / scale[i]
            x = -limit if x < -limit else x
            a[i * _B + s] = limit if x > limit else x


@inlined
def forward(w, widths, a):
    """Write the activations of all layers after the inputs in a; return the row where outputs begin."""
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
            tanh(a, to_row * _B, rows * _B)
        row, first = to_row, bias + rows
    return row


@inlined
def backward(w, widths, a, d, row, g):
    """Add the gradient with respect to the weights to g, from that with respect to the outputs in d."""
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
