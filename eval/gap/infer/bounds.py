"""Bounds of the coordinates along columns, and normal distributions truncated to them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np

from inclined_landing.eval.gap.model.columns import Candidates, Column, ParameterColumn

ACTIVE_SET_ROUNDS = 4


class Bounds(NamedTuple):
    """Bounds of the coordinates along columns."""

    low: np.ndarray  # (P,)
    high: np.ndarray  # (P,)
    # (n, 6) for the two columns of an effect about a reference: their indices, bounds of the size (their sum)
    # and of the second one's share of it.
    pairs: np.ndarray

    @staticmethod
    def of(candidates: Candidates, columns: Sequence[Column], unit: np.ndarray) -> Bounds:
        """Return the bounds in units (P,), from neutral."""
        low, high, pairs = np.full(len(columns), -np.inf), np.full(len(columns), np.inf), []
        for k, column in enumerate(columns):
            if not isinstance(column, ParameterColumn):
                continue
            p = candidates.parameter(column)
            least, most = (p.coordinate(x) / unit[k] for x in p.possible)
            if not column.fixed:
                low[k], high[k] = least, most
            elif k and columns[k - 1].effect == column.effect:
                effect = candidates.library[column.effect]
                about = effect.reference
                assert about is not None  # a fixed parameter is a reference
                first, last = sorted(effect.at_ends(1.0, x)[1] for x in about.possible)
                pairs.append((k - 1, k, least, most, first, last))
        return Bounds(low, high, np.array(pairs, float).reshape(-1, 6))


@numba.njit(cache=True, nogil=True)
def clipped(at, bounds):
    """Return coordinates (P,) clipped to the bounds."""
    result = np.minimum(np.maximum(at, bounds.low), bounds.high)
    for pair in bounds.pairs:
        i, j = int(pair[0]), int(pair[1])
        size = at[i] + at[j]
        share = min(max(at[j] / size if size != 0.0 else 0.5, pair[4]), pair[5])
        size = min(max(size, pair[2]), pair[3])
        result[i], result[j] = size * (1.0 - share), size * share
    return result


@numba.njit(cache=True, nogil=True)
def truncated_mode(at, covariance, own, bounds):
    """Return the mode (P,) of a truncated normal distribution and its log density relative to the mean.

    at (P,) mean, covariance (P, P); own (k,): the coordinates that have bounds.
    """
    # Active set A of coordinates fixed at their bounds c_A; the others conditioned on them:
    #   x = m + C_.A C_AA^-1 (c_A - m_A),   log p(x) - log p(m) = -1/2 (c_A - m_A)' C_AA^-1 (c_A - m_A)
    outside, result, log_ratio = np.zeros(len(at), np.bool_), at.copy(), 0.0
    for _ in range(ACTIVE_SET_ROUNDS):
        within, inside = clipped(result, bounds), True
        for k in own:
            if abs(within[k] - result[k]) > 1e-9 * (1.0 + abs(within[k])):
                outside[k], inside = True, False
        if inside:
            break
        active = np.flatnonzero(outside)
        of_active, shift = np.ascontiguousarray(covariance[:, active]), (within - at)[active]
        solved = np.linalg.solve(of_active[active] + 1e-9 * np.eye(len(active)), shift)
        result, log_ratio = at + of_active @ solved, -0.5 * (shift @ solved)
        result[active] = within[active]
    return result, log_ratio
