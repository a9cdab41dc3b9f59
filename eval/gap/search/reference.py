"""What flights of a vehicle leave uncertain of it: the posterior that `identify` writes beside its vehicle."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from inclined_landing.eval.gap.search.evidence import Column, Problem
from inclined_landing.eval.gap.search.posterior import Local, between_flights, looks_alike, slabs


@dataclasses.dataclass(frozen=True)
class Reference:
    """How far a vehicle may be off along every column of the library: normal about nothing."""

    columns: tuple[Column, ...]
    covariance: np.ndarray  # (P, P) in the units of the parameters

    def covariance_of(self, columns: Sequence[Column]) -> np.ndarray:
        """(Q, Q) of other columns: where an effect has a size its reference stands, else it is at two ends."""
        share = np.array(
            [
                [
                    float((c.effect, c.parameter) == (k.effect, k.parameter) and c.fixed in ((), k.fixed))
                    for k in self.columns
                ]
                for c in columns
            ]
        ).reshape(len(columns), len(self.columns))
        return share @ self.covariance @ share.T

    @staticmethod
    def of(problem: Problem, inflation: np.ndarray) -> Reference:
        """The posterior of the vehicle of `problem`, every effect as free as real vehicles are."""
        columns = problem.columns({}, list(problem.library))
        near = problem.linearise({}, columns).weighted(inflation)
        problem.alike = looks_alike(near)
        problem.between = between_flights(problem, near)
        local = Local.of(problem, near, {})
        _, covariance = local.fit(frozenset(problem.library))
        return Reference(tuple(columns), covariance * np.outer(local.unit, local.unit))
